"""Baselines, the table of regressors and the summary of simulated data, on synthetic sequences."""

from __future__ import annotations

from functools import cache

import numpy as np
import pytest

from body.model import Body, skin
from datasets.sequences import Sequence, from_canonical, to_canonical
from evaluation.baselines import (
    MeanShape,
    PcaFloor,
    RidgeRegression,
    SimulatedAgain,
    SkinnedRidge,
    SkinnedTemplate,
    fit_baselines,
    history,
)
from evaluation.drift import drift_rows
from evaluation.metrics import rmse
from evaluation.regressor import RegressorEvaluation, regressor_rows
from evaluation.ridge import PENALTIES, Ridge
from evaluation.simulation import reason_class, simulation_rows
from garments.template import GarmentTemplate
from models.motion_features import sequence_track, track_features

FRAMES, LEAD = 12, 6


@cache
def body() -> Body:
    return Body.load("small")


@cache
def template() -> GarmentTemplate:
    """A band of cloth around the hips, skinned to the pelvis and the thighs."""
    columns, heights = 24, np.linspace(0.02, -0.15, 5)
    angle = np.arange(columns) * 2 * np.pi / columns
    centre = body().joints[0]
    rings = [np.stack([0.21 * np.sin(angle), 0 * angle + h, 0.18 * np.cos(angle)], axis=1) for h in heights]
    vertices = (np.concatenate(rings) + centre).astype(np.float32)
    faces = []
    for i in range(len(heights) - 1):
        for j in range(columns):
            a, b = i * columns + j, i * columns + (j + 1) % columns
            faces += [[a, a + columns, b], [b, a + columns, b + columns]]
    left = np.clip(0.5 + 2 * (vertices[:, :1] - centre[0]), 0, 1)
    down = np.clip((centre[1] - vertices[:, 1:2]) / 0.3, 0, 1)
    weight = np.concatenate([1 - down, down * left, down * (1 - left), 0 * down], axis=1)
    index = np.tile([0, 1, 2, 3], (len(vertices), 1))
    return GarmentTemplate(
        "band", "skirt", vertices, np.array(faces), np.arange(columns), index, weight, body().name, body().digest
    )


def motion(seed: int, rigid: bool = False) -> tuple[np.ndarray, np.ndarray]:
    """Smooth random pose and root of LEAD + FRAMES frames; ``rigid`` moves the pelvis alone."""
    rng = np.random.default_rng(seed)
    time = np.arange(LEAD + FRAMES)[:, None, None] / 10
    pose = 0.25 * rng.normal(size=(24, 3)) + 0.25 * rng.normal(size=(24, 3)) * np.sin(time + rng.normal(size=(24, 3)))
    if rigid:
        pose[:, 1:] = body().bind_pose()[1:]
    root = 0.3 * np.sin(time[:, 0] + rng.normal(size=3)) + rng.normal(size=3)
    return pose.astype(np.float32), root.astype(np.float32)


def sequence(seed: int, vertices: np.ndarray | None = None, rigid: bool = False, split: str = "train") -> Sequence:
    """A sequence with the given recorded vertices; by default the skinned template with a wave."""
    pose, root = motion(seed, rigid)
    joints = body().joint_positions(pose, root)
    if vertices is None:
        t = template()
        transforms = body().joint_transforms(pose[LEAD:], root[LEAD:])
        vertices = skin(t.vertices, t.skin_index, t.skin_weight, transforms)
        wave = 0.02 * np.sin(np.arange(FRAMES)[:, None] + np.arange(vertices.shape[1]))
        vertices = (vertices + wave[..., None]).astype(np.float32)
    return Sequence(
        garment="band",
        clip=f"clip{seed}",
        take=f"take{seed}",
        label="walk",
        plan="motions",
        phi=0,
        split=split,
        fps=30.0,
        vertices=vertices,
        pose=pose[LEAD:],
        root=root[LEAD:],
        joints=joints[LEAD:],
        lead_pose=pose[:LEAD],
        lead_root=root[:LEAD],
        lead_joints=joints[:LEAD],
        parameters={},
    )


