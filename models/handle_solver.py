"""Displacements of a garment that put some of its vertices where they are wanted and change its shape least.

In: which vertices, and their displacements d [m]. Out: the displacements x of all vertices that minimise

    |L x|^2 + mu |x|^2 + omega sum_{i in C} |x_i - d_i|^2,

L the uniform Laplacian. Only the diagonal of the normal equations depends on C, so their constant part A, which is
factorised once (QDLDL, Apache-2.0), gives the solution by the Woodbury identity: with the rows R_C of A^-1 that belong
to C, x = R_C^T y, where (R_CC + I / omega) y = d. Each row is computed when its vertex first needs it, and kept.
"""

from __future__ import annotations

import numpy as np
import qdldl
import scipy.sparse as sp
from scipy.linalg import cho_factor, cho_solve

from geometry.topology import MeshTopology

MOST_SHARE, MOST_HANDLES = 0.25, 600
"""Share and number of the vertices up to which their rows are used; with more a new factorisation is cheaper."""

MOST_BYTES = 256 * 2**20
"""Memory that the kept rows may take."""


class HandleSolver:
    """The least change of shape for one garment connectivity.

    Args:
        topology: Connectivity of the garment.
        weight: omega, of the wanted displacements.
        anchor: mu, of all displacements; > 0.
    """

    def __init__(self, topology: MeshTopology, weight: float, anchor: float) -> None:
        self.weight, self.vertex_count = weight, topology.vertex_count
        laplacian = topology.uniform_laplacian()
        constant = laplacian.T @ laplacian + anchor * sp.identity(self.vertex_count)
        self._matrix = sp.triu(constant, format="csc")
        self._matrix.sort_indices()
        self._solver = qdldl.Solver(self._matrix, upper=True)
        self._whole: qdldl.Solver | None = None
        # Pages of it are taken as rows are written.
        self._rows = np.empty(
            (min(self.vertex_count, MOST_BYTES // (4 * self.vertex_count)), self.vertex_count), np.float32
        )
        self._slot = np.full(self.vertex_count, -1)
        self._kept = 0

    def solve(self, vertices: np.ndarray, wanted: np.ndarray) -> np.ndarray:
        """Displacements [m], shape [V, 3], for those that ``wanted [C, 3]`` gives to the distinct ``vertices [C]``."""
        if len(vertices) > min(MOST_SHARE * self.vertex_count, MOST_HANDLES, len(self._rows)):
            return self.solve_anew(vertices, wanted)
        rows = self._rows_of(vertices)
        among = rows[:, vertices].astype(np.float64)
        among = 0.5 * (among + among.T)
        among.flat[:: len(among) + 1] += 1.0 / self.weight
        forces = cho_solve(cho_factor(among, overwrite_a=True, check_finite=False), wanted, check_finite=False)
        return (rows.T @ forces.astype(np.float32)).astype(np.float64)

    def solve_anew(self, vertices: np.ndarray, wanted: np.ndarray) -> np.ndarray:
        """As ``solve``, by a factorisation of the whole system."""
        matrix, extra = self._matrix.copy(), np.zeros(self.vertex_count)
        extra[vertices] = self.weight
        # With sorted rows the last entry of each column of an upper triangle is its diagonal.
        matrix.data[matrix.indptr[1:] - 1] += extra
        if self._whole is None:
            self._whole = qdldl.Solver(matrix, upper=True)
        else:
            self._whole.update(matrix, upper=True)
        right = np.zeros((3, self.vertex_count))
        right[:, vertices] = self.weight * wanted.T
        return np.stack([self._whole.solve(column) for column in right], axis=1)

    def _rows_of(self, vertices: np.ndarray) -> np.ndarray:
        """Rows of the inverse of the constant part, shape [C, V]."""
        missing = vertices[self._slot[vertices] < 0]
        if self._kept + len(missing) > len(self._rows):
            self._slot[:] = -1
            self._kept, missing = 0, vertices
        for vertex in missing:
            unit = np.zeros(self.vertex_count)
            unit[vertex] = 1.0
            self._rows[self._kept] = self._solver.solve(unit)
            self._slot[vertex] = self._kept
            self._kept += 1
        return self._rows[self._slot[vertices]]
