"""On which side of the body a garment vertex belongs that was found inside it.

In: the vertices inside, and the closest body point of each. Out: points of the body's surface that they are to be sent
to. The closest one is wrong for a vertex beyond the middle of a limb: it lies on the far side, and cloth that is sent
there is drawn through the limb. Three signs of that, looked for where closest points leap along an edge of the garment:

- a sleeve or a trouser leg that has sunk into its limb is torn there, one part sent to the front, its neighbour to the
  back. Such a piece leaves along the garment's own normals, which the sinking has not turned, where around it garment
  and body face the same way;
- a closest point that leaps away from that of the last good vertex on the way from outside is wrong;
- so is one whose normal turns against it.

The garment lies over the body there as it does around: what is left wrong is filled in harmonically from its
neighbours and brought onto the surface.
"""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp
from scipy.sparse.csgraph import connected_components, dijkstra
from scipy.sparse.linalg import spsolve

from geometry.proximity import PosedSurface
from geometry.topology import MeshTopology, vertex_normals

JUMP = 3.0
"""How many garment steps a closest point may move on the body from one garment vertex to its neighbour."""

SUNK = 3.0
"""Clearances that a piece of garment lies deep, from which on it may leave along its own normals."""

ALIKE = 0.3
"""Mean cosine between the normals of garment and body about a sunk piece, from which on it is cloth of that limb."""

FARTHEST = 3.0
"""Depths that it may go that way: farther, the way leads on through another part of the body."""

SHORTEST = 0.03
"""Way that it may go in any case [m]."""

STEPS = 12
"""Steps of that way, each as long as no surface is nearer, and at least ``LEAST_STEP`` [m]."""

LEAST_STEP = 0.002


class WayOut:
    """For one garment connectivity.

    Args:
        topology: Connectivity of the garment.
        clearance: Distance from the body that vertices are sent to [m].
    """

    def __init__(self, topology: MeshTopology, clearance: float) -> None:
        self.clearance, self.vertex_count, self._faces = clearance, topology.vertex_count, topology.faces
        self._ends = tuple(np.ascontiguousarray(end) for end in topology.edges.T)
        adjacency = topology.adjacency()
        self._laplacian = (sp.diags(np.asarray(adjacency.sum(axis=1)).ravel()) - adjacency).tocsr()

    def correct(
        self,
        body: PosedSurface,
        predicted: np.ndarray,
        vertices: np.ndarray,
        inside: np.ndarray,
        known: np.ndarray,
        surface: np.ndarray,
        normal: np.ndarray,
    ) -> int:
        """Correct in place the closest points that lie on the wrong side of the body.

        Args:
            body: In this frame.
            predicted: Garment as it was before anything moved it [m], shape [V, 3].
            vertices: Garment as it is now [m], shape [V, 3].
            inside: Which vertices are inside, shape [V].
            known: Whether the next two say something about a vertex, shape [V]; brought up to date in place.
            surface, normal: Closest body points [m] and normals there, each [V, 3].

        Returns:
            Number of vertices that were sent elsewhere than to their closest point.
        """
        i, j = self._ends
        touching = np.flatnonzero(inside[i] | inside[j])
        i, j = i[touching], j[touching]
        length = _length(vertices[i] - vertices[j]) + 1e-9
        # Only the vertices inside and those next to them take part, under numbers of their own.
        part = np.zeros(self.vertex_count, dtype=bool)
        part[i] = part[j] = True
        names = np.flatnonzero(part)
        shore = names[~inside[names]]
        if len(shore) == 0:
            return 0
        far = shore[~known[shore]]
        if len(far):
            hits = body.query(vertices[far])
            surface[far], normal[far], known[far] = hits.point, hits.normal, True
        # The ways below go along these edges: where none of them leaps, nothing is wrong.
        leap = _length(surface[i] - surface[j]) > JUMP * length + self.clearance
        torn = leap | (np.einsum("nc,nc->n", normal[i], normal[j]) < 0.0)
        if not torn.any():
            return 0
        depth = np.einsum("nc,nc->n", surface - vertices, normal)
        gone = np.zeros(0, dtype=np.int64)
        torn_deep = _pieces(inside & (depth > SUNK * self.clearance), i, j, torn)
        if torn_deep.any():
            shallow = known & (np.abs(depth) < SUNK * self.clearance)
            own = self._outward(predicted, shallow, normal)
            alike = np.einsum("nc,nc->n", own, normal)
            sunk = np.flatnonzero(_own_cloth(torn_deep, shallow, alike, i, j))
            if len(sunk):
                gone = _along(body, vertices, own, depth, sunk, surface, normal)
        waiting = inside.copy()
        waiting[gone] = False
        number = np.cumsum(part) - 1
        graph = sp.coo_matrix((length, (number[i], number[j])), shape=(len(names), len(names))).tocsr()
        return len(gone) + self._fill(body, vertices, names, graph, waiting, surface, normal)

    def _outward(self, predicted: np.ndarray, sure: np.ndarray, normal: np.ndarray) -> np.ndarray:
        """The garment's own normals [V, 3], turned away from the body: as most of the ``sure [V]`` vertices say."""
        own = vertex_normals(predicted[None], self._faces)[0].astype(np.float64)
        return -own if np.einsum("nc,nc->", own[sure], normal[sure]) < 0.0 else own

    def _fill(
        self,
        body: PosedSurface,
        vertices: np.ndarray,
        names: np.ndarray,
        graph: sp.csr_matrix,
        waiting: np.ndarray,
        surface: np.ndarray,
        normal: np.ndarray,
    ) -> int:
        """Visit the ``waiting [V]`` vertices by geodesic distance, and fill in the wrong ones; returns their number.

        ``graph`` joins the vertices ``names``, of which those that do not wait are good.
        """
        inside = waiting.copy()
        shore = np.flatnonzero(~inside[names])
        _, found, _ = dijkstra(graph, directed=False, indices=shore, return_predecessors=True, min_only=True)
        parent = np.full(self.vertex_count, -1)
        parent[names[found >= 0]] = names[found[found >= 0]]
        waiting = inside & (parent >= 0)
        last_good = np.arange(self.vertex_count)
        while waiting.any():
            level = np.nonzero(waiting & ~waiting[np.maximum(parent, 0)])[0]
            good = last_good[parent[level]]
            step = _length(vertices[level] - vertices[good])
            leap = _length(surface[level] - surface[good]) > JUMP * step + self.clearance
            turned = np.einsum("nc,nc->n", normal[level], normal[good]) < 0.0
            last_good[level] = np.where(leap | turned, good, level)
            waiting[level] = False
        is_wrong = last_good != np.arange(self.vertex_count)
        wrong = np.nonzero(is_wrong)[0]
        if len(wrong):
            # Every wrong vertex has a way to a good one, so the system is definite.
            around = self._laplacian[wrong][:, ~is_wrong] @ surface[~is_wrong]
            filled = spsolve(self._laplacian[wrong][:, wrong].tocsc(), -around).reshape(-1, 3)
            hits = body.query(filled)
            surface[wrong], normal[wrong] = hits.point, hits.normal
        return len(wrong)


