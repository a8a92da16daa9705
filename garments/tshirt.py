"""T-shirt: the closed, eased body surface, cut at the neck, the sleeves and the hem.

The neckline follows the base of the neck closely: a wide one slides off the shoulder as soon as the body moves and then
spoils every figure of the simulation. For the same reason the shirt lies close to the shoulders and only stands off
below them.
"""

from __future__ import annotations

import numpy as np

from garments.distance_field import eased_field, empty_grid, grid_spacing
from garments.ease import smooth_step, triangle_sag
from garments.landmarks import ELBOWS, HEAD, LEFT_HIP, NECK, RIGHT_HIP, SHOULDERS, WRISTS, Landmarks, slice_points
from garments.spec import GarmentSpec
from garments.surface import DenseSurface

SHOULDER_EASE = 0.005
"""Gap of the fabric that rests on neck and shoulders [m]."""

NECK_CLEARANCE = 0.008
"""Distance of the neckline from the neck's own outline when ``neck`` is 0 [m]."""

NECK_DEPTH = 0.06
"""Lowest point of the neckline below the neck joint when ``neck`` is 0 [m]."""

NECK_ROUNDING = 0.04
"""Radius scale of the corner between the neckline's sides and its lowest point [m]."""

ARM_REACH = 0.13
"""Everything nearer than this to the bare arm's bones and beyond the sleeve hem is cut away [m]."""


def tshirt_surface(spec: GarmentSpec, marks: Landmarks, edge: float) -> DenseSurface:
    """Dense surface of a T-shirt; ``ValueError`` if hem or sleeves leave the part of this body they can cover."""
    joints = marks.joints
    neck = joints[NECK]
    length = spec.measure("length", neck[1] - joints[[LEFT_HIP, RIGHT_HIP], 1].mean())
    longest = neck[1] - (marks.crotch + 0.02)
    if length > longest:
        raise ValueError(
            f"garment '{spec.name}': 'length' {length:.3f} m passes the crotch, this body allows {longest:.3f} m"
        )
    hem = neck[1] - length
    sag = triangle_sag(edge)
    ease, flare, close = spec.measure("ease") + sag, spec.measure("flare"), spec.measure("close")
    arms = [_Sleeve(spec, joints[SHOULDERS[s]], joints[ELBOWS[s]], joints[WRISTS[s]]) for s in (0, 1)]

    spacing = grid_spacing(edge)
    widest = ease + flare * length
    margin = max(close, widest) + 4 * spacing
    trunk = marks.vertices[marks.trunk_faces.reshape(-1)]
    trunk = trunk[(trunk[:, 1] > hem) & (trunk[:, 1] < neck[1])]
    ends = np.stack([arm.end for arm in arms])
    low = np.minimum(trunk.min(axis=0), ends.min(axis=0) - ARM_REACH / 2) - margin
    high = np.maximum(trunk.max(axis=0), ends.max(axis=0) + ARM_REACH / 2) + margin
    low[1], high[1] = hem - margin, joints[HEAD, 1]
    grid = empty_grid(low, high, spacing)
    y = grid.points()[..., 1]
    armpit = joints[list(SHOULDERS), 1].mean() - 0.10
    shoulder = min(SHOULDER_EASE + sag, ease)
    gap = shoulder + (ease - shoulder) * smooth_step((armpit + 0.12 - y) / 0.12)
    gap += flare * np.maximum(armpit - y, 0.0)
    # The closing would bridge shoulder and neck and widen the neckline: none near the neck, all of it 10 cm lower.
    bridged = smooth_step((neck[1] - 0.01 - y) / 0.10)
    surface = eased_field(grid, marks, marks.faces, gap, bridged, close).level_surface()
    surface = surface.clipped(hem - surface.vertices[:, 1])
    for arm in arms:
        surface = surface.clipped(arm.beyond(surface.vertices))
    surface = surface.clipped(_inside_neckline(spec, marks, surface.vertices))
    return surface.largest_component()


class _Sleeve:
    """Where one sleeve ends: a plane across the arm, ``sleeve`` metres from the shoulder along its bones."""

    def __init__(self, spec: GarmentSpec, shoulder: np.ndarray, elbow: np.ndarray, wrist: np.ndarray) -> None:
        upper, fore = np.linalg.norm(elbow - shoulder), np.linalg.norm(wrist - elbow)
        length = spec.measure("sleeve", 0.55 * upper)
        longest = upper + fore - 0.02
        if length > longest:
            raise ValueError(
                f"garment '{spec.name}': 'sleeve' {length:.3f} m passes the wrist, this body allows {longest:.3f} m"
            )
        on_upper = length <= upper
        self.direction = (elbow - shoulder) / upper if on_upper else (wrist - elbow) / fore
        self.end = shoulder + length * self.direction if on_upper else elbow + (length - upper) * self.direction
        # The bare arm: from the sleeve's end along the bones, the hand being as far again as half the forearm.
        fingers = wrist + 0.6 * (wrist - elbow)
        self.bare = [(self.end, elbow), (elbow, fingers)] if on_upper else [(self.end, fingers)]

    def beyond(self, points: np.ndarray) -> np.ndarray:
        """Positive [m] for points of the arm past the sleeve's end, shape [N]."""
        along = (points - self.end) @ self.direction
        away = np.min([_segment_distance(points, start, end) for start, end in self.bare], axis=0)
        return np.minimum(along, ARM_REACH - away)


def _segment_distance(points: np.ndarray, start: np.ndarray, end: np.ndarray) -> np.ndarray:
    """Distances [m] of points [N, 3] from a straight segment, shape [N]."""
    side = end - start
    where = np.clip((points - start) @ side / max(side @ side, 1e-12), 0.0, 1.0)
    return np.linalg.norm(points - start - where[:, None] * side, axis=1)


def _inside_neckline(spec: GarmentSpec, marks: Landmarks, points: np.ndarray) -> np.ndarray:
    """Positive [m] inside an upright elliptic cylinder around the neck and above the collar bones, shape [N]."""
    neck = marks.joints[NECK]
    outline = slice_points(marks.vertices, marks.trunk_faces, neck[1] + 0.02)
    outline = outline[np.abs(outline[:, 0] - neck[0]) < 0.10]
    if len(outline) < 8:
        raise ValueError(f"garment '{spec.name}': this body has no neck to fit a neckline to")
    low, high = outline.min(axis=0), outline.max(axis=0)
    widening = spec.measure("neck")
    axes = 0.5 * (high - low) + NECK_CLEARANCE + widening
    scaled = (points[:, [0, 2]] - 0.5 * (low + high)) / axes
    around = (1.0 - np.linalg.norm(scaled, axis=1)) * axes.min()
    above = points[:, 1] - (neck[1] - NECK_DEPTH - widening)
    # Rounded minimum: a sharp one would leave corners in the neckline.
    blend = np.maximum(NECK_ROUNDING - np.abs(around - above), 0.0)
    return np.minimum(around, above) - blend * blend / (4.0 * NECK_ROUNDING)
