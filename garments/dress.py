"""Dress: the eased surface of the trunk down to the waist, and a skirt from there.

Both are fields on one grid whose zero levels are the garment; they are blended around the waist, where they agree.
"""

from __future__ import annotations

import numpy as np

from garments.distance_field import DistanceField, eased_field, empty_grid, grid_spacing
from garments.ease import smooth_step, triangle_sag
from garments.landmarks import NECK, Landmarks
from garments.shirt import trunk_grid
from garments.skirt import ANGLES_AROUND, RING_STEP, skirt_radius
from garments.spec import GarmentSpec
from garments.surface import DenseSurface
from garments.trunk import arm_openings, bridged_below_neck, cut_at_arms_and_neck, hem_height, trunk_gap

BLEND = 0.03
"""Height above and below the waist over which the trunk becomes a skirt [m]."""

OVER_WAIST = 0.06
"""Height that a sleeve stays above the waist [m]: the skirt knows no arms."""


def dress_surface(spec: GarmentSpec, marks: Landmarks, edge: float) -> DenseSurface:
    """Dense surface of a dress; ``ValueError`` if hem or sleeves leave the part of this body they can cover."""
    neck = marks.joints[NECK, 1]
    hem = hem_height(spec, marks, neck - marks.knee, neck - marks.crotch, neck - marks.ankle)
    sag = triangle_sag(edge)
    ease, flare, close = spec.measure("ease") + sag, spec.measure("flare"), spec.measure("close")
    arms = arm_openings(spec, marks, ease)
    lowest = min(arm.end[1] for arm in arms)
    if lowest < marks.waist + OVER_WAIST:
        raise ValueError(
            f"garment '{spec.name}': its sleeves end {lowest:.3f} m high, on this body they must end at least "
            f"{OVER_WAIST:g} m above the waist, which is at {marks.waist:.3f} m"
        )
    spacing = grid_spacing(edge)
    top = marks.waist + 2.0 * BLEND
    heights = np.arange(top, hem - 6.0 * spacing, -RING_STEP)
    # Below the hem it goes straight on: only for the grid's last cells, which are cut away.
    gap = np.full(len(heights), ease)
    covered = np.maximum(heights, max(hem, marks.ankle + 1e-3))
    centre, radius = skirt_radius(marks, covered, gap, flare)

    trunk = trunk_grid(marks, arms, hem, max(close, ease) + 4 * spacing, spacing)
    reach = radius.max() + 4 * spacing
    end = trunk.origin + spacing * (np.array(trunk.values.shape) - 1)
    low = np.array(
        [min(trunk.origin[0], centre[0] - reach), hem - 4 * spacing, min(trunk.origin[2], centre[1] - reach)]
    )
    high = np.array([max(end[0], centre[0] + reach), end[1], max(end[2], centre[1] + reach)])
    grid = empty_grid(low, high, spacing)
    points = grid.points()
    y = points[..., 1]
    below = smooth_step((marks.waist + BLEND - y) / (2.0 * BLEND))
    skirt = _skirt_field(points, heights, centre, radius)
    bodice = _bodice_field(grid, marks, marks.waist - 2.0 * BLEND, ease, sag, close)
    values = np.where(below < 1.0, (1.0 - below) * bodice + below * skirt, skirt)
    surface = grid.with_values(values).level_surface()
    surface = surface.clipped(hem - surface.vertices[:, 1])
    return cut_at_arms_and_neck(surface, spec, marks, arms)


def _bodice_field(
    grid: DistanceField, marks: Landmarks, lowest: float, ease: float, sag: float, close: float
) -> np.ndarray:
    """Field of the trunk [m], shape of the grid; not reckoned, and positive, below a height [m]."""
    first = max(int((lowest - grid.origin[1]) / grid.spacing) - int(np.ceil(2 * close / grid.spacing)), 0)
    origin = grid.origin + np.array([0.0, first * grid.spacing, 0.0])
    upper = DistanceField(grid.values[:, first:], origin, grid.spacing)
    y = upper.points()[..., 1]
    field = eased_field(upper, marks, marks.faces, trunk_gap(y, marks, ease, sag), bridged_below_neck(y, marks), close)
    values = np.full(grid.values.shape, close)
    values[:, first:] = field.values
    return values


def _skirt_field(points: np.ndarray, heights: np.ndarray, centre: np.ndarray, radius: np.ndarray) -> np.ndarray:
    """How far points [..., 3] are outside of the skirt, level [m], shape [...]; above its top ring as at it."""
    x, z = points[..., 0] - centre[0], points[..., 2] - centre[1]
    turn = np.mod(np.arctan2(x, z), 2.0 * np.pi) / (2.0 * np.pi) * len(ANGLES_AROUND)
    ring = np.clip((heights[0] - points[..., 1]) / RING_STEP, 0.0, len(heights) - 1.000001)
    k, a = ring.astype(int), turn.astype(int) % len(ANGLES_AROUND)
    b, u, v = (a + 1) % len(ANGLES_AROUND), ring - k, turn - np.floor(turn)
    below = radius[k + 1, a] * (1.0 - v) + radius[k + 1, b] * v
    return np.hypot(x, z) - (1.0 - u) * (radius[k, a] * (1.0 - v) + radius[k, b] * v) - u * below