def test_skinning_baseline_is_exact_on_rigid_motion() -> None:
    # Pelvis alone moves: the garment is the template plus a fixed offset in the pelvis frame, anywhere in the world.
    offset = 0.02 * np.random.default_rng(0).normal(size=template().vertices.shape)

    def rigid(seed: int) -> Sequence:
        pose, root = motion(seed, rigid=True)
        pose, root = pose[LEAD:], root[LEAD:]
        t = template()
        world = skin(t.vertices, t.skin_index, t.skin_weight, body().joint_transforms(pose, root))
        moved = to_canonical(world, pose, root, body()) + offset
        return sequence(seed, from_canonical(moved, pose, root, body()), rigid=True)

    train, test = [rigid(1), rigid(2)], rigid(3)
    for baseline in (SkinnedTemplate(body(), template()), MeanShape()):
        np.testing.assert_allclose(baseline.fit(train).predict(test), test.vertices, atol=2e-5)


def test_the_ridge_on_skinning_is_exact_where_skinning_leaves_a_linear_map() -> None:
    # The garment is skinned, and its every vertex trails behind the pelvis.
    def trailing(seed: int) -> Sequence:
        skinned = SkinnedTemplate(body(), template())
        plain = sequence(seed, np.zeros((FRAMES, *template().vertices.shape), np.float32))
        features = SkinnedRidge(body(), template())._features(plain)
        worn = skinned.skinned(plain) + 0.05 * features[:, None, 72:75]
        return sequence(seed, plain.in_world(worn))

    train, test = [trailing(i) for i in range(150)], trailing(999)
    made = SkinnedRidge(body(), template()).fit(train)
    plain = RidgeRegression().fit(train)
    error = [np.linalg.norm(one.predict(test) - test.vertices, axis=2).mean() for one in (made, plain)]
    assert error[0] < 1e-3 and error[0] < 0.2 * error[1]
    assert made.ridge.size == (made._features(test).shape[1] + 1) * template().vertices.size


def test_ridge_recovers_a_linear_map_and_ignores_dead_features() -> None:
    rng = np.random.default_rng(0)
    weights, intercept = rng.normal(size=(9, 5)), rng.normal(size=5) + 100.0
    features = rng.normal(size=(300, 9)) * 10.0 ** np.arange(-4, 5)
    features[:, 4] = 7.0  # never moves in training
    targets = features @ weights + intercept
    ridge = Ridge()
    ridge.add(features[:100], targets[:100])
    ridge.add(features[100:200], targets[100:200])
    ridge.fit(penalty=1e-9)
    probe = features[200:].copy()
    np.testing.assert_allclose(ridge.predict(probe), targets[200:], rtol=1e-4, atol=1e-2)
    before = ridge.predict(probe)
    probe[:, 4] = -50.0
    np.testing.assert_array_equal(ridge.predict(probe), before)


def test_ridge_penalty_comes_from_the_held_out_blocks() -> None:
    rng = np.random.default_rng(1)
    weights = rng.normal(size=(40, 3))

    def chosen(noise: float) -> float:
        ridge = Ridge()
        for held_out in (False, True):
            features = rng.normal(size=(60, 40))
            ridge.add(features, features @ weights + noise * rng.normal(size=(60, 3)), held_out)
        return ridge.fit().penalty

    assert chosen(0.0) == PENALTIES[0]
    assert chosen(30.0) == PENALTIES[-1]
    with pytest.raises(ValueError, match="nothing to fit"):
        Ridge().fit()


