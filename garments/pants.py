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
    x, y = np.abs(points[..., 0] - marks.joints[PELVIS, 0]), points[..., 1]
    gap = waist_gap(y, marks.waist, ease)
    near_crotch = smooth_step((marks.crotch + 0.10 - y) / 0.08) * smooth_step((y - marks.crotch + 0.20) / 0.10)
    inner = near_crotch * (1.0 - smooth_step((x - 0.01) / 0.07))
    gap += inner * (min(CROTCH_EASE + sag, ease) - gap) + flare * np.maximum(marks.crotch - y, 0.0)
    bridged = smooth_step((y - marks.crotch + 0.02) / 0.05)
    field = eased_field(grid, marks, marks.leg_faces, gap, bridged, close)
    # Wide legs would grow together: keep a slot of air in the symmetry plane, from where the thighs leave room for it.
    below_slot = np.maximum(y - (marks.crotch - SLOT_DEPTH), 0.0)
    slot = SLOT_HALF_WIDTH - np.hypot(x, below_slot)
    surface = field.with_values(np.maximum(field.values, slot)).level_surface()
    surface = surface.clipped(hem - surface.vertices[:, 1])
    surface = surface.clipped(surface.vertices[:, 1] - marks.waist)
    return surface.largest_component()
