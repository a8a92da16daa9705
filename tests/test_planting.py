"""Planted feet: they neither slide nor sink, what stands is left alone, a swung foot is lifted, a jump stays one."""

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
    planted, root = plant_feet(clip.pose, slid, body, FPS)
    assert _skate(clip.pose, slid, body) > 0.1 and _skate(planted, root, body) < 0.012
    np.testing.assert_array_equal(root[:, [0, 2]], slid[:, [0, 2]])
    assert np.abs(root - slid).max() < 0.03
    legs = [JOINT_INDEX[f"{side}_{joint}"] for side in ("left", "right") for joint in ("hip", "knee", "ankle")]
    others = [joint for joint in range(24) if joint not in legs]
    np.testing.assert_allclose(planted[:, others], clip.pose[:, others], atol=1e-6)
    before, after = (body.joint_frames(pose, own) for pose, own in ((clip.pose, slid), (planted, root)))
    for side in ("left", "right"):
        ankle = JOINT_INDEX[f"{side}_ankle"]
        np.testing.assert_allclose(after[0][:, ankle], before[0][:, ankle], atol=0.03)  # the foot keeps its direction
        moved = np.linalg.norm(after[1][:, ankle] - before[1][:, ankle], axis=1)
        assert 0.01 < moved.max() < 0.07
        assert np.abs(after[1][:, ankle, 1] - before[1][:, ankle, 1]).max() < 0.01


def test_feet_that_stand_stay_and_no_bone_changes_its_length(body: Body) -> None:
    clip = generate_clip("walk", 2, 40, FPS, 1, body)
    planted, root = plant_feet(clip.pose, clip.root, body, FPS)
    joints, before = (body.joint_positions(*motion) for motion in ((planted, root), (clip.pose, clip.root)))
    ankles = [JOINT_INDEX[f"{side}_ankle"] for side in ("left", "right")]
    assert (
        np.abs(joints - before)[:, ankles].max() < 0.015
    )  # where a foot lands slowly, it is put down a little earlier
    assert np.abs(joints - before).mean() < 5e-4
    for parent, child in (("left_hip", "left_knee"), ("left_knee", "left_ankle")):
        bone = np.linalg.norm(joints[:, JOINT_INDEX[child]] - joints[:, JOINT_INDEX[parent]], axis=1)
        np.testing.assert_allclose(bone, bone[0], rtol=1e-4)


def test_a_foot_swung_along_the_ground_is_lifted_and_one_in_the_air_is_let_be(body: Body) -> None:
    clip = generate_clip("squat", 0, 20, FPS, 1, body)
    dragged = clip.root.copy()
    dragged[:, 2] += 0.1 * np.arange(20)  # 3 m/s
    assert _skate(clip.pose, dragged, body) > 2.0
    assert _skate(*plant_feet(clip.pose, dragged, body, FPS), body) < 0.05
    flying = clip.root + np.array([0.0, 0.5, 0.0], dtype=np.float32)
    pose, root = plant_feet(clip.pose, flying, body, FPS)
    np.testing.assert_allclose(pose, clip.pose, atol=1e-6)
    np.testing.assert_array_equal(root, flying)
    pose, root = plant_feet(clip.pose[:1], flying[:1], body, FPS)
    assert pose.shape == (1, 24, 3) and root.shape == (1, 3)


def test_feet_that_sink_or_hover_are_put_on_the_ground_and_a_foot_that_turns_is_held(body: Body) -> None:
    clip = generate_clip("squat", 0, 40, FPS, 1, body)
    time = np.arange(40)
    root = clip.root + 0.01 * np.sin(time / 4.0)[:, None] * (0.0, 1.0, 0.0)
    pose = clip.pose.copy()
    pose[:, JOINT_INDEX["left_ankle"], 1] += 0.05 * np.sin(time / 5.0)
    planted, root = plant_feet(pose, root.astype(np.float32), body, FPS)
    for points in sole_points(planted, root, body):
        np.testing.assert_allclose(points[..., 1].min(axis=1), 0.0, atol=1e-3)
    assert _skate(pose, clip.root, body) > 0.01 and _skate(planted, root, body) < 0.003


def test_a_jump_keeps_its_flight(body: Body) -> None:
    clip = generate_clip("jump", 0, 60, FPS, 1, body)
    rough = clip.root + 0.008 * np.sin(np.arange(60) / 3.0)[:, None] * (1.0, 1.0, 0.0)
    planted, root = plant_feet(clip.pose, rough.astype(np.float32), body, FPS)
    heights = [
        np.minimum(*(points[..., 1].min(axis=1) for points in sole_points(*motion, body)))
        for motion in ((clip.pose, clip.root), (planted, root))
    ]
    assert heights[0].max() > 0.1 and abs(heights[1].max() - heights[0].max()) < 0.02
    assert heights[1].min() > -1e-5
