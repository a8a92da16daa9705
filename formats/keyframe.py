"""Reading a keyframe: a garment's own mesh, moved in another program, from OBJ or PLY. The file is untrusted."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np

from garments.mesh_file import read_mesh

FARTHEST = 100.0
"""Coordinates beyond it [m] are those of another unit."""


def read_keyframe(path: str | os.PathLike, faces: np.ndarray, vertex_count: int) -> np.ndarray:
    """Vertices [m] of a file that holds the same mesh in another shape, shape [V, 3] float32.

    Args:
        path: OBJ or PLY, in metres, y up.
        faces: Triangles of the garment, shape [F, 3].
        vertex_count: Its vertices V.

    Raises:
        FileNotFoundError: No such file.
        ValueError: Not a readable mesh, or not the same one: it says both counts, or the first triangle that differs.
    """
    path = Path(path)
    if path.is_file() and path.suffix.lower() not in (".obj", ".ply"):
        raise ValueError(f"{path}: a keyframe must be an .obj or a .ply file")
    vertices, found = read_mesh(path)
    if len(vertices) != vertex_count or len(found) != len(faces):
        raise ValueError(
            f"{path}: has {len(vertices)} vertices and {len(found)} triangles, the garment has {vertex_count} and "
            f"{len(faces)}; a keyframe must be the garment's own mesh, moved but not changed"
        )
    own, other = _canonical(np.asarray(faces)), _canonical(found)
    differs = (own != other).any(axis=1)
    if differs.any():
        first = int(differs.argmax())
        raise ValueError(
            f"{path}: has the triangle {_listed(other[first])} where the garment has {_listed(own[first])}; its "
            "vertices were put in another order, or the mesh was changed"
        )
    bad = ~np.isfinite(vertices).all(axis=1)
    if bad.any():
        raise ValueError(f"{path}: vertex {int(bad.argmax())} is not finite")
    if np.abs(vertices).max() > FARTHEST:
        raise ValueError(
            f"{path}: reaches {np.abs(vertices).max():.0f} m from the origin, at most {FARTHEST:.0f} m are allowed; "
            "is it in metres?"
        )
    return vertices.astype(np.float32)


def _canonical(faces: np.ndarray) -> np.ndarray:
    """Triangles from their smallest corner on, in the order of their corners: alike for the same triangles."""
    turned = np.stack([np.roll(faces, -k, axis=1) for k in range(3)], axis=1)
    first = turned[np.arange(len(faces)), faces.argmin(axis=1)]
    return first[np.lexsort(first.T[::-1])]


def _listed(corners: np.ndarray) -> str:
    return ", ".join(str(int(corner)) for corner in corners)
