"""The 24-joint SMPL skeleton: names, parents and left-right pairs (Loper et al. 2015)."""

from __future__ import annotations

import numpy as np

JOINT_NAMES: tuple[str, ...] = (
    "pelvis",
    "left_hip",
    "right_hip",
    "spine1",
    "left_knee",
    "right_knee",
    "spine2",
    "left_ankle",
    "right_ankle",
    "spine3",
    "left_foot",
    "right_foot",
    "neck",
    "left_collar",
    "right_collar",
    "head",
    "left_shoulder",
    "right_shoulder",
    "left_elbow",
    "right_elbow",
    "left_wrist",
    "right_wrist",
    "left_hand",
    "right_hand",
)
"""Joint names in SMPL order; a pose array's second axis follows it."""

JOINT_COUNT = len(JOINT_NAMES)

PARENTS: tuple[int, ...] = (-1, 0, 0, 0, 1, 2, 3, 4, 5, 6, 7, 8, 9, 9, 9, 12, 13, 14, 16, 17, 18, 19, 20, 21)
"""Parent joint of each joint; -1 for the root. A parent always comes before its children."""

JOINT_INDEX: dict[str, int] = {name: index for index, name in enumerate(JOINT_NAMES)}
"""Index of each joint by its name."""

LEFT_RIGHT_PAIRS: tuple[tuple[int, int], ...] = tuple(
    (JOINT_INDEX[name], JOINT_INDEX["right_" + name.removeprefix("left_")])
    for name in JOINT_NAMES
    if name.startswith("left_")
)
"""(left, right) joint indices."""


def mirrored_joint_order() -> np.ndarray:
    """Permutation of the joints that swaps left and right, shape [24]."""
    order = np.arange(JOINT_COUNT)
    for left, right in LEFT_RIGHT_PAIRS:
        order[left], order[right] = right, left
    return order
