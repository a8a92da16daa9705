"""Root translation from poses alone: what is known from the generator comes back, feet stay where they stand."""

from __future__ import annotations

import numpy as np
import pytest

from body.model import Body
from geometry.rotations import axis_angle_to_matrix, matrix_to_axis_angle
from motions.grounding import ground_motion
from motions.procedural import generate_clip
from motions.quality import sliding_speed, sole_points


@pytest.fixture(scope="module")
def body() -> Body:
    return Body.load("small")


@pytest.mark.parametrize("label", ["walk", "squat", "sidestep-left"])
def test_the_generators_own_root_comes_back(body: Body, label: str) -> None:
    clip = generate_clip(label, 0, 45, 30, 1, body)
    root = ground_motion(clip.pose, body, start=clip.root[0, [0, 2]])
    np.testing.assert_allclose(root, clip.root, atol=0.02)


def test_a_walk_travels_without_sliding(body: Body) -> None:
    clip = generate_clip("walk", 1, 45, 30, 2, body)
    root = ground_motion(clip.pose, body)
    assert np.linalg.norm(root[-1] - root[0]) > 0.5
    slide = np.concatenate([sliding_speed(sole, clip.fps) for sole in sole_points(clip.pose, root, body)])
    assert np.percentile(slide, 95) < 0.1
    still = np.concatenate([sliding_speed(s, clip.fps) for s in sole_points(clip.pose, 0 * root + root[0], body)])
    assert np.percentile(still, 95) > 0.3


def test_the_lowest_point_is_on_the_ground_in_every_frame(body: Body) -> None:
    clip = generate_clip("dance-sway", 0, 30, 30, 3, body)
    lowest = body.posed(clip.pose, ground_motion(clip.pose, body))[..., 1].min(axis=1)
    np.testing.assert_allclose(lowest, 0.0, atol=1e-5)


def test_a_body_that_holds_still_stays(body: Body) -> None:
    pose = np.repeat(body.bind_pose()[None], 5, axis=0)
    root = ground_motion(pose, body)
    np.testing.assert_allclose(root, np.broadcast_to(root[0], root.shape), atol=1e-6)


def test_turning_the_whole_motion_turns_its_path(body: Body) -> None:
    clip = generate_clip("walk", 0, 30, 30, 4, body)
    turn = axis_angle_to_matrix(np.array([0.0, np.pi / 2, 0.0]))
    pose = clip.pose.copy()
    pose[:, 0] = matrix_to_axis_angle(turn @ axis_angle_to_matrix(clip.pose[:, 0]))
    straight, turned = ground_motion(clip.pose, body), ground_motion(pose, body)
    np.testing.assert_allclose(turned - turned[0], (straight - straight[0]) @ turn.T, atol=1e-3)


def test_a_broken_pose_does_not_throw_the_body(body: Body) -> None:
    pose = np.random.default_rng(0).normal(0.0, 1.5, (20, 24, 3))
    step = np.linalg.norm(np.diff(ground_motion(pose, body)[:, [0, 2]], axis=0), axis=1)
    assert step.max() <= 0.3 + 1e-5


def test_wrong_shape_is_named(body: Body) -> None:
    with pytest.raises(ValueError, match=r"\[T, 24, 3\]"):
        ground_motion(np.zeros((4, 23, 3)), body)
