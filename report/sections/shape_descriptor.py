"""Section: the shape descriptor beside principal components."""

from __future__ import annotations

from evaluation.table import columns_of
from report import plots
from report.columns import is_number
from report.sections.blocks import Block, Run, Section


def section(run: Run) -> Section:
    """Error by length of the code, single frames, shapes between two, implausible shapes."""
    rows = run.rows("shape_descriptor")
    size = next((c for c in columns_of(rows) if c in ("dimension", "dimensions")), "")
    charts: list[Block] = []
    if rows and size and any(is_number(r.get("rmse_mm")) for r in rows):
        name = next((n for n in ("method", "variant") if n in columns_of(rows)), "method")
        charts.append(run.chart("descriptor_curve", plots.dimension_curves(rows, "rmse_mm", "RMSE [mm]", size, name)))
    return Section(
        "shape-descriptor",
        "Shape descriptor",
        "How few numbers describe a draped garment: an autoencoder of single frames, held against principal "
        "components of equal dimension.",
        [
            *charts,
            *run.table("shape_descriptor", within=size),
            run.pictures("descriptor_error"),
            *run.table("descriptor_interpolation", mark=False),
            run.pictures("descriptor_between"),
            *run.table("descriptor_projection", mark=False),
            run.pictures("descriptor_implausible"),
        ],
    )
