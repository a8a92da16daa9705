"""Section: the intrinsic latent and what can be read from it."""

from __future__ import annotations

from dataclasses import replace

from report import plots
from report.captions import CAPTIONS
from report.columns import is_number
from report.sections.blocks import Block, Run, Section, as_sentence, once, some_split
from report.tables import table_view
from report.wide import wide_view

TRANSFER_CONTROLS = "^descriptor floor|^wrong phi|^mean z|^mean shape"
CONTROL_VARIANTS = "^motion-only$|^true-parameters$"
"""Lines of the transfer table that are there to compare with."""


def section(run: Run) -> Section:
    """Transfer, variance of the latent, recovered parameters."""
    return Section(
        "motion-invariant",
        "Motion-invariant autoencoder",
        "What a garment is made of, apart from how its wearer moves. One latent should hold for all frames that "
        "share a parameter set, and should dress a motion that it was not taken from.",
        [*_transfer(run), *_recovery(run)],
    )


def _transfer(run: Run) -> list[Block]:
    rows = run.rows("motion_invariant")
    transfers = [r for r in rows if r.get("quantity") and r.get("rmse_mm") is not None]
    blocks: list[Block] = []
    if transfers:
        view = wide_view(transfers, "quantity", "variant", "rmse_mm", TRANSFER_CONTROLS, CONTROL_VARIANTS)
        blocks.append(Block("table", CAPTIONS["motion_invariant"], view, table_view(rows, mark=False)))
    else:
        blocks += run.table("motion_invariant", controls=CONTROL_VARIANTS)
    for name, column in (("transfer_gain", "gain_share"), ("transfer_over_true", "over_true_parameters")):
        if any(is_number(r.get(column)) for r in rows):
            view = wide_view(rows, "quantity", "variant", column, control_columns=CONTROL_VARIANTS)
            blocks.append(Block("table", CAPTIONS[name], view))
    for name, column in (("latent_variance", "variance_ratio"), ("clip_latent_variance", "clip_variance_ratio")):
        ratios = once([r for r in rows if is_number(r.get(column))], "garment", "split", "variant")
        if ratios:
            view = wide_view(ratios, "garment", "variant", column, control_columns=CONTROL_VARIANTS, keys=("split",))
            blocks.append(Block("table", CAPTIONS[name], view))
    return blocks


def _recovery(run: Run) -> list[Block]:
    rows = run.rows("parameter_recovery")
    if not any(r.get("r_squared") is not None for r in rows):
        return run.table("parameter_recovery")
    shown = some_split(rows)
    caption = replace(CAPTIONS["recovery_bars"], split=as_sentence(shown[0].get("split")))
    view = wide_view(rows, "parameter", "variant", "r_squared", control_columns=CONTROL_VARIANTS)
    return [
        Block("chart", caption, svg=plots.recovery_bars(shown, "r_squared")),
        Block("table", CAPTIONS["parameter_recovery"], view, table_view(rows, mark=False)),
    ]
