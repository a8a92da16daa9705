"""The check of a cloth mesh: whatever would spoil a simulation is named before one begins.

In: vertices [V, 3] [m] and triangles [F, 3] from anywhere. Out: nothing, or one ``ValueError`` that names the mesh, the
vertex, triangle or edge (counted from 0) and what is allowed. Cheap enough to run on every mesh (about 20 ms at 12,540
vertices), so that no caller needs to trust another.
"""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp
from scipy.spatial import cKDTree

SAME_PLACE = 1e-6
"""Vertices nearer than this to each other [m] count as one that stands twice."""

FLATTEST = 1e-4
"""Least height of a triangle over its longest edge; a flatter one has no direction to measure strain along."""

SMALLEST_AREA = 1e-9
"""Least area of a triangle [m^2]: a hair of 1 mm by 2 um."""


def check_mesh(what: str, vertices: np.ndarray, faces: np.ndarray, pieces: int = 1) -> None:
    """Refuse a mesh that is no clean sheet of cloth.

    Args:
        what: How to name the mesh in an error, such as "garment 'skirt'".
        vertices: Positions [m], shape [V, 3].
        faces: Consistently wound triangles, shape [F, 3] of whole numbers.
        pieces: Connected pieces that the mesh is meant to have, at most; more than 1 for garments worn in layers.

    Raises:
        ValueError: Wrong shapes or types, values that are not finite, indices out of range, vertices in no triangle,
            degenerate or repeated triangles, edges of more than two triangles, windings that disagree, a vertex that
            joins separate parts, vertices at one place, or too many pieces.
    """
    vertices, faces = np.asarray(vertices), np.asarray(faces)
    check_arrays(what, vertices, faces)
    vertices = vertices.astype(np.float64)
    _check_triangles(what, vertices, faces)
    edge_of, first_of, owner = _check_edges(what, faces, len(vertices))
    _check_places(what, vertices)
    _check_fans(what, faces, len(vertices), edge_of, first_of, owner)
    _check_pieces(what, faces, len(vertices), pieces)


def check_arrays(what: str, vertices: np.ndarray, faces: np.ndarray) -> None:
    """The first part of :func:`check_mesh`: shapes, types, finite values and the range of the indices."""
    for name, array, letter, kinds, values in (
        ("vertices", vertices, "V", "iuf", "numbers"),
        ("triangles", faces, "F", "iu", "whole numbers"),
    ):
        if array.ndim != 2 or array.shape[1] != 3:
            raise ValueError(f"{what}: {name} must have shape [{letter}, 3], got {list(array.shape)}")
        if array.dtype.kind not in kinds:
            raise ValueError(f"{what}: {name} must hold {values}, got {array.dtype}")
    if len(vertices) < 3 or len(faces) == 0:
        raise ValueError(
            f"{what}: a mesh needs at least 3 vertices and 1 triangle, got {len(vertices)} and {len(faces)}"
        )
    bad = ~np.isfinite(vertices).all(axis=1)
    if bad.any():
        raise ValueError(f"{what}: vertex {_first(bad)} is not finite{_more(bad, 'such vertices')}")
    bad = ((faces < 0) | (faces >= len(vertices))).any(axis=1)
    if bad.any():
        triangle = _first(bad)
        raise ValueError(
            f"{what}: triangle {triangle} has the corners {_listed(faces[triangle])}, outside the {len(vertices)} "
            f"vertices 0..{len(vertices) - 1}"
        )


def _check_triangles(what: str, vertices: np.ndarray, faces: np.ndarray) -> None:
    unused = np.bincount(faces.ravel(), minlength=len(vertices)) == 0
    if unused.any():
        raise ValueError(f"{what}: vertex {_first(unused)} belongs to no triangle{_more(unused, 'such vertices')}")
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    doubled = np.linalg.norm(np.cross(b - a, c - a), axis=1)
    longest = np.max([((p - q) ** 2).sum(axis=1) for p, q in ((a, b), (b, c), (c, a))], axis=0)
    flat = (doubled < 2.0 * SMALLEST_AREA) | (doubled < FLATTEST * longest)
    if flat.any():
        triangle = _first(flat)
        raise ValueError(
            f"{what}: triangle {triangle} of the vertices {_listed(faces[triangle])} is degenerate, its area is "
            f"{doubled[triangle] / 2:.2g} m^2{_more(flat, 'such triangles')}"
        )
    corners = np.sort(faces, axis=1)
    order = np.lexsort(corners.T)
    same = (corners[order[1:]] == corners[order[:-1]]).all(axis=1)
    if same.any():
        pair = sorted(order[_first(same) : _first(same) + 2])
        raise ValueError(
            f"{what}: triangles {pair[0]} and {pair[1]} have the same corners {_listed(faces[pair[0]])}"
            f"{_more(same, 'such pairs')}"
        )


