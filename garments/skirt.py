"""Skirt: a tube around waist, hips and legs.

The radius at angle a and height y is ``max(convex body slice + ease, ring above + flare dy)``: it touches nothing,
never narrows, and its waist ring hugs the body, because that ring is the one that is held.
"""

from __future__ import annotations

import numpy as np
from scipy.ndimage import gaussian_filter1d

from garments.ease import waist_gap
from garments.landmarks import Landmarks
from garments.spec import GarmentSpec
from garments.surface import DenseSurface

RING_STEP = 0.006
"""Height between rings of the dense tube [m]."""

ANGLES = 288
ANGLES_AROUND = np.arange(ANGLES) * 2.0 * np.pi / ANGLES
"""Directions [rad] in which radii are measured, from +z towards +x."""


def skirt_surface(spec: GarmentSpec, marks: Landmarks) -> DenseSurface:
    """Dense tube of a skirt, hem up to the waist plane; raises ``ValueError`` if it would touch the ground."""
    longest = marks.waist - marks.ankle
    length = spec.measure("length", marks.waist - marks.knee)
    if length > longest:
        raise ValueError(
            f"garment '{spec.name}': 'length' {length:.3f} m passes the ankles, this body allows {longest:.3f} m"
        )
    ease, flare = spec.measure("ease"), spec.measure("flare")
    rings = max(int(np.ceil(length / RING_STEP)), 8) + 1
    heights = marks.waist - np.linspace(0.0, length, rings)
    centre, radius = skirt_radius(marks, heights, waist_gap(heights, marks.waist, ease), flare)
    angle = ANGLES_AROUND
    vertices = np.empty((rings, ANGLES, 3))
    vertices[..., 0] = centre[0] + radius * np.sin(angle)
    vertices[..., 1] = heights[:, None]
    vertices[..., 2] = centre[1] + radius * np.cos(angle)
    return DenseSurface(vertices.reshape(-1, 3), _tube_faces(rings, ANGLES))


def skirt_radius(marks: Landmarks, heights: np.ndarray, gap: np.ndarray, flare: float) -> tuple[np.ndarray, np.ndarray]:
    """Radius of a skirt around the middle of the waist.

    Args:
        marks: The body.
        heights: Heights of the rings [m], from the top down in even steps, shape [R].
        gap: Gap to the body's convex outline at each [m], shape [R].
        flare: Growth of the radius per metre of height below the waist [m/m].

    Returns:
        The middle of the waist (x, z) [m], and the radius [m] of each ring at ``ANGLES_AROUND``, shape [R, ANGLES].
    """
    waist = marks.slice_hull(marks.waist)
    centre = 0.5 * (waist.min(axis=0) + waist.max(axis=0))  # (x, z)
    body = np.stack([_radius(marks.slice_hull(y - 1e-4), centre, ANGLES_AROUND, g) for y, g in zip(heights, gap)])
    radius = body.copy()
    for k in range(1, len(heights)):
        if heights[k] < marks.waist:  # above it, the chest is wider
            radius[k] = np.maximum(body[k], radius[k - 1] + flare * (heights[k - 1] - heights[k]))
    # Rounded over ~15 mm, then lifted by what rounding took, so that no ring enters the body's outline.
    smooth = gaussian_filter1d(radius, 2.5, axis=0, mode="nearest")
    smooth = gaussian_filter1d(smooth, 3.0, axis=1, mode="wrap")
    lift = np.maximum(body - smooth, 0.0)
    radius = smooth + gaussian_filter1d(gaussian_filter1d(lift, 2.0, axis=0, mode="nearest"), 2.0, axis=1, mode="wrap")
    return centre, np.maximum(radius, body)


def _radius(outline: np.ndarray, centre: np.ndarray, angle: np.ndarray, gap: float) -> np.ndarray:
    """Distance [m] from the centre to a convex outline moved outwards by ``gap``, per angle from +z towards +x."""
    side = np.roll(outline, -1, axis=0) - outline
    normal = np.stack([side[:, 1], -side[:, 0]], axis=1)
    size = np.linalg.norm(normal, axis=1)
    normal = normal[size > 1e-9] / size[size > 1e-9, None]
    reach = ((outline[size > 1e-9] - centre) * normal).sum(axis=1) + gap
    if reach.min() <= 0.0:
        raise ValueError("the middle of the waist lies outside a slice of the body: a skirt cannot be built around it")
    towards = normal @ np.stack([np.sin(angle), np.cos(angle)])  # [sides, angles]
    with np.errstate(divide="ignore"):
        distance = np.where(towards > 1e-9, reach[:, None] / np.maximum(towards, 1e-12), np.inf)
    return distance.min(axis=0)


def _tube_faces(rings: int, around: int) -> np.ndarray:
    """Outward faces of a tube whose rings run from the top down and turn from +z to +x, shape [F, 3]."""
    k, a = np.meshgrid(np.arange(rings - 1), np.arange(around), indexing="ij")
    top, right = k * around + a, k * around + (a + 1) % around
    below, diagonal = top + around, right + around
    first = np.stack([top, below, right], axis=-1)
    second = np.stack([right, below, diagonal], axis=-1)
    return np.stack([first, second], axis=2).reshape(-1, 3)
