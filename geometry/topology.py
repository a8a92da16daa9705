"""Connectivity of triangle meshes: edges, hinges, vertex normals and Laplacians.

In: ``faces [F, 3]`` (and vertex positions where geometry is asked for). Out: index arrays and sparse operators that
depend on the connectivity alone, so that they are computed once a garment and reused for every frame.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp


@dataclass(frozen=True)
class MeshTopology:
    """Unique edges and hinges of a manifold triangle mesh.

    Attributes:
        faces: Vertex indices of the triangles, shape [F, 3].
        edges: Unique undirected edges (i < j), shape [E, 2].
        boundary: True for edges with one adjacent face, shape [E].
        hinges: For each inner edge ``(i, j, k, l)``: the edge i-j as it runs in the first face, the opposite vertex k
            of the first face and l of the second, shape [H, 4].
        hinge_faces: The two faces of each hinge, shape [H, 2].
        vertex_count: Number of vertices V.
    """

    faces: np.ndarray
    edges: np.ndarray
    boundary: np.ndarray
    hinges: np.ndarray
    hinge_faces: np.ndarray
    vertex_count: int

    @classmethod
    def from_faces(cls, faces: np.ndarray, vertex_count: int | None = None) -> MeshTopology:
        """Build the topology; raises ``ValueError`` when an edge has more than two faces or two faces disagree."""
        faces = np.asarray(faces)
        if faces.ndim != 2 or faces.shape[1] != 3:
            raise ValueError(f"faces: expected shape [F, 3], got {list(faces.shape)}")
        faces = faces.astype(np.int32)
        count = int(faces.max()) + 1 if vertex_count is None else int(vertex_count)
        face_count = len(faces)
        # Half-edges, face by face: (a, b) with opposite vertex c.
        start = faces[:, [0, 1, 2]].reshape(-1).astype(np.int64)
        end = faces[:, [1, 2, 0]].reshape(-1).astype(np.int64)
        opposite = faces[:, [2, 0, 1]].reshape(-1)
        owner = np.repeat(np.arange(face_count), 3)
        key = np.minimum(start, end) * count + np.maximum(start, end)
        order = np.argsort(key, kind="stable")
        sorted_key = key[order]
        unique, first, uses = np.unique(sorted_key, return_index=True, return_counts=True)
        if (uses > 2).any():
            bad = unique[uses > 2][0]
            raise ValueError(f"edge {bad // count}-{bad % count} has {uses.max()} faces: the mesh is not manifold")
        edges = np.stack([unique // count, unique % count], axis=1).astype(np.int32)
        inner = uses == 2
        h0, h1 = order[first[inner]], order[first[inner] + 1]
        if (start[h0] == start[h1]).any():
            bad = h0[np.argmax(start[h0] == start[h1])]
            raise ValueError(f"two faces at edge {start[bad]}-{end[bad]} have opposite orientation")
        hinges = np.stack([start[h0], end[h0], opposite[h0], opposite[h1]], axis=1).astype(np.int32)
        hinge_faces = np.stack([owner[h0], owner[h1]], axis=1).astype(np.int32)
        return cls(faces, edges, ~inner, hinges, hinge_faces, count)

    def boundary_loops(self) -> list[np.ndarray]:
        """Boundary vertex loops in walking order, longest first."""
        following: dict[int, list[int]] = {}
        for i, j in self.edges[self.boundary]:
            following.setdefault(int(i), []).append(int(j))
            following.setdefault(int(j), []).append(int(i))
        loops, unseen = [], set(following)
        while unseen:
            vertex = min(unseen)
            loop = []
            while vertex is not None:
                loop.append(vertex)
                unseen.discard(vertex)
                vertex = next((n for n in following[vertex] if n in unseen), None)
            loops.append(np.array(loop, dtype=np.int32))
        return sorted(loops, key=len, reverse=True)

    def component_count(self) -> int:
        """Number of connected components over the vertices that a face uses."""
        graph = self.adjacency()
        used = np.zeros(self.vertex_count, dtype=bool)
        used[self.faces] = True
        _, labels = sp.csgraph.connected_components(graph, directed=False)
        return len(np.unique(labels[used]))

    def adjacency(self) -> sp.csr_matrix:
        """Symmetric 0/1 vertex adjacency, shape [V, V]."""
        i, j = self.edges.T
        ones = np.ones(len(i))
        half = sp.coo_matrix((ones, (i, j)), shape=(self.vertex_count, self.vertex_count))
        return (half + half.T).tocsr()

    def uniform_laplacian(self) -> sp.csr_matrix:
        """Umbrella operator ``(L x)_i = x_i - mean of the neighbours``, shape [V, V]."""
        adjacency = self.adjacency()
        degree = np.maximum(np.asarray(adjacency.sum(axis=1)).ravel(), 1.0)
        return (sp.identity(self.vertex_count) - sp.diags(1.0 / degree) @ adjacency).tocsr()


def corner_table(faces: np.ndarray, vertex_count: int) -> tuple[np.ndarray, np.ndarray]:
    """For each vertex the (next, last) vertices of its faces in face order: offsets [B + 1] and pairs [3 F, 2]."""
    pairs = np.stack([faces[:, [1, 2]], faces[:, [2, 0]], faces[:, [0, 1]]], axis=1).reshape(-1, 2)
    order = np.argsort(faces.ravel(), kind="stable")
    counts = np.bincount(faces.ravel(), minlength=vertex_count)
    return np.concatenate([[0], np.cumsum(counts)]).astype(np.int32), pairs[order].astype(np.int32)


def face_normals(vertices: np.ndarray, faces: np.ndarray, unit: bool = True) -> np.ndarray:
    """Normals of the triangles, shape [..., F, 3]; not unit: length is twice the area [m^2]."""
    a, b, c = (np.moveaxis(vertices.take(faces[:, k], axis=-2), -1, 0) for k in range(3))
    normals = np.stack(list(_cross(b - a, c - a)), axis=-1)
    return normalized(normals) if unit else normals


def vertex_normals(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Area-weighted unit vertex normals, shape [..., V, 3] for ``vertices [..., V, 3]``."""
    count = vertices.shape[-2]
    rows = faces.reshape(-1)
    columns = np.repeat(np.arange(len(faces)), 3)
    gather = sp.csr_matrix((np.ones(len(rows), dtype=vertices.dtype), (rows, columns)), shape=(count, len(faces)))
    # Coordinate by coordinate, with the frames side by side, as products and sums are fastest.
    points = by_coordinate(vertices)
    a, b, c = (points.take(faces[:, k], axis=1) for k in range(3))
    summed = [gather @ normal for normal in _cross(b - a, c - a)]
    length = np.maximum(_length(*summed), 1e-20)
    made = np.empty((points.shape[2], count, 3), dtype=vertices.dtype)
    for k in range(3):
        made[..., k] = (summed[k] / length).T
    return made.reshape(vertices.shape)


