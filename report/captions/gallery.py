"""Captions: the gallery of each garment."""

from __future__ import annotations

from report.captions.caption import Caption

CAPTIONS: dict[str, Caption] = {
    "gallery": Caption(
        "Gallery",
        "Simulated with the base material. Generated: label → motion CVAE → ground → garment regressor → refinement, "
        "without a simulator. One clip under clearly different parameter sets. Held-out motions: the simulation, what "
        "the network makes of the motion alone, and their distance.",
        "Shi 2023, Figures 1 and 6; Wang 2019, section 4.",
        "render → pipeline/render.py → figures/<garment>/",
    ),
}
