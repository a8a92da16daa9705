"""Planted feet: sliding is taken back, what stands is left alone, and a foot swung along the ground is lifted."""

from __future__ import annotations

import numpy as np
import pytest

from body.model import Body
from body.skeleton import JOINT_INDEX
from motions.planting import plant_feet
from motions.procedural import generate_clip
from motions.quality import sliding_speed, sole_points

FPS = 30.0


@pytest.fixture(scope="module")
def body() -> Body:
    return Body.load("small")


def _skate(pose: np.ndarray, root: np.ndarray, body: Body) -> float:
    return float(np.percentile(np.concatenate([sliding_speed(p, FPS) for p in sole_points(pose, root, body)]), 99.0))


@pytest.mark.parametrize("label", ["walk", "squat"])
def test_a_motion_that_slides_is_planted_and_hardly_changed(body: Body, label: str) -> None:
    clip = generate_clip(label, 0, 40, FPS, 1, body)
    slid = clip.root.copy()
    slid[:, 0] += 0.03 * np.sin(np.arange(40) / 6.0)  # up to 0.15 m/s
    planted = plant_feet(clip.pose, slid, body, FPS)
    assert _skate(clip.pose, slid, body) > 0.1 and _skate(planted, slid, body) < 0.03
    legs = [JOINT_INDEX[f"{side}_{joint}"] for side in ("left", "right") for joint in ("hip", "knee", "ankle")]
    others = [joint for joint in range(24) if joint not in legs]
    np.testing.assert_allclose(planted[:, others], clip.pose[:, others], atol=1e-6)
    before, after = (body.joint_frames(pose, slid) for pose in (clip.pose, planted))
    for side in ("left", "right"):
        ankle = JOINT_INDEX[f"{side}_ankle"]
        np.testing.assert_allclose(after[0][:, ankle], before[0][:, ankle], atol=1e-4)  # the foot keeps its direction
        moved = np.linalg.norm(after[1][:, ankle] - before[1][:, ankle], axis=1)
        assert 0.01 < moved.max() < 0.07
        assert np.abs(after[1][:, ankle, 1] - before[1][:, ankle, 1]).max() < 0.01


def test_feet_that_stand_stay_and_no_bone_changes_its_length(body: Body) -> None:
    clip = generate_clip("walk", 2, 40, FPS, 1, body)
    planted = plant_feet(clip.pose, clip.root, body, FPS)
    joints, before = (body.joint_positions(pose, clip.root) for pose in (planted, clip.pose))
    assert np.abs(joints - before).max() < 0.01
    for parent, child in (("left_hip", "left_knee"), ("left_knee", "left_ankle")):
        bone = np.linalg.norm(joints[:, JOINT_INDEX[child]] - joints[:, JOINT_INDEX[parent]], axis=1)
        np.testing.assert_allclose(bone, bone[0], rtol=1e-4)


def test_a_foot_swung_along_the_ground_is_lifted_and_one_in_the_air_is_let_be(body: Body) -> None:
    clip = generate_clip("squat", 0, 20, FPS, 1, body)
    dragged = clip.root.copy()
    dragged[:, 2] += 0.1 * np.arange(20)  # 3 m/s
    assert _skate(clip.pose, dragged, body) > 2.0
    assert _skate(plant_feet(clip.pose, dragged, body, FPS), dragged, body) < 0.05
    flying = clip.root + np.array([0.0, 0.5, 0.0], dtype=np.float32)
    np.testing.assert_allclose(plant_feet(clip.pose, flying, body, FPS), clip.pose, atol=1e-6)
    assert plant_feet(clip.pose[:1], flying[:1], body, FPS).shape == (1, 24, 3)
