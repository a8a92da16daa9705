"""Check of the body motion that a solver is given."""

from __future__ import annotations

import numpy as np


def checked_motion(pose: np.ndarray, root: np.ndarray, lead_in: int, joints: int) -> tuple[np.ndarray, np.ndarray]:
    """Pose [L + T, joints, 3] [rad] and root [L + T, 3] [m] as float64; ``ValueError`` says what does not fit."""
    pose, root = np.asarray(pose, dtype=np.float64), np.asarray(root, dtype=np.float64)
    if pose.ndim != 3 or pose.shape[1:] != (joints, 3):
        raise ValueError(f"pose: expected shape [L + T, {joints}, 3], got {list(pose.shape)}")
    if root.shape != (len(pose), 3):
        raise ValueError(f"root: expected shape [{len(pose)}, 3] to match the pose, got {list(root.shape)}")
    for name, values in (("pose", pose), ("root", root)):
        finite = np.isfinite(values).reshape(len(values), -1).all(axis=1)
        if not finite.all():
            raise ValueError(f"{name}: frame {int(np.argmin(finite))} is not finite")
    if not 0 <= lead_in < len(pose):
        raise ValueError(f"lead_in = {lead_in}: allowed are 0 to {len(pose) - 1} for {len(pose)} frames")
    return pose, root
