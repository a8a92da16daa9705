"""Trousers: the eased surface of hips and legs, cut at the waist and above the feet.

Hollows are bridged down to the crotch only: between the legs a closing would make one bag of both. Where the thighs are
near, the gap shrinks towards the symmetry plane, so that the crotch sits just under the body's.
"""

from __future__ import annotations

import numpy as np

from garments.distance_field import eased_field, empty_grid, grid_spacing
from garments.ease import smooth_step, triangle_sag, waist_gap
from garments.landmarks import PELVIS, Landmarks
from garments.spec import GarmentSpec
from garments.surface import DenseSurface

SLOT_DEPTH, SLOT_HALF_WIDTH = 0.06, 0.006
"""Air between wide legs: depth of its top under the crotch and half its width [m]."""

CROTCH_EASE = 0.006
"""Gap of the fabric at the inner thighs just under the crotch [m]."""


def pants_surface(spec: GarmentSpec, marks: Landmarks, edge: float) -> DenseSurface:
    """Dense surface of trousers; ``ValueError`` if the hem lies above the crotch or below the ankles."""
    length = spec.measure("length", marks.waist - marks.ankle - 0.04)
    shortest, longest = marks.waist - marks.crotch + 0.08, marks.waist - marks.ankle - 0.02
    if not shortest <= length <= longest:
        raise ValueError(
            f"garment '{spec.name}': 'length' {length:.3f} m must put the hem between crotch and ankles, on this body "
            f"{shortest:.3f}..{longest:.3f} m"
        )
    hem = marks.waist - length
    sag = triangle_sag(edge)
    ease, flare, close = spec.measure("ease") + sag, spec.measure("flare"), spec.measure("close")
    widest = ease + flare * max(marks.crotch - hem, 0.0)

    spacing = grid_spacing(edge)
    margin = max(close, widest) + 4 * spacing
    trunk = marks.vertices[marks.trunk_faces.reshape(-1)]
    trunk = trunk[(trunk[:, 1] > hem) & (trunk[:, 1] < marks.waist)]
    low, high = trunk.min(axis=0) - margin, trunk.max(axis=0) + margin
    low[1], high[1] = hem - 4 * spacing, marks.waist + margin
    grid = empty_grid(low, high, spacing)
    points = grid.points()
    y = points[..., 1]
    gap = gap_of_legs(waist_gap(y, marks.waist, ease), points, marks, marks.crotch, min(CROTCH_EASE + sag, ease), flare)
    field = eased_field(grid, marks, marks.leg_faces, gap, bridged_above_crotch(y, marks.crotch), close)
    surface = field.with_values(np.maximum(field.values, slot(points, marks, marks.crotch))).level_surface()
    surface = surface.clipped(hem - surface.vertices[:, 1])
    surface = surface.clipped(surface.vertices[:, 1] - marks.waist)
    return surface.largest_component()


def gap_of_legs(
    gap: np.ndarray, points: np.ndarray, marks: Landmarks, crotch: float, inner: float, flare: float
) -> np.ndarray:
    """A garment's gap [m] with legs: ``inner`` at the inner thighs around the crotch, ``flare`` below it.

    Args:
        gap: Gap without regard to the legs [m], shape [NX, NY, NZ].
        points: Grid points [m], shape [NX, NY, NZ, 3].
        marks: The body.
        crotch: Height of the garment's crotch [m].
        inner: Gap of the fabric at the inner thighs [m].
        flare: Growth of the gap per metre below the crotch [m/m].
    """
    x, y = np.abs(points[..., 0] - marks.joints[PELVIS, 0]), points[..., 1]
    near_crotch = smooth_step((crotch + 0.10 - y) / 0.08) * smooth_step((y - crotch + 0.20) / 0.10)
    share = near_crotch * (1.0 - smooth_step((x - 0.01) / 0.07))
    return gap + (share * (inner - gap) + flare * np.maximum(crotch - y, 0.0))


def bridged_above_crotch(y: np.ndarray, crotch: float) -> np.ndarray:
    """Where hollows are bridged at heights [m], 0..1: not between the legs."""
    return smooth_step((y - crotch + 0.02) / 0.05)


def slot(points: np.ndarray, marks: Landmarks, crotch: float) -> np.ndarray:
    """Positive [m] in a slot of air in the symmetry plane, from where the thighs leave room for it, down.

    Wide legs would grow together without it.
    """
    x, y = np.abs(points[..., 0] - marks.joints[PELVIS, 0]), points[..., 1]
    return SLOT_HALF_WIDTH - np.hypot(x, np.maximum(y - (crotch - SLOT_DEPTH), 0.0))
