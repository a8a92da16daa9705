"""Chart of an error over the epochs: one line a method, as an inline SVG in the page's own colours.

Methods learn in epochs of different lengths, so the axis is the share of each training that is over.
"""

from __future__ import annotations

from collections.abc import Sequence

import matplotlib
from matplotlib.figure import Figure
from matplotlib.ticker import PercentFormatter

from evaluation.table import Row
from report.plots import INK, PALETTE, WIDTH, svg

_STYLE = {
    "svg.fonttype": "none",
    "svg.hashsalt": "drapeline",
    "font.family": "sans-serif",
    "font.size": 9,
    "axes.edgecolor": INK,
    "axes.labelcolor": INK,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.linewidth": 0.7,
    "text.color": INK,
    "xtick.color": INK,
    "ytick.color": INK,
    "legend.frameon": False,
    "lines.linewidth": 1.7,
}


def epoch_curves(rows: Sequence[Row], value: str, unit: str, method: str = "method") -> str:
    """Lines of ``value`` over the epochs; the legend says how many epochs 100% are.

    Args:
        rows: At least one, each with ``epoch`` and ``method``.
        value: Column with the error.
        unit: What stands beside the axis.
        method: Column that names the lines.
    """
    with matplotlib.rc_context(_STYLE):
        figure = Figure(figsize=(WIDTH, 3.0), layout="constrained")
        axes = figure.add_subplot()
        for k, name in enumerate(dict.fromkeys(str(r[method]) for r in rows)):
            mine = [r for r in rows if str(r[method]) == name]
            last = max(r["epoch"] for r in mine)
            points = [(r["epoch"] / last, r[value]) for r in mine]
            axes.plot(
                *zip(*points), marker="o", ms=3.5, color=PALETTE[k % len(PALETTE)], label=f"{name} ({last} epochs)"
            )
        axes.set_ylim(bottom=0.0)
        axes.set_xlabel("share of the training")
        axes.set_ylabel(unit)
        axes.xaxis.set_major_formatter(PercentFormatter(1.0))
        axes.legend(fontsize=8.5, loc="upper right", ncols=2)
        return svg(figure, "epochs")
