"""A mesh at several resolutions: quadric edge collapse downwards, barycentric interpolation upwards (Ranjan 2018).

In: a closed triangle mesh, the vertices that matter, and how many of them each coarser level keeps. Out: sparse
matrices between neighbouring levels and the adjacency within each. Coarse vertices are a subset of the fine ones, so
going down picks rows; going up, each fine vertex takes the weights of its closest point on the coarse mesh.

The whole mesh is collapsed, for a closed one needs no rule for borders, but what lies beyond the vertices that matter
goes first and takes no part in any matrix.
"""

from __future__ import annotations

import zipfile
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
import scipy.sparse as sp
from scipy.spatial import cKDTree

from datasets.atomic import atomic_path
from geometry.decimate import Decimator
from geometry.proximity import closest_surface
from geometry.topology import MeshTopology

FORMAT_VERSION = 1

BEYOND = 1.0e-6
"""Cost of removing a vertex that does not matter, against one that does."""


@dataclass(frozen=True)
class MeshHierarchy:
    """Levels of one mesh, finest first.

    Attributes:
        digest: Which mesh, as its owner names it.
        levels: Vertices of each level, as ascending numbers of the whole mesh's vertices.
        faces: Triangles between the vertices of each level, numbered within it, shape [F_k, 3].
        up: Matrices [n_k, n_k+1] from level k + 1 to level k; rows are not negative and sum to one.
    """

    digest: str
    levels: tuple[np.ndarray, ...]
    faces: tuple[np.ndarray, ...]
    up: tuple[sp.csr_matrix, ...]

    def down(self, level: int) -> sp.csr_matrix:
        """Matrix [n_k+1, n_k] that picks the rows of level k which level k + 1 keeps."""
        columns = np.searchsorted(self.levels[level], self.levels[level + 1])
        shape = (len(columns), len(self.levels[level]))
        return sp.csr_matrix((np.ones(len(columns)), (np.arange(len(columns)), columns)), shape=shape)

    def between(self, start: int, end: int) -> sp.csr_matrix:
        """Matrix from one level to another, over all levels between them; the identity where they are the same."""
        matrix = sp.identity(len(self.levels[start]), format="csr")
        while start < end:
            matrix, start = self.down(start) @ matrix, start + 1
        while start > end:
            matrix, start = self.up[start - 1] @ matrix, start - 1
        return matrix.tocsr()

    def adjacency(self, level: int) -> sp.csr_matrix:
        """Symmetric 0/1 adjacency of a level, shape [n, n]."""
        return MeshTopology.from_faces(self.faces[level], len(self.levels[level])).adjacency()

    def save(self, path: str | Path) -> None:
        """Write one ``.npz`` file, whole or not at all."""
        content: dict[str, np.ndarray] = {"digest": np.array(self.digest), "count": np.array(len(self.levels))}
        for k, (level, faces) in enumerate(zip(self.levels, self.faces, strict=True)):
            content |= {f"level_{k}": level, f"faces_{k}": faces}
        for k, matrix in enumerate(self.up):
            content |= {f"up_{k}_data": matrix.data, f"up_{k}_indices": matrix.indices, f"up_{k}_indptr": matrix.indptr}
        with atomic_path(path) as partial, open(partial, "wb") as stream:
            np.savez_compressed(stream, format_version=np.array(FORMAT_VERSION), **content)

    @classmethod
    def load(cls, path: str | Path) -> MeshHierarchy:
        """Read what ``save`` wrote; ``ValueError`` names the file and what is wrong with it."""
        try:
            with np.load(path, allow_pickle=False) as archive:
                if int(archive["format_version"]) != FORMAT_VERSION:
                    raise ValueError(f"format {archive['format_version']}, only {FORMAT_VERSION} can be read")
                count = int(archive["count"])
                levels = tuple(archive[f"level_{k}"] for k in range(count))
                faces = tuple(archive[f"faces_{k}"] for k in range(count))
                up = []
                for k in range(count - 1):
                    parts = tuple(archive[f"up_{k}_{name}"] for name in ("data", "indices", "indptr"))
                    up.append(sp.csr_matrix(parts, shape=(len(levels[k]), len(levels[k + 1]))))
                return cls(str(archive["digest"]), levels, faces, tuple(up))
        except FileNotFoundError:
            raise
        except (OSError, ValueError, EOFError, zipfile.BadZipFile, KeyError, AttributeError) as error:
            raise ValueError(f"{path}: not a readable mesh hierarchy ({error})") from None


def build_hierarchy(
    vertices: np.ndarray, faces: np.ndarray, active: np.ndarray, counts: Sequence[int], digest: str
) -> MeshHierarchy:
    """Levels of a closed mesh.

    Args:
        vertices: Positions [m], shape [V, 3].
        faces: Triangles, shape [F, 3].
        active: The vertices that matter, all of the finest level.
        counts: Vertices of each coarser level, falling.
        digest: Which mesh this is.

    Raises:
        ValueError: Counts that do not fall, or more than can be collapsed.
    """
    active = np.unique(active)
    steps = [len(active), *counts]
    if min(steps) < 4 or any(b >= a for a, b in pairwise(steps)):
        raise ValueError(f"mesh hierarchy: the levels must fall and have at least 4 vertices, got {steps}")
    matters = np.zeros(len(vertices), dtype=bool)
    matters[active] = True
    vertices = np.asarray(vertices, dtype=np.float64)
    work = Decimator(vertices, faces, np.where(matters, 1.0, BEYOND), np.arange(len(vertices)))
    whole = [(np.arange(len(vertices)), np.asarray(faces))]
    for count in counts:
        while (excess := int(matters[_kept(work)].sum()) - count) > 0:
            work.run(work.alive - excess)
        left = np.array([face for face in work.faces if face])
        whole.append((_kept(work), left))
    levels = tuple(kept[matters[kept]] for kept, _ in whole)
    inner = tuple(_renumbered(left[matters[left].all(axis=1)], level) for (_, left), level in zip(whole, levels))
    ups = [_up(vertices, fine, coarse, whole[k + 1][1]) for k, (fine, coarse) in enumerate(pairwise(levels))]
    return MeshHierarchy(digest, levels, inner, tuple(ups))


def _kept(work: Decimator) -> np.ndarray:
    return np.unique([vertex for face in work.faces for vertex in face])


def _renumbered(faces: np.ndarray, level: np.ndarray) -> np.ndarray:
    return np.searchsorted(level, faces).astype(np.int32)


def _up(vertices: np.ndarray, fine: np.ndarray, coarse: np.ndarray, coarse_faces: np.ndarray) -> sp.csr_matrix:
    """Weights of each fine vertex's closest point on the coarse mesh, among the coarse vertices that matter."""
    hits = closest_surface(vertices[fine], vertices, coarse_faces)
    corners = coarse_faces[hits.face]
    column = np.minimum(np.searchsorted(coarse, corners), len(coarse) - 1)
    weight = np.where(coarse[column] == corners, np.maximum(hits.barycentric, 0.0), 0.0)
    lost = weight.sum(axis=1) < 1e-3
    if lost.any():
        column[lost, 0] = cKDTree(vertices[coarse]).query(vertices[fine[lost]])[1]
        weight[lost] = (1.0, 0.0, 0.0)
    weight /= weight.sum(axis=1, keepdims=True)
    row = np.repeat(np.arange(len(fine)), 3)
    matrix = sp.csr_matrix((weight.reshape(-1), (row, column.reshape(-1))), shape=(len(fine), len(coarse)))
    matrix.eliminate_zeros()
    matrix.sum_duplicates()
    return matrix
