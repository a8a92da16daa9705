"""Where the body is at the query times of a clip: skinning transforms and floating origins."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from geometry.rotations import slerp_poses

if TYPE_CHECKING:
    from body.model import Body

PELVIS = 0


def query_times(frames: int, counts: list[int]) -> np.ndarray:
    """Times of the queries in frames: 0 and the end of every interval, shape [1 + (frames - 1) * len(counts)]."""
    within = np.cumsum(counts) / sum(counts)
    return np.concatenate([[0.0], (np.arange(frames - 1)[:, None] + within).ravel()])


def transforms_at(body: Body, pose: np.ndarray, root: np.ndarray, times: np.ndarray) -> np.ndarray:
    """Skinning transforms [Q, J, 4, 4] at times in frames: joints slerped, the root linear."""
    frames = np.arange(len(pose), dtype=np.float64)
    if len(times) > 1:
        pose = slerp_poses(pose, frames, times)
        root = np.stack([np.interp(times, frames, root[:, axis]) for axis in range(3)], axis=1)
    return body.joint_transforms(pose, root)


def pelvis_positions(body: Body, transforms: np.ndarray) -> np.ndarray:
    """The pelvis under skinning transforms [..., J, 4, 4]: the floating origin of the simulation [m], [..., 3]."""
    return moved(transforms[..., PELVIS, :, :], body.joints[PELVIS])


def moved(transforms: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Points [..., 3] under 4 x 4 transforms [..., 4, 4]."""
    return np.einsum("...ab,...b->...a", transforms[..., :3, :3], points) + transforms[..., :3, 3]
