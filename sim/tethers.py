"""Tethers: each free vertex is tied to the pin that is nearest over the cloth, by the length of the cloth between them.

In: the rest state of a garment with pins. See ``sim.kernels.tethers`` for why; how taut they get under which material
is told in ``sim.kernels.parameters``.
"""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp
import warp as wp

from sim.kernels import tethers as kernels
from sim.kernels.lanes import launch
from sim.rest_state import RestState

CHORD_EDGES = 5
"""Chords span up to this many edges."""


class Tethers:
    """Vertices, their pins and the distances between them over the cloth.

    Attributes:
        longest: Length of the longest tether [m].
    """

    def __init__(self, rest: RestState, width: int, device: str):
        vertex, pin, length = nearest_pins(rest)
        self.width, self.device = width, device
        self.longest = float(length.max(initial=0.0))
        self.vertex = wp.array(vertex.astype(np.int32), dtype=int, device=device)
        self.pin = wp.array(pin.astype(np.int32), dtype=int, device=device)
        self.length = wp.array(length.astype(np.float32), dtype=float, device=device)

    def launch(self, parameters: wp.array, x: wp.array) -> None:
        """Record: pull the vertices back of every lane."""
        inputs = [self.vertex, self.pin, self.length, parameters]
        launch(kernels.solve_tethers, self.width, len(self.vertex), inputs, [x], self.device)


def nearest_pins(rest: RestState) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """For each free vertex of a piece with pins: the vertex, its nearest pin, and the way over the cloth [m]."""
    distance, _, source = sp.csgraph.dijkstra(
        _chords(rest), directed=False, indices=rest.pinned, min_only=True, return_predecessors=True
    )
    vertex = np.flatnonzero(np.isfinite(distance) & (rest.inverse_mass > 0.0))
    return vertex, source[vertex], distance[vertex]


def _chords(rest: RestState) -> sp.csr_matrix:
    """Lengths [m] of the chords between vertices up to five edges apart, [V, V].

    A path of edges zigzags and is up to 15% longer than the cloth; a path of such chords is within 1%.
    """
    near = rest.topology.adjacency().astype(bool)
    reach = near
    for _ in range(CHORD_EDGES - 1):
        reach = (reach @ near + near).astype(bool)
    i, j = sp.triu(reach, k=1).nonzero()
    length = np.linalg.norm(rest.vertices[i] - rest.vertices[j], axis=1)
    return sp.coo_matrix((length, (i, j)), shape=reach.shape).tocsr()
