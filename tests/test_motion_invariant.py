"""Motion-invariant encoding: same-phi batches, U-blocks against their definition, transfer with its controls."""

from __future__ import annotations

from dataclasses import asdict, replace

import numpy as np
import pytest
import torch

from evaluation.intrinsic import ReadFrames, transfer_rows, variance_row
from evaluation.recovery import recovery_rows
from models.checkpoint import save_model
from models.intrinsic_fitting import (
    SamePhiStep,
    TrainedOn,
    build_motion_invariant,
    decode_frames,
    embedding_loss,
    encode_frames,
    fit_motion_invariant,
    load_motion_invariant,
    motion_invariant_loss,
    pooled,
    save_motion_invariant,
)
from models.motion_features import MotionTrack
from models.motion_history import MotionHistory
from models.motion_invariant import VARIANTS, MotionInvariantConfig, UBlock
from models.same_phi import IntrinsicFrames, SamePhiBatches
from models.shape_descriptor import ResidualPcaDescriptor, ShapeDescriptorConfig
from models.training import TrainingSettings

SMALL = {"latent": 4, "width": 24, "blocks": 2, "subnetworks": 5, "motion_hidden": (24,), "batch": 24}
CLIPS, FRAMES = 4, 12
SKIRT = TrainedOn("skirt", "a" * 64)


def material_frames(phis: range) -> tuple[IntrinsicFrames, dict[int, dict[str, float]]]:
    """Descriptors that are a material times one function of the motion plus another function of it."""
    rng = np.random.default_rng(0)
    mix, plain = rng.normal(size=(6, 6)), rng.normal(size=(6, 6))
    rows: dict[str, list] = {"descriptors": [], "signatures": [], "phi": [], "clip": [], "parameters": []}
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
            rows["parameters"].append(np.full((FRAMES, 1), np.log(stiffness)))
    joined = {name: np.concatenate(values) for name, values in rows.items()}
    for name in ("descriptors", "signatures", "parameters"):
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


def test_halves_of_a_batch_share_no_clip():
    rng = np.random.default_rng(0)
    clip = rng.integers(0, 5, 40)
    sampler = SamePhiBatches(np.zeros(40), clip, 40)
    half = sampler.halves(np.arange(40), rng)
    assert set(clip[half == 0]).isdisjoint(clip[half == 1]) and set(half) == {0, 1}
    alone = SamePhiBatches(np.zeros(8), np.zeros(8), 8)
    assert sorted(alone.halves(np.arange(8), rng)) == [0] * 4 + [1] * 4


@pytest.mark.parametrize(("variant", "together"), [("paper", 1), ("pooled", 3), ("concatenate", 2)])
def test_training_gets_batches_of_one_phi(variant, together, tmp_path, monkeypatch):
    """What reaches the loss in training, not only what the sampler gives; every frame comes once an epoch."""
    frames, _ = material_frames(range(3))
    owner = {row.tobytes(): phi for row, phi in zip(frames.descriptors, frames.phi, strict=True)}
    counts, seen = [], 0

    def watched(module, step):
        nonlocal seen
        phis = np.array([owner[row.numpy().tobytes()] for row in step.descriptor])
        groups = step.group.numpy()
        for group in np.unique(groups):
            counts.append(len(set(phis[groups == group])))
        assert (phis == phis[step.partners.numpy()]).all() and (groups == groups[step.partners.numpy()]).all()
        seen += len(phis)
        return motion_invariant_loss(module, step)

    monkeypatch.setattr("models.intrinsic_fitting.motion_invariant_loss", watched)
    settings = TrainingSettings(epochs=1, device="cpu")
    config = MotionInvariantConfig(variant=variant, batches_a_step=together, **SMALL)
    fit_motion_invariant(frames, config, settings, tmp_path)
    assert counts == [1] * 6 and seen == len(frames.phi)


