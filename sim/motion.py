"""Check of the body motion that a solver is given."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from body.motion_limits import check_speeds

if TYPE_CHECKING:
    from body.model import Body


def checked_motion(
    pose: np.ndarray, root: np.ndarray, lead_in: int, body: Body, fps: float
) -> tuple[np.ndarray, np.ndarray]:
    """A motion as float64, or one sentence that says what does not fit.

    Args:
        pose: Axis-angle joint rotations [rad], shape [L + T, joints, 3].
        root: Root translations [m], shape [L + T, 3].
        lead_in: Number L of leading frames that are not recorded.
        body: The body that moves: its limbs say how far a rotation carries a joint.
        fps: Frames a second [Hz].

    Raises:
        ValueError: Wrong shapes, a value that is not finite, a lead-in longer than the motion, or a root or joint that
            moves faster than people do or jumps between frames (``body.motion_limits``).
    """
    pose, root = np.asarray(pose, dtype=np.float64), np.asarray(root, dtype=np.float64)
    joints = len(body.joints)
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
    check_speeds("motion", pose, root, fps, body.joint_positions(pose, root), lead_in)
    return pose, root
