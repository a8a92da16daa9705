"""The way from the bind pose, in which a garment is built, into the first frame of a clip.

A simulation starts with the garment on the body in its bind pose. The lead-in carries the body from there, at rest,
to the first pose of the clip and arrives with that pose's velocity and acceleration, so that the cloth feels no jolt
at frame 0.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from scipy.spatial.transform import Rotation

from motions.clip import Clip

if TYPE_CHECKING:
    from body.model import Body


def lead_in(clip: Clip, body: Body, frames: int) -> tuple[np.ndarray, np.ndarray]:
    """Motion that ends one frame before the clip begins.

    Every joint follows a quintic in the logarithm of its rotation relative to the bind pose: value, velocity and
    acceleration are zero at the first frame and those of the clip at its first frame (Flash & Hogan 1985: the
    minimum-jerk curve between these two states).

    Args:
        clip: The clip to arrive in.
        body: Body whose bind pose is the start.
        frames: Number of frames L of the lead-in at the clip's rate; its first frame is the bind pose itself.

    Returns:
        Pose [rad], shape [L, 24, 3], and root [m], shape [L, 3], float32; ``concatenate([lead_pose, clip.pose])`` is
        smooth.

    Raises:
        ValueError: Fewer than 2 frames.
    """
    if frames < 2:
        raise ValueError(f"A lead-in needs at least 2 frames, got {frames}")
    progress = np.arange(frames) / frames
    bind = Rotation.from_rotvec(np.asarray(body.bind_pose(), dtype=np.float64))
    # Logarithms relative to the bind pose of the clip's first frames, where the boundary values are read off by
    # differences.
    ahead = np.stack(
        [(bind.inv() * Rotation.from_rotvec(pose)).as_rotvec() for pose in clip.pose[:3].astype(np.float64)]
    )
    for index in range(1, len(ahead)):
        ahead[index] = _nearest_equivalent(ahead[index], ahead[index - 1])
    relative = _quintic(ahead, progress, frames)
    pose = np.stack([(bind * Rotation.from_rotvec(vectors)).as_rotvec() for vectors in relative])
    root = _quintic(clip.root[:3].astype(np.float64), progress, frames)
    return pose.astype(np.float32), root.astype(np.float32)


def _quintic(ahead: np.ndarray, progress: np.ndarray, frames: int) -> np.ndarray:
    """Quintic, shape [L, ...], from rest at zero to the state of `ahead` (values at 1, 1 + 1/L, 1 + 2/L)."""
    end = ahead[0]
    if len(ahead) > 2:
        velocity = (-3.0 * ahead[0] + 4.0 * ahead[1] - ahead[2]) / 2.0 * frames
        acceleration = (ahead[0] - 2.0 * ahead[1] + ahead[2]) * frames**2
    else:
        velocity, acceleration = (ahead[1] - ahead[0]) * frames, np.zeros_like(end)
    s = progress.reshape(-1, *([1] * end.ndim))
    position_part = s**3 * (10.0 - 15.0 * s + 6.0 * s**2)
    velocity_part = s**3 * (-4.0 + 7.0 * s - 3.0 * s**2)
    acceleration_part = 0.5 * s**3 * (1.0 - s) ** 2
    return end * position_part + velocity * velocity_part + acceleration * acceleration_part


def _nearest_equivalent(vectors: np.ndarray, reference: np.ndarray) -> np.ndarray:
    """Of the rotation vectors that mean the same rotation, the one nearest to the reference, shape [J, 3] [rad]."""
    angle = np.linalg.norm(vectors, axis=-1, keepdims=True)
    safe = np.where(angle > 1e-9, angle, 1.0)
    other = vectors * (1.0 - 2.0 * np.pi / safe)
    closer = np.linalg.norm(other - reference, axis=-1) < np.linalg.norm(vectors - reference, axis=-1)
    return np.where(closer[:, None] & (angle > 1e-9), other, vectors)
