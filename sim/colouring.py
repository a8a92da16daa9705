"""Greedy colouring of constraints, so that no two of one colour share a vertex.

Constraints of one colour can be solved in any order, or at once, with the same result: that makes Gauss-Seidel
deterministic on a CPU and parallel on a GPU.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Colouring:
    """An order of constraints, colour by colour.

    Attributes:
        order: Constraint indices sorted by colour, shape [C].
        ranges: ``(start, count)`` of each colour within ``order``.
    """

    order: np.ndarray
    ranges: tuple[tuple[int, int], ...]


def colour_constraints(constraints: np.ndarray, vertex_count: int) -> Colouring:
    """Colour constraints given by their vertices, shape [C, k]; first fit in the given order."""
    used = [0] * vertex_count  # bit c: a constraint of colour c touches the vertex
    colours = np.zeros(len(constraints), dtype=np.int64)
    for index, members in enumerate(constraints.tolist()):
        taken = 0
        for vertex in members:
            taken |= used[vertex]
        free = ~taken & (taken + 1)  # lowest zero bit
        colours[index] = free.bit_length() - 1
        for vertex in members:
            used[vertex] |= free
    order = np.argsort(colours, kind="stable")
    counts = np.bincount(colours) if len(colours) else np.zeros(0, dtype=np.int64)
    starts = np.concatenate([[0], np.cumsum(counts)[:-1]]) if len(counts) else counts
    return Colouring(order, tuple((int(s), int(n)) for s, n in zip(starts, counts)))
