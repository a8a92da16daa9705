"""Motion generators beside the paper's: shapes, learning, causality, labels, density, files, refusals."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path

import numpy as np
import pytest
import torch

from body.model import Body
from geometry.rotations import matrix_from_6d
from models.action2motion import Action2Motion, Action2MotionConfig
from models.actor import Actor, ActorConfig
from models.body_layer import BodyLayer
from models.checkpoint import save_model
from models.dense_motion_cvae import DenseMotionConfig, DenseMotionCVAE, mirrored, spline_basis
from models.motion_fitting import fit_motion_cvae, load_motion_cvae, save_motion_cvae, variant_config
from models.motion_generator import MotionGenerator, gaussian_kl
from models.training import TrainingSettings
from tests.test_motion_cvae import LABELS, labelled_motions

torch.set_num_threads(1)
CONFIGS = {
    "dense": DenseMotionConfig(LABELS, 10, 8, latent=4, hidden=(32,), spacing=3),
    "actor": ActorConfig(LABELS, width=32, layers=1, heads=2, feed_forward=64, dropout=0.0),
    "action2motion": Action2MotionConfig(LABELS, width=32, latent=6),
}
EPOCHS = {"dense": 250, "actor": 250, "action2motion": 200}


def roots(labels: list[str]) -> np.ndarray:
    """Those that bow go up and down at their place, those that walk go ahead, all from somewhere."""
    time = np.arange(10)
    ways = {"bow": np.stack([0 * time, 0.1 * np.sin(time / 2.0), 0 * time], 1), "walk": np.outer(time, (0, 0, 0.03))}
    return np.stack([ways[label] + (5.0, 0.0, -3.0) for label in labels]).astype(np.float32)


@pytest.fixture(scope="module")
def body() -> Body:
    return Body.load("small")


@pytest.fixture(scope="module", params=list(CONFIGS))
def trained(request: pytest.FixtureRequest, body: Body, tmp_path_factory: pytest.TempPathFactory) -> MotionGenerator:
    poses, labels = labelled_motions(8)
    settings = TrainingSettings(
        epochs=EPOCHS[request.param], learning_rate=5e-3, schedule="cosine", checkpoint_every=1000
    )
    folder = tmp_path_factory.mktemp(request.param)
    config = CONFIGS[request.param]
    model, log = fit_motion_cvae(poses, labels, body, config, settings, 8, folder, root=roots(labels))
    assert {"pose", "kl", "total"} <= set(log.last())
    return model


def test_one_batch_is_learned(trained: MotionGenerator) -> None:
    poses, labels = labelled_motions(8)
    error = np.square(trained.reconstruct(poses, labels) - poses).mean()
    label_mean = np.mean([np.square(poses[n::2] - poses[n::2].mean((0, 1))).mean() for n in range(2)])
    assert error < 0.5 * label_mean


def test_samples_are_rotations_of_any_length_and_follow_the_label(trained: MotionGenerator) -> None:
    poses, _ = labelled_motions(8)
    generated = trained.sample(["bow", "walk"] * 4, 13, torch.Generator().manual_seed(1))
    assert generated.shape == (8, 13, 24, 6)
    matrix = matrix_from_6d(generated)
    np.testing.assert_allclose(matrix[..., :, :2].swapaxes(-1, -2).reshape(generated.shape), generated, atol=1e-5)
    for number in range(2):
        own = np.square(generated[number::2].mean((0, 1)) - poses[number::2].mean((0, 1))).mean()
        other = np.square(generated[number::2].mean((0, 1)) - poses[1 - number :: 2].mean((0, 1))).mean()
        assert own < 0.3 * other


def test_the_root_is_generated_by_those_that_travel_alone(trained: MotionGenerator) -> None:
    labels = ["bow", "walk"] * 4
    poses, root = trained.sample_motions(labels, 10, torch.Generator().manual_seed(1))
    np.testing.assert_array_equal(poses, trained.sample(labels, 10, torch.Generator().manual_seed(1)))
    assert (root is not None) == trained.travels == isinstance(trained, DenseMotionCVAE)
    if root is not None:
        true = roots(labels)
        assert np.abs(root - (true - true[:, :1] * (1.0, 0.0, 1.0))).mean() < 0.03
        np.testing.assert_array_equal(root[:, 0, [0, 2]], 0.0)


def test_same_seed_gives_the_same_motions_and_another_gives_others(trained: MotionGenerator) -> None:
    first, again, other = (trained.sample(["walk"], 10, torch.Generator().manual_seed(s)) for s in (1, 1, 2))
    np.testing.assert_array_equal(first, again)
    assert np.abs(first - other).max() > 1e-4


def test_file_round_trip_keeps_the_kind(trained: MotionGenerator, tmp_path: Path) -> None:
    save_motion_cvae(tmp_path / "model.pt", trained)
    again = load_motion_cvae(tmp_path / "model.pt")
    assert type(again) is type(trained) and again.config == trained.config
    seeds = (torch.Generator().manual_seed(5), torch.Generator().manual_seed(5))
    np.testing.assert_array_equal(again.sample(["bow"], 10, seeds[0]), trained.sample(["bow"], 10, seeds[1]))


def test_bad_input_is_named(trained: MotionGenerator) -> None:
    with pytest.raises(ValueError, match="label 'fly' was not trained; known: bow, walk"):
        trained.sample(["fly"], 10, torch.Generator())
    with pytest.raises(ValueError, match="at least 1 frame, got 0"):
        trained.sample(["bow"], 0, torch.Generator())
    with pytest.raises(ValueError, match=r"expected shape \[N, T, 24, 6\], got \[1, 10, 23, 6\]"):
        trained.reconstruct(np.zeros((1, 10, 23, 6)), ["bow"])


@pytest.fixture
def frame_level() -> Action2Motion:
    torch.manual_seed(3)
    return Action2Motion(CONFIGS["action2motion"]).eval()


def test_action2motion_never_looks_ahead(frame_level: Action2Motion) -> None:
    poses, labels = torch.as_tensor(labelled_motions(2)[0]), torch.tensor([0, 1])
    changed = poses.clone()
    changed[:, 6:] += 0.5
    with torch.no_grad():
        before, after = frame_level.rebuild(poses, labels), frame_level.rebuild(changed, labels)
    torch.testing.assert_close(before[:, :6], after[:, :6])
    assert (before[:, 6:] - after[:, 6:]).abs().max() > 1e-4


def test_action2motion_goes_on_from_its_own_frames(frame_level: Action2Motion) -> None:
    """A latent vector of one frame changes that frame and those after it, and the prior of the next ones."""
    condition = frame_level._condition(torch.tensor([0]), 8)
    latents = torch.zeros(2, 8, 6)
    latents[1, 3] = 2.0
    with torch.no_grad():
        (a, prior_a), (b, prior_b) = (
            frame_level._roll_out(condition, lambda t, *_, one=one: one[None, t]) for one in latents
        )
    moved = (a - b).abs().amax((0, 2))
    assert (moved[:3] == 0.0).all() and (moved[3:] > 1e-6).all()
    told = (prior_a - prior_b).abs().amax((0, 2))
    assert (told[:4] == 0.0).all() and (told[4:] > 1e-7).all()


def test_action2motion_with_teacher_forcing_sees_the_true_frame_before(frame_level: Action2Motion, body: Body) -> None:
    poses, labels = (torch.as_tensor(labelled_motions(2)[0]), torch.tensor([0, 1]))
    layer, losses = BodyLayer(body), {}
    for share in (0.0, 1.0):
        model = Action2Motion(Action2MotionConfig(LABELS, width=32, latent=6, teacher_forcing=share)).train()
        model.load_state_dict(frame_level.state_dict())
        torch.manual_seed(0)
        losses[share] = float(model.loss(layer, (poses, labels))["pose"])
    assert losses[0.0] != pytest.approx(losses[1.0], rel=1e-6)


def test_actor_restores_every_frame_from_the_latent_vector_and_its_time() -> None:
    torch.manual_seed(4)
    model = Actor(CONFIGS["actor"]).eval()
    with torch.no_grad():
        one, other = (model.decode(torch.full((1, 32), value), torch.tensor([0]), 9) for value in (0.0, 1.0))
        labelled = model.decode(torch.zeros(1, 32), torch.tensor([1]), 9)
    for changed in (other, labelled):
        assert ((one - changed).abs().amax((0, 2, 3)) > 1e-4).all()
    assert (one[:, 0] - one[:, 5]).abs().max() > 1e-4


def test_divergence_of_gaussians_is_the_analytic_one() -> None:
    generator = torch.Generator().manual_seed(0)
    mean, deviation, prior_mean, prior_deviation = (torch.randn(5, 3, generator=generator) for _ in range(4))
    own, prior = (torch.distributions.Normal(m, d.exp()) for m, d in ((mean, deviation), (prior_mean, prior_deviation)))
    expected = torch.distributions.kl_divergence(own, prior).sum(-1)
    torch.testing.assert_close(gaussian_kl(mean, deviation, prior_mean, prior_deviation), expected)


def test_settings_that_make_no_sense_are_refused() -> None:
    with pytest.raises(ValueError, match="teacher_forcing is a share from 0 to 1, got 2"):
        Action2MotionConfig(LABELS, teacher_forcing=2.0)
    with pytest.raises(ValueError, match="labels must be non-empty and different"):
        ActorConfig(())
    with pytest.raises(ValueError, match=r"kernel_width is from 0 to 1, got 1\.5"):
        DenseMotionConfig(LABELS, 10, 8, kernel_width=1.5)
    with pytest.raises(ValueError, match="unknown variant 'gan'; known: paper"):
        variant_config("gan", LABELS, np.zeros((8, 10, 24, 6)))
    assert variant_config("dense-no-vertex-loss", LABELS, np.zeros((8, 10, 24, 6)), vertex_weight=0.0).frames == 10


def _dense(kernel_width: float, clips: int = 40) -> tuple[DenseMotionCVAE, torch.Tensor, torch.Tensor]:
    """An untrained network whose density is fitted to the clips of its first label."""
    torch.manual_seed(5)
    config = DenseMotionConfig(LABELS, 10, clips, latent=3, hidden=(16,), spacing=3, kernel_width=kernel_width)
    model = DenseMotionCVAE(config).eval()
    poses = torch.as_tensor(labelled_motions(2 * clips)[0][::2])
    labels = torch.zeros(clips, dtype=torch.long)
    model.set_scaling(poses)
    with torch.no_grad():  # latent vectors that lie apart and are known well
        last = model.encoder[-1]
        last.weight[:3] *= 20.0
        last.bias[3:] -= 4.0
    model.finish(poses, labels)
    return model, poses, labels


@pytest.mark.parametrize("kernel_width", [0.0, 0.5, 1.0])
def test_drawn_latent_vectors_have_mean_and_spread_of_the_training_clips(kernel_width: float) -> None:
    model, poses, labels = _dense(kernel_width)
    seen: list[torch.Tensor] = []
    model.decode_motion = lambda latent, labels, frames: (seen.append(latent), None)
    many = torch.zeros(4000, dtype=torch.long)
    with torch.no_grad():
        model.draw(many, 10, torch.Generator().manual_seed(0))
        known, log_deviation = model.encode(poses, labels)
    drawn = seen[0]
    assert known.std(0).min() > 0.5 and log_deviation.exp().max() < 0.1
    spread = float(known.std(0).max())
    torch.testing.assert_close(drawn.mean(0), known.mean(0), atol=0.08 * spread, rtol=0.0)
    covariance = (
        torch.cov(known.T, correction=0) * (1.0 + 1.0 / len(known)) + (2.0 * log_deviation).exp().mean(0).diag()
    )
    expected = kernel_width**2 * covariance + (1.0 - kernel_width**2) * torch.cov(known.T, correction=0)
    torch.testing.assert_close(torch.cov(drawn.T), expected, atol=0.08 * spread**2, rtol=0.0)
    nearest = torch.cdist(drawn[:100], known).amin(1)
    assert (nearest < 1e-2).all() if kernel_width == 0.0 else (nearest > 0.1).any()


def test_a_label_without_clips_draws_from_its_prior() -> None:
    model, *_ = _dense(0.5)
    drawn = model.sample(["walk"] * 3, 10, torch.Generator().manual_seed(0))
    assert np.isfinite(drawn).all() and np.abs(drawn[0] - drawn[1]).max() > 1e-4


def test_beyond_the_trained_length_time_runs_back_and_forth() -> None:
    assert mirrored(9, 4).tolist() == [0, 1, 2, 3, 2, 1, 0, 1, 2] and mirrored(3, 1).tolist() == [0, 0, 0]
    model, *_ = _dense(0.5)
    long = model.sample(["bow"], 19, torch.Generator().manual_seed(0))
    np.testing.assert_allclose(long[:, :10], long[:, :8:-1], atol=1e-6)
    with pytest.raises(ValueError, match="trained on 10 frames and cannot encode 11"):
        model.reconstruct(np.zeros((1, 11, 24, 6)), ["bow"])


def test_spline_holds_a_constant_and_a_line() -> None:
    basis = spline_basis(13, 4)
    np.testing.assert_allclose(basis.sum(1).numpy(), 1.0, atol=1e-6)
    line = basis @ (4.0 * (torch.arange(basis.shape[1]) - 1.0))
    np.testing.assert_allclose(line.numpy(), np.arange(13.0), atol=1e-5)


def test_losses_of_root_and_steps_equal_their_definitions(body: Body) -> None:
    model, poses, labels = _dense(0.5)
    poses, labels, root = poses[:3], labels[:3], torch.as_tensor(roots(["walk"] * 3))
    root = root + torch.randn(root.shape, generator=torch.Generator().manual_seed(0))
    layer = BodyLayer(body)
    with torch.no_grad():
        parts = model.loss(layer, (poses, labels, root))
        predicted, made = model.decode_motion(model.encode(poses, labels)[0], labels, 10)
        true = root - root[:, :1] * torch.tensor([1.0, 0.0, 1.0])
        feet = [layer.joint_positions(layer.global_rotations(p), r) for p, r in ((predicted, made), (poses, true))]
        step = (feet[0] - feet[1])[:, :, [7, 8, 10, 11]].diff(dim=1).square().mean()
    assert float(parts["root"]) == pytest.approx(float((made - true).square().mean()), rel=1e-5)
    assert float(parts["step"]) == pytest.approx(float(step), rel=1e-3)
    only_root = (
        model.loss(layer, (poses, labels, root))["total"] - model.loss(layer, (poses, labels, 2.0 * root))["total"]
    )
    only_root.backward()  # the poses are not learned for the sake of the root
    assert all(p.grad is None or p.grad.abs().max() < 1e-7 for p in model.decoder.parameters())
    assert max(p.grad.abs().max() for p in model.traveller.parameters()) > 1e-5
    weights = {"pose": 1.0, "vertex": 1.0, "kl": 1e-5, "root": 0.5, "step": 10.0}
    assert float(parts["total"]) == pytest.approx(sum(w * float(parts[name]) for name, w in weights.items()), rel=1e-4)


def test_a_generator_that_travels_asks_for_roots_and_refuses_files_from_before(body: Body, tmp_path: Path) -> None:
    poses, labels = labelled_motions(8)
    settings = TrainingSettings(epochs=1)
    with pytest.raises(ValueError, match="also learns root translations, and none are given"):
        fit_motion_cvae(poses, labels, body, CONFIGS["dense"], settings, 8, tmp_path)
    with pytest.raises(ValueError, match=r"root: expected shape \[8, 10, 3\], got \[8, 9, 3\]"):
        fit_motion_cvae(poses, labels, body, CONFIGS["dense"], settings, 8, tmp_path, root=roots(labels)[:, :9])
    model = DenseMotionCVAE(CONFIGS["dense"])
    config = {"kind": "dense", **asdict(model.config)}
    del config["root_weight"]
    save_model(tmp_path / "old.pt", "motion_cvae", config, model)
    with pytest.raises(
        ValueError, match=r"old\.pt: a generator of kind dense from before it had root_weight; train it"
    ):
        load_motion_cvae(tmp_path / "old.pt")
