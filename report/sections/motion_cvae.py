"""Section: reconstruction and generation of motions."""

from __future__ import annotations

from report import published
from report.sections.blocks import Run, Section


def section(run: Run) -> Section:
    """Generated clothed animations, and the motions by themselves."""
    return Section(
        "motion-cvae",
        "Motion CVAE",
        "New motions from an action label. They are put on the ground, led into, dressed by the garment regressor "
        "and refined; nothing of them was ever simulated.",
        [
            run.pictures("generated"),
            *run.table("motion_reconstruction"),
            run.published("published_reconstruction", published.RECONSTRUCTION, "motion_reconstruction"),
            *run.table("motion_generation", controls="^mean pose of the label$"),
            run.published("published_generation", published.GENERATION, "motion_generation"),
            *run.table("motion_quality", mark=False),
        ],
    )
