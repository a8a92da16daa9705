"""How much of a garment is inside the body, before and after refinement.

In: garment and body vertices of a sequence [m]. Out: shares of the vertices inside the body or nearer than 1 mm, and
the deepest one, by exact signed distances to the body's surface.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import scipy.sparse as sp

from evaluation.metrics import COLLISION_MARGIN
from geometry.proximity import PosedSurface, SurfaceQuery
from geometry.topology import lengths
from models.refinement import Refiner

LOOK_UP = 5.0e-3
"""Distance from the body [m] that a vertex must be known to keep for it not to be looked up."""


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


class KnownGarment:
    """A garment outside a body whose distances are known, which tells much of those of garments that lie near it.

    A vertex that is nearer to its counterpart than the counterpart is to the body is outside as well, and its distance
    is less by their distance at most: such vertices, on a good prediction most, need not be looked up. Where the body
    runs through itself a look at the nearest surface can say otherwise, close to it: hence ``LOOK_UP``.

    Args:
        vertices: The known garment [m], shape [V, 3].
        body: The body at the same instant.
    """

    def __init__(self, vertices: np.ndarray, body: PosedSurface) -> None:
        self._vertices, self._body = np.asarray(vertices, dtype=np.float64), body
        self._distance = body.query(vertices).distance

    def distances(self, vertices: np.ndarray) -> np.ndarray:
        """Signed distances [m], [V], of another garment: exact below ``LOOK_UP``, else at least that."""
        distance = self._distance - lengths(vertices - self._vertices)
        ask = np.flatnonzero(distance < LOOK_UP)
        if len(ask):
            distance[ask] = self._body.query(vertices[ask]).distance
        return distance


def contacts(
    predictions: Mapping[str, np.ndarray], truth: np.ndarray, body: SurfaceQuery, body_vertices: np.ndarray
) -> dict[str, Contact]:
    """Contact of several garments with one moving body.

    Args:
        predictions: Garments [m] by name, shape [T, V, 3] each.
        truth: The garment that they predict, shape [T, V, 3].
        body: The body's surface.
        body_vertices: Its vertices [m], shape [T, B, 3].
    """
    found = {name: Contact() for name in predictions}
    for t, under in enumerate(body_vertices):
        known = KnownGarment(truth[t], body.at(under))
        for name, vertices in predictions.items():
            found[name].add(known.distances(vertices[t]))
    return found


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
        after.add(body.query_moved(refined[t], vertices, hits).distance)
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
