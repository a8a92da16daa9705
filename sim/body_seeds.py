"""Seeds of walks over the body: points spread evenly over it, by limbs, and the empty grid that they are planted in.

``sim.kernels.seeds`` tells what they are for.
"""

from __future__ import annotations

import numpy as np
import warp as wp
from scipy.spatial import cKDTree

from sim.kernels.seeds import CELL, SEED_BITS, STAMPS, Seeds

SEED_SPACING = 0.025
"""Distance between seeds on the body in its bind pose [m], more where they would be too many."""

LONGEST_PIECE = 0.5
"""Extent of the pieces that seeds are told apart by [m]."""

_NO_ENTRY = 2**31 - 1


def spread_seeds(bind: np.ndarray, faces: np.ndarray, regions: np.ndarray, motions: int, device: str) -> Seeds:
    """Seeds spread evenly over the body, and an empty grid for them."""
    face, weight = _spread(bind, faces, 0.5 * SEED_SPACING)
    spots = np.einsum("sk,skc->sc", weight, bind[faces[face]])
    spacing = SEED_SPACING
    chosen = _thinned(spots, spacing)
    while len(chosen) > 2**SEED_BITS:
        spacing *= 1.2
        chosen = chosen[_thinned(spots[chosen], spacing)]
    face, weight = face[chosen], weight[chosen]
    count = int(regions.max()) + 1
    extent = max(np.ptp(bind[faces[regions == r]].reshape(-1, 3), axis=0).max() for r in range(count))
    seeds = Seeds()
    seeds.face = wp.array(face.astype(np.int32), dtype=int, device=device)
    seeds.region = wp.array(regions[face].astype(np.int32), dtype=int, device=device)
    seeds.weight = wp.array(weight.astype(np.float32), dtype=wp.vec3, device=device)
    seeds.point, seeds.normal = (wp.zeros(motions * len(face), dtype=wp.vec3, device=device) for _ in range(2))
    seeds.count, seeds.regions, seeds.stamp = len(face), count, STAMPS
    seeds.cells = 2 ** int(np.ceil(np.log2(max(1.5 * extent / CELL, 8.0))))
    seeds.grid = wp.full(motions * seeds.cells**3 * seeds.regions, _NO_ENTRY, dtype=int, device=device)
    return seeds


def pieces(centres: np.ndarray, regions: np.ndarray) -> np.ndarray:
    """Limbs cut where they are long and the trunk down the middle, for a walk does not cross clefts, shape [F]."""
    pieces = []
    waiting = [np.flatnonzero(regions == r) for r in np.unique(regions)]
    while waiting:
        faces = waiting.pop()
        low, high = centres[faces].min(axis=0), centres[faces].max(axis=0)
        axis, middle = int(np.argmax(high - low)), 0.5 * (low + high)
        if low[0] < -0.05 and high[0] > 0.05:
            axis, middle[0] = 0, 0.0
        elif high[axis] - low[axis] < LONGEST_PIECE:
            pieces.append(faces)
            continue
        beyond = centres[faces, axis] > middle[axis]
        waiting += [faces[beyond], faces[~beyond]]
    if len(pieces) > 31:  # a bit each
        return regions
    label = np.zeros(len(regions), dtype=np.int32)
    for number, faces in enumerate(pieces):
        label[faces] = number
    return label


def _spread(points: np.ndarray, faces: np.ndarray, spacing: float) -> tuple[np.ndarray, np.ndarray]:
    """Faces and weights of points that lie on every face, at most ``spacing`` apart on it."""
    corner = points[faces]
    longest = np.linalg.norm(corner - np.roll(corner, 1, axis=1), axis=2).max(axis=1)
    pieces = np.clip(np.ceil(longest / spacing), 1, 64).astype(int)
    which, weights = [], []
    for n in np.unique(pieces):
        i, j = np.meshgrid(np.arange(n), np.arange(n), indexing="ij")
        i, j = i[i + j < n], j[i + j < n]
        grid = np.stack([i, j, n - 1 - i - j], axis=1) + 1.0 / 3.0
        members = np.flatnonzero(pieces == n)
        which.append(np.repeat(members, len(grid)))
        weights.append(np.tile(grid / n, (len(members), 1)))
    return np.concatenate(which), np.concatenate(weights)


def _thinned(points: np.ndarray, spacing: float) -> np.ndarray:
    """Points of which no two are nearer than ``spacing``, the first ones first."""
    tree = cKDTree(points)
    alive = np.ones(len(points), dtype=bool)
    for i in range(len(points)):
        if alive[i]:
            near = tree.query_ball_point(points[i], spacing)
            alive[near] = False
            alive[i] = True
    return np.flatnonzero(alive)


def age(seeds: Seeds) -> None:
    """Before every planting: entries of the last one do not hold any more."""
    if seeds.stamp == 1:
        seeds.grid.fill_(_NO_ENTRY)
        seeds.stamp = STAMPS
    else:
        seeds.stamp -= 1
