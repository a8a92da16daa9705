"""A moving mesh as few morph targets: the frames' differences from the first one, decomposed by singular values.

One target a frame would be as large as the frames themselves, and graphics cards blend a few hundred at most. The
decomposition is exact where there are as many targets as frames, and the best there is in the mean square where there
are fewer.

Its weights have both signs, but Blender cuts shape keys off below 0 and above 1. So they are shifted and scaled into
that range, and what the shift adds is taken away again by one more target that is always on. The rest shape stays the
first frame.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.linalg import eigh

from formats.animation import FRAMES_PER_CHUNK, AnimatedMesh

TOLERANCE = 1e-4
"""Root mean square distance of the vertices in the worst frame [m] that is aimed at."""

MOST_TARGETS = 200
"""Weights that fit into the 256 registers that every graphics card has."""

_COLUMNS = 3 * 2048  # coordinates at a time: bounds the double precision copy


@dataclass(frozen=True)
class MorphTargets:
    """Vertices of frame t are ``frames[0] + sum_k weights[t, k] positions[k]``; normals likewise, to be normalised.

    Attributes:
        weights: Between 0 and 1, shape [T, K] float32.
        positions: Offsets of the vertices [m], shape [K, V, 3] float32.
        base_normals: Normals of frame 0, shape [V, 3] float32.
        normals: Offsets of the normals, least squares for these weights, shape [K, V, 3] float32.
        worst_rms: Root mean square distance to the vertices in the worst frame [m].
        worst: Largest distance of a vertex in any frame [m].
    """

    weights: np.ndarray
    positions: np.ndarray
    base_normals: np.ndarray
    normals: np.ndarray
    worst_rms: float
    worst: float


def morph_targets(mesh: AnimatedMesh, tolerance: float = TOLERANCE, most: int = MOST_TARGETS) -> MorphTargets:
    """The fewest targets that keep every frame within a tolerance.

    Args:
        mesh: The mesh.
        tolerance: Root mean square distance of the vertices in any frame [m].
        most: Targets, at most; where they do not reach the tolerance, the result tells how near they come.
    """
    frames = mesh.frames
    count, vertices = frames.shape[:2]
    flat = frames.reshape(count, -1)
    # In double precision: the small singular values of a walk across the room would drown in single.
    gram = np.zeros((count, count))
    for start in range(0, flat.shape[1], _COLUMNS):
        offsets = flat[:, start : start + _COLUMNS].astype(np.float64)
        offsets -= offsets[0]
        gram += offsets @ offsets.T
    values, basis = eigh(gram)
    values, basis = np.maximum(values[::-1], 0.0), basis[:, ::-1]
    kept = _fewest(values, basis, tolerance**2 * vertices, most - 1)
    basis = basis[:, :kept]
    basis[0] = 0.0
    basis *= np.where(-basis.min(axis=0) > basis.max(axis=0), -1.0, 1.0) if kept else 1.0  # the smaller shift
    low = basis.min(axis=0, initial=0.0)
    scale = basis.max(axis=0, initial=0.0) - low
    weights = (basis - low) / scale
    # Projected with the unit columns, stored with the scaled ones, so that the product stays the same.
    positions = _projected(flat, basis) * scale[:, None]
    base_normals, normals = _projected_normals(mesh, basis)
    normals = normals * scale[:, None]
    if low.any():
        shift = (low / scale)[None]
        weights = np.concatenate([np.ones((count, 1)), weights], axis=1)
        positions, normals = (np.concatenate([shift @ x, x]) for x in (positions, normals))
    weights, positions, normals = (x.astype(np.float32) for x in (weights, positions, normals))
    worst_rms, worst = _distances(frames, weights, positions)
    shape = (-1, vertices, 3)
    return MorphTargets(weights, positions.reshape(shape), base_normals, normals.reshape(shape), worst_rms, worst)


def _fewest(values: np.ndarray, basis: np.ndarray, allowed: float, most: int) -> int:
    """Leading components after which the energy left over in every frame is at most ``allowed`` [m^2]."""
    noise = 8 * np.finfo(np.float64).eps * values[0]
    energy = np.where(values > noise, values, 0.0) * basis**2  # [T, K]
    left = energy.sum(axis=1)[:, None] - np.concatenate(
        [np.zeros((len(energy), 1)), np.cumsum(energy, axis=1)], axis=1
    )  # after 0, 1, ... K components
    enough = np.flatnonzero(left.max(axis=0) <= allowed)
    rank = int((values > noise).sum())
    return min(int(enough[0]) if len(enough) else rank, rank, most)


def _projected(flat: np.ndarray, basis: np.ndarray) -> np.ndarray:
    """Components of the offsets from the first frame, shape [K, 3 V]."""
    result = np.empty((basis.shape[1], flat.shape[1]))
    for start in range(0, flat.shape[1], _COLUMNS):
        part = slice(start, start + _COLUMNS)
        result[:, part] = basis.T @ (flat[:, part].astype(np.float64) - flat[0, part])
    return result


def _projected_normals(mesh: AnimatedMesh, basis: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Normals of the first frame, shape [V, 3], and components of the offsets from them, shape [K, 3 V]."""
    source = mesh.normals()
    base = next(source)
    rows = basis.astype(np.float32)
    result = np.zeros((basis.shape[1], base.size), dtype=np.float32)
    block: list[np.ndarray] = []
    first = 1
    for number, normals in enumerate(source, 1):
        block.append((normals - base).reshape(-1))
        if len(block) == FRAMES_PER_CHUNK or number == len(basis) - 1:
            result += rows[first : number + 1].T @ np.stack(block)
            block, first = [], number + 1
    return base, result


def _distances(frames: np.ndarray, weights: np.ndarray, positions: np.ndarray) -> tuple[float, float]:
    """Root mean square of the worst frame and largest single distance [m]."""
    worst_rms = worst = 0.0
    for start in range(0, len(frames), FRAMES_PER_CHUNK):
        part = frames[start : start + FRAMES_PER_CHUNK]
        again = frames[0] + (weights[start : start + FRAMES_PER_CHUNK] @ positions).reshape(part.shape)
        squared = np.square(again - part).sum(axis=-1)
        worst_rms, worst = max(worst_rms, float(squared.mean(axis=1).max())), max(worst, float(squared.max()))
    return worst_rms**0.5, worst**0.5
