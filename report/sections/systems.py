"""Section: all systems side by side on the garment that all can dress."""

from __future__ import annotations

from report.sections.blocks import Run, Section

REFERENCES = "^the truth$"
"""Of the column ``told``: what sees it is no method."""


def section(run: Run) -> Section | None:
    """The table, and one frame dressed by all; none where the run was not asked for it."""
    if not run.rows("systems"):
        return None
    return Section(
        "systems",
        "Side by side",
        "Four published systems and our variants of them on the one garment that all can dress: how far they are off, "
        "how they fold and collide, what a frame costs and what the training did.",
        [run.pictures("systems"), *run.table("systems", controls=REFERENCES)],
    )
