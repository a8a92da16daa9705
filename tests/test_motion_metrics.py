"""Figures of generated motions against their analytic values, and the two motion tables end to end."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from body.model import Body
from evaluation.metrics import rmse
from evaluation.motion import MotionSet, axis_angle, generation_rows, reconstruction_rows
from evaluation.motion_metrics import (
    Repeated,
    accuracy,
    discontinuous_share,
    diversity,
    frechet_distance,
    gaussian_distance,
    label_spread,
    multimodality,
    nearest_distance,
)
from evaluation.motion_quality import quality_rows
from geometry.rotations import axis_angle_to_6d
from models.motion_cvae import MotionCVAE, MotionCVAEConfig
from models.recognition import RecognitionConfig, RecognitionNetwork
from motions.clip import Clip

torch.set_num_threads(1)


def test_frechet_distance_of_identical_sets_is_zero() -> None:
    features = np.random.default_rng(0).normal(size=(200, 30))
    assert frechet_distance(features, features) < 1e-6


def test_frechet_distance_of_gaussians_is_the_analytic_one() -> None:
    # Commuting covariances: |m|^2 + sum (sqrt a - sqrt b)^2.
    a, b, mean = np.array([1.0, 4.0]), np.array([9.0, 1.0]), np.array([3.0, 4.0])
    turn = np.array([[0.6, -0.8], [0.8, 0.6]])
    found = gaussian_distance(np.zeros(2), turn @ np.diag(a) @ turn.T, mean, turn @ np.diag(b) @ turn.T)
    assert found == pytest.approx(25.0 + (1 - 3) ** 2 + (2 - 1) ** 2)
    rng = np.random.default_rng(1)
    sampled = frechet_distance(
        rng.normal(size=(40000, 2)) * np.sqrt(a) @ turn.T, rng.normal(size=(40000, 2)) * np.sqrt(b) @ turn.T + mean
    )
    assert sampled == pytest.approx(30.0, rel=0.03)


def test_frechet_distance_takes_fewer_motions_than_features() -> None:
    rng = np.random.default_rng(2)
    assert np.isfinite(frechet_distance(rng.normal(size=(5, 30)), rng.normal(size=(8, 30))))
    with pytest.raises(ValueError, match="first set"):
        frechet_distance(np.zeros((1, 30)), np.zeros((8, 30)))


def test_diversity_and_multimodality_see_what_they_should() -> None:
    rng = np.random.default_rng(3)
    classes = np.repeat([0, 1], 50)
    features = np.repeat([[0.0, 0.0], [10.0, 0.0]], 50, axis=0)
    assert multimodality(features, classes, rng) == 0.0
    assert diversity(features, rng, pairs=4000) == pytest.approx(5.0, rel=0.1)
    # Two motions a class, 2 apart: a pair is never a motion with itself.
    few = np.array([[0.0, 1.0], [0.0, -1.0], [10.0, 1.0], [10.0, -1.0]])
    assert multimodality(few, np.array([0, 0, 1, 1]), rng) == pytest.approx(2.0)
    assert accuracy(np.array([0, 1, 1, 0]), np.array([0, 1, 0, 0])) == 0.75


def test_interval_is_that_of_the_mean() -> None:
    repeated = Repeated.of([1.0, 2.0, 3.0, 4.0])
    assert repeated.mean == 2.5
    assert repeated.interval == pytest.approx(1.96 * np.std([1, 2, 3, 4], ddof=1) / 2.0)


def test_a_jump_makes_a_sequence_discontinuous() -> None:
    time = np.arange(60)[None, :, None, None] / 30.0
    phase = np.random.default_rng(4).uniform(0, 6, (20, 1, 24, 3))
    real = np.sin(3.0 * time + phase)
    broken = real.copy()
    broken[:5, 30:] += 0.2
    share = discontinuous_share(broken, real, 30.0)
    assert share >= 0.25
    assert discontinuous_share(0.9 * real, real, 30.0) == 0.0


@pytest.fixture(scope="module")
def body() -> Body:
    return Body.load("small")


def _motions(seed: int, clips: int, labels: tuple[str, ...]) -> MotionSet:
    rng = np.random.default_rng(seed)
    chosen = tuple(labels[n % len(labels)] for n in range(clips))
    centre = np.random.default_rng(0).normal(0.0, 0.4, (len(labels), 1, 24, 3))
    time = np.arange(8)[:, None, None] / 4.0
    poses = [centre[labels.index(c)] + 0.2 * np.sin(time + rng.uniform(0, 6, (1, 24, 3))) for c in chosen]
    return MotionSet(axis_angle_to_6d(np.stack(poses)).astype(np.float32), chosen, 30.0)


def test_label_spread_is_the_distance_of_motions_of_a_label() -> None:
    joints = np.zeros((5, 4, 24, 3))
    joints[1, ..., 0] = 0.1
    joints[3, ..., 1] = 0.3
    joints[4] = 9.0  # alone in its class
    assert label_spread(joints, np.array([0, 0, 1, 1, 2])) == pytest.approx(0.2)
    assert np.isnan(label_spread(joints[:1], np.array([0])))
    # The nearest of the same class: 0.3 for the first, though one of another class is where it is.
    assert nearest_distance(joints[[0, 1]], np.array([1, 0]), joints[[0, 1, 3]], np.array([0, 0, 1])) == pytest.approx(
        (0.3 + 0.0) / 2
    )


def test_tables_rank_a_perfect_generator_above_an_untrained_one(body: Body) -> None:
    labels = ("a", "b")
    train, test = _motions(1, 12, labels), _motions(2, 6, labels)
    torch.manual_seed(0)
    untrained = MotionCVAE(MotionCVAEConfig(labels, width=16, layers=1, heads=2, feed_forward=16))
    recognition = RecognitionNetwork(RecognitionConfig(labels, width=16))

    class Perfect(MotionCVAE):
        def reconstruct(self, pose6d, labels):
            return pose6d

        def sample(self, labels, frames, generator):
            return np.concatenate([test.pose6d] * (len(labels) // len(test.labels)))

    models = {"untrained": untrained, "perfect": Perfect(untrained.config)}
    rows = {row["method"]: row for row in reconstruction_rows(models, train, test, body)}
    assert set(rows) == {*models, "mean pose of the label", "nearest training motion of the label"}
    for column in ("joint_error_m", "vertex_rmse_m", "hausdorff_m", "sted", "pose_rmse"):
        assert rows["perfect"][column] < 1e-5 < rows["untrained"][column]
    assert rows["perfect"]["motions"] == rows["perfect"]["mesh_motions"] == 6
    still = np.zeros((8, 3))
    meshes = [
        [body.posed(axis_angle(p), still) for p in poses]
        for poses in (untrained.reconstruct(test.pose6d, test.labels), test.pose6d)
    ]
    brute = np.mean([rmse(a, b) for a, b in zip(*meshes, strict=True)])
    assert rows["untrained"]["vertex_rmse_m"] == pytest.approx(brute, rel=1e-3)
    rows = {r["source"]: r for r in generation_rows(models, recognition, train, test, body, seed=0, repetitions=2)}
    assert rows["perfect"]["fid"] == pytest.approx(rows["real, unseen motions"]["fid"])
    assert rows["perfect"]["fid"] < 0.5 * rows["untrained"]["fid"]
    for column in ("fid", "accuracy_percent", "diversity", "multimodality", "label_spread_m", "discontinuous_percent"):
        assert np.isfinite(rows["untrained"][column]) and rows["untrained"][f"{column}_interval"] >= 0.0
    assert rows["mean pose of the label"]["multimodality"] == rows["mean pose of the label"]["label_spread_m"] == 0.0
    assert rows["real, training motions"]["nearest_training_m"] == pytest.approx(0.0, abs=1e-6)
    assert rows["perfect"]["nearest_training_m"] == pytest.approx(rows["real, unseen motions"]["nearest_training_m"])
    assert rows["untrained"]["repetitions"] == 2 and rows["untrained"]["motions"] >= 128
    assert {row["judge_accuracy_percent"] for row in rows.values()} == {
        rows["real, unseen motions"]["accuracy_percent"]
    }


def test_quality_tells_a_moonwalk_from_a_stand_and_counts_what_no_body_can_do(body: Body) -> None:
    still = np.zeros((1, 12, 24, 3), dtype=np.float32)
    root = np.zeros((12, 3), dtype=np.float32)
    root[:, 1] = -body.posed(still[0], np.zeros((12, 3)))[..., 1].min()
    slid = root.copy()
    slid[:, 0] = 0.02 * np.arange(12)  # 0.6 m/s
    clips = [Clip(name, name, "stand", still[0], r, 30.0, "test") for name, r in (("stands", root), ("slides", slid))]
    broken = still.copy()
    broken[0, 6:, 1, 0] = 2.5  # a hip that turns by 143 degrees between two frames
    six = axis_angle_to_6d(still).astype(np.float32)
    generated = {
        "still": (six, None),
        "sunk": (six, root[None] - np.array([0.0, 0.03, 0.0], dtype=np.float32)),
        "broken": (axis_angle_to_6d(broken).astype(np.float32), None),
    }
    rows = {row["source"]: row for row in quality_rows(clips, generated, body)}
    assert rows["real, unseen motions"]["foot_skate_cm_s"] == pytest.approx(30.0, rel=0.01)
    assert rows["real, unseen motions"]["planted_foot_skate_cm_s"] < 15.0  # one stands, one slides farther than a leg
    assert rows["still"]["foot_skate_cm_s"] == pytest.approx(0.0, abs=1e-3)
    assert rows["still"]["ground_penetration_cm"] == pytest.approx(0.0, abs=1e-3)
    assert rows["sunk"]["ground_penetration_cm"] == pytest.approx(3.0, abs=0.01)
    assert rows["sunk"]["planted_ground_penetration_cm"] == pytest.approx(0.0, abs=1e-3)
    assert [rows[name]["root"] for name in ("real, unseen motions", "still", "sunk")] == [
        "recorded",
        "derived",
        "generated",
    ]
    assert rows["broken"]["refused_percent"] == 100.0 and rows["broken"]["foot_skate_cm_s"] is None
    with pytest.raises(ValueError, match="no real clip"):
        quality_rows([], generated, body)
