"""Remeshing of a dense surface to exactly N vertices with near-equilateral triangles.

Approximated centroidal Voronoi clusters (Valette and Chassery 2004, "Approximated centroidal Voronoi diagrams for
uniform polygonal mesh coarsening", through ``pyacvd``) give the vertices, the dual of the clusters the triangles. The
boundary is then drawn onto the dense surface's boundary curves and spaced evenly along them, and the inside relaxed by
Delaunay flips and tangential smoothing with re-projection.

Isotropic triangles matter to the simulation: a bending energy's error depends on direction on regular grids.
"""

from __future__ import annotations

import warnings

import numpy as np
import pyvista as pv
from pyacvd import Clustering
from scipy.spatial import cKDTree

from garments.surface import DenseSurface
from geometry.mesh_check import check_mesh
from geometry.proximity import SurfaceQuery
from geometry.topology import MeshTopology, edge_lengths, face_angles, face_normals, vertex_normals

POINTS_PER_CLUSTER = 24
"""Dense vertices per cluster at least; fewer leave ragged clusters and crooked duals."""

ATTEMPTS = 5
GOOD_ANGLE = 25.0
"""Clusterings tried; the first whose smallest angle [degrees] is good ends the search, else the best is taken."""

FLIP_ROUNDS = 20
"""Passes of flips at most: each flips edges that do not touch."""

SMOOTHING_ROUNDS = 8
SMOOTHING_STEPS = 5
"""Rounds of flips, steps of tangential smoothing per round; re-projected once a round."""


