"""Facets rounded off, for pictures: each triangle in four, the new points lifted towards a smooth surface.

In: vertices [m], normals and colours. Out: those of a finer mesh, whose first vertices are the given ones.
"""

from __future__ import annotations

import numpy as np

from geometry.topology import MeshTopology, normalized


class Tessellation:
    """One level of Phong tessellation (Boubekeur and Alexa 2008): rounder silhouettes, vertices kept."""

    def __init__(self, faces: np.ndarray, roundness: float = 0.6) -> None:
        topology = MeshTopology.from_faces(faces)
        self.edges, self.roundness = topology.edges.astype(np.int64), roundness
        count = topology.vertex_count
        key = {(int(i), int(j)): count + k for k, (i, j) in enumerate(self.edges)}
        a, b, c = faces.T

        def middle(i: np.ndarray, j: np.ndarray) -> np.ndarray:
            return np.array([key[min(p, q), max(p, q)] for p, q in zip(i.tolist(), j.tolist(), strict=True)])

        ab, bc, ca = middle(a, b), middle(b, c), middle(c, a)
        parts = ((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca))
        self.faces = np.concatenate([np.stack(part, axis=1) for part in parts])

    def __call__(
        self, vertices: np.ndarray, normals: np.ndarray, colours: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Vertices, normals and colours of the finer mesh, [V + E, 3] each."""
        i, j = self.edges.T
        half = 0.5 * (vertices[i] - vertices[j])
        # The midpoint dropped onto the tangent planes at both ends; the mean of the two.
        lift_i = np.einsum("ec,ec->e", half, normals[i])[:, None] * normals[i]
        lift_j = -np.einsum("ec,ec->e", half, normals[j])[:, None] * normals[j]
        middle = 0.5 * (vertices[i] + vertices[j]) + 0.5 * self.roundness * (lift_i + lift_j)
        return (
            np.concatenate([vertices, middle]),
            np.concatenate([normals, normalized(normals[i] + normals[j])]),
            np.concatenate([colours, 0.5 * (colours[i] + colours[j])]),
        )
