"""Left-right mirrored clips: a second motion for free, and the way that one-sided families get their other side."""

from __future__ import annotations

import numpy as np

from body.skeleton import mirrored_joint_order
from motions.clip import Clip

_SUFFIX = "-mirrored"


def mirror_motion(pose: np.ndarray, root: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Motion reflected at the plane x = 0.

    Args:
        pose: Axis-angle joint rotations [rad], shape [..., 24, 3].
        root: Root translations [m], shape [..., 3].

    Returns:
        Pose and root of the same shapes. A reflection S maps R to S R S: of an axis-angle vector it keeps x and turns
        y, z.
    """
    return pose[..., mirrored_joint_order(), :] * np.float32([1, -1, -1]), root * np.float32([-1, 1, 1])


def mirror(clip: Clip) -> Clip:
    """The clip with left and right exchanged; mirroring twice gives the clip back.

    The words left and right in the label are exchanged as well. The take stays the same, so that a clip and its
    mirror image never land on different sides of a split.
    """
    pose, root = mirror_motion(clip.pose, clip.root)
    name = clip.name.removesuffix(_SUFFIX) if clip.name.endswith(_SUFFIX) else clip.name + _SUFFIX
    swapped = {"left": "right", "right": "left"}
    label = "-".join(swapped.get(word, word) for word in clip.label.split("-"))
    return Clip(name=name, take=clip.take, label=label, pose=pose, root=root, fps=clip.fps, source=clip.source)