def test_lonely_frame_is_refused():
    with pytest.raises(ValueError, match="phi 4 has one frame only"):
        SamePhiBatches(np.array([1, 1, 4]), np.zeros(3), 8)
    with pytest.raises(ValueError, match="2 descriptors, but 3 phi"):
        IntrinsicFrames(np.zeros((2, 3)), np.zeros((2, 4)), np.zeros(3), np.zeros(2), np.zeros((2, 0)))


def test_histories_are_those_of_their_own_track():
    rng = np.random.default_rng(0)
    tracks = [
        MotionTrack(rng.normal(size=(n, 24, 3)), rng.normal(size=(n, 24, 3)), lead, 30.0)
        for n, lead in ((9, 4), (7, 2))
    ]
    history = MotionHistory(tracks, "joints", 3)
    assert history.shape == (10, 4 * 72) == (len(history), history[:].shape[1])
    rotation, position = tracks[1].pelvis_frames()
    for frame, row in ((2, 5), (6, 9)):  # the first and the last wanted frame of the second track
        past = tracks[1].joints[np.maximum(frame - np.arange(4), 0)]
        expected = (past - position[frame]) @ rotation[frame]
        assert np.allclose(history[np.array([row])].reshape(4, 24, 3), expected, atol=1e-5)
    assert np.array_equal(history.take(np.array([9, 5]), axis=0)[:1], history[[9]])
    features = MotionHistory(tracks, "features", 4)
    assert features.shape == (10, 4 * 78)  # 0, 1, 2, 3 frames back, and not yet 5
    longer = MotionHistory(tracks, "features", 100)[:].reshape(
        10, -1, 78
    )  # than the tracks: there the body stood still
    first = MotionHistory(tracks, "features", 4)[:].reshape(10, -1, 78)
    assert longer.shape[1] == 13 and np.array_equal(longer[:, :4], first)
    assert np.array_equal(longer[4, 5:], np.tile(longer[0, 4], (8, 1))) and not np.array_equal(
        longer[4, 0], longer[0, 0]
    )
    with pytest.raises(ValueError, match="not one of joints, features"):
        MotionHistory(tracks, "pose", 3)


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
    network = build_motion_invariant(MotionInvariantConfig(**SMALL), 6, 6, 1).eval()
    blend = network.context(torch.randn(9, 6) * 100)[0]
    assert blend.shape == (9, 5)
    assert (blend >= 0).all()
    assert torch.allclose(blend.sum(1), torch.ones(9), atol=1e-6)
    with pytest.raises(ValueError, match=r"expected shape \[B, 6\], got \[9, 7\]"):
        network.context(torch.zeros(9, 7))


def test_loss_terms_have_the_papers_weights(tmp_path, monkeypatch):
    torch.manual_seed(0)
    frames, _ = material_frames(range(1))
    steps = []
    monkeypatch.setattr(
        "models.intrinsic_fitting.motion_invariant_loss",
        lambda module, step: steps.append(step) or motion_invariant_loss(module, step),
    )
    sizes = SMALL | {"batch": 100}
    fit_motion_invariant(frames, MotionInvariantConfig(**sizes), TrainingSettings(epochs=1, device="cpu"), tmp_path)
    network, step = build_motion_invariant(MotionInvariantConfig(**sizes), 6, 6, 1).eval(), steps[0]
    latent = encode_frames(network, frames)
    rebuilt = decode_frames(network, latent, frames.signatures)
    variance = latent.var(axis=0).mean()
    own = np.sqrt(((rebuilt - frames.descriptors) ** 2).mean(1)).mean()
    with torch.no_grad():
        terms = motion_invariant_loss(network, step)
    assert set(terms) == {"total", "variance", "own"}
    assert float(terms["variance"]) == pytest.approx(variance, rel=1e-4)
    assert float(terms["total"]) == pytest.approx(variance + 0.1 * own, rel=1e-4)


