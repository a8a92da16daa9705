"""Section: reconstruction and generation of motions."""

from __future__ import annotations

from report import published
from report.sections.blocks import Run, Section


def section(run: Run) -> Section:
    """Motions by themselves; how they look dressed is in the gallery."""
    return Section(
        "motion-cvae",
        "Motion CVAE",
        "New motions from an action label. They are put on the ground, led into, dressed by the garment regressor "
        "and refined; nothing of them was ever simulated.",
        [
            *run.table("motion_reconstruction"),
            run.published("published_reconstruction", published.RECONSTRUCTION, "motion_reconstruction"),
            *run.table("motion_generation", controls="^mean pose of the label$"),
            run.published("published_generation", published.GENERATION, "motion_generation"),
            *run.table("motion_quality", mark=False),
        ],
    )
