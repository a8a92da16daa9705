"""Section: animations made of keyframes, and what shapes tell of their material."""

from __future__ import annotations

from report import plots
from report.captions import CAPTIONS
from report.columns import is_number
from report.sections.blocks import Block, Run, Section, once, some_split
from report.tables import table_view
from report.wide import wide_view

_EVERY = ".*"
"""Numbers of keyframes, or of frames, do not compete with each other."""


def section(run: Run) -> Section:
    """Error against the number of keyframes, and estimated parameters."""
    return Section(
        "composition",
        "Authoring",
        "A few keyframes instead of one in every five frames: they are read into the intrinsic space, and the motion "
        "does what lies between them.",
        [*_composition(run), *_inference(run)],
    )


def _composition(run: Run) -> list[Block]:
    rows = [r for r in run.rows("composition") if is_number(r.get("rmse_mm"))]
    if not rows:
        return run.table("composition")
    curves = plots.dimension_curves(rows, "rmse_mm", "RMSE [mm]", "keyframes")
    errors = wide_view(rows, "method", "keyframes", "rmse_mm", control_columns=_EVERY)
    needed = once(rows, "garment", "split", "method")
    blocks = [
        run.chart("composition_curve", curves),
        Block("table", CAPTIONS["composition"], errors, table_view(rows, mark=False)),
    ]
    if any(is_number(r.get("share_for_the_same_percent")) for r in needed):
        shares = wide_view(
            needed, "method", "split", "share_for_the_same_percent", control_columns=_EVERY, keys=("garment",)
        )
        blocks.append(Block("table", CAPTIONS["composition_share"], shares))
    return blocks


def _inference(run: Run) -> list[Block]:
    rows = run.rows("inference")
    if not rows:
        return run.table("inference")
    shown, full = some_split(rows), table_view(rows, mark=False)
    columns = {
        "inference": "r_squared",
        "inference_coverage": "coverage_percent",
        "inference_width": "interval_of_range",
    }
    views = {
        name: wide_view(shown, "parameter", "frames", column, control_columns=_EVERY)
        for name, column in columns.items()
    }
    return [Block("table", CAPTIONS[name], view, full if name == "inference" else None) for name, view in views.items()]