def test_embedding_loss_is_zero_where_distances_agree():
    network = build_motion_invariant(MotionInvariantConfig(**SMALL | {"variant": "embedding", "latent": 2}), 2, 6, 2)
    network.encode = lambda descriptor, context, parameters: descriptor
    values = torch.rand(20, 2)
    turned = values @ torch.tensor([[0.6, -0.8], [0.8, 0.6]])
    assert float(embedding_loss(network, turned, torch.zeros(20, 6), values)["total"]) < 1e-9
    assert float(embedding_loss(network, 2 * turned, torch.zeros(20, 6), values)["total"]) > 0.01


def test_embedding_fixes_the_encoder_before_the_decoder_is_trained(tmp_path):
    network, _ = fitted("embedding", tmp_path, 4)
    encoder = torch.load(tmp_path / "encoder" / "checkpoint.pt", weights_only=True)["module"]
    now = network.state_dict()
    same = {name for name in now if torch.equal(now[name], encoder[name])}
    assert {
        n for n in now if n.startswith(("encoder", "motion_encoder")) and "batches" not in n and "running" not in n
    } <= same
    assert not {n for n in now if n.startswith("decoder") and n.endswith("weight")} & same


def test_the_decoder_of_ours_learns_from_the_true_parameters_alone():
    torch.manual_seed(0)
    network = build_motion_invariant(MotionInvariantConfig(**SMALL | {"variant": "pooled"}), 6, 6, 1)
    whole = torch.arange(8)
    step = SamePhiStep(
        torch.randn(8, 6), torch.randn(8, 6), torch.tensor([[0.5], [-1.0]]).repeat_interleave(4, 0),
        whole, whole // 4, whole % 2, torch.ones(8),
    )  # fmt: skip
    reached = {}
    for name, term in motion_invariant_loss(network, step).items():
        network.zero_grad(set_to_none=True)
        term.backward(retain_graph=True)
        reached[name] = {n.split(".")[0] for n, p in network.named_parameters() if p.grad is not None and p.grad.any()}
    assert reached["known"] == {"motion_encoder", "base", "blend", "decoder", "embedding"}
    assert reached["cross"] == {"encoder"} and reached["parameters"] == {"encoder", "head"}
    assert reached["match"] == {"encoder"}
    assert all(p.requires_grad for p in network.parameters())


@pytest.mark.filterwarnings("ignore:Initializing zero-element tensors")
def test_ours_does_without_parameters(tmp_path):
    frames, _ = material_frames(range(3))
    frames = IntrinsicFrames(frames.descriptors, frames.signatures, frames.phi, frames.clip, np.zeros((144, 0)))
    settings = TrainingSettings(epochs=1, device="cpu")
    network = fit_motion_invariant(frames, MotionInvariantConfig(**SMALL | {"variant": "pooled"}), settings, tmp_path)
    assert np.isfinite(encode_frames(network, frames)).all()


def test_evidence_of_frames_adds_up_beside_the_prior():
    network = build_motion_invariant(MotionInvariantConfig(**SMALL | {"variant": "pooled"}), 6, 6, 1)
    value, weight = np.array([[2.0], [4.0]]), np.array([[1.0], [3.0]])
    assert pooled(network, value, weight) == pytest.approx(14.0 / 5.0)
    assert pooled(network, value, 0 * weight) == pytest.approx(0.0)  # who knows nothing says the mean material
    paper = build_motion_invariant(MotionInvariantConfig(**SMALL), 6, 6, 1)
    assert pooled(paper, value, np.ones((2, 1))) == pytest.approx(3.0)


