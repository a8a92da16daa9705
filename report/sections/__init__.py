"""The chapters of the page, in order: which table, chart and picture stands where.

One file a topic, each with ``section(run) -> Section | None``; None leaves the chapter out, as of a part that the run
was not asked for. A new topic is one more file and its name in ``TOPICS``; what is said about its tables stands in
``report/captions/`` under the same name.
"""

from __future__ import annotations

from report.sections import (
    collisions,
    composition,
    gallery,
    garment_regressor,
    gsnet,
    losses,
    mesh_vae_gan,
    motion_cvae,
    motion_invariant,
    shape_descriptor,
    simulation,
    systems,
    timing,
)
from report.sections.blocks import Run, Section

TOPICS = (
    gallery,
    simulation,
    shape_descriptor,
    motion_invariant,
    composition,
    motion_cvae,
    garment_regressor,
    collisions,
    timing,
    gsnet,
    mesh_vae_gan,
    systems,
    losses,
)
"""In the order of the page."""


def all_sections(run: Run) -> list[Section]:
    """Every section that the run has."""
    return [section for topic in TOPICS if (section := topic.section(run)) is not None]
