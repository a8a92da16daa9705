"""Section: every garment in motion, simulated, generated, in several materials, and truth beside prediction."""

from __future__ import annotations

from dataclasses import replace

from report.captions import CAPTIONS
from report.sections.blocks import Block, Run, Section

KINDS = ("simulated", "generated", "materials", "error")
"""Pictures of a garment, in the order that they are shown in."""


def section(run: Run) -> Section | None:
    """A block a garment; None where nothing was drawn."""
    moving = [p for kind in KINDS for p in run.found if p.kind == kind]
    blocks = []
    for garment in dict.fromkeys(p.garment for p in moving):
        caption = CAPTIONS["gallery"] if not blocks else replace(CAPTIONS["gallery"], what="", answers="", made="")
        title = f"{garment[:1].upper()}{garment[1:]}"
        shown = [p for p in moving if p.garment == garment]
        blocks.append(Block("pictures", replace(caption, title=title), pictures=shown))
    if not blocks:
        return None
    return Section(
        "gallery",
        "Gallery",
        "Cloth is judged in motion. All are drawn by one viewer, lit so that folds show; videos play while they are in "
        "sight.",
        blocks,
    )
