"""Motions one after another as one: each turned and moved to where the one before it arrives, and faded into it.

In: motions, each with its root. Out: one motion. The frames of an overlap belong to both neighbours: there the joints
turn from the pose of one to that of the other along the shortest rotation, and the root moves from one path to the
other, by a weight that begins and ends at rest.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.spatial.transform import Rotation

from motions.timing import minimum_jerk, rotation_about

Motion = tuple[np.ndarray, np.ndarray]
"""Pose [T, 24, 3] [rad] and root [T, 3] [m]."""


def chain(motions: Sequence[Motion], overlap: int) -> Motion:
    """One motion of several.

    Args:
        motions: In their order, each longer than two overlaps.
        overlap: Frames that neighbours share, at least 1.

    Returns:
        Pose [rad] and root [m], float32, of sum of the lengths minus the overlaps; the first motion is where it was.

    Raises:
        ValueError: No motion, no overlap, or a motion that is too short.
    """
    if not motions or overlap < 1:
        raise ValueError(f"chain of motions: needs motions and an overlap of at least 1 frame, got {overlap}")
    for number, (pose, _) in enumerate(motions):
        if len(motions) > 1 and len(pose) <= 2 * overlap:
            raise ValueError(
                f"chain of motions: motion {number} has {len(pose)} frames, more than {2 * overlap} needed"
            )
    pose, root = (np.asarray(part, dtype=np.float64) for part in motions[0])
    for following in motions[1:]:
        next_pose, next_root = _placed(following, pose, root, overlap)
        weight = minimum_jerk((np.arange(overlap) + 0.5) / overlap)
        shared = _between(pose[-overlap:], next_pose[:overlap], weight)
        path = root[-overlap:] + weight[:, None] * (next_root[:overlap] - root[-overlap:])
        pose = np.concatenate([pose[:-overlap], shared, next_pose[overlap:]])
        root = np.concatenate([root[:-overlap], path, next_root[overlap:]])
    return pose.astype(np.float32), root.astype(np.float32)


def chained_length(count: int, length: int, overlap: int) -> int:
    """Frames of ``count`` motions of ``length`` frames in a chain."""
    return count * length - (count - 1) * overlap


def _placed(motion: Motion, pose: np.ndarray, root: np.ndarray, overlap: int) -> Motion:
    """A motion turned about the vertical and moved along the ground, so that in the middle of the overlap it faces and
    stands where the chain does."""
    next_pose, next_root = (np.asarray(part, dtype=np.float64).copy() for part in motion)
    middle = overlap // 2
    now, then = len(pose) - overlap + middle, middle
    turn = _heading(pose[now, 0]) - _heading(next_pose[then, 0])
    about = Rotation.from_matrix(rotation_about("y", turn))
    next_pose[:, 0] = (about * Rotation.from_rotvec(next_pose[:, 0])).as_rotvec()
    next_root = about.apply(next_root)
    shift = root[now] - next_root[then]
    shift[1] = 0.0
    return next_pose, next_root + shift


def _heading(pelvis: np.ndarray) -> float:
    """Angle about the vertical [rad] to which the front of a pelvis points, from +z towards +x."""
    front = Rotation.from_rotvec(pelvis).apply([0.0, 0.0, 1.0])
    return float(np.arctan2(front[0], front[2]))


def _between(start: np.ndarray, end: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """Rotations [O, 24, 3] on the shortest way from ``start`` to ``end`` [O, 24, 3], at ``weight`` [O]."""
    first, last = (Rotation.from_rotvec(part.reshape(-1, 3)) for part in (start, end))
    way = (first.inv() * last).as_rotvec() * np.repeat(weight, start.shape[1])[:, None]
    return (first * Rotation.from_rotvec(way)).as_rotvec().reshape(start.shape)
