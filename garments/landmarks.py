"""Tailor's landmarks of a body in its bind pose: waist, crotch, neck base, limbs.

In: a ``Body`` (vertices, faces, joints in SMPL order, skin weights). Out: heights and points [m] that lengths of
garments are measured from, and convex slices of the trunk and legs.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
from scipy.spatial import ConvexHull

if TYPE_CHECKING:
    from body.model import Body

# SMPL joint numbers.
PELVIS, LEFT_HIP, RIGHT_HIP = 0, 1, 2
LEFT_KNEE, RIGHT_KNEE, LEFT_ANKLE, RIGHT_ANKLE, SPINE3 = 4, 5, 7, 8, 9
NECK, HEAD = 12, 15
SHOULDERS, ELBOWS, WRISTS = (16, 17), (18, 19), (20, 21)
ARM_JOINTS = (16, 17, 18, 19, 20, 21, 22, 23)
"""Upper arms to hands, left and right; the collars belong to the trunk."""

FOOT_JOINTS = (7, 8, 10, 11)


@dataclass(frozen=True)
class Landmarks:
    """Places on one body.

    Attributes:
        vertices: Body vertices [m], shape [B, 3].
        joints: Joints [m], shape [24, 3].
        faces: All faces, shape [F, 3].
        trunk_faces: Faces without the arms, shape [G, 3].
        leg_faces: Trunk faces without the feet, which would push a wide hem forward, shape [H, 3].
        arm_weight: Summed skin weight of the arms, shape [B].
        waist: Height of the natural waist (smallest girth between hips and ribs) [m].
        crotch: Height of the lowest trunk point in the symmetry plane [m].
        knee: Mean knee height [m].
        ankle: Mean ankle height [m].
    """

    vertices: np.ndarray
    joints: np.ndarray
    faces: np.ndarray
    trunk_faces: np.ndarray
    leg_faces: np.ndarray
    arm_weight: np.ndarray
    waist: float
    crotch: float
    knee: float
    ankle: float

    def slice_hull(self, height: float) -> np.ndarray:
        """Convex outline (x, z) [m] of trunk and legs at a height, counter-clockwise, shape [K, 2].

        Raises:
            ValueError: if the trunk and legs do not reach that height.
        """
        return _hull(slice_points(self.vertices, self.trunk_faces, height), height)


def find_landmarks(body: Body) -> Landmarks:
    """Measure a body in its bind pose; raises ``ValueError`` where it has no waist or crotch to measure."""
    vertices = np.asarray(body.vertices, dtype=np.float64)
    faces = np.asarray(body.faces, dtype=np.int64)
    joints = np.asarray(body.joints, dtype=np.float64)
    arm_weight = (np.asarray(body.skin_weight) * np.isin(body.skin_index, ARM_JOINTS)).sum(axis=1)
    trunk_faces = faces[arm_weight[faces].max(axis=1) < 0.5]
    foot_weight = (np.asarray(body.skin_weight) * np.isin(body.skin_index, FOOT_JOINTS)).sum(axis=1)
    hips = joints[[LEFT_HIP, RIGHT_HIP], 1].mean()
    heights = np.linspace(hips + 0.35 * (joints[SPINE3, 1] - hips), joints[SPINE3, 1], 25)
    girth = [_perimeter(_hull(slice_points(vertices, trunk_faces, y), y)) for y in heights]
    middle = slice_points(vertices, faces, joints[PELVIS, 0], axis=0)  # (y, z) of the symmetry plane
    trunk = middle[middle[:, 0] > joints[[LEFT_KNEE, RIGHT_KNEE], 1].mean()]
    if len(trunk) == 0:
        raise ValueError(f"body '{body.name}': nothing in the symmetry plane above the knees, so no crotch was found")
    return Landmarks(
        vertices=vertices,
        joints=joints,
        faces=faces,
        trunk_faces=trunk_faces,
        leg_faces=trunk_faces[foot_weight[trunk_faces].max(axis=1) < 0.5],
        arm_weight=arm_weight,
        waist=float(heights[int(np.argmin(girth))]),
        crotch=float(trunk[:, 0].min()),
        knee=float(joints[[LEFT_KNEE, RIGHT_KNEE], 1].mean()),
        ankle=float(joints[[LEFT_ANKLE, RIGHT_ANKLE], 1].mean()),
    )


def slice_points(vertices: np.ndarray, faces: np.ndarray, level: float, axis: int = 1) -> np.ndarray:
    """Points [m] where edges cross the plane ``coordinate[axis] = level``: the other two coordinates, shape [K, 2]."""
    other = [k for k in range(3) if k != axis]
    above = vertices[:, axis] > level
    start, end = faces[:, [0, 1, 2]].reshape(-1), faces[:, [1, 2, 0]].reshape(-1)
    cut = above[start] != above[end]
    a, b = vertices[start[cut]], vertices[end[cut]]
    weight = ((level - a[:, axis]) / (b[:, axis] - a[:, axis]))[:, None]
    return (a + weight * (b - a))[:, other]


def _hull(points: np.ndarray, height: float) -> np.ndarray:
    if len(points) < 3:
        raise ValueError(f"the body has no slice at height {height:.3f} m")
    return points[ConvexHull(points).vertices]


def _perimeter(outline: np.ndarray) -> float:
    return float(np.linalg.norm(outline - np.roll(outline, 1, axis=0), axis=1).sum())
