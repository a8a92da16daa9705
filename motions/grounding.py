"""Root translation of motions that are known as poses alone, such as generated ones.

In: poses. Out: the root translation under which the supporting part of the body stays where it touches the ground. A
pose sequence fixes how the body moves about its pelvis; if the lowest point does not slide, the pelvis must move
against it. So a generated walk travels, and a generated squat goes down instead of lifting its feet.

Any part can support: all body vertices are candidates (thinned out), so that crawling and sitting work as walking does.
What cannot be known from poses is flight: the lowest point of every frame is put on the ground, a jump becomes a squat.
"""

from __future__ import annotations

import numpy as np

from body.model import Body, apply_skin, skin_matrix

SUPPORT_HEIGHT = 0.015  # [m] height over which a point loses its weight as a support
CANDIDATES = 1500
MOST_STEP = 0.3  # [m] a frame; more is a broken pose, not a stride, and would throw the body across the room


def ground_motion(pose: np.ndarray, body: Body, start: np.ndarray | None = None) -> np.ndarray:
    """Root translation that keeps the supporting points of a pose sequence in place on the ground.

    Args:
        pose: Axis-angle pose [rad], shape [T, 24, 3].
        body: Body whose surface touches the ground.
        start: Horizontal position (x, z) of the root at the first frame [m]; default the origin.

    Returns:
        Root translation [m], shape [T, 3] float32: the lowest body vertex of every frame is at y = 0.

    Raises:
        ValueError: Wrong shape of the pose.
    """
    transforms = body.joint_transforms(pose, np.zeros((len(pose), 3)))
    points = _candidate_points(body, transforms)  # [T, C, 3], root at rest
    height = points[..., 1] - points[..., 1].min(axis=1, keepdims=True)
    # A support must be low in both frames of a step: otherwise the foot that is just lifting off would still count.
    lowest = np.maximum(height[1:], height[:-1])
    lowest -= lowest.min(axis=1, keepdims=True)
    weight = np.exp(-np.square(lowest / SUPPORT_HEIGHT))
    weight /= weight.sum(axis=1, keepdims=True)
    step = np.einsum("tc,tcd->td", weight, (points[1:] - points[:-1])[..., [0, 2]])
    step *= np.minimum(1.0, MOST_STEP / np.maximum(np.linalg.norm(step, axis=1, keepdims=True), 1e-12))
    root = np.zeros((len(pose), 3))
    root[1:, [0, 2]] = -np.cumsum(step, axis=0)
    if start is not None:
        root[:, [0, 2]] += np.asarray(start, dtype=np.float64)
    root[:, 1] = -body.posed(pose, np.zeros((len(pose), 3)))[..., 1].min(axis=1)
    return root.astype(np.float32)


def _candidate_points(body: Body, transforms: np.ndarray) -> np.ndarray:
    """World positions [T, C, 3] of an even selection of body vertices, all of the feet among them."""
    foot = np.isin(body.part_of_vertex, (7, 8, 10, 11))
    rest = np.flatnonzero(~foot)
    stride = max(1, len(rest) // max(1, CANDIDATES - int(foot.sum())))
    chosen = np.concatenate([np.flatnonzero(foot), rest[::stride]])
    matrix = skin_matrix(body.vertices[chosen], body.skin_index[chosen], body.skin_weight[chosen])
    return apply_skin(matrix, transforms).astype(np.float64)