def test_history_ridge_learns_what_the_current_pose_does_not_show() -> None:
    # The garment hangs back against the pelvis velocity, rotated into the pelvis frame: linear in the motion features.
    rng = np.random.default_rng(2)
    response = 0.05 * rng.normal(size=(3, template().vertices.size))

    def swung(seed: int) -> Sequence:
        plain = sequence(seed)
        track = sequence_track(plain)
        velocity = track_features(track, "motion")[LEAD - 2 : -2, 72:75]  # two frames ago
        shape = template().vertices.reshape(-1) + velocity @ response
        moved = from_canonical(shape.reshape(FRAMES, -1, 3), plain.pose, plain.root, body())
        return sequence(seed, moved)

    train, test = [swung(seed) for seed in range(40)], swung(99)
    errors = [
        np.abs(RidgeRegression(offsets).fit(train).predict(test) - test.vertices).mean() for offsets in ((), (0, 1, 2))
    ]
    assert errors[1] < 0.2 * errors[0]
    assert history(np.arange(4.0)[:, None], (0, 2), np.array([1, 3])).tolist() == [[1, 0], [3, 1]]


def test_pca_floor_falls_with_its_dimension_and_is_exact_in_its_span() -> None:
    train = [sequence(seed) for seed in range(6)]
    test = sequence(50)
    errors = [np.sqrt(np.mean((PcaFloor(k).fit(train).predict(test) - test.vertices) ** 2)) for k in (1, 8, 40)]
    assert errors[0] > errors[1] > errors[2]
    full = PcaFloor(100).fit(train)
    np.testing.assert_allclose(full.predict(train[0]), train[0].vertices, atol=1e-4)


def test_regressor_rows() -> None:
    sequences = [sequence(1, split="unseen_motions"), sequence(2, split="unseen_motions"), sequence(3, split="train")]
    shift = np.array([0.003, 0.0, 0.004], dtype=np.float32)
    sunk = {s.clip: s.vertices.copy() for s in sequences}
    predictors = {
        "simulation": lambda s: s.vertices,
        "shifted": lambda s: s.vertices + shift,
        # Drawn towards the pelvis, into the body.
        "sunk": lambda s: 0.6 * sunk[s.clip] + 0.4 * s.joints[:, :1],
    }
    done: list[int] = []
    settings = RegressorEvaluation(frames_stride=5)
    predictors["silent"] = lambda s: None
    rows = regressor_rows(sequences, predictors, body(), template(), settings, done.append, refined=("sunk",))
    assert len(done) == 12
    assert [(r["split"], r["method"], r["sequences"]) for r in rows[:4]] == [
        ("unseen_motions", "simulation", 2),
        ("unseen_motions", "shifted", 2),
        ("unseen_motions", "sunk", 2),
        ("train", "simulation", 1),
    ]
    truth, shifted, sunken = rows[:3]
    assert truth["rmse_mm"] == truth["hausdorff_mm"] == truth["sted"] == 0.0
    assert shifted["rmse_mm"] == pytest.approx(5.0, rel=1e-3) and shifted["frames"] == 2 * FRAMES
    assert shifted["sted"] == pytest.approx(0.0, abs=1e-4)
    assert sunken["collision_rate_percent"] > 20 and sunken["deepest_mm"] > 10
    assert sunken["refined_collision_rate_percent"] == 0.0 and sunken["refined_deepest_mm"] == 0.0
    assert sunken["all_frames_collision_rate_percent"] > 20 and sunken["refinement_laplacian_percent"] > 1.0
    assert "refined_rmse_mm" not in truth
    assert truth["sted_parameters"] == "d=1 w=5 dt=0.01 c=1" and truth["frames_stride"] == 5

    few = regressor_rows(sequences, predictors, body(), template(), RegressorEvaluation(frames_stride=5, detailed=1))
    assert few[1]["rmse_mm"] == shifted["rmse_mm"] and (few[1]["sequences"], few[1]["detailed_sequences"]) == (2, 1)

    with pytest.raises(ValueError, match="method 'short' on clip clip1: expected vertices"):
        regressor_rows(sequences, {"short": lambda s: s.vertices[:3]}, body(), template())
    with pytest.raises(ValueError, match="not finite"):
        regressor_rows(sequences, {"nan": lambda s: s.vertices * np.nan}, body(), template())


