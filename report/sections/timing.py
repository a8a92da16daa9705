"""Section: seconds a frame of simulators and networks."""

from __future__ import annotations

from report import plots, published
from report.captions import CAPTIONS
from report.sections.blocks import Block, Run, Section, full_view, missing, once
from report.tables import is_reference, table_view

ELSEWHERE = ("solver", "vertices", "frames", "substeps", "median_s_per_frame", "source")
"""Columns of what was measured on other machines."""


def section(run: Run) -> Section:
    """Our own times, and those that others published."""
    rows = run.rows("timing")
    own = [r for r in rows if not is_reference(r)]
    others = once([r for r in rows if is_reference(r)], "solver", "vertices", "source")
    caption = CAPTIONS["timing"]
    if own:
        view, full = table_view(own, caption.columns, mark=False), full_view(own, caption, mark=False)
        blocks = [run.chart("timing_bars", plots.timing_bars(rows)), Block("table", caption, view, full)]
    else:
        blocks = [missing("timing")]
    elsewhere = [{k: r.get(k) for k in ELSEWHERE} for r in [*others, *published.TIMING]]
    return Section(
        "timing",
        "Time a frame",
        "Simulators and networks on the same garment, body and clip, one after the other on one thread of the "
        "machine below.",
        [*blocks, run.published("published_timing", elsewhere, "timing")],
    )