def test_a_network_of_another_garment_or_descriptor_is_refused_by_name(tmp_path):
    network, path = build_motion_invariant(MotionInvariantConfig(**SMALL), 6, 6, 1), tmp_path / "model.pt"
    save_motion_invariant(path, network, SKIRT)
    with pytest.raises(ValueError, match=r"model\.pt was trained on the garment 'skirt', not on 'coat'; run"):
        load_motion_invariant(path, replace(SKIRT, garment="coat"))
    with pytest.raises(ValueError, match="trained on another shape descriptor of 'skirt' than the run has; run"):
        load_motion_invariant(path, replace(SKIRT, descriptor="b" * 64))
    assert load_motion_invariant(path).config == network.config
    # As files were before they said so.
    save_model(path, "motion_invariant", asdict(network.config), network)
    assert load_motion_invariant(path, SKIRT).config == network.config
    save_model(path, "motion_invariant", asdict(network.config) | {"colour": 1}, network)
    with pytest.raises(ValueError, match=r"model\.pt is damaged, or of another version of this program \(.*colour"):
        load_motion_invariant(path, SKIRT)


@pytest.mark.parametrize("variant", VARIANTS)
def test_same_seed_same_network_and_file_round_trip(variant, tmp_path):
    first, frames = fitted(variant, tmp_path / "a", 1)
    second, _ = fitted(variant, tmp_path / "b", 1)
    save_motion_invariant(tmp_path / "model.pt", first, SKIRT)
    loaded = load_motion_invariant(tmp_path / "model.pt", SKIRT)
    latents = encode_frames(first, frames)
    for other in (second, loaded):
        assert np.array_equal(latents, encode_frames(other, frames))
    rebuilt = decode_frames(first, latents[0], frames.signatures)
    assert np.array_equal(rebuilt, decode_frames(loaded, latents[0], frames.signatures))
    assert rebuilt.shape == frames.descriptors.shape


@pytest.mark.parametrize("variant", ["paper", "concatenate"])
def test_network_overfits_a_batch(variant, tmp_path):
    frames, _ = material_frames(range(1))
    settings = TrainingSettings(epochs=150, learning_rate=1e-2, schedule="cosine", device="cpu")
    sizes = SMALL | {"batch": 48, "motion_batch_norm": False, "motion_dropout": 0.0, "subnetworks": 12}
    network = fit_motion_invariant(frames, MotionInvariantConfig(variant=variant, **sizes), settings, tmp_path)
    latents = encode_frames(network, frames)
    rebuilt = decode_frames(network, latents, frames.signatures)
    assert np.std(rebuilt - frames.descriptors) < 0.5 * np.std(frames.descriptors)


@pytest.mark.parametrize(("variant", "epochs"), [("cross", 8), ("pooled", 15)])
def test_z_separates_material_from_motion(variant, epochs, tmp_path):
    """On unseen materials z transfers, a wrong z and no z do not, and the material can be read from it."""
    network, training = fitted(variant, tmp_path, epochs)
    tests, test_parameters = material_frames(range(50, 58))
    descriptor = identity_descriptor()
    with torch.no_grad():
        vertices = descriptor.decode(torch.from_numpy(tests.descriptors)).numpy()
    training, tests = (ReadFrames.of(network, frames) for frames in (training, tests))
    rows = transfer_rows(descriptor, tests, vertices, training, "unseen_parameters")
    error = {row["quantity"]: row["rmse_mm"] for row in rows}
    assert error["descriptor floor"] < 1.0
    assert error["transfer, z of a clip"] < 0.6 * error["mean z"]
    assert error["transfer, z of a clip"] < 0.6 * error["wrong phi, z of a clip"]
    assert all(row["sequences"] == 8 * CLIPS for row in rows)
    ratios = variance_row(tests, "unseen_parameters")
    assert ratios["clip_ratio"] < 0.1 and ratios["clip_ratio"] < ratios["ratio"]
    _, parameters = material_frames(range(12))
    recovered = recovery_rows(training, {"x": tests}, parameters | test_parameters, {"stiffness"})
    assert [row["parameter"] for row in recovered] == ["stiffness"]
    assert recovered[0]["r_squared"] > 0.8
