"""Plot of the ranges of a garment's parameters: one row a parameter, each on its own scale.

A row shows what was tried (a dot held, a cross did not), the interval in which everything held, the part of it that
data are drawn from, the base value, and what stopped the search at either end. Colours are Okabe and Ito's; the marks
differ in shape too.
"""

from __future__ import annotations

import io
from collections.abc import Sequence

import matplotlib
from matplotlib.axes import Axes
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, MaxNLocator, NullFormatter, NullLocator

from sim.parameters import IntrinsicParameter, parameter
from sim.range_finder import CRITERIA, FAILED, FoundRange, Outcome, Trial

HELD, BROKEN, INTERVAL, DRAWN = "#009e73", "#d55e00", "#b9ddec", "#0072b2"
_STYLE = {
    "svg.fonttype": "none",
    "svg.hashsalt": "drapeline",
    "font.size": 8.5,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.spines.left": False,
    "axes.linewidth": 0.6,
    "xtick.major.width": 0.6,
}
_CAUSES = {
    "p99_edge_strain": "strain",
    "penetration": "penetration",
    "vertices_inside": "inside the body",
    "residual_speed": "does not settle",
    "jitter": "jitter",
    FAILED: "diverges",
}
_ROW, _TOP, _WIDTH = 0.46, 0.75, 7.4  # [inch]


def ranges_figure(garment: str, found: Sequence[FoundRange], trials: Sequence[Trial], share: float) -> Figure:
    """The plot as a Matplotlib figure.

    Args:
        garment: Name for the title.
        found: The ranges, one row each, in order.
        trials: All trials of the search.
        share: Share of the ranges that data are drawn from.
    """
    with matplotlib.rc_context(_STYLE):
        height = _ROW * len(found) + _TOP
        figure = Figure(figsize=(_WIDTH, height))
        FigureCanvasSVG(figure)
        for row, one in enumerate(found):
            bottom = 1.0 - (_TOP + _ROW * (row + 0.62)) / height
            axes = figure.add_axes((0.335, bottom, 0.5, 0.3 * _ROW / height))
            _draw(axes, parameter(one.parameter), one, [t for t in trials if t.parameter == one.parameter], share)
        figure.text(0.01, 1.0 - 0.24 / height, f"{garment}: ranges found one parameter at a time", fontweight="bold", fontsize=10)  # fmt: skip  # noqa: E501
        _legend(figure, share, 1.0 - 0.52 / height)
        return figure


def ranges_plot(garment: str, found: Sequence[FoundRange], trials: Sequence[Trial], share: float) -> str:
    """The plot of :func:`ranges_figure` as the text of an SVG file."""
    stream = io.StringIO()
    with matplotlib.rc_context(_STYLE):
        figure = ranges_figure(garment, found, trials, share)
        figure.savefig(stream, format="svg", metadata={"Date": None, "Creator": None})
    return stream.getvalue()


def _draw(axes: Axes, p: IntrinsicParameter, found: FoundRange, trials: Sequence[Trial], share: float) -> None:
    values = [t.value for t in trials] + [found.low, found.high, found.base]
    low, high = found.narrowed(share)
    if p.logarithmic and min(values) > 0.0:
        axes.set_xscale("log")
        axes.xaxis.set_major_locator(LogLocator(numticks=6))
        axes.xaxis.set_minor_locator(NullLocator())
        axes.xaxis.set_minor_formatter(NullFormatter())
        widen = max((max(values) / min(values)) ** 0.04, 1.01)
        axes.set_xlim(min(values) / widen, max(values) * widen)
    else:
        axes.xaxis.set_major_locator(MaxNLocator(5, integer=p.integer))
        widen = 0.04 * max(max(values) - min(values), 1e-9)
        axes.set_xlim(min(values) - widen, max(values) + widen)
    axes.xaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:.3g}"))
    axes.barh(0.0, found.high - found.low, 1.0, left=found.low, color=INTERVAL, zorder=1)
    axes.barh(0.0, high - low, 0.34, left=low, color=DRAWN, zorder=2)
    for held, marker, colour in ((True, "o", HELD), (False, "x", BROKEN)):
        some = [t.value for t in trials if (t.outcome.cause is None) == held]
        axes.plot(some, [0.0] * len(some), marker, color=colour, ms=4.0, mew=1.3, lw=0, zorder=4, clip_on=False)
    axes.plot([found.base] * 2, [-0.75, 0.75], color="black", lw=1.1, zorder=3)
    axes.set_ylim(-0.8, 0.8)
    axes.set_yticks([])
    axes.tick_params(axis="x", length=2.5, pad=1.5, labelsize=7)
    unit = "" if p.unit == "1" else f" [{p.unit.replace('^2', '²').replace('^3', '³')}]"
    axes.annotate(
        f"{p.name.replace('_', ' ')}{unit}", (0.0, 0.5), (-172, 0), "axes fraction", "offset points", va="center"
    )
    side = {"textcoords": "offset points", "xycoords": "axes fraction", "va": "center", "fontsize": 7.5}
    for way, end, stop in (("right", 0.0, found.low_stop), ("left", 1.0, found.high_stop)):
        colour = "0.45" if stop is None else BROKEN
        axes.annotate(_cause(stop), (end, 0.5), (-6 if end == 0.0 else 6, 0), ha=way, color=colour, **side)


def _cause(stop: Outcome | None) -> str:
    if stop is None:
        return "limit"
    return _CAUSES.get(stop.cause or "", CRITERIA.get(stop.cause or "", (stop.cause or "", ""))[0])


def _legend(figure: Figure, share: float, height: float) -> None:
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    marks = [
        Line2D([], [], marker="o", color=HELD, lw=0, ms=4, label="held"),
        Line2D([], [], marker="x", color=BROKEN, lw=0, ms=4.5, mew=1.3, label="did not hold"),
        Patch(color=INTERVAL, label="found range"),
        Patch(color=DRAWN, label=f"drawn from ({share:.0%})"),
        Line2D([], [], color="black", lw=1.1, label="base value"),
    ]
    figure.legend(handles=marks, loc="center left", bbox_to_anchor=(0.0, height), ncols=5, frameon=False, fontsize=8)
