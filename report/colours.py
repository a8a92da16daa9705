"""Colours of bodies and garments, in pictures and in exported files: RGB in 0..1, as shown on a screen (sRGB)."""

from __future__ import annotations

BODY = (0.835, 0.790, 0.755)
GARMENT_COLOURS = {
    "skirt": (0.145, 0.470, 0.520),
    "tshirt": (0.820, 0.360, 0.270),
    "pants": (0.250, 0.330, 0.560),
    "top": (0.860, 0.610, 0.250),
    "jumpsuit": (0.360, 0.500, 0.300),
    "dress": (0.560, 0.270, 0.440),
}
"""Colours by garment kind."""
