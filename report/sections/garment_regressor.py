"""Section: regressors beside baselines, and the papers' figures."""

from __future__ import annotations

from report import plots, published
from report.columns import is_number
from report.sections.blocks import Block, Run, Section, some_split


def section(run: Run) -> Section:
    """Truth beside prediction, errors by method, long sequences."""
    rows = run.rows("garment_regressor")
    charts: list[Block] = []
    if rows and any(is_number(r.get("rmse_mm")) for r in rows):
        charts.append(run.chart("regressor_bars", plots.method_bars(some_split(rows), "rmse_mm", "RMSE [mm]")))
    return Section(
        "garment-regressor",
        "Garment regressor",
        "From body motion to garment vertices, on motions that were not trained on, with the base material. A "
        "learned regressor has to beat what needs no network.",
        [
            run.pictures("error_still"),
            *charts,
            *run.table("garment_regressor"),
            *run.table("regressor_drift"),
            run.published("published_regressors", published.REGRESSORS, "garment_regressor"),
            run.published("published_gsnet", published.REGRESSORS_GSNET, "garment_regressor"),
        ],
    )
