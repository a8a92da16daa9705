"""Section: GSNet, one network for garments of any topology, beside its baselines."""

from __future__ import annotations

from collections.abc import Iterable

from evaluation.table import Row
from report import epoch_curves, plots
from report.captions import CAPTIONS
from report.columns import is_number
from report.sections.blocks import Block, Run, Section, full_view, missing
from report.tables import table_view
from report.wide import wide_view

NAMES = {
    "anchored": "GSNet, ours",
    "steady": "GSNet, ours, from random weights",
    "paper": "GSNet, published form",
    "deepsd": "DeePSD",
    "tailornet": "TailorNet",
    "pbns": "PBNS",
}
"""What the variants are called beside the papers' tables; another variant has its own name."""

ABLATION = {
    "no-temporal": "pose alone",
    "garment": "+ garment before",
    "garment-pose": "+ garment before, + motion",
    "pose": "motion, no garment before",
}
"""Variants that differ in what they know of the past, in the order of the paper's Table 3."""

CONTROLS = "^(linear blend skinning|ridge on skinning.*)$"


def section(run: Run) -> Section | None:
    """Tables 1 to 3, the charts of figures 7 to 9, contact and long roll-outs; None where GSNet was not asked for."""
    rows = run.rows("gsnet")
    if not rows:
        return None
    main = [r for r in rows if r["method"] not in ABLATION]
    caption = CAPTIONS["gsnet"]
    shown = named(main)
    blocks: list[Block | None] = [
        run.pictures("gsnet"),
        Block("table", caption, table_view(shown, caption.columns, controls=CONTROLS), None),
        _categories(run),
        _ablation(rows),
        _gap(run),
        _stability(run),
        *_contact(run),
        *_drift(run),
        *_timing(run),
    ]
    return Section(
        "gsnet",
        "One network for all garments",
        "GSNet learns from the wardrobe: templates of six kinds, each of its own measures, mesh and material. What it "
        "knows of a garment it reads off the template's mesh, so it dresses templates that it never saw. Our form of "
        "it sends displacements along several edges from every joint, which know the last second of the motion, to "
        "every vertex; what of that is linear in the motion is found in closed form, before training.",
        blocks,
    )


def named(rows: Iterable[Row]) -> list[Row]:
    """Rows with the methods' names as the papers have them."""
    names = NAMES | ABLATION
    return [r | {"method": names.get(str(r["method"]), r["method"])} for r in rows]


def _categories(run: Run) -> Block:
    rows = [r for r in run.rows("gsnet_categories") if r["method"] not in ABLATION]
    if not rows:
        return missing("gsnet_categories")
    view = wide_view(named(rows), "category", "method", "error_mm", control_columns=CONTROLS)
    return Block("table", CAPTIONS["gsnet_categories"], view, table_view(named(rows), controls=CONTROLS))


def _ablation(rows: list[Row]) -> Block | None:
    found = {m: [r for r in rows if r["method"] == m and r["split"] != "train"] for m in ABLATION}
    ordered = sorted(
        (r for some in found.values() for r in some), key=lambda r: [x["split"] for x in rows].index(r["split"])
    )
    if not ordered:
        return None
    caption = CAPTIONS["gsnet_ablation"]
    return Block("table", caption, table_view(named(ordered), caption.columns))


def _gap(run: Run) -> Block:
    rows = [r for r in run.rows("gsnet_gap") if r["method"] not in ABLATION]
    if not rows:
        return missing("gsnet_gap")
    return Block("table", CAPTIONS["gsnet_gap"], table_view(named(rows), mark=False))


def _stability(run: Run) -> Block:
    rows = [r for r in run.rows("gsnet_stability") if r["method"] not in ABLATION]
    if not rows:
        return missing("gsnet_stability")
    return run.chart("gsnet_stability", epoch_curves.epoch_curves(named(rows), "validation_error_mm", "error [mm]"))


def _contact(run: Run) -> list[Block]:
    return run.table("gsnet_contact", mark=False)


def _drift(run: Run) -> list[Block]:
    rows = [r for r in run.rows("gsnet_drift") if r["method"] not in ABLATION]
    if not rows:
        return [missing("gsnet_drift")]
    caption = CAPTIONS["gsnet_drift"]
    if not any(is_number(r.get("last_tenth_over_first")) for r in rows):
        return [Block("table", caption, table_view(rows, mark=False))]
    view = table_view(named(rows), caption.columns, controls=CONTROLS, mark=False)
    return [Block("table", caption, view, full_view(named(rows), caption, CONTROLS, False))]


def _timing(run: Run) -> list[Block]:
    rows = run.rows("gsnet_timing")
    if not rows:
        return [missing("gsnet_timing")]
    per_frame = [r for r in rows if "once" not in str(r["what"])]
    chart = run.chart("gsnet_timing_bars", plots.timing_bars(per_frame, label="what"))
    return [chart, *run.table("gsnet_timing", mark=False)]