def _pieces(deep: np.ndarray, i: np.ndarray, j: np.ndarray, torn: np.ndarray) -> np.ndarray:
    """Number, from 1, of the piece of ``deep [V]`` that a vertex belongs to, joined by edges i-j; 0 where none.

    Only pieces count at which an edge is torn.
    """
    ends = np.concatenate([i[torn], j[torn]])
    ends = ends[deep[ends]]
    if len(ends) == 0:
        return np.zeros(len(deep), dtype=np.int64)
    within = deep[i] & deep[j]
    shape = (len(deep), len(deep))
    graph = sp.coo_matrix((np.ones(within.sum(), dtype=np.int8), (i[within], j[within])), shape=shape)
    piece = connected_components(graph, directed=False)[1]
    return np.where(deep & np.isin(piece, piece[ends]), piece + 1, 0)


def _own_cloth(piece: np.ndarray, shallow: np.ndarray, alike: np.ndarray, i: np.ndarray, j: np.ndarray) -> np.ndarray:
    """Which vertices are of a piece that clothes what it has sunk into: a sleeve in its arm.

    About such a piece, garment and body face the same way. About one that another limb was pushed into, as an elbow
    into the side of a shirt, they face each other; along its own normals it would be wrapped about that limb.

    Args:
        piece: Piece of each vertex, shape [V], 0 where none.
        shallow: Vertices near the surface, shape [V].
        alike: Cosine between the normals of garment and body, shape [V].
        i, j: Ends of edges.
    """
    count = int(piece.max()) + 1
    total, number = np.zeros(count), np.zeros(count)
    for one, other in ((i, j), (j, i)):
        rim = (piece[one] > 0) & shallow[other]
        total += np.bincount(piece[one[rim]], alike[other[rim]], minlength=count)
        number += np.bincount(piece[one[rim]], minlength=count)
    own = total > ALIKE * number
    own[0] = False
    return own[piece]


def _along(
    body: PosedSurface,
    vertices: np.ndarray,
    direction: np.ndarray,
    depth: np.ndarray,
    left: np.ndarray,
    surface: np.ndarray,
    normal: np.ndarray,
) -> np.ndarray:
    """Where the vertices ``left`` come out of the body along their directions [V, 3], noted in place.

    No surface is nearer than the closest, so that it is safe to go as far at each step (sphere tracing).

    Returns:
        Those that came out.
    """
    gone, most = depth[left].copy(), np.maximum(FARTHEST * depth[left], SHORTEST)
    came_out = []
    for _ in range(STEPS):
        hits = body.query(vertices[left] + gone[:, None] * direction[left])
        out = hits.distance >= 0.0
        surface[left[out]], normal[left[out]] = hits.point[out], hits.normal[out]
        came_out.append(left[out])
        gone = gone + np.maximum(-hits.distance, LEAST_STEP)
        on = ~out & (gone < most)
        left, gone, most = left[on], gone[on], most[on]
        if len(left) == 0:
            break
    return np.concatenate(came_out)


def _length(vectors: np.ndarray) -> np.ndarray:
    """Of each of ``vectors [N, 3]``; a third of the time of ``np.linalg.norm``."""
    return np.sqrt(np.einsum("nc,nc->n", vectors, vectors))
