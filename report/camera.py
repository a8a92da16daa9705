"""Where the camera of a picture stands: angles asked for, and the distance that shows a whole sequence.

In: body (and garment) vertices of a sequence [m]. Out: a ``Framing`` that every frame of the sequence is drawn with.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import gaussian_filter


@dataclass(frozen=True)
class View:
    """Where the camera stands.

    Attributes:
        azimuth: Angle around the body [deg]; 0 looks at the face of a body that faces +z, 90 at its left side.
        elevation: Angle above the horizon [deg].
        follow: Keep the pelvis in the middle instead of framing the whole sequence from one place.
        field: Vertical field of view [deg].
        margin: Free space around the body, a share of the picture.
    """

    azimuth: float = 25.0
    elevation: float = 8.0
    follow: bool = False
    field: float = 22.0
    margin: float = 0.06


@dataclass(frozen=True)
class Framing:
    """A camera fixed for a sequence: its distance [m], its target [m] and, when following, the path of targets."""

    direction: np.ndarray
    distance: float
    targets: np.ndarray  # [T, 3]
    field: float

    @classmethod
    def of(cls, body: np.ndarray, view: View, size: tuple[int, int], garment: np.ndarray | None = None) -> Framing:
        """Camera that sees all of ``body [T, B, 3]`` and ``garment [T, V, 3]``; ``size`` is (width, height) [px]."""
        azimuth, elevation = np.deg2rad(view.azimuth), np.deg2rad(view.elevation)
        back = np.array([np.sin(azimuth) * np.cos(elevation), np.sin(elevation), np.cos(azimuth) * np.cos(elevation)])
        right = np.array([np.cos(azimuth), 0.0, -np.sin(azimuth)])
        up = np.cross(back, right)
        low, high = body.min(axis=1), body.max(axis=1)  # [T, 3]
        centres = 0.5 * (low + high)
        if view.follow:
            # Along the ground only, and without the jitter of the single frame.
            height = 0.5 * (low[:, 1].min() + high[:, 1].max())
            targets = gaussian_filter(centres, (3.0, 0.0), mode="nearest")
            targets[:, 1] = height
        else:
            middle = 0.5 * (low.min(axis=0) + high.max(axis=0))
            targets = np.repeat(middle[None], len(centres), axis=0)
        # Every seventh vertex tells the outline.
        offset = (body[:, ::7] if garment is None else np.concatenate([body[:, ::7], garment], axis=1)) - targets[
            :, None
        ]
        tangent = np.tan(np.deg2rad(view.field) / 2) * (1.0 - 2 * view.margin)
        # A point at depth z before the target is seen when |x| <= tan * (distance - z).
        depth = offset @ back
        distance = max(
            float((np.abs(offset @ up) / tangent + depth).max()),
            float((np.abs(offset @ right) / (tangent * size[0] / size[1]) + depth).max()),
        )
        return cls(back, distance, targets, view.field)
