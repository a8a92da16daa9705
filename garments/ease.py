"""How far a garment stands off the body: the thin gap of a held waist ring, growing to the garment's ease."""

from __future__ import annotations

import numpy as np

WAIST_EASE = 0.004
"""Gap of a held waist ring [m]: thin enough to look worn, thick enough to stay out of a coarse body's edges."""

WAIST_BLEND = 0.06
"""Height over which the gap grows from the waist's to the ease [m]."""


LIMB_RADIUS = 0.05
"""Radius of shoulders and limbs [m]."""


def waist_gap(heights: np.ndarray, waist: float, ease: float) -> np.ndarray:
    """Gap [m] at heights [m] below a waist, any shape: ``WAIST_EASE`` at the waist, ``ease`` from the blend down."""
    return WAIST_EASE + (max(ease, WAIST_EASE) - WAIST_EASE) * smooth_step((waist - heights) / WAIST_BLEND)


def triangle_sag(edge: float) -> float:
    """How far the middle of a triangle of that edge length lies under the arc its corners are on [m].

    Shoulders and legs bend with radii of about ``LIMB_RADIUS``; a coarse garment is built that much wider, or the body
    would look through the middle of its triangles.
    """
    return min(edge * edge / (8.0 * LIMB_RADIUS), 0.008)


def smooth_step(t: np.ndarray) -> np.ndarray:
    """Cubic from 0 (t <= 0) to 1 (t >= 1) with level ends."""
    t = np.clip(t, 0.0, 1.0)
    return t * t * (3.0 - 2.0 * t)