def _check_edges(what: str, faces: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """At most two triangles an edge, running along it in opposite directions.

    Returns:
        The half-edges (3 f + k runs from corner k to corner k + 1 of triangle f) that have a partner, shape [H], and
        the partners, shape [H]; then the vertex that each of the former starts from, shape [H].
    """
    start, end = faces.reshape(-1).astype(np.int64), faces[:, [1, 2, 0]].reshape(-1).astype(np.int64)
    key = np.minimum(start, end) * count + np.maximum(start, end)
    order = np.argsort(key, kind="stable")
    follows = key[order][1:] == key[order][:-1]
    crowded = follows[1:] & follows[:-1]
    if crowded.any():
        edge = key[order[_first(crowded)]]
        owners = np.flatnonzero(key == edge) // 3
        raise ValueError(
            f"{what}: the edge between vertices {edge // count} and {edge % count} belongs to {len(owners)} triangles "
            f"({_listed(owners[:6])}): the mesh is not manifold, at most 2 may share an edge"
        )
    one, other = order[:-1][follows], order[1:][follows]
    alike = start[one] == start[other]
    if alike.any():
        k = _first(alike)
        raise ValueError(
            f"{what}: triangles {one[k] // 3} and {other[k] // 3} are wound against each other at the edge between "
            f"vertices {start[one[k]]} and {end[one[k]]}{_more(alike, 'such edges')}: all must be counter-clockwise "
            "from the same side"
        )
    return one, other, start[one]


def _check_places(what: str, vertices: np.ndarray) -> None:
    tree = cKDTree(vertices, balanced_tree=False, compact_nodes=False)
    pairs = tree.query_pairs(SAME_PLACE, output_type="ndarray")
    if len(pairs):
        first = pairs[np.lexsort(pairs.T[::-1])[0]]
        more = f" ({len(pairs)} such pairs)" if len(pairs) > 1 else ""
        raise ValueError(
            f"{what}: vertices {first[0]} and {first[1]} lie at the same place (within {SAME_PLACE:g} m){more}: "
            "join them into one"
        )


def _check_fans(
    what: str, faces: np.ndarray, count: int, one: np.ndarray, other: np.ndarray, begin: np.ndarray
) -> None:
    """The triangles around a vertex must hang together by their edges, or the sheet is only held by a point there."""
    corners = 3 * len(faces)
    following = np.arange(corners).reshape(-1, 3)[:, [1, 2, 0]].reshape(-1)
    # Partners run in opposite directions: the start of one is the end of the other.
    rows = np.concatenate([one, following[one]])
    columns = np.concatenate([following[other], other])
    graph = sp.coo_matrix((np.ones(len(rows), dtype=bool), (rows, columns)), shape=(corners, corners))
    fans, label = sp.csgraph.connected_components(graph.tocsr(), directed=False)
    if fans > count:
        _, corner = np.unique(label, return_index=True)
        around = np.bincount(faces.reshape(-1)[corner], minlength=count)
        raise ValueError(
            f"{what}: vertex {_first(around > 1)} joins {around[_first(around > 1)]} parts that share no edge there"
            f"{_more(around > 1, 'such vertices')}: the mesh is not manifold"
        )


def _check_pieces(what: str, faces: np.ndarray, count: int, pieces: int) -> None:
    sizes = piece_sizes(faces, count)
    if len(sizes) > pieces:
        shown = ", ".join(map(str, sizes[:6])) + (", ..." if len(sizes) > 6 else "")
        raise ValueError(
            f"{what}: the mesh falls into {len(sizes)} disconnected pieces of {shown} vertices, {pieces} "
            f"{'is' if pieces == 1 else 'are'} allowed"
        )


def piece_sizes(faces: np.ndarray, count: int) -> np.ndarray:
    """Vertices in each connected piece of a mesh of ``count`` vertices, all of them used, largest first."""
    start, end = faces[:, [0, 1]].reshape(-1), faces[:, [1, 2]].reshape(-1)
    graph = sp.coo_matrix((np.ones(len(start), dtype=bool), (start, end)), shape=(count, count))
    _, label = sp.csgraph.connected_components(graph.tocsr(), directed=False)
    return np.sort(np.bincount(label))[::-1]


def _first(mask: np.ndarray) -> int:
    return int(np.argmax(mask))


def _more(mask: np.ndarray, noun: str) -> str:
    return f" ({int(mask.sum())} {noun})" if mask.sum() > 1 else ""


def _listed(numbers: np.ndarray) -> str:
    return ", ".join(str(int(number)) for number in numbers)
