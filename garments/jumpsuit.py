"""Jumpsuit: trunk and legs in one, cut at the neck, the sleeves or armholes and above the feet.

It hangs from the shoulders and ends between the legs: without room there it would be pulled tight by every stoop. So
its crotch is lower than that of trousers, as it is in a boiler suit.
"""

from __future__ import annotations

import numpy as np

from garments.distance_field import eased_field, grid_spacing
from garments.ease import triangle_sag
from garments.landmarks import NECK, Landmarks
from garments.pants import CROTCH_EASE, bridged_above_crotch, gap_of_legs, slot
from garments.shirt import trunk_grid
from garments.spec import GarmentSpec
from garments.surface import DenseSurface
from garments.trunk import arm_openings, bridged_below_neck, cut_at_arms_and_neck, hem_height, trunk_gap

CROTCH_DROP = 0.04
"""Height of the room under the body's crotch [m]."""


def jumpsuit_surface(spec: GarmentSpec, marks: Landmarks, edge: float) -> DenseSurface:
    """Dense surface of a jumpsuit; ``ValueError`` if hem or sleeves leave the part of this body they can cover."""
    neck, crotch = marks.joints[NECK, 1], marks.crotch - CROTCH_DROP
    usual = neck - marks.ankle - 0.04
    hem = hem_height(spec, marks, usual, neck - crotch + 0.08, usual + 0.02)
    sag = triangle_sag(edge)
    ease, flare, close = spec.measure("ease") + sag, spec.measure("flare"), spec.measure("close")
    arms = arm_openings(spec, marks, ease)
    spacing = grid_spacing(edge)
    margin = max(close, ease + flare * (crotch - hem)) + 4 * spacing
    grid = trunk_grid(marks, arms, hem, margin, spacing)
    points = grid.points()
    y = points[..., 1]
    gap = trunk_gap(y, marks, ease, sag)
    gap = gap_of_legs(gap, points, marks, crotch, min(CROTCH_EASE + sag, ease), flare)
    bridged = bridged_below_neck(y, marks) * bridged_above_crotch(y, crotch)
    arm_faces = marks.faces[marks.arm_weight[marks.faces].max(axis=1) >= 0.5]
    field = eased_field(grid, marks, np.concatenate([marks.leg_faces, arm_faces]), gap, bridged, close)
    surface = field.with_values(np.maximum(field.values, slot(points, marks, crotch))).level_surface()
    surface = surface.clipped(hem - surface.vertices[:, 1])
    return cut_at_arms_and_neck(surface, spec, marks, arms)
