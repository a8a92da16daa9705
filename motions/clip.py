"""A clip: one labelled stretch of body motion, the unit that is simulated, split and drawn."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from body.motion_limits import check_speeds
from body.skeleton import JOINT_COUNT

MAX_ROTATION = 4.0 * np.pi  # [rad]; larger axis-angle vectors are almost always degrees taken for radians


@dataclass(frozen=True)
class Clip:
    """One labelled stretch of motion of the SMPL skeleton.

    Attributes:
        name: Unique name inside a set of clips.
        take: Recording (or generator run) that the clip was cut from. Splits never part the clips of one take.
        label: Class of the motion, for the label-conditioned models.
        pose: Axis-angle joint rotations in SMPL joint order [rad], shape [T, 24, 3], float32.
        root: Translation added to the posed body [m], shape [T, 3], float32.
        fps: Frames per second [Hz].
        source: Where the motion comes from, e.g. "procedural" or "bvh".

    Raises:
        ValueError: Wrong shapes, NaN or infinite values, rotations that look like degrees, a root or a
            joint that teleports (``body.motion_limits``).
    """

    name: str
    take: str
    label: str
    pose: np.ndarray
    root: np.ndarray
    fps: float
    source: str

    def __post_init__(self) -> None:
        object.__setattr__(self, "pose", np.ascontiguousarray(self.pose, dtype=np.float32))
        object.__setattr__(self, "root", np.ascontiguousarray(self.root, dtype=np.float32))
        object.__setattr__(self, "fps", float(self.fps))
        validate_motion(self.pose, self.root, self.fps, f"Clip '{self.name}'")
        for field in ("name", "take", "label"):
            if not getattr(self, field):
                raise ValueError(
                    f"Clip '{self.name}' has an empty {field}; every clip needs a name, a take and a label"
                )

    @property
    def frames(self) -> int:
        """Number of frames T."""
        return len(self.pose)


def validate_motion(pose: np.ndarray, root: np.ndarray, fps: float, what: str) -> None:
    """Refuse motion arrays that no simulation should see.

    Args:
        pose: Axis-angle joint rotations [rad], shape [T, 24, 3].
        root: Root translations [m], shape [T, 3].
        fps: Frames per second [Hz].
        what: How to name the motion in an error.

    Raises:
        ValueError: One sentence that says what is wrong, where, and what is allowed.
    """
    if pose.ndim != 3 or pose.shape[1:] != (JOINT_COUNT, 3):
        raise ValueError(f"{what}: pose has shape {list(pose.shape)}, expected [T, {JOINT_COUNT}, 3]")
    if len(pose) < 2:
        raise ValueError(f"{what}: {len(pose)} frame(s), at least 2 are needed")
    if root.shape != (len(pose), 3):
        raise ValueError(f"{what}: root has shape {list(root.shape)}, expected [{len(pose)}, 3]")
    if not (np.isfinite(fps) and 1.0 <= fps <= 480.0):
        raise ValueError(f"{what}: fps is {fps}, allowed are 1 to 480")
    for field, array in (("pose", pose), ("root", root)):
        bad = np.argwhere(~np.isfinite(array))
        if len(bad):
            raise ValueError(f"{what}: {field} is NaN or infinite in frame {bad[0][0]} ({len(bad)} values in all)")
    largest = np.linalg.norm(pose, axis=-1)
    if largest.max() > MAX_ROTATION:
        frame, joint = np.unravel_index(largest.argmax(), largest.shape)
        raise ValueError(
            f"{what}: joint {joint} is rotated by {largest.max():.1f} rad in frame {frame}, "
            f"at most {MAX_ROTATION:.1f} rad is allowed (are these degrees?)"
        )
    check_speeds(what, pose, root, fps)
