"""Roll-outs that diverge: held where they can be seen and judged, and nothing else is disturbed by them."""

from __future__ import annotations

import numpy as np

FARTHEST = 10.0
"""Distance from the pelvis along each axis at which the vertices of a roll-out that diverges are held [m]."""


def held_near(vertices: np.ndarray) -> np.ndarray:
    """Vertices relative to the pelvis [m], of any shape, no farther than ``FARTHEST`` along each axis, all numbers."""
    if vertices.size == 0 or np.abs(vertices).max() <= FARTHEST:  # not so where one is no number
        return vertices
    finite = np.nan_to_num(vertices, nan=FARTHEST, posinf=FARTHEST, neginf=-FARTHEST)
    return np.clip(finite, -FARTHEST, FARTHEST)
