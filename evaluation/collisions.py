"""How much of a garment is inside the body, before and after refinement.

In: garment and body vertices of a sequence [m]. Out: shares of the vertices inside the body or nearer than 1 mm, and
the deepest one, by exact signed distances to the body's surface.
"""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp

from evaluation.metrics import COLLISION_MARGIN
from models.refinement import Refiner


class Contact:
    """Counts of signed distances over frames."""

    def __init__(self) -> None:
        self.count = self.below = self.near = 0
        self.deepest = 0.0

    def add(self, distance: np.ndarray) -> None:
        """Count the signed distances [m] of a frame's vertices."""
        self.count += len(distance)
        self.below += int((distance < 0.0).sum())
        self.near += int((distance < COLLISION_MARGIN).sum())
        self.deepest = max(self.deepest, -float(distance.min()))

    def figures(self, prefix: str) -> dict[str, float]:
        """Shares [%] and depth [mm] under names that begin with ``prefix``."""
        return {
            f"{prefix}collision_rate_percent": 100.0 * self.below / self.count,
            f"{prefix}collision_rate_{1e3 * COLLISION_MARGIN:g}mm_percent": 100.0 * self.near / self.count,
            f"{prefix}deepest_mm": 1e3 * self.deepest,
        }


def refine_and_judge(
    refiner: Refiner, laplacian: sp.spmatrix, predicted: np.ndarray, body_vertices: np.ndarray
) -> tuple[np.ndarray, dict[str, float]]:
    """Refine every frame of a sequence and look at every vertex of it again.

    Args:
        refiner: Of this garment on this body.
        laplacian: Of the garment, [V, V].
        predicted: Garment [m], shape [T, V, 3].
        body_vertices: Body [m], shape [T, B, 3].

    Returns:
        The refined garment [T, V, 3] float32 and its figures: collisions before and after, the change of the Laplacian
        as a share of the Laplacian itself [%], the largest move [mm], and what share of the vertices inside was left
        to the last resort [%].
    """
    before, after = Contact(), Contact()
    refined = np.empty(predicted.shape, dtype=np.float32)
    moved, projected, touched = 0.0, 0, 0
    for t, vertices in enumerate(predicted):
        body = refiner.body.at(body_vertices[t])
        hits = body.query(vertices)
        before.add(hits.distance)
        refined[t], stats = refiner.refine_hits(vertices, body, hits)
        distance = hits.distance
        moved_now = (refined[t] != vertices).any(axis=1)
        if moved_now.any():
            distance = distance.copy()
            distance[moved_now] = body.query(refined[t][moved_now]).distance
        after.add(distance)
        moved = max(moved, stats.largest_move)
        projected += stats.projected
        touched += stats.inside
    own, change = (_bending(laplacian, v) for v in (predicted, refined - predicted))
    return refined, {
        **before.figures("all_frames_"),
        **after.figures("refined_"),
        "refinement_laplacian_percent": 100.0 * float(np.sqrt(change / max(own, 1e-30))),
        "refinement_largest_move_mm": 1e3 * moved,
        "refinement_projected_percent": 100.0 * projected / max(touched, 1),
    }


def _bending(laplacian: sp.spmatrix, vertices: np.ndarray) -> float:
    """Mean square of the Laplacian of ``vertices [T, V, 3]`` [m^2]."""
    flat = vertices.transpose(1, 0, 2).reshape(vertices.shape[1], -1)
    return float(np.square(laplacian @ flat).mean())
