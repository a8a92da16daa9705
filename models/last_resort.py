"""The last resort of refinement: put single vertices out of the body, whatever that does to their surroundings.

In: garment vertices of a frame [m] and which of them are inside. Out: float32 vertices of which none is inside.

In a fold of the body the full clearance can lead into another part of it, so it is halved until the vertex is outside.
Where the skinned body runs through itself, in an armpit or a groin, the closest point itself can be buried: such a
vertex is drawn towards a neighbour that is outside.
"""

from __future__ import annotations

import numpy as np

from geometry.proximity import PosedSurface

TOUCH = 1.0e-5
"""A vertex nearer than this counts as inside [m], so that rounding to float32 cannot put it back."""

PROJECTIONS = 8
"""Halvings of the clearance that the last resort tries; 3 mm ends at 12 micrometres, just above ``TOUCH``."""

HALVINGS = 12
"""Times that the way from a buried vertex to a neighbour outside is halved; the rest of it is below 10 micrometres."""


def project_out(
    body: PosedSurface,
    edges: np.ndarray,
    vertices: np.ndarray,
    inside: np.ndarray,
    surface: np.ndarray,
    normal: np.ndarray,
    clearance: float,
) -> tuple[np.ndarray, int, int]:
    """Put what is inside straight onto its closest point.

    Args:
        body: The body in this frame.
        edges: Of the garment, shape [E, 2].
        vertices: Of the garment [m], shape [V, 3].
        inside: Which of them are inside, shape [V].
        surface, normal: Their closest body points [m] and its normals there, each [V, 3].
        clearance: Distance from the body to begin with [m].

    Returns:
        Vertices [V, 3] float32, how many were moved, and how many are inside still: 0 unless all were.
    """
    refined = vertices.astype(np.float32)
    rest = np.nonzero(inside)[0]
    projected = len(rest)
    for _ in range(PROJECTIONS + 1):
        if len(rest) == 0:
            return refined, projected, 0
        refined[rest] = surface[rest] + max(clearance, 1.1 * TOUCH) * normal[rest]
        rest = rest[body.query(refined[rest]).distance < 0.0]
        clearance *= 0.5
    return refined, projected, _draw_out(body, edges, refined, rest)


def _draw_out(body: PosedSurface, edges: np.ndarray, refined: np.ndarray, buried: np.ndarray) -> int:
    """Move in place the buried vertices towards neighbours that are outside, ring by ring; number left inside.

    About a vertex outside there is a ball without body, so that halving the way to it must end outside. A piece of
    garment that is inside as a whole has no such vertex: it goes to the nearest outside vertex of the garment.
    """
    outside = np.ones(len(refined), dtype=bool)
    outside[buried] = False
    while len(buried):
        goal = np.full(len(refined), -1)
        i, j = np.concatenate([edges, edges[:, ::-1]]).T
        edge = ~outside[i] & outside[j]
        # Of several neighbours outside, the nearest is written last and stays.
        far = np.linalg.norm(refined[i[edge]] - refined[j[edge]], axis=1)
        order = np.argsort(-far, kind="stable")
        goal[i[edge][order]] = j[edge][order]
        ready = buried[goal[buried] >= 0]
        if len(ready) == 0:
            free = np.nonzero(outside)[0]
            if len(free) == 0:
                break
            gap = np.linalg.norm(refined[buried[:1]] - refined[free], axis=1)
            ready, goal[buried[0]] = buried[:1], free[gap.argmin()]
        start, end = refined[ready], refined[goal[ready]]
        left, share = np.arange(len(ready)), np.float32(0.5)
        for _ in range(HALVINGS):
            refined[ready[left]] = end[left] + share * (start[left] - end[left])
            left = left[body.query(refined[ready[left]]).distance < 0.0]
            if len(left) == 0:
                break
            share *= np.float32(0.5)
        refined[ready[left]] = end[left]
        outside[ready] = True
        buried = buried[~outside[buried]]
    return len(buried)
