"""Colours of bodies and garments, in pictures and in exported files: RGB in 0..1, as shown on a screen (sRGB)."""

from __future__ import annotations

BODY = (0.835, 0.790, 0.755)
GARMENT_COLOURS = {
    "skirt": (0.145, 0.470, 0.520),
    "tshirt": (0.820, 0.360, 0.270),
    "pants": (0.250, 0.330, 0.560),
}
"""Colours by garment kind."""
