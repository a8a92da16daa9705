"""Checks of a body surface: closed and outward oriented, and which of its faces cut through each other.

In: vertices [m] and faces. Out: a list of faults in words, or the intersecting faces. Numpy and SciPy only.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from geometry.topology import MeshTopology


def enclosed_volume(vertices: np.ndarray, faces: np.ndarray) -> float:
    """Signed volume of a closed surface [m^3]; positive when the faces point outwards."""
    a, b, c = (np.asarray(vertices, dtype=np.float64)[faces[:, k]] for k in range(3))
    return float(np.einsum("fi,fi->", a, np.cross(b, c)) / 6.0)


def closed_surface_faults(vertices: np.ndarray, faces: np.ndarray) -> list[str]:
    """What keeps a mesh from being one closed, outward oriented surface without handles; empty when nothing does.

    Raises:
        ValueError: The mesh is not manifold, or two neighbouring faces disagree in orientation.
    """
    topology = MeshTopology.from_faces(faces, len(vertices))
    faults = []
    if topology.boundary.any():
        faults.append(f"{int(topology.boundary.sum())} boundary edges, expected none")
    if topology.component_count() != 1:
        faults.append(f"{topology.component_count()} components, expected one")
    unused = len(vertices) - len(np.unique(faces))
    if unused:
        faults.append(f"{unused} vertices without a face")
    euler = len(vertices) - len(topology.edges) + len(faces)
    if euler != 2:
        faults.append(f"Euler characteristic {euler}, expected 2")
    volume = enclosed_volume(vertices, faces)
    if volume <= 0.0:
        faults.append(f"enclosed volume {volume:.4f} m^3: the faces point inwards")
    return faults


def self_intersecting_faces(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Faces that another face, without a common vertex, cuts through; ascending indices.

    Two triangles cross when an edge of one passes through the other: every edge is tested against every near triangle.
    """
    corners = np.asarray(vertices, dtype=np.float64)[faces]
    centre = corners.mean(axis=1)
    radius = np.linalg.norm(corners - centre[:, None], axis=2).max(axis=1)
    first, second = near_pairs(centre, radius)
    shared = (faces[first][:, :, None] == faces[second][:, None, :]).any(axis=(1, 2))
    low, high = corners.min(axis=1), corners.max(axis=1)
    apart = ((low[first] > high[second]) | (low[second] > high[first])).any(axis=1)
    first, second = first[~shared & ~apart], second[~shared & ~apart]
    crossing = np.zeros(len(first), dtype=bool)
    for k in range(3):
        start, end = k, (k + 1) % 3
        crossing |= segment_hits_triangle(corners[first, start], corners[first, end], corners[second])
        crossing |= segment_hits_triangle(corners[second, start], corners[second, end], corners[first])
    return np.unique(np.concatenate([first[crossing], second[crossing]]))


def near_pairs(centre: np.ndarray, radius: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Pairs (i < j) of balls that overlap. Large balls are few, so they are searched apart from the small ones."""
    limit = np.quantile(radius, 0.9)
    small, large = np.flatnonzero(radius <= limit), np.flatnonzero(radius > limit)
    pairs = small[cKDTree(centre[small]).query_pairs(2.0 * limit, output_type="ndarray")]
    lists = cKDTree(centre).query_ball_point(centre[large], radius[large] + radius.max())
    owner = np.repeat(large, [len(found) for found in lists])
    found = np.concatenate([np.asarray(entry, dtype=int) for entry in lists]) if len(large) else np.zeros(0, dtype=int)
    keep = (radius[found] <= limit) | (owner < found)
    first = np.concatenate([pairs[:, 0], owner[keep]])
    second = np.concatenate([pairs[:, 1], found[keep]])
    overlap = np.linalg.norm(centre[first] - centre[second], axis=1) <= radius[first] + radius[second]
    return first[overlap], second[overlap]


def segment_hits_triangle(start: np.ndarray, end: np.ndarray, triangle: np.ndarray) -> np.ndarray:
    """Whether each segment [N, 3] passes through its triangle [N, 3, 3], shape [N] (Moller & Trumbore 1997)."""
    direction = end - start
    u, v = triangle[:, 1] - triangle[:, 0], triangle[:, 2] - triangle[:, 0]
    normal = np.cross(direction, v)
    determinant = np.einsum("ni,ni->n", u, normal)
    parallel = np.abs(determinant) < 1e-18
    scale = 1.0 / np.where(parallel, 1.0, determinant)
    offset = start - triangle[:, 0]
    a = np.einsum("ni,ni->n", offset, normal) * scale
    cross = np.cross(offset, u)
    b = np.einsum("ni,ni->n", direction, cross) * scale
    t = np.einsum("ni,ni->n", v, cross) * scale
    return ~parallel & (a >= 0) & (b >= 0) & (a + b <= 1) & (t >= 0) & (t <= 1)