def test_fit_baselines_names_and_refuses_mixed_garments() -> None:
    train = [sequence(seed) for seed in range(3)]
    fitted = fit_baselines(train, body(), template(), pca_dimensions=8)
    assert next(iter(fitted)) == "mean shape" and list(fitted)[-1] == "PCA-8 of the truth (floor)"
    assert all(predict(train[0]).shape == train[0].vertices.shape for predict in fitted.values())
    with pytest.raises(ValueError, match="no training sequences"):
        MeanShape().fit([])


def test_ridge_holds_features_that_leave_the_training_range() -> None:
    rng = np.random.default_rng(3)
    features = rng.normal(size=(500, 2))
    ridge = Ridge()
    ridge.add(features, features @ np.array([[1.0], [2.0]]))
    ridge.fit(penalty=1e-9)
    far, edge = np.array([[4000.0, 0.0]]), 6.0 * features[:, 0].std() + features[:, 0].mean()
    assert ridge.predict(far)[0, 0] == pytest.approx(edge, rel=1e-3)


def test_chaos_floor_is_the_difference_of_two_runs_over_root_two() -> None:
    first, other = sequence(1), sequence(2)
    second = sequence(1, vertices=first.vertices + np.float32([0.003, 0.0, 0.004]))
    floor = SimulatedAgain([second])
    assert 1e3 * rmse(floor.predict(first), first.vertices) == pytest.approx(5.0 / np.sqrt(2.0), rel=1e-3)
    assert floor.predict(other) is None


def test_drift_rows_tell_a_growing_error_from_a_steady_one() -> None:
    test = [sequence(1), sequence(2)]
    growing = np.linspace(1.0, 10.0, FRAMES, dtype=np.float32)[:, None, None] * np.float32([0.001, 0.0, 0.0])
    predictors = {"steady": lambda s: s.vertices + np.float32(0.001), "growing": lambda s: s.vertices + growing}
    steady, drifting = drift_rows(test, predictors)
    assert steady["last_tenth_over_first"] == pytest.approx(1.0, rel=1e-3)
    assert drifting["last_tenth_over_first"] > 4.0
    assert drifting["tenth_10_rmse_mm"] > 9.0 > 3.0 > drifting["tenth_1_rmse_mm"]
    with pytest.raises(ValueError, match="one length"):
        drift_rows([], predictors)


def test_simulation_rows() -> None:
    kept = [
        {"garment": "skirt", "plan": "motions", "phi": 0, "clip": f"c{k}", "frames": 60, "attempts": 1 + (k == 2)}
        | {"p99_edge_strain": 0.01 * (k + 1), "deepest_penetration_m": 0.001 * k}
        | {"pinched_vertices": 2.0 * k, "pinched_frames": 3.0 * k, "crossing_pairs": 7.0 - k}
        for k in range(3)
    ]
    lost = [
        {"garment": "skirt", "plan": "motions", "reason": f"p99 edge strain 0.{k}1 above 0.1", "attempts": 3}
        for k in (3, 5)
    ]
    (row,) = simulation_rows(kept, lost)
    assert (row["sequences"], row["frames"], row["dropped"], row["dropped_percent"]) == (3, 180, 2, 40.0)
    assert row["dropped_reasons"] == "2 x p99 edge strain N above N"
    assert row["p99_edge_strain_max_percent"] == pytest.approx(3.0)
    assert row["deepest_penetration_max_mm"] == pytest.approx(2.0)
    assert (row["pinched_vertices_max"], row["pinched_frames_mean"], row["crossing_pairs_max"]) == (4.0, 3.0, 7.0)
    assert row["crossing_frames_mean"] is None
    assert row["retried"] == 1 and row["max_edge_strain_percent"] is None
    assert reason_class("speed 1.5e-3 m/s at frame 12") == "speed N m/s at frame N"
