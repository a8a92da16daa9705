"""Dense triangle surfaces that a garment is cut from: clipping, components, boundary curves.

In: any triangle mesh (marching cubes or a tube). Out: the part of it where smooth scalars are negative, with new
vertices exactly on the zero line, so that a hem is a clean curve whatever the triangles under it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp

from geometry.topology import MeshTopology, face_areas


@dataclass(frozen=True)
class DenseSurface:
    """A fine triangle mesh in body space.

    Attributes:
        vertices: Positions [m], shape [V, 3] float64.
        faces: Outward-oriented triangles, shape [F, 3].
    """

    vertices: np.ndarray
    faces: np.ndarray

    def clipped(self, scalar: np.ndarray) -> DenseSurface:
        """The part where ``scalar [V] < 0``; edges that change sign are cut at the linear zero crossing."""
        # A corner exactly on the line would make triangles without area.
        scalar = np.where(np.abs(scalar) < 1e-9, 1e-9, scalar)
        inside = scalar < 0.0
        counts = inside[self.faces].sum(axis=1)
        whole = self.faces[counts == 3]
        # Rotate the cut triangles so that the odd corner comes first.
        one = _odd_corner_first(self.faces[counts == 1], inside)
        two = _odd_corner_first(self.faces[counts == 2], ~inside)
        pairs = np.concatenate([one[:, [0, 1]], one[:, [0, 2]], two[:, [0, 1]], two[:, [0, 2]]])
        count = len(self.vertices)
        low, high = pairs.min(axis=1), pairs.max(axis=1)
        unique, inverse = np.unique(low.astype(np.int64) * count + high, return_inverse=True)
        a, b = unique // count, unique % count
        weight = (scalar[a] / (scalar[a] - scalar[b]))[:, None]
        added = self.vertices[a] * (1.0 - weight) + self.vertices[b] * weight
        n1, n2 = len(one), len(two)
        cut = inverse.reshape(-1) + count
        one_b, one_c, two_b, two_c = np.split(cut, [n1, 2 * n1, 2 * n1 + n2])
        faces = np.concatenate(
            [
                whole,
                np.stack([one[:, 0], one_b, one_c], axis=1),
                np.stack([two_b, two[:, 1], two[:, 2]], axis=1),
                np.stack([two_b, two[:, 2], two_c], axis=1),
            ]
        )
        return DenseSurface(np.concatenate([self.vertices, added]), faces).compacted()

    def compacted(self) -> DenseSurface:
        """The same surface without vertices that no face uses."""
        used, faces = np.unique(self.faces, return_inverse=True)
        return DenseSurface(self.vertices[used], faces.reshape(-1, 3))

    def largest_component(self) -> DenseSurface:
        """The connected part with the largest area."""
        if len(self.faces) == 0:
            return self
        i, j = self.faces[:, [0, 1, 2]].reshape(-1), self.faces[:, [1, 2, 0]].reshape(-1)
        graph = sp.coo_matrix((np.ones(len(i), dtype=bool), (i, j)), shape=(len(self.vertices),) * 2)
        _, label = sp.csgraph.connected_components(graph.tocsr(), directed=False)
        area = np.bincount(label[self.faces[:, 0]], weights=face_areas(self.vertices, self.faces))
        return DenseSurface(self.vertices, self.faces[label[self.faces[:, 0]] == area.argmax()]).compacted()

    def area(self) -> float:
        """Total area [m^2]."""
        return float(face_areas(self.vertices, self.faces).sum())

    def boundary_curves(self) -> list[np.ndarray]:
        """Closed boundary polylines [m], each of shape [K, 3], longest vertex count first."""
        topology = MeshTopology.from_faces(self.faces, len(self.vertices))
        return [self.vertices[loop] for loop in topology.boundary_loops()]


def _odd_corner_first(faces: np.ndarray, marked: np.ndarray) -> np.ndarray:
    """Faces rotated so that their single marked corner comes first; orientation is kept."""
    start = marked[faces].argmax(axis=1)
    return np.take_along_axis(faces, (start[:, None] + np.arange(3)) % 3, axis=1)
