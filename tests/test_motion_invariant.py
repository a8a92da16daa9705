"""Motion-invariant encoding: same-phi batches, U-blocks against their definition, transfer with its controls."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from evaluation.intrinsic import recovery_rows, sequences_of, transfer_rows, variance_ratio, variance_row
from models.motion_invariant import (
    VARIANTS,
    MotionInvariantConfig,
    MotionInvariantNetwork,
    UBlock,
    decode_frames,
    encode_frames,
    fit_motion_invariant,
    load_motion_invariant,
    motion_invariant_loss,
    save_motion_invariant,
)
from models.same_phi import IntrinsicFrames, SamePhiBatches
from models.shape_descriptor import ResidualPcaDescriptor, ShapeDescriptorConfig
from models.training import TrainingSettings

SMALL = {"latent": 4, "width": 24, "blocks": 2, "subnetworks": 5, "motion_hidden": (24,), "batch": 24}
CLIPS, FRAMES = 4, 12


def material_frames(phis: range) -> tuple[IntrinsicFrames, dict[int, dict[str, float]]]:
    """Descriptors that are a material times one function of the motion plus another function of it."""
    rng = np.random.default_rng(0)
    mix, plain = rng.normal(size=(6, 6)), rng.normal(size=(6, 6))
    rows: dict[str, list] = {"descriptors": [], "signatures": [], "phi": [], "clip": []}
    parameters = {}
    for phi in phis:
        stiffness = float(np.exp(np.random.default_rng(100 + phi).uniform(-1.5, 1.5)))
        parameters[phi] = {"stiffness": stiffness, "gravity": 9.81}
        for clip in range(CLIPS):
            motion = np.random.default_rng(clip).normal(size=(FRAMES, 6))
            rows["descriptors"].append(np.log(stiffness) * (1.5 + np.tanh(motion @ mix)) + 0.5 * np.sin(motion @ plain))
            rows["signatures"].append(motion)
            rows["phi"].append(np.full(FRAMES, phi))
            rows["clip"].append(np.full(FRAMES, clip))
    joined = {name: np.concatenate(values) for name, values in rows.items()}
    for name in ("descriptors", "signatures"):
        joined[name] = joined[name].astype(np.float32)
    return IntrinsicFrames(**joined), parameters


def fitted(variant: str, folder, epochs: int, seed: int = 0):
    frames, _ = material_frames(range(12))
    settings = TrainingSettings(epochs=epochs, learning_rate=3e-3, schedule="cosine", device="cpu", seed=seed)
    return fit_motion_invariant(frames, MotionInvariantConfig(variant=variant, **SMALL), settings, folder), frames


def identity_descriptor() -> ResidualPcaDescriptor:
    """A descriptor of a two-triangle sheet whose code is the first six of its coordinates."""
    faces = np.array([[0, 1, 2], [1, 3, 2]])
    config = ShapeDescriptorConfig(variant="residual-pca", code=6, hidden=(2,), components=6)
    module = ResidualPcaDescriptor(config, faces, 4, 6)
    module.components.copy_(torch.eye(6, 12))
    return module.eval()


def test_every_batch_has_one_phi_and_every_frame_comes_once():
    rng = np.random.default_rng(0)
    phi = rng.integers(0, 5, 300) * 7
    clip = rng.integers(0, 3, 300)
    sampler = SamePhiBatches(phi, clip, 32)
    seen, order = [], []
    for frames, partners in sampler.epoch(np.random.default_rng(1)):
        assert len(np.unique(phi[frames])) == 1
        assert 2 <= len(frames) <= 32
        assert sorted(partners) == list(range(len(frames)))
        # No clip has over half of such a batch, so every frame gets one of another clip.
        if np.unique(clip[frames], return_counts=True)[1].max() <= len(frames) / 2:
            assert (clip[frames] != clip[frames[partners]]).all()
        seen.append(frames)
        order.append(phi[frames[0]])
    assert sorted(np.concatenate(seen)) == list(range(300))
    assert order != sorted(order)
    again = [frames for frames, _ in sampler.epoch(np.random.default_rng(1))]
    other = [frames for frames, _ in sampler.epoch(np.random.default_rng(2))]
    assert all(np.array_equal(a, b) for a, b in zip(seen, again, strict=True))
    assert not all(np.array_equal(a, b) for a, b in zip(seen, other, strict=True))


def test_training_gets_batches_of_one_phi(tmp_path, monkeypatch):
    """What reaches the loss in training, not only what the sampler gives."""
    frames, _ = material_frames(range(3))
    owner = {row.tobytes(): phi for row, phi in zip(frames.descriptors, frames.phi, strict=True)}
    counts = []

    def watched(module, descriptor, signature, partners):
        counts.append(len({owner[row.numpy().tobytes()] for row in descriptor}))
        return motion_invariant_loss(module, descriptor, signature, partners)

    monkeypatch.setattr("models.motion_invariant.motion_invariant_loss", watched)
    settings = TrainingSettings(epochs=1, device="cpu")
    fit_motion_invariant(frames, MotionInvariantConfig(**SMALL), settings, tmp_path)
    assert counts == [1] * 6


def test_lonely_frame_is_refused():
    with pytest.raises(ValueError, match="phi 4 has one frame only"):
        SamePhiBatches(np.array([1, 1, 4]), np.zeros(3), 8)
    with pytest.raises(ValueError, match="2 descriptors, but 3 phi"):
        IntrinsicFrames(np.zeros((2, 3)), np.zeros((2, 4)), np.zeros(3), np.zeros(2))


def test_u_block_equals_its_definition():
    torch.manual_seed(0)
    block = UBlock(7, 5, 6).double()
    torch.nn.init.normal_(block.bias)
    x, blend = torch.randn(4, 7).double(), torch.rand(4, 6).double()
    expected = torch.zeros(4, 5).double()
    for i in range(6):
        expected += blend[:, i : i + 1] * (x @ block.weight[i] + block.bias[i])
    assert torch.allclose(block(x, blend), block.activation(expected), atol=1e-6)


def test_u_blocks_keep_the_size_of_their_input():
    """Ten blocks of independently drawn sub-networks would shrink it by 30^(10/2)."""
    torch.manual_seed(0)
    x = torch.randn(64, 100)
    blend = torch.full((64, 30), 1 / 30)
    for _ in range(10):
        x = UBlock(100, 100, 30)(x, blend)
    assert 0.01 < x.std() < 10.0


def test_blending_weights_sum_to_one():
    network = MotionInvariantNetwork(MotionInvariantConfig(**SMALL), 6, 6).eval()
    blend = network.blend(torch.randn(9, 6) * 100)
    assert blend.shape == (9, 5)
    assert (blend >= 0).all()
    assert torch.allclose(blend.sum(1), torch.ones(9), atol=1e-6)
    with pytest.raises(ValueError, match=r"expected shape \[B, 6\], got \[9, 7\]"):
        network.blend(torch.zeros(9, 7))


def test_loss_terms_have_the_papers_weights():
    torch.manual_seed(0)
    frames, _ = material_frames(range(1))
    network = MotionInvariantNetwork(MotionInvariantConfig(**SMALL), 6, 6).eval()
    rows = torch.from_numpy(frames.descriptors), torch.from_numpy(frames.signatures)
    latent, rebuilt = network(*rows)
    variance = latent.detach().numpy().var(axis=0).mean()
    own = np.sqrt(((rebuilt.detach().numpy() - frames.descriptors) ** 2).mean(1)).mean()
    with torch.no_grad():
        terms = motion_invariant_loss(network, *rows, torch.arange(len(frames.phi)))
    assert "cross" not in terms
    assert float(terms["variance"]) == pytest.approx(variance, rel=1e-4)
    assert float(terms["total"]) == pytest.approx(variance + 0.1 * own, rel=1e-4)


@pytest.mark.parametrize("variant", VARIANTS)
def test_same_seed_same_network_and_file_round_trip(variant, tmp_path):
    first, frames = fitted(variant, tmp_path / "a", 1)
    second, _ = fitted(variant, tmp_path / "b", 1)
    save_motion_invariant(tmp_path / "model.pt", first)
    loaded = load_motion_invariant(tmp_path / "model.pt")
    latents = encode_frames(first, frames.descriptors, frames.signatures)
    for other in (second, loaded):
        assert np.array_equal(latents, encode_frames(other, frames.descriptors, frames.signatures))
    rebuilt = decode_frames(first, latents[0], frames.signatures)
    assert np.array_equal(rebuilt, decode_frames(loaded, latents[0], frames.signatures))
    assert rebuilt.shape == frames.descriptors.shape


@pytest.mark.parametrize("variant", ["paper", "cross", "concatenate"])
def test_network_overfits_a_batch(variant, tmp_path):
    frames, _ = material_frames(range(1))
    settings = TrainingSettings(epochs=400, learning_rate=5e-3, schedule="cosine", device="cpu")
    sizes = SMALL | {"batch": 48, "motion_batch_norm": False, "subnetworks": 12}
    network = fit_motion_invariant(frames, MotionInvariantConfig(variant=variant, **sizes), settings, tmp_path)
    latents = encode_frames(network, frames.descriptors, frames.signatures)
    rebuilt = decode_frames(network, latents, frames.signatures)
    assert np.std(rebuilt - frames.descriptors) < 0.3 * np.std(frames.descriptors)


def test_cross_variant_separates_material_from_motion(tmp_path):
    """On unseen materials z transfers, a wrong z and no z do not, and the material can be read from it."""
    network, training = fitted("cross", tmp_path, 60)
    tests, test_parameters = material_frames(range(50, 58))
    descriptor = identity_descriptor()
    with torch.no_grad():
        vertices = descriptor.decode(torch.from_numpy(tests.descriptors)).numpy()
    rows = transfer_rows(descriptor, network, tests, vertices, training, "unseen_parameters")
    error = {row["quantity"]: row["rmse_mm"] for row in rows}
    assert error["descriptor floor"] < 1.0
    assert error["transfer, z of a clip"] < 0.6 * error["motion only, mean z"]
    assert error["transfer, z of a clip"] < 0.6 * error["wrong phi, z of a clip"]
    assert all(row["sequences"] == 8 * CLIPS for row in rows)
    assert variance_row(network, tests, "unseen_parameters")["ratio"] < 0.5
    _, parameters = material_frames(range(12))
    recovered = recovery_rows(network, training, {"x": tests}, parameters | test_parameters, {"stiffness"})
    assert [row["parameter"] for row in recovered] == ["stiffness"]
    assert recovered[0]["r_squared"] > 0.8


def test_variance_ratio_by_hand():
    phi = np.array([0, 0, 1, 1])
    latents = np.array([[0.0], [2.0], [10.0], [12.0]])
    assert variance_ratio(latents, phi) == pytest.approx(1.0 / 25.0)
    assert variance_ratio(latents, np.zeros(4)) is None


def test_transfer_without_a_second_clip_is_refused(tmp_path):
    network, training = fitted("cross", tmp_path, 1)
    only = sequences_of(training)[(3, 1)]
    alone = IntrinsicFrames(*(getattr(training, n)[only] for n in ("descriptors", "signatures", "phi", "clip")))
    with pytest.raises(ValueError, match="nothing to transfer"):
        transfer_rows(identity_descriptor(), network, alone, np.zeros((FRAMES, 4, 3)), training, "x")
    rows = transfer_rows(
        identity_descriptor(), network, alone, np.zeros((FRAMES, 4, 3)), training, "x", sources=training
    )
    assert {row["sequences"] for row in rows} == {1}
