"""Pieces of a triangle mesh as surfaces of their own: their vertices, their rims, and lids over the rims."""

from __future__ import annotations

import numpy as np
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from geometry.topology import MeshTopology


def own_vertices(faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Number the vertices of a piece so that each belongs to one fan of triangles.

    Where a piece touches itself at a mere vertex, the vertex is given one number a fan, so that every rim is a simple
    loop.

    Args:
        faces: Triangles of the piece in the mesh's numbering, shape [F, 3].

    Returns:
        The same triangles in the piece's numbering, shape [F, 3], and the mesh's vertex of each number, shape [N].
    """
    corners = np.arange(faces.size).reshape(faces.shape)
    pairs = _shared_edges(faces)
    ones = np.ones(len(pairs))
    graph = coo_matrix((ones, (pairs[:, 0], pairs[:, 1])), shape=(faces.size, faces.size))
    count, label = connected_components(graph, directed=False)
    origin = np.empty(count, dtype=np.int64)
    origin[label] = faces.ravel()
    return label[corners].astype(np.int32), origin


def _shared_edges(faces: np.ndarray) -> np.ndarray:
    """Pairs of corners (numbered 3 f + k) that sit at the same end of an edge shared by two triangles, shape [P, 2]."""
    count = int(faces.max()) + 1
    start, end = faces.ravel().astype(np.int64), np.roll(faces, -1, axis=1).ravel().astype(np.int64)
    corner = np.arange(faces.size)
    following = 3 * (corner // 3) + (corner + 1) % 3
    key = np.minimum(start, end) * count + np.maximum(start, end)
    order = np.argsort(key, kind="stable")
    same = np.flatnonzero(key[order][1:] == key[order][:-1])
    first, second = order[same], order[same + 1]
    # The second triangle runs along the edge the other way.
    return np.concatenate([np.stack([first, following[second]], 1), np.stack([following[first], second], 1)])


def rims(faces: np.ndarray) -> list[np.ndarray]:
    """Boundary loops of a piece with vertices of its own, each walked as its triangles run, in order of vertices."""
    edges = set(map(tuple, np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]).tolist()))
    following = {a: b for a, b in sorted(edges) if (b, a) not in edges}
    loops = []
    while following:
        start = min(following)
        loop, vertex = [], start
        while vertex in following:
            loop.append(vertex)
            vertex = following.pop(vertex)
        loops.append(np.array(loop))
    return loops


def closed(vertices: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The piece with a fan of triangles from the middle of each rim over it; vertices [N, 3] [m] and faces [F, 3]."""
    points, triangles = [vertices], [faces]
    count = len(vertices)
    for loop in rims(faces):
        points.append(vertices[loop].mean(axis=0, keepdims=True))
        triangles.append(np.stack([np.roll(loop, -1), loop, np.full(len(loop), count)], axis=1))
        count += 1
    return np.concatenate(points), np.concatenate(triangles).astype(np.int32)


def components(faces: np.ndarray) -> list[np.ndarray]:
    """Positions in ``faces`` of the triangles of each edge-connected component."""
    corner = _shared_edges(faces) // 3
    graph = coo_matrix((np.ones(len(corner)), (corner[:, 0], corner[:, 1])), shape=(len(faces), len(faces)))
    count, label = connected_components(graph, directed=False)
    return [np.flatnonzero(label == k) for k in range(count)]


def is_disc(faces: np.ndarray) -> bool:
    """Whether a connected piece with vertices of its own is a disc: one rim and no handle."""
    topology = MeshTopology.from_faces(faces)
    return topology.vertex_count - len(topology.edges) + len(faces) == 1
