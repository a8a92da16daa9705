"""T-shirt and top: the closed, eased body surface, cut at the neck, the hem and the sleeves or armholes."""

from __future__ import annotations

import numpy as np

from garments.distance_field import DistanceField, eased_field, empty_grid, grid_spacing
from garments.ease import triangle_sag
from garments.landmarks import HEAD, LEFT_HIP, NECK, RIGHT_HIP, Landmarks
from garments.spec import GarmentSpec
from garments.surface import DenseSurface
from garments.trunk import (
    ARM_REACH,
    Armhole,
    Sleeve,
    arm_openings,
    bridged_below_neck,
    cut_at_arms_and_neck,
    trunk_gap,
)


def shirt_surface(spec: GarmentSpec, marks: Landmarks, edge: float) -> DenseSurface:
    """Dense surface of a T-shirt or a top; ``ValueError`` if it leaves the part of this body that it can cover."""
    neck = marks.joints[NECK]
    length = spec.measure("length", neck[1] - marks.joints[[LEFT_HIP, RIGHT_HIP], 1].mean())
    longest = neck[1] - (marks.crotch + 0.02)
    if length > longest:
        raise ValueError(
            f"garment '{spec.name}': 'length' {length:.3f} m passes the crotch, this body allows {longest:.3f} m"
        )
    hem = neck[1] - length
    sag = triangle_sag(edge)
    ease, flare, close = spec.measure("ease") + sag, spec.measure("flare"), spec.measure("close")
    arms = arm_openings(spec, marks, ease)
    spacing = grid_spacing(edge)
    margin = max(close, ease + flare * length) + 4 * spacing
    grid = trunk_grid(marks, arms, hem, margin, spacing)
    y = grid.points()[..., 1]
    gap = trunk_gap(y, marks, ease, sag, flare)
    surface = eased_field(grid, marks, marks.faces, gap, bridged_below_neck(y, marks), close).level_surface()
    surface = surface.clipped(hem - surface.vertices[:, 1])
    return cut_at_arms_and_neck(surface, spec, marks, arms)


def trunk_grid(
    marks: Landmarks, arms: list[Sleeve | Armhole], hem: float, margin: float, spacing: float
) -> DistanceField:
    """An empty grid from a hem [m] to the head, around the trunk and as far along the arms as they are covered."""
    trunk = marks.vertices[marks.trunk_faces.reshape(-1)]
    trunk = trunk[(trunk[:, 1] > hem) & (trunk[:, 1] < marks.joints[NECK, 1])]
    ends = np.stack([arm.end for arm in arms])
    low = np.minimum(trunk.min(axis=0), ends.min(axis=0) - ARM_REACH / 2) - margin
    high = np.maximum(trunk.max(axis=0), ends.max(axis=0) + ARM_REACH / 2) + margin
    low[1], high[1] = hem - margin, marks.joints[HEAD, 1]
    return empty_grid(low, high, spacing)
