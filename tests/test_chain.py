"""Motions in a chain: no jump where they meet, no turn and no place that the motion before does not lead to."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from body.skeleton import JOINT_COUNT
from motions.chain import chain, chained_length

OVERLAP = 8


def walk(frames: int, heading: float, step: float = 0.04, swing: float = 0.3) -> tuple[np.ndarray, np.ndarray]:
    """A body that goes straight ahead in a direction [rad] from +z towards +x, arms swinging."""
    pose = np.zeros((frames, JOINT_COUNT, 3))
    pose[:, 0, 1] = heading
    pose[:, 16, 0] = swing * np.sin(0.4 * np.arange(frames))
    root = np.outer(np.arange(frames) * step, [np.sin(heading), 0.0, np.cos(heading)]) + [0.0, 0.9, 0.0]
    return pose, root


def test_a_walk_goes_on_straight_whatever_way_its_parts_face():
    pose, root = chain([walk(40, 0.3), walk(40, -2.0), walk(40, 1.1)], OVERLAP)
    assert len(pose) == len(root) == chained_length(3, 40, OVERLAP) == 104
    ahead = np.array([np.sin(0.3), 0.0, np.cos(0.3)])
    steps = np.diff(root, axis=0)
    np.testing.assert_allclose(steps @ ahead, 0.04, atol=1e-6)
    np.testing.assert_allclose(steps - np.outer(steps @ ahead, ahead), 0.0, atol=1e-6)
    np.testing.assert_allclose(pose[:, 0, 1], 0.3, atol=1e-6)


def test_the_first_motion_stays_and_joints_turn_without_a_jump():
    first, second = walk(40, 0.0, swing=0.3), walk(40, 0.0, swing=-0.5)
    pose, root = chain([first, second], OVERLAP)
    np.testing.assert_allclose(pose[: 40 - OVERLAP], first[0][: 40 - OVERLAP], atol=1e-6)
    np.testing.assert_allclose(pose[40:, 16], second[0][OVERLAP:, 16], atol=1e-6)
    turned = Rotation.from_rotvec(pose[:-1, 16]).inv() * Rotation.from_rotvec(pose[1:, 16])
    assert turned.magnitude().max() < 0.3
    assert np.abs(np.diff(root[:, 1])).max() < 1e-6


def test_rotations_take_the_short_way_round():
    first, second = walk(30, 0.0), walk(30, 0.0)
    first[0][:, 3, 1], second[0][:, 3, 1] = np.pi - 0.1, -np.pi + 0.1  # 0.2 apart, across the half turn
    pose, _ = chain([first, second], OVERLAP)
    angle = Rotation.from_rotvec(pose[:, 3]).magnitude()
    assert angle.min() > np.pi - 0.11


def test_one_motion_alone_is_itself():
    motion = walk(12, 0.7)
    pose, root = chain([motion], OVERLAP)
    np.testing.assert_allclose(pose, motion[0], atol=1e-6)
    np.testing.assert_allclose(root, motion[1], atol=1e-6)


@pytest.mark.parametrize(
    ("motions", "overlap", "message"),
    [([], 4, "needs motions"), ([walk(20, 0.0)], 0, "needs motions"), ([walk(20, 0.0)] * 2, 10, "has 20 frames")],
)
def test_what_cannot_be_chained_is_refused(motions, overlap, message):
    with pytest.raises(ValueError, match=message):
        chain(motions, overlap)
