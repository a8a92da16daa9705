"""Section: animations made of keyframes, and what shapes tell of their material."""

from __future__ import annotations

from report import plots
from report.captions import CAPTIONS
from report.columns import is_number
from report.sections.blocks import Block, Run, Section
from report.tables import table_view
from report.wide import wide_view

_ALL_FRAMES = ".*"
"""No number of frames competes with another."""


def section(run: Run) -> Section:
    """Error against the number of keyframes, and estimated parameters."""
    rows = [r for r in run.rows("composition") if is_number(r.get("rmse_mm"))]
    charts: list[Block] = []
    if rows:
        curves = plots.dimension_curves(rows, "rmse_mm", "RMSE [mm]", "keyframes")
        charts.append(run.chart("composition_curve", curves))
    return Section(
        "composition",
        "Authoring",
        "A few keyframes instead of one in every five frames: they are read into the intrinsic space, and the motion "
        "does what lies between them.",
        [*charts, *run.table("composition", within="keyframes"), *_inference(run)],
    )


def _inference(run: Run) -> list[Block]:
    rows = run.rows("inference")
    if not rows:
        return run.table("inference")
    columns = {
        "inference": "r_squared",
        "inference_coverage": "coverage_percent",
        "inference_width": "interval_of_range",
    }
    views = {name: wide_view(rows, "parameter", "frames", column, _ALL_FRAMES) for name, column in columns.items()}
    full = table_view(rows, mark=False)
    return [Block("table", CAPTIONS[name], view, full if name == "inference" else None) for name, view in views.items()]
