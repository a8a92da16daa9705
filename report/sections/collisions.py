"""Section: before and after collision tuning, before and after refinement."""

from __future__ import annotations

from evaluation.table import columns_of
from report.captions import CAPTIONS
from report.sections.blocks import Block, Run, Section, missing
from report.tables import table_view


def section(run: Run) -> Section:
    """How garments are kept out of the body."""
    return Section(
        "collisions",
        "Collisions",
        "First the regressor is tuned on generated motions, without ground truth, so that its garments leave the "
        "body. Then each frame is refined: what is still inside is drawn out while the garment keeps its shape.",
        [run.pictures("refined"), *run.table("collision_tuning", mark=False), _refinement(run)],
    )


def _refinement(run: Run) -> Block:
    rows, caption = run.rows("garment_regressor"), CAPTIONS["refinement"]
    rows = [r for r in rows if r.get("refined_rmse_mm") is not None] or rows
    if rows and any(c in columns_of(rows) for c in caption.columns[2:]):
        return Block("table", caption, table_view(rows, caption.columns))
    return missing("refinement")
