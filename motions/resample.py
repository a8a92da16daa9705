"""A motion at another frame rate."""

from __future__ import annotations

import numpy as np

from geometry.rotations import slerp_poses


def resampled(pose: np.ndarray, path: np.ndarray, fps: float, wanted: float) -> tuple[np.ndarray, np.ndarray]:
    """Pose and path at another rate, from the same first frame on.

    Frames are left out where the rates divide, so that nothing recorded is changed; else rotations are interpolated
    spherically and the path linearly.

    Args:
        pose: Axis-angle joint rotations [rad], shape [T, J, 3].
        path: Positions [m], shape [T, 3].
        fps: Frames per second that they have [Hz].
        wanted: Frames per second that are wanted [Hz].

    Raises:
        ValueError: Impossible rates, or fewer than two frames come out.
    """
    if not all(np.isfinite(rate) and 1.0 <= rate <= 480.0 for rate in (fps, wanted)):
        raise ValueError(f"from {fps:g} to {wanted:g} frames a second: both must lie between 1 and 480")
    times = np.arange(len(pose)) / fps
    count = int(times[-1] * wanted + 1e-3) + 1 if len(pose) else 0
    if count < 2:
        raise ValueError(f"{len(pose)} frames at {fps:g} Hz are too short for two frames at {wanted:g} Hz")
    stride = fps / wanted
    if abs(stride - round(stride)) < 1e-3 * stride:
        return pose[:: round(stride)], path[:: round(stride)]
    query = np.minimum(np.arange(count) / wanted, times[-1])
    positions = np.stack([np.interp(query, times, path[:, axis]) for axis in range(3)], axis=-1)
    return slerp_poses(pose, times, query), positions


def plain_rate(fps: float) -> float:
    """The whole number of frames a second that a recorded rate such as 29.9997 stands for, within a thousandth."""
    return float(round(fps)) if abs(fps - round(fps)) < 1e-3 * fps else fps
