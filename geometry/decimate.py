"""Quadric edge collapse to an exact number of vertices, keeping the topology and the left-right symmetry.

In: a closed triangle mesh, a per-vertex importance and the mirror image of each vertex. Out: the kept vertices (a
subset of the given ones: skinning weights and shape components carry over without any transfer) and the new faces.

Half-edge collapses ranked by the quadric error of Garland & Heckbert 1997; a collapse is allowed only under the link
condition (Dey et al. 1999), which keeps a closed manifold closed and of the same genus, and when no face flips or
degenerates.
"""

from __future__ import annotations

import heapq

import numpy as np

EDGE_TERM = 0.05  # share of the squared edge length in the cost: evens out the triangles where the surface is flat
SMALLEST_NORMAL_COSINE = 0.5  # a collapse may turn a face by at most 60 degrees
LOWEST_SHAPE_QUALITY = 0.25  # 1 for an equilateral triangle, 0 for a sliver


class Decimator:
    """Working state of one decimation; see :func:`decimate`."""

    def __init__(self, vertices: np.ndarray, faces: np.ndarray, importance: np.ndarray, mirror: np.ndarray) -> None:
        self.points = [tuple(p) for p in np.asarray(vertices, dtype=float)]
        self.faces = [list(map(int, f)) for f in faces]
        self.importance = np.asarray(importance, dtype=float)
        self.mirror = [int(m) for m in mirror]
        self.star: list[set[int]] = [set() for _ in self.points]  # faces around each vertex
        for index, face in enumerate(self.faces):
            for vertex in face:
                self.star[vertex].add(index)
        self.alive = len(self.points)
        self.version = [0] * len(self.points)
        self.quadric = vertex_quadrics(np.asarray(vertices, dtype=float), np.asarray(faces))
        self.heap: list[tuple[float, int, int, int, int]] = []

    def ring(self, vertex: int) -> set[int]:
        """Vertices that share an edge with ``vertex``."""
        return {v for face in self.star[vertex] for v in self.faces[face]} - {vertex}

    def push(self, removed: int, kept: int) -> None:
        """Rank the collapse of ``removed`` onto ``kept``."""
        position = np.array([*self.points[kept], 1.0])
        error = position @ (self.quadric[removed] + self.quadric[kept]) @ position
        offset = position[:3] - np.array(self.points[removed])
        cost = self.importance[removed] * (error + EDGE_TERM * (offset @ offset) ** 2)
        heapq.heappush(self.heap, (cost, removed, kept, self.version[removed], self.version[kept]))

    def allowed(self, removed: int, kept: int) -> bool:
        """Link condition, no flipped face, no sliver."""
        ring_removed, ring_kept = self.ring(removed), self.ring(kept)
        if len(ring_removed & ring_kept) != 2 or len(ring_removed | ring_kept) <= 4:
            return False
        if any(len(self.ring(v)) <= 3 for v in ring_removed & ring_kept):
            return False
        target = self.points[kept]
        bound = LOWEST_SHAPE_QUALITY
        for index in self.star[removed]:  # where slivers are already, no better shape is asked for
            bound = min(bound, triangle_normal(*(self.points[v] for v in self.faces[index]))[1])
        for index in self.star[removed]:
            face = self.faces[index]
            if kept in face:
                continue
            before = [self.points[v] for v in face]
            after = [target if v == removed else self.points[v] for v in face]
            normal_before, _ = triangle_normal(*before)
            normal_after, quality = triangle_normal(*after)
            cosine = sum(a * b for a, b in zip(normal_before, normal_after))
            if cosine < SMALLEST_NORMAL_COSINE or quality < bound:
                return False
        return True

    def relink(self, removed: int, kept: int) -> list[tuple[int, list[int]]]:
        """Move all faces of ``removed`` to ``kept``; returns the faces as they were, for :meth:`restore`."""
        before = [(index, list(self.faces[index])) for index in self.star[removed]]
        for index, face in before:
            for vertex in face:
                self.star[vertex].discard(index)
            if kept in face:
                self.faces[index] = []
            else:
                self.faces[index] = [kept if vertex == removed else vertex for vertex in face]
                for vertex in self.faces[index]:
                    self.star[vertex].add(index)
        return before

    def restore(self, before: list[tuple[int, list[int]]]) -> None:
        """Undo a :meth:`relink`."""
        for index, face in before:
            for vertex in self.faces[index]:
                self.star[vertex].discard(index)
            self.faces[index] = face
            for vertex in face:
                self.star[vertex].add(index)

    def collapse(self, removed: int, kept: int) -> bool:
        """Collapse the edge and its mirror image; False, with nothing changed, where one of the two is not allowed."""
        pairs = [(removed, kept)]
        if self.mirror[removed] != removed:
            pairs.append((self.mirror[removed], self.mirror[kept]))
            if self.mirror[removed] == kept:
                return False
        elif self.mirror[kept] != kept:
            return False  # would pull the plane of symmetry to one side
        done: list[list[tuple[int, list[int]]]] = []
        for u, v in pairs:
            if not self.allowed(u, v):
                for before in reversed(done):
                    self.restore(before)
                return False
            done.append(self.relink(u, v))
        for u, v in pairs:
            self.quadric[v] += self.quadric[u]
            self.version[u] += 1
            self.version[v] += 1
            self.alive -= 1
        # Collapses rejected before may have become possible around here, so the whole neighbourhood is ranked again.
        for _, v in pairs:
            for neighbour in self.ring(v):
                self.push(v, neighbour)
                self.push(neighbour, v)
        return True

    def run(self, count: int) -> None:
        """Collapse the cheapest mirrored pairs until ``count`` vertices are left; may be called again for fewer."""
        if not self.heap:
            for vertex in range(len(self.points)):
                for neighbour in self.ring(vertex):
                    self.push(vertex, neighbour)
        while self.alive > count:
            if not self.heap:
                raise ValueError(f"decimation stopped at {self.alive} vertices, wanted {count}: no collapse is allowed")
            _, removed, kept, version_removed, version_kept = heapq.heappop(self.heap)
            if version_removed != self.version[removed] or version_kept != self.version[kept]:
                continue
            if self.mirror[removed] != removed and self.alive - 2 < count:
                continue  # an odd one is left: wait for a collapse on the plane of symmetry
            self.collapse(removed, kept)


