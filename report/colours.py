"""Colours of bodies and garments, in pictures and in exported files: RGB in 0..1, as shown on a screen (sRGB)."""

from __future__ import annotations

BODY = (0.835, 0.790, 0.755)
GARMENT_COLOURS = {
    "skirt": (0.335, 0.500, 0.545),
    "tshirt": (0.760, 0.515, 0.435),
    "pants": (0.350, 0.405, 0.545),
    "top": (0.800, 0.660, 0.430),
    "jumpsuit": (0.475, 0.550, 0.425),
    "dress": (0.560, 0.400, 0.500),
}
"""Colours by garment kind."""