def remesh(surface: DenseSurface, count: int, loops: int) -> tuple[np.ndarray, np.ndarray]:
    """Mesh a surface with exactly ``count`` vertices.

    Args:
        surface: One connected dense surface of genus 0.
        count: Vertices wanted.
        loops: Boundary loops of the surface.

    Returns:
        Vertices [m], shape [count, 3] float64, and faces, shape [F, 3] int32.

    Raises:
        ValueError: if no attempt gave a manifold mesh of the surface's topology.
    """
    curves = surface.boundary_curves()
    if len(curves) != loops:
        raise ValueError(
            f"its openings run into each other ({len(curves)} instead of {loops}): lower ease and close, "
            "or change lengths"
        )
    clustering = _clustering(surface, POINTS_PER_CLUSTER * count)
    reason, best, best_angle = "the count was not met", None, 0.0
    # Cleaning may drop vertices, and a rare cluster is ring-shaped or pinched: neighbouring counts give other clusters.
    wanted = count
    for _ in range(ATTEMPTS):
        vertices, faces = _dual_mesh(clustering, wanted)
        fault = _topology_fault(vertices, faces, loops)
        missing = count - len(vertices)
        if fault:
            reason = fault
        elif abs(missing) <= max(4, count // 100):
            vertices, faces = _relaxed(surface, curves, *_adjusted(vertices, faces, count))
            # A strap of one triangle's width can hang together by a point: right in all its counts, and no sheet.
            fault = _sheet_fault(vertices, faces)
            reason = fault or reason
            angle = 0.0 if fault else float(np.degrees(face_angles(vertices, faces).min()))
            if angle > best_angle:
                best, best_angle = (vertices, faces), angle
            if angle >= GOOD_ANGLE:
                break
        wanted += 1 if fault or abs(missing) <= 1 else missing
    if best is None:
        raise ValueError(f"remeshing to {count} vertices failed ({reason}): ask for more vertices")
    return best


def _clustering(surface: DenseSurface, points: int) -> Clustering:
    """A clustering over the surface, subdivided until it has enough points."""
    cells = np.column_stack([np.full(len(surface.faces), 3), surface.faces])
    with warnings.catch_warnings():
        # pyacvd reads an attribute that pyvista has renamed; nothing that a user could act on.
        warnings.simplefilter("ignore", pv.PyVistaDeprecationWarning)
        clustering = Clustering(pv.PolyData(surface.vertices, cells.reshape(-1)))
        while clustering.mesh.n_points < points:
            clustering.subdivide(1)
    return clustering


def _dual_mesh(clustering: Clustering, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Cluster into ``count`` cells and join neighbouring cells: centroids and oriented dual triangles."""
    label = np.asarray(clustering.cluster(count))
    points = np.asarray(clustering.mesh.points, dtype=np.float64)
    area = np.asarray(clustering.area)
    size = np.maximum(np.bincount(label, weights=area), 1e-20)
    centre = np.stack([np.bincount(label, weights=area * points[:, k]) for k in range(3)], axis=1) / size[:, None]
    dense = np.asarray(clustering.mesh.faces).reshape(-1, 4)[:, 1:]
    dual = label[dense]
    dual = dual[(dual[:, 0] != dual[:, 1]) & (dual[:, 1] != dual[:, 2]) & (dual[:, 2] != dual[:, 0])]
    # Three cells can meet in several dense triangles: keep one, with the dense surface's orientation.
    _, first = np.unique(np.sort(dual, axis=1), axis=0, return_index=True)
    faces = dual[np.sort(first)]
    used, faces = np.unique(faces, return_inverse=True)
    return centre[used], faces.reshape(-1, 3).astype(np.int32)


def _topology_fault(vertices: np.ndarray, faces: np.ndarray, loops: int) -> str:
    """Empty if the mesh is one manifold piece of genus 0 with that many boundary loops, else what is wrong."""
    try:
        topology = MeshTopology.from_faces(faces, len(vertices))
    except ValueError as error:
        return str(error)
    found = len(topology.boundary_loops())
    euler = len(vertices) - len(topology.edges) + len(faces)
    if topology.component_count() != 1 or found != loops or euler != 2 - loops:
        return f"{topology.component_count()} components, {found} boundary loops, Euler number {euler}"
    return ""


def _sheet_fault(vertices: np.ndarray, faces: np.ndarray) -> str:
    """Empty if the mesh is a clean sheet of cloth, else what is wrong."""
    try:
        check_mesh("the mesh", vertices, faces)
    except ValueError as error:
        return str(error)
    return ""


def _adjusted(vertices: np.ndarray, faces: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Reach the exact count by splitting the longest inner edges or collapsing the shortest ones."""
    while len(vertices) < count:
        topology = MeshTopology.from_faces(faces, len(vertices))
        inner = topology.hinges[edge_lengths(vertices, topology.hinges[:, :2]).argmax()]
        i, j, k, m = (int(v) for v in inner)
        new = len(vertices)
        vertices = np.vstack([vertices, 0.5 * (vertices[i] + vertices[j])])
        keep = ~((faces == i).any(axis=1) & (faces == j).any(axis=1))
        faces = np.vstack([faces[keep], [[i, new, k], [new, j, k], [j, new, m], [new, i, m]]]).astype(np.int32)
    while len(vertices) > count:
        topology = MeshTopology.from_faces(faces, len(vertices))
        adjacency = topology.adjacency()
        on_boundary = np.zeros(len(vertices), dtype=bool)
        on_boundary[topology.edges[topology.boundary]] = True
        hinges = topology.hinges[edge_lengths(vertices, topology.hinges[:, :2]).argsort(kind="stable")]
        for i, j in hinges[:, :2]:
            rings = [adjacency.indices[adjacency.indptr[v] : adjacency.indptr[v + 1]] for v in (i, j)]
            # Link condition of a collapse, away from the boundary.
            if not on_boundary[i] and not on_boundary[j] and len(np.intersect1d(*rings)) == 2:
                break
        else:
            raise ValueError("no inner edge can be collapsed")
        vertices[i] = 0.5 * (vertices[i] + vertices[j])
        faces = np.where(faces == j, i, faces)
        faces = faces[(faces[:, 0] != faces[:, 1]) & (faces[:, 1] != faces[:, 2]) & (faces[:, 2] != faces[:, 0])]
        faces = np.where(faces > j, faces - 1, faces).astype(np.int32)
        vertices = np.delete(vertices, j, axis=0)
    return vertices, faces


def _relaxed(
    surface: DenseSurface, curves: list[np.ndarray], vertices: np.ndarray, faces: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Snap the boundary to its curves, then flip and smooth."""
    vertices = vertices.copy()
    for loop, place in _matched_loops(curves, vertices, faces):
        vertices[loop] = place
    dense = SurfaceQuery(surface.faces, len(surface.vertices)).at(surface.vertices)
    for _ in range(SMOOTHING_ROUNDS):
        faces = delaunay_flips(vertices, faces)
        topology = MeshTopology.from_faces(faces, len(vertices))
        inner = np.ones(len(vertices), dtype=bool)
        inner[topology.edges[topology.boundary]] = False
        laplacian = topology.uniform_laplacian()
        for _ in range(SMOOTHING_STEPS):
            normal = vertex_normals(vertices, faces)
            step = -0.5 * (laplacian @ vertices)
            step -= (step * normal).sum(axis=1, keepdims=True) * normal
            vertices[inner] += step[inner]
        vertices[inner] = dense.query(vertices[inner]).point
    faces = delaunay_flips(vertices, faces)
    return vertices, faces


def _matched_loops(
    curves: list[np.ndarray], vertices: np.ndarray, faces: np.ndarray
) -> list[tuple[np.ndarray, np.ndarray]]:
    """For each boundary loop its vertex indices [K] and even places on the nearest curve [K, 3]."""
    loops = MeshTopology.from_faces(faces, len(vertices)).boundary_loops()
    free = list(range(len(curves)))
    matched = []
    for loop in loops:
        distance = [cKDTree(curves[c]).query(vertices[loop])[0].mean() for c in free]
        curve = curves[free.pop(int(np.argmin(distance)))]
        matched.append((loop, _even_places(curve, vertices[loop])))
    return matched


def _even_places(curve: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Points spread evenly by arc length over a closed polyline, in the phase and direction nearest to ``points``."""
    closed = np.vstack([curve, curve[:1]])
    length = np.concatenate([[0.0], np.linalg.norm(np.diff(closed, axis=0), axis=1).cumsum()])
    total = length[-1]
    # A fine resampling makes nearest vertex as good as nearest point.
    fine = np.linspace(0.0, total, 20 * len(points), endpoint=False)
    places = np.stack([np.interp(fine, length, closed[:, k]) for k in range(3)], axis=1)
    nearest = fine[cKDTree(places).query(points)[1]]
    turn = 2.0 * np.pi * nearest / total
    step = np.angle(np.exp(1j * np.diff(turn, append=turn[:1])))
    direction = 1.0 if step.sum() >= 0 else -1.0
    even = direction * np.arange(len(points)) * total / len(points)
    phase = np.angle(np.exp(1j * (turn - 2.0 * np.pi * even / total)).mean()) * total / (2.0 * np.pi)
    where = (even + phase) % total
    return np.stack([np.interp(where, length, closed[:, k]) for k in range(3)], axis=1)


def delaunay_flips(vertices: np.ndarray, faces: np.ndarray, smallest_degree: int = 4) -> np.ndarray:
    """Flip inner edges whose opposite angles sum to more than pi, where the surface allows it.

    Args:
        vertices: Positions [m], shape [V, 3].
        faces: Triangles, shape [F, 3].
        smallest_degree: Edges that a vertex keeps at least.

    Returns:
        The new triangles, shape [F, 3].
    """
    for _ in range(FLIP_ROUNDS):
        topology = MeshTopology.from_faces(faces, len(vertices))
        angle = face_angles(vertices, faces)
        hinge, owner = topology.hinges, topology.hinge_faces
        opposite = [angle[owner[:, s]][faces[owner[:, s]] == hinge[:, 2 + s : 3 + s]] for s in (0, 1)]
        excess = opposite[0] + opposite[1] - np.pi
        count = np.int64(len(vertices))
        key = np.minimum(hinge[:, 2], hinge[:, 3]) * count + np.maximum(hinge[:, 2], hinge[:, 3])
        exists = np.isin(key, topology.edges[:, 0] * count + topology.edges[:, 1])
        degree = np.bincount(topology.edges.reshape(-1), minlength=len(vertices))
        # Slightly over zero, so that four points on a circle do not flip for ever.
        wanted = (excess > 1e-3) & ~exists & (degree[hinge[:, :2]].min(axis=1) > smallest_degree)
        i, j, k, m = hinge.T
        new = np.stack([np.stack([i, m, k], axis=1), np.stack([m, j, k], axis=1)], axis=1)  # [H, 2, 3]
        old_normal = face_normals(vertices, faces)[owner].sum(axis=1)
        new_normal = face_normals(vertices, new.reshape(-1, 3)).reshape(-1, 2, 3)
        wanted &= ((new_normal * old_normal[:, None]).sum(axis=2) > 0.0).all(axis=1)
        chosen = np.nonzero(wanted)[0]
        if len(chosen) == 0:
            return faces
        # The worst flips first; of those that share a face or a new edge only one a round.
        faces = faces.copy()
        busy = np.zeros(len(vertices), dtype=bool)
        for h in chosen[np.argsort(-excess[chosen], kind="stable")]:
            if busy[hinge[h]].any():
                continue
            busy[hinge[h]] = True
            faces[owner[h]] = new[h]
    return faces