def decimate(
    vertices: np.ndarray, faces: np.ndarray, count: int, importance: np.ndarray, mirror: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Reduce a closed, left-right symmetric mesh to exactly ``count`` vertices.

    Args:
        vertices: Positions [m], shape [V, 3].
        faces: Triangles, shape [F, 3].
        count: Wanted number of vertices.
        importance: Factor on the cost of removing a vertex, shape [V]; smaller where detail matters less.
        mirror: Index of each vertex's mirror image (its own on the plane of symmetry), shape [V].

    Returns:
        Indices of the kept vertices, ascending, shape [count]; faces over the kept vertices, shape [F', 3].
    """
    work = Decimator(vertices, faces, importance, mirror)
    work.run(count)
    left = np.array([face for face in work.faces if face])
    kept = np.unique(left)
    renumber = np.full(len(work.points), -1)
    renumber[kept] = np.arange(len(kept))
    return kept, renumber[left]


def vertex_quadrics(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Area-weighted sum of squared plane distances as quadratic forms [m^4], shape [V, 4, 4]."""
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    normal = np.cross(b - a, c - a)
    double_area = np.linalg.norm(normal, axis=1, keepdims=True)
    unit = normal / np.maximum(double_area, 1e-20)
    plane = np.concatenate([unit, -(unit * a).sum(axis=1, keepdims=True)], axis=1)
    form = plane[:, :, None] * plane[:, None, :] * (double_area[:, :, None] / 6.0)
    quadrics = np.zeros((len(vertices), 4, 4))
    for corner in range(3):
        np.add.at(quadrics, faces[:, corner], form)
    return quadrics


def triangle_normal(a: tuple, b: tuple, c: tuple) -> tuple[tuple[float, float, float], float]:
    """Unit normal and shape quality (1 for equilateral) of one triangle; in plain floats: arrays are slower here."""
    ux, uy, uz = b[0] - a[0], b[1] - a[1], b[2] - a[2]
    vx, vy, vz = c[0] - a[0], c[1] - a[1], c[2] - a[2]
    nx, ny, nz = uy * vz - uz * vy, uz * vx - ux * vz, ux * vy - uy * vx
    length = (nx * nx + ny * ny + nz * nz) ** 0.5
    if length == 0.0:
        return (0.0, 0.0, 0.0), 0.0
    wx, wy, wz = vx - ux, vy - uy, vz - uz
    edges = ux * ux + uy * uy + uz * uz + vx * vx + vy * vy + vz * vz + wx * wx + wy * wy + wz * wz
    return (nx / length, ny / length, nz / length), 2.0 * 3.0**0.5 * length / edges