def by_coordinate(vertices: np.ndarray) -> np.ndarray:
    """Vertices [..., V, 3] as [3, V, T], frames side by side: the form in which many frames are quick to go through."""
    return np.ascontiguousarray(vertices.reshape(-1, *vertices.shape[-2:]).transpose(2, 1, 0))


def face_areas(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Triangle areas [m^2], shape [..., F]."""
    return 0.5 * np.linalg.norm(face_normals(vertices, faces, unit=False), axis=-1)


def edge_lengths(vertices: np.ndarray, edges: np.ndarray) -> np.ndarray:
    """Edge lengths [m], shape [..., E]."""
    return lengths(vertices.take(edges[:, 0], axis=-2) - vertices.take(edges[:, 1], axis=-2))


def face_angles(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Inner angles of the triangles [rad], shape [F, 3]."""
    corners = vertices[faces]
    angles = []
    for k in range(3):
        u = normalized(corners[:, (k + 1) % 3] - corners[:, k])
        v = normalized(corners[:, (k + 2) % 3] - corners[:, k])
        angles.append(np.arccos(np.clip((u * v).sum(-1), -1.0, 1.0)))
    return np.stack(angles, axis=1)


def normalized(vectors: np.ndarray) -> np.ndarray:
    """Vectors divided by their length; a zero vector stays zero."""
    return vectors / np.maximum(lengths(vectors), 1e-20)[..., None]


def lengths(vectors: np.ndarray) -> np.ndarray:
    """Of ``vectors [..., 3]``, to the last bit those of ``np.linalg.norm``, which takes three times as long."""
    return _length(vectors[..., 0], vectors[..., 1], vectors[..., 2])


def _length(x: np.ndarray, y: np.ndarray, z: np.ndarray) -> np.ndarray:
    return np.sqrt(x * x + y * y + z * z)


def _cross(u: np.ndarray, v: np.ndarray) -> Iterator[np.ndarray]:
    """``np.cross`` of vectors [3, ...], coordinate by coordinate, to the last bit."""
    for i, j in ((1, 2), (2, 0), (0, 1)):
        yield u[i] * v[j] - u[j] * v[i]
