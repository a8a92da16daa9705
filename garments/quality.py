"""Quality of a garment mesh: topology, triangle shape, clearance to the body, self-intersection.

Checked every time a garment is made: a torn or crossed template spoils every simulation that starts from it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from geometry.proximity import closest_surface
from geometry.topology import MeshTopology, edge_lengths, face_angles

SMALLEST_ANGLE = 20.0
"""Smallest inner angle allowed in a garment [degrees]."""

CLEARANCE = 0.0015
"""Smallest distance of a garment vertex to the body's surface, outside it [m]."""


@dataclass(frozen=True)
class MeshQuality:
    """Figures of one garment mesh.

    Attributes:
        vertices, faces: Counts.
        components: Connected pieces.
        loops: Boundary loops.
        euler: Euler number V - E + F.
        smallest_angle: Smallest inner angle [degrees].
        mean_edge: Mean edge length [m].
        edge_variation: Standard deviation of the edge lengths over their mean.
        clearance: Smallest signed distance of a vertex to the body [m].
        crossings: Pairs of the garment's own triangles that cross.
    """

    vertices: int
    faces: int
    components: int
    loops: int
    euler: int
    smallest_angle: float
    mean_edge: float
    edge_variation: float
    clearance: float
    crossings: int


def measure_quality(
    vertices: np.ndarray, faces: np.ndarray, body_vertices: np.ndarray, body_faces: np.ndarray
) -> MeshQuality:
    """Figures of a garment ``(vertices [V, 3], faces [F, 3])`` on a body; ``ValueError`` if it is not manifold."""
    topology = MeshTopology.from_faces(faces, len(vertices))
    edges = edge_lengths(vertices, topology.edges)
    return MeshQuality(
        vertices=len(vertices),
        faces=len(faces),
        components=topology.component_count(),
        loops=len(topology.boundary_loops()),
        euler=len(vertices) - len(topology.edges) + len(faces),
        smallest_angle=float(np.degrees(face_angles(vertices, faces).min())),
        mean_edge=float(edges.mean()),
        edge_variation=float(edges.std() / edges.mean()),
        clearance=float(closest_surface(vertices, body_vertices, body_faces).distance.min()),
        crossings=crossing_pairs(vertices, faces),
    )


def assert_quality(name: str, quality: MeshQuality, vertices: int, loops: int) -> None:
    """Raise ``ValueError``, in one sentence, if a garment's figures break a bound."""
    where = f"garment '{name}'"
    if quality.vertices != vertices:
        raise ValueError(f"{where}: the mesh has {quality.vertices} vertices instead of {vertices}")
    if quality.components != 1 or quality.loops != loops or quality.euler != 2 - loops:
        raise ValueError(
            f"{where}: the mesh is torn or pinched ({quality.components} pieces, {quality.loops} openings instead of "
            f"{loops}, Euler number {quality.euler} instead of {2 - loops}): ask for more vertices"
        )
    if quality.smallest_angle < SMALLEST_ANGLE:
        raise ValueError(
            f"{where}: the smallest angle is {quality.smallest_angle:.1f} degrees, at least "
            f"{SMALLEST_ANGLE:.0f} are needed: ask for more vertices"
        )
    if quality.clearance < CLEARANCE:
        raise ValueError(
            f"{where}: a vertex is {1e3 * quality.clearance:.1f} mm from the body, at least {1e3 * CLEARANCE:.1f} mm "
            "are needed: raise the ease"
        )
    if quality.crossings:
        raise ValueError(
            f"{where}: {quality.crossings} pairs of its triangles cross: change its length or ask for more vertices"
        )


def crossing_pairs(vertices: np.ndarray, faces: np.ndarray) -> int:
    """Number of triangle pairs without a common vertex that cross each other."""
    return len(crossing_triangles(vertices, faces))


def crossing_triangles(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Pairs of triangles without a common vertex that cross each other, each pair and all of them sorted, [K, 2]."""
    corners = vertices[faces].astype(np.float64)
    centre = corners.mean(axis=1)
    radius = np.linalg.norm(corners - centre[:, None], axis=2).max(axis=1)
    pairs = cKDTree(centre).query_pairs(2.0 * radius.max(), output_type="ndarray")
    pairs = pairs[np.linalg.norm(centre[pairs[:, 0]] - centre[pairs[:, 1]], axis=1) < radius[pairs].sum(axis=1)]
    shared = (faces[pairs[:, 0]][:, :, None] == faces[pairs[:, 1]][:, None, :]).any(axis=(1, 2))
    pairs = pairs[~shared]
    crossed = np.zeros(len(pairs), dtype=bool)
    for first, second in ((0, 1), (1, 0)):
        edge_of, triangle = corners[pairs[:, first]], corners[pairs[:, second]]
        for k in range(3):
            crossed |= _segments_cross(edge_of[:, k], edge_of[:, (k + 1) % 3], triangle)
    found = np.sort(pairs[crossed], axis=1)
    return found[np.lexsort(found.T[::-1])]


def _segments_cross(start: np.ndarray, end: np.ndarray, triangle: np.ndarray) -> np.ndarray:
    """Whether segments [M, 3] pass through triangles [M, 3 corners, 3], row by row."""

    def volume(a: np.ndarray, b: np.ndarray, c: np.ndarray, d: np.ndarray) -> np.ndarray:
        return np.einsum("mc,mc->m", np.cross(b - a, c - a), d - a)

    a, b, c = (triangle[:, k] for k in range(3))
    sides = volume(a, b, c, start) * volume(a, b, c, end) < 0.0
    around = [volume(start, end, a, b), volume(start, end, b, c), volume(start, end, c, a)]
    same = np.sign(around[0]) == np.sign(around[1])
    return sides & same & (np.sign(around[1]) == np.sign(around[2])) & (around[0] != 0.0)
