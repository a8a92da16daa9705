"""Motion generator and recognition network: shapes, learning, conditioning, determinism, files."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch

from body.model import Body
from geometry.rotations import axis_angle_to_6d, matrix_from_6d
from models.body_layer import BodyLayer
from models.motion_cvae import MotionCVAE, MotionCVAEConfig
from models.motion_fitting import (
    fit_motion_cvae,
    fit_recognition,
    load_motion_cvae,
    load_recognition,
    save_motion_cvae,
    save_recognition,
)
from models.recognition import RecognitionConfig
from models.training import TrainingSettings

torch.set_num_threads(1)
LABELS = ("bow", "walk")
SIZES = {"width": 32, "layers": 1, "heads": 2, "feed_forward": 64, "dropout": 0.0, "label_hidden": 8}


@pytest.fixture(scope="module")
def body() -> Body:
    return Body.load("small")


def labelled_motions(count: int, frames: int = 10) -> tuple[np.ndarray, list[str]]:
    """Two labels with poses of their own that swing with a random phase."""
    rng = np.random.default_rng(0)
    centre = rng.normal(0.0, 0.4, (2, 1, 24, 3))
    time = np.arange(frames)[:, None, None] / 3.0
    poses = [centre[n % 2] + 0.2 * np.sin(time + rng.uniform(0, 6)) for n in range(count)]
    return axis_angle_to_6d(np.stack(poses)).astype(np.float32), [LABELS[n % 2] for n in range(count)]


@pytest.fixture(scope="module")
def trained(body: Body, tmp_path_factory: pytest.TempPathFactory) -> MotionCVAE:
    poses, labels = labelled_motions(8)
    settings = TrainingSettings(epochs=200, learning_rate=5e-3, schedule="cosine", checkpoint_every=1000)
    config = MotionCVAEConfig(LABELS, **SIZES)
    folder = tmp_path_factory.mktemp("cvae")
    model, log = fit_motion_cvae(poses, labels, body, config, settings, 8, folder, validation=(poses, labels))
    assert {"pose", "vertex", "kl", "total"} <= set(log.last())
    return model


def test_one_batch_is_learned(trained: MotionCVAE) -> None:
    poses, labels = labelled_motions(8)
    error = np.square(trained.reconstruct(poses, labels) - poses).mean()
    label_mean = np.mean([np.square(poses[n::2] - poses[n::2].mean((0, 1))).mean() for n in range(2)])
    assert error < 0.5 * label_mean


def test_samples_are_rotations_and_follow_the_label(trained: MotionCVAE) -> None:
    poses, _ = labelled_motions(8)
    generated = trained.sample(["bow", "walk"] * 4, 10, torch.Generator().manual_seed(1))
    assert generated.shape == (8, 10, 24, 6)
    matrix = matrix_from_6d(generated)
    np.testing.assert_allclose(matrix[..., :, :2].swapaxes(-1, -2).reshape(generated.shape), generated, atol=1e-5)
    for number in range(2):
        own = np.square(generated[number::2].mean((0, 1)) - poses[number::2].mean((0, 1))).mean()
        other = np.square(generated[number::2].mean((0, 1)) - poses[1 - number :: 2].mean((0, 1))).mean()
        assert own < 0.3 * other


def test_same_seed_gives_the_same_motions_and_another_gives_others(trained: MotionCVAE) -> None:
    first, again, other = (trained.sample(["walk"], 10, torch.Generator().manual_seed(s)) for s in (1, 1, 2))
    np.testing.assert_array_equal(first, again)
    assert np.abs(first - other).max() > 1e-4


def test_label_alone_changes_the_output(trained: MotionCVAE) -> None:
    latent = torch.zeros(1, trained.config.width)
    a, b = (trained.decode(latent, torch.tensor([n]), 10) for n in range(2))
    assert (a - b).abs().max() > 0.01


def test_any_length_can_be_generated(trained: MotionCVAE) -> None:
    assert trained.sample(["walk"], 25, torch.Generator().manual_seed(0)).shape == (1, 25, 24, 6)


def test_losses_equal_their_definitions(trained: MotionCVAE, body: Body) -> None:
    poses, labels = (torch.as_tensor(labelled_motions(2)[0]), torch.tensor([0, 1]))
    layer = BodyLayer(body)
    with torch.no_grad():
        parts = trained.eval().loss(layer, (poses, labels))
        mean, log_deviation = trained.encode(poses, labels)
        predicted = trained.decode(mean, labels, poses.shape[1])
        prior = torch.distributions.Normal(0.0, 1.0)
        kl = torch.distributions.kl_divergence(torch.distributions.Normal(mean, log_deviation.exp()), prior)
        vertex = (layer(predicted) - layer(poses)).square().mean()
    assert float(parts["kl"]) == pytest.approx(float(kl.sum(1).mean()), rel=1e-4)
    assert float(parts["vertex"]) == pytest.approx(float(vertex), rel=1e-3)
    total = parts["pose"] + parts["vertex"] + 1e-5 * parts["kl"]
    assert float(parts["total"]) == pytest.approx(float(total), rel=1e-5)


def test_file_round_trip(trained: MotionCVAE, tmp_path: Path) -> None:
    save_motion_cvae(tmp_path / "model.pt", trained)
    again = load_motion_cvae(tmp_path / "model.pt")
    assert again.config == trained.config
    seeds = (torch.Generator().manual_seed(5), torch.Generator().manual_seed(5))
    np.testing.assert_array_equal(again.sample(["bow"], 10, seeds[0]), trained.sample(["bow"], 10, seeds[1]))
    with pytest.raises(ValueError, match="expected 'recognition'"):
        load_recognition(tmp_path / "model.pt")


def test_bad_input_is_named(trained: MotionCVAE, body: Body, tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="label 'fly' was not trained; known: bow, walk"):
        trained.sample(["fly"], 10, torch.Generator())
    with pytest.raises(ValueError, match="2 pose sequences, but 1 labels"):
        fit_motion_cvae(labelled_motions(2)[0], ["bow"], body, trained.config, TrainingSettings(epochs=1), 2, tmp_path)
    with pytest.raises(ValueError, match="labels must be non-empty and different"):
        MotionCVAEConfig(("a", "a"))


def test_recognition_learns_ignores_no_randomness_and_survives_its_file(tmp_path: Path) -> None:
    poses, labels = labelled_motions(16)
    settings = TrainingSettings(epochs=15, learning_rate=1e-2, checkpoint_every=1000)
    network, _ = fit_recognition(poses, labels, RecognitionConfig(LABELS, width=16), settings, 8, tmp_path)
    features, classes = network.describe(poses)
    assert features.shape == (16, 30) and np.abs(features).max() <= 1.0
    assert [LABELS[c] for c in classes] == labels
    np.testing.assert_array_equal(network.describe(poses)[0], features)
    save_recognition(tmp_path / "model.pt", network)
    np.testing.assert_array_equal(load_recognition(tmp_path / "model.pt").describe(poses)[0], features)
