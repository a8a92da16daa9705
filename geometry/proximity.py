"""Closest points and signed distances from points to a triangle surface.

In: points [m] and a moving triangle mesh (fixed faces, new vertices every frame). Out: the closest surface point of
each point, with a signed distance that is negative inside a closed, outward-oriented surface.

The nearest face comes from a tree of boxes over the faces (Warp's, on the CPU), built once and refitted to every frame:
0.2 ms for a body of 13,776 faces, and 1.4 microseconds a point. Where two faces are equally near but for rounding in
single precision (0.1 micrometre on a body), either may be taken; its closest point is exact in double precision.

The sign comes from angle-weighted pseudo-normals, which are right on faces, edges and vertices alike (Baerentzen and
Aanaes 2005, "Signed distance computation using the angle weighted pseudonormal").
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import warp as wp
from scipy.sparse import csr_matrix

from geometry.surface_kernels import Surface, closest_points, find_sides

EVERYWHERE = 1.0e9
"""Reach of a search that has no limit [m]; its square is still a number in single precision."""


@dataclass(frozen=True)
class SurfaceHits:
    """Closest surface points of N query points.

    Attributes:
        distance: Signed distance [m], negative inside, shape [N].
        point: Closest surface point [m], shape [N, 3].
        normal: Outward unit pseudo-normal at the closest point, shape [N, 3].
        face: Index of the face that holds the closest point, shape [N].
        barycentric: Weights of that face's corners, shape [N, 3].
    """

    distance: np.ndarray
    point: np.ndarray
    normal: np.ndarray
    face: np.ndarray
    barycentric: np.ndarray

    def put(self, rows: np.ndarray, found: SurfaceHits) -> None:
        """Set those of the given numbers [M] to ``found``, of M points."""
        for own, new in zip(vars(self).values(), vars(found).values(), strict=True):
            own[rows] = new


class Sheet:
    """Which points are neighbours: of a garment, its vertices.

    Args:
        adjacency: Symmetric, non-zero between neighbours, shape [N, N].
    """

    def __init__(self, adjacency: csr_matrix) -> None:
        self.count = adjacency.shape[0]
        self.first = wp.array(adjacency.indptr, dtype=int, device="cpu")
        self.neighbours = wp.array(adjacency.indices, dtype=int, device="cpu")


class SurfaceQuery:
    """Closest-point queries against one triangle connectivity whose vertices move.

    Args:
        faces: Outward-oriented triangles, shape [F, 3].
        vertex_count: Number of vertices B; by default the largest index + 1.
    """

    def __init__(self, faces: np.ndarray, vertex_count: int | None = None) -> None:
        faces = np.asarray(faces)
        if faces.ndim != 2 or faces.shape[1] != 3 or len(faces) == 0:
            raise ValueError(f"faces: expected shape [F, 3] with F >= 1, got {list(faces.shape)}")
        self.faces = faces.astype(np.int64)
        self.vertex_count = int(self.faces.max()) + 1 if vertex_count is None else int(vertex_count)
        if self.faces.min() < 0 or self.faces.max() >= self.vertex_count:
            raise ValueError(f"faces: vertex indices must lie in 0..{self.vertex_count - 1}")
        # Warp's banner and its note about a missing CUDA driver would fill every job's log.
        wp.config.log_level = wp.LOG_ERROR
        first, around = _vertex_faces(self.faces, self.vertex_count)
        self._surface = Surface()
        self._surface.vertices = wp.zeros(self.vertex_count, dtype=wp.vec3d, device="cpu")
        self._surface.faces = _warp(self.faces, int)
        self._surface.across = _warp(_edge_neighbours(self.faces, self.vertex_count), int)
        self._surface.first, self._surface.around = _warp(first, int), _warp(around, int)
        self._tree: wp.Mesh | None = None
        self._posed: PosedSurface | None = None

    def at(self, vertices: np.ndarray) -> PosedSurface:
        """The surface with its vertices [m], shape [B, 3], at one instant: ask it as often as needed."""
        vertices = _checked(vertices, "vertices")
        if len(vertices) != self.vertex_count:
            raise ValueError(f"vertices: expected {self.vertex_count} rows, got {len(vertices)}")
        return PosedSurface(self, vertices.copy())

    def query(self, points: np.ndarray, vertices: np.ndarray) -> SurfaceHits:
        """Closest surface points of ``points [N, 3]`` on the mesh with ``vertices [B, 3]`` [m]."""
        return self.at(vertices).query(points)

    def surface(self, posed: PosedSurface) -> Surface:
        """What the kernels take, at this instant; valid until it is asked for at another."""
        if self._posed is not posed:
            vertices = posed.vertices
            # Column by column: over the short axis NumPy takes ten times as long.
            middle = np.array([0.5 * (column.min() + column.max()) for column in vertices.T])
            self._surface.middle = wp.vec3d(*middle)
            self._surface.vertices.numpy()[:] = vertices
            if self._tree is None:
                corners = wp.array((vertices - middle).astype(np.float32), dtype=wp.vec3, device="cpu")
                self._tree = wp.Mesh(corners, _warp(self.faces.reshape(-1), int))
                self._surface.tree = self._tree.id
            else:
                self._tree.points.numpy()[:] = vertices - middle
                self._tree.refit()
            self._posed = posed
        return self._surface


class PosedSurface:
    """A surface at one instant; made by ``SurfaceQuery.at``."""

    def __init__(self, mesh: SurfaceQuery, vertices: np.ndarray) -> None:
        self.mesh, self.vertices = mesh, vertices

    def query(self, points: np.ndarray) -> SurfaceHits:
        """Closest surface points of ``points [N, 3]`` [m]."""
        return self._search(_checked(points, "points"), EVERYWHERE)

    def query_sheet(self, points: np.ndarray, sheet: Sheet, reach: float) -> SurfaceHits:
        """Closest surface points of the vertices ``points [N, 3]`` of a sheet [m], where only contact matters.

        A vertex that is farther than ``reach`` [m] from the surface, and outside because it hangs together with others
        that are, gets the distance infinity and face -1. All else is as ``query`` says; vertices inside are found at
        any depth. Where the surface runs through itself, and sides mean little, ``query`` may think otherwise.

        Raises:
            ValueError: The sheet has another number of vertices.
        """
        points = _checked(points, "points")
        if len(points) != sheet.count:
            raise ValueError(f"points: expected the {sheet.count} vertices of the sheet, got {len(points)}")
        hits = self._search(points, reach)
        state = _warp(hits.face >= 0, int)
        queue = wp.empty(sheet.count, dtype=int, device="cpu")
        inputs = [_warp(points, wp.vec3d), sheet.first, sheet.neighbours, wp.float64(reach)]
        inputs += [_warp(hits.distance, wp.float64), state, queue]
        wp.launch(find_sides, dim=1, inputs=inputs, device="cpu")
        ask = np.flatnonzero(state.numpy() % 3 == 0)
        if len(ask):
            hits.put(ask, self._search(points[ask], EVERYWHERE))
        return hits

    def query_moved(self, points: np.ndarray, before: np.ndarray, known: SurfaceHits) -> SurfaceHits:
        """``query`` of points [N, 3] , ``known`` where they were ``before``: those that moved are looked up."""
        moved = np.flatnonzero((points != before).any(axis=1))
        if len(moved) == 0:
            return known
        hits = SurfaceHits(*(array.copy() for array in vars(known).values()))
        hits.put(moved, self.query(points[moved]))
        return hits

    def _search(self, points: np.ndarray, reach: float) -> SurfaceHits:
        """Closest points within ``reach`` [m]; where there is none, infinity and face -1."""
        count = len(points)
        hits = SurfaceHits(
            np.full(count, np.inf),
            *(np.zeros((count, 3)) for _ in range(2)),
            np.empty(count, np.int32),
            np.zeros((count, 3)),
        )
        outputs = [
            _warp(array, dtype)
            for array, dtype in (
                (hits.distance, wp.float64),
                (hits.point, wp.vec3d),
                (hits.normal, wp.vec3d),
                (hits.face, int),
                (hits.barycentric, wp.vec3d),
            )
        ]
        surface = self.mesh.surface(self)
        wp.launch(
            closest_points, dim=count, inputs=[surface, _warp(points, wp.vec3d), float(reach), *outputs], device="cpu"
        )
        return hits


def closest_surface(points: np.ndarray, vertices: np.ndarray, faces: np.ndarray) -> SurfaceHits:
    """One-off query; for a sequence make one ``SurfaceQuery`` and ask it every frame."""
    return SurfaceQuery(faces, len(vertices)).query(points, vertices)


def _edge_neighbours(faces: np.ndarray, vertex_count: int) -> np.ndarray:
    """Face across the edge opposite of each corner, shape [F, 3]; -1 at a boundary."""
    start, end = faces[:, [1, 2, 0]].reshape(-1), faces[:, [2, 0, 1]].reshape(-1)
    key = np.minimum(start, end) * vertex_count + np.maximum(start, end)
    order = np.argsort(key, kind="stable")
    same = np.nonzero(key[order][1:] == key[order][:-1])[0]
    neighbour = np.full(len(key), -1, dtype=np.int64)
    left, right = order[same], order[same + 1]
    neighbour[left], neighbour[right] = right // 3, left // 3
    return neighbour.reshape(-1, 3)


def _vertex_faces(faces: np.ndarray, vertex_count: int) -> tuple[np.ndarray, np.ndarray]:
    """Faces around each vertex: offsets [B + 1] into a list of face indices [3 F]."""
    flat = faces.reshape(-1)
    counts = np.bincount(flat, minlength=vertex_count)
    return np.concatenate([[0], np.cumsum(counts)]), np.argsort(flat, kind="stable") // 3


def _warp(array: np.ndarray, dtype: type) -> wp.array:
    """On the CPU; where type and layout are right already, the same memory."""
    if dtype is int:
        array = array.astype(np.int32, copy=False)
    return wp.array(np.ascontiguousarray(array), dtype=dtype, device="cpu", copy=False)


def _checked(array: np.ndarray, name: str) -> np.ndarray:
    array = np.asarray(array, dtype=np.float64)
    if array.ndim != 2 or array.shape[1] != 3 or len(array) == 0:
        raise ValueError(f"{name}: expected shape [N, 3] with N >= 1, got {list(array.shape)}")
    if not np.isfinite(array).all():
        raise ValueError(f"{name}: {int((~np.isfinite(array)).any(axis=1).sum())} rows are not finite")
    return array
