"""Whether a garment can be on a body at all: its size, its place, and that it starts outside the skin and uncrossed.

Faults that only show as a spoiled simulation otherwise: a file in centimetres, a mesh beside the body, a vertex in it.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from garments.quality import crossing_triangles
from geometry.proximity import SurfaceHits

if TYPE_CHECKING:
    from body.model import Body

SMALLEST, LARGEST = 0.08, 2.0
"""Longest side of a garment's bounding box over the height of the body: from a short top of a child's to a train."""

START_DEPTH = 0.005
"""Deepest that a vertex may lie inside the bind-pose body [m]; contact lifts it out at once."""

_UNITS = {"millimetres": 0.001, "centimetres": 0.01, "inches": 0.0254, "tenths of a millimetre": 0.0001}


def check_size_and_place(what: str, vertices: np.ndarray, body: Body) -> None:
    """Refuse a garment [m], shape [V, 3], of another scale than the bind-pose body or beside it.

    Raises:
        ValueError: One sentence with the sizes, and the unit that the mesh seems to be in.
    """
    low, high = vertices.min(axis=0).astype(float), vertices.max(axis=0).astype(float)
    feet, head = np.asarray(body.vertices).min(axis=0), np.asarray(body.vertices).max(axis=0)
    tall, size = float(head[1] - feet[1]), float((high - low).max())
    if not SMALLEST * tall <= size <= LARGEST * tall:
        fitting = [unit for unit, scale in _UNITS.items() if 0.15 * tall < scale * size < 1.2 * tall]
        hint = f": is it in {fitting[0]}?" if fitting else ""
        raise ValueError(
            f"{what}: the mesh is {size:.3g} m large on a body of {tall:.2f} m, allowed are {SMALLEST * tall:.2f} to "
            f"{LARGEST * tall:.2f} m{hint}"
        )
    apart = (low > head) | (high < feet)
    if apart.any():
        axis = int(np.argmax(apart))
        raise ValueError(
            f"{what}: the mesh lies beside the body, its {'xyz'[axis]} runs from {low[axis]:.2f} to {high[axis]:.2f} m "
            f"and the body's from {feet[axis]:.2f} to {head[axis]:.2f} m (y is up, z is the front)"
        )


def check_uncrossed(what: str, vertices: np.ndarray, faces: np.ndarray) -> None:
    """Refuse a garment that passes through itself; ``ValueError`` names the first two triangles that cross."""
    crossed = crossing_triangles(vertices, faces)
    if len(crossed):
        more = f" ({len(crossed)} such pairs)" if len(crossed) > 1 else ""
        raise ValueError(
            f"{what}: triangles {crossed[0, 0]} and {crossed[0, 1]} cross each other{more}: the garment must not pass "
            "through itself where it starts"
        )


def check_outside(what: str, hits: SurfaceHits, allowed: float = START_DEPTH) -> None:
    """Refuse a garment with vertices inside the body.

    Args:
        what: How to name the garment in an error.
        hits: The body's surface points closest to the garment's vertices.
        allowed: Deepest that a vertex may lie inside [m].

    Raises:
        ValueError: Names the deepest vertex.
    """
    depth = -hits.distance
    if depth.max() > allowed:
        worst = int(np.argmax(depth))
        raise ValueError(
            f"{what}: starts inside the body, vertex {worst} by {depth[worst] * 1e3:.1f} mm, at most "
            f"{allowed * 1e3:g} mm are allowed ({int((depth > allowed).sum())} such vertices)"
        )
