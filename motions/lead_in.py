"""The way from the bind pose, in which a garment is built, into the first frame of a clip.

A simulation starts with the garment on the body in its bind pose. The lead-in carries the body from there, at rest,
to the first pose of the clip and arrives with that pose's velocity, so that the cloth feels no jolt at frame 0.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from scipy.spatial.transform import Rotation

from motions.clip import Clip
from motions.timing import minimum_jerk

if TYPE_CHECKING:
    from body.model import Body

RUN_UP_SECONDS = 0.3  # over which the velocity of the clip's first frame builds up


def lead_in(clip: Clip, body: Body, frames: int) -> tuple[np.ndarray, np.ndarray]:
    """Motion that ends one frame before the clip begins.

    Every joint follows a minimum-jerk curve (Flash & Hogan 1985) in the logarithm of its rotation relative to the bind
    pose, at rest in the first frame, plus a run-up over the last ``RUN_UP_SECONDS`` that ends with the clip's first
    velocity. The run-up is short because it has to swing back first, the farther the longer it is.

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
    # Logarithms, relative to the bind pose, of the clip's first two frames: where to arrive, and how fast.
    ahead = np.stack(
        [(bind.inv() * Rotation.from_rotvec(pose)).as_rotvec() for pose in clip.pose[:2].astype(np.float64)]
    )
    ahead[1] = _nearest_equivalent(ahead[1], ahead[0])
    run_up = min(frames, max(2.0, RUN_UP_SECONDS * clip.fps))
    relative = _arrive(ahead, progress, 1.0 - run_up / frames)
    pose = np.stack([(bind * Rotation.from_rotvec(vectors)).as_rotvec() for vectors in relative])
    root = _arrive(clip.root[:2].astype(np.float64), progress, 1.0 - run_up / frames)
    return pose.astype(np.float32), root.astype(np.float32)


def _arrive(ahead: np.ndarray, progress: np.ndarray, run_up_start: float) -> np.ndarray:
    """From rest at zero to the first of two frames ahead, with the velocity between them.

    Args:
        ahead: Values of the clip's first two frames, shape [2, ...].
        progress: Part of the way in time, 0 to below 1, shape [L].
        run_up_start: Part of the way after which the velocity builds up.
    """
    s = progress.reshape(-1, *([1] * (ahead.ndim - 1)))
    u = np.clip((s - run_up_start) / (1.0 - run_up_start), 0.0, 1.0)
    # Quintic that is zero with its derivatives at u = 0, and has value 0, slope 1, curvature 0 at u = 1.
    slope = u**3 * (-4.0 + 7.0 * u - 3.0 * u**2)
    velocity = (ahead[1] - ahead[0]) * len(progress) * (1.0 - run_up_start)
    return ahead[0] * minimum_jerk(s) + velocity * slope


def _nearest_equivalent(vectors: np.ndarray, reference: np.ndarray) -> np.ndarray:
    """Of the rotation vectors that mean the same rotation, the one nearest to the reference, shape [J, 3] [rad]."""
    angle = np.linalg.norm(vectors, axis=-1, keepdims=True)
    safe = np.where(angle > 1e-9, angle, 1.0)
    other = vectors * (1.0 - 2.0 * np.pi / safe)
    closer = np.linalg.norm(other - reference, axis=-1) < np.linalg.norm(vectors - reference, axis=-1)
    return np.where(closer[:, None] & (angle > 1e-9), other, vectors)
