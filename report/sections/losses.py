"""Section: loss curves of every training."""

from __future__ import annotations

from report import plots
from report.captions import CAPTIONS, Caption
from report.sections.blocks import Block, Run, Section


def section(run: Run) -> Section:
    """One chart a garment, and one of the motion models."""
    common, blocks = CAPTIONS["losses"], []
    for group, trainings in run.files.trainings().items():
        name = "motion models" if group == "motion" else group
        caption = Caption(f"Losses, {name}", common.what, made=common.made)
        blocks.append(Block("chart", caption, svg=plots.loss_curves([(f"{n}", r) for n, r in trainings], key=group)))
    return Section(
        "losses",
        "Loss curves",
        "The loss that each training minimised, by epoch. A validation curve that turns upwards is overfitting; "
        "one that still falls at the end would gain from more epochs.",
        blocks or [Block("missing", text="No training has left its losses in this run.")],
    )
