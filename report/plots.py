"""Charts of the page as inline SVG: transparent, in the page's own colours and fonts.

In: rows of tables. Out: an ``<svg>`` element as text. Text and lines that are drawn in ``INK`` take the colour of the
text around the chart, and the series colours are variables of the style sheet with a fallback, so that one picture
serves the light and the dark page. The palette is Okabe and Ito's, made for colour-blind readers.
"""

from __future__ import annotations

import io
import math
import re
from collections.abc import Sequence

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_svg import FigureCanvasSVG
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, MaxNLocator, NullFormatter, NullLocator

from evaluation.table import Row
from report.columns import is_number, significant

INK = "#7f7f81"
MUTED = "#7f7f82"
PALETTE = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#56b4e9", "#e69f00")
_STYLE = {
    "svg.fonttype": "none",
    "svg.hashsalt": "drapeline",
    "font.family": "sans-serif",
    "font.size": 9,
    "axes.titlesize": 9.5,
    "axes.titleweight": "bold",
    "axes.titlelocation": "left",
    "axes.edgecolor": INK,
    "axes.labelcolor": INK,
    "axes.titlecolor": INK,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.linewidth": 0.7,
    "text.color": INK,
    "xtick.color": INK,
    "ytick.color": INK,
    "xtick.major.width": 0.7,
    "ytick.major.width": 0.7,
    "legend.frameon": False,
    "lines.linewidth": 1.7,
    "axes.prop_cycle": matplotlib.cycler(color=list(PALETTE)),
}
WIDTH = 9.6
"""Width of a full chart [inch]; the page scales it to the column."""


def loss_curves(trainings: Sequence[tuple[str, Sequence[Row]]], key: str, columns: int = 4) -> str:
    """Small multiples, one a training: the loss that is minimised over epochs, training and validation, log scale.

    Args:
        trainings: (title, rows of ``losses.csv``), at least one.
        key: Name that makes the ids of the picture unique on the page.
        columns: Panels in a row.
    """
    with matplotlib.rc_context(_STYLE):
        lines = math.ceil(len(trainings) / columns)
        figure = _figure(WIDTH, 1.95 * lines + 0.35)
        for number, (title, rows) in enumerate(trainings):
            axes = figure.add_subplot(lines, columns, number + 1)
            for split, style in (("train", {"color": PALETTE[0]}), ("validation", {"color": PALETTE[1]})):
                points = [
                    (r["epoch"], r["total"]) for r in rows if r.get("split") == split and _positive(r.get("total"))
                ]
                if points:
                    # A single epoch is a point, not a line.
                    axes.plot(*zip(*points), label=split, marker="o" if len(points) < 4 else None, ms=3, **style)
            axes.set_title(title)
            axes.set_yscale("log")
            _log_axis(axes, "y")
            axes.margins(x=0.02)
            axes.xaxis.set_major_locator(MaxNLocator(4, integer=True, min_n_ticks=1))
            if number >= len(trainings) - columns:
                axes.set_xlabel("epoch")
        _legend(figure)
        return svg(figure, f"loss-{key}")


def method_bars(rows: Sequence[Row], value: str, unit: str, group: str = "garment", label: str = "method") -> str:
    """Horizontal bars of one figure by method, one panel a group, references in grey."""
    from report.tables import is_reference

    groups = list(dict.fromkeys(str(r.get(group) or "") for r in rows))
    with matplotlib.rc_context(_STYLE):
        most = max(sum(str(r.get(group) or "") == g for r in rows) for g in groups)
        figure = _figure(WIDTH, 0.27 * most + 0.75)
        for number, name in enumerate(groups):
            mine = [r for r in rows if str(r.get(group) or "") == name and _positive(r.get(value))]
            axes = figure.add_subplot(1, len(groups), number + 1)
            colours = [MUTED if is_reference(r) else _method_colour(str(r[label])) for r in mine]
            values = [float(r[value]) for r in mine]
            _bars(axes, [str(r[label]) for r in mine], values, colours)
            axes.set_title(name)
            axes.set_xlabel(unit)
        return svg(figure, f"bars-{value}")


def dimension_curves(rows: Sequence[Row], value: str, unit: str, dimension: str, method: str = "method") -> str:
    """Error against the number of dimensions, or of what the column counts: a line a method, a marker for one size."""
    panels = list(dict.fromkeys((r.get("garment"), r.get("split")) for r in rows))
    methods = list(dict.fromkeys(_family(r, method, dimension) for r in rows))
    columns = min(len(panels), 4)
    with matplotlib.rc_context(_STYLE):
        lines = math.ceil(len(panels) / columns)
        figure = _figure(WIDTH, 2.3 * lines + 0.4)
        for number, panel in enumerate(panels):
            axes = figure.add_subplot(lines, columns, number + 1)
            for k, name in enumerate(methods):
                points = sorted(
                    (r[dimension], r[value])
                    for r in rows
                    if (r.get("garment"), r.get("split")) == panel
                    and _family(r, method, dimension) == name
                    and is_number(r.get(dimension))
                    and _positive(r.get(value))
                )
                if points:
                    line = {"marker": "o", "ms": 3.5} if len(points) > 1 else {"marker": "D", "ms": 6, "ls": ""}
                    axes.plot(*zip(*points), label=name, color=PALETTE[k % len(PALETTE)], **line)
            axes.set_title(" · ".join(str(p).replace("_", " ") for p in panel if p))
            axes.set_xlabel(dimension if dimension.endswith("s") else f"{dimension}s")
            if number % columns == 0:
                axes.set_ylabel(unit)
            axes.set_ylim(bottom=0)
        _legend(figure, columns=3)
        return svg(figure, f"{dimension}-{value}")


def timing_bars(rows: Sequence[Row], value: str = "median_s_per_frame", label: str = "solver") -> str:
    """Seconds a frame on a log scale, one panel a garment; times from other hardware in grey."""
    from report.tables import is_reference

    groups = list(dict.fromkeys(str(r.get("garment") or "") for r in rows))
    with matplotlib.rc_context(_STYLE):
        most = max(sum(str(r.get("garment") or "") == g for r in rows) for g in groups)
        figure = _figure(WIDTH, (0.27 * most + 0.7) * len(groups))
        for number, name in enumerate(groups):
            mine = [r for r in rows if str(r.get("garment") or "") == name and _positive(r.get(value))]
            axes = figure.add_subplot(len(groups), 1, number + 1)
            colours = [MUTED if is_reference(r) else _solver_colour(str(r[label])) for r in mine]
            values = [float(r[value]) for r in mine]
            axes.set_xscale("log")
            _bars(axes, [str(r[label]) for r in mine], values, colours, unit=_readable_time)
            _log_axis(axes, "x", _readable_time)
            axes.set_xlim(left=10 ** math.floor(math.log10(min(values, default=1))) / 2)
            axes.set_title(name)
        return svg(figure, "timing")


def recovery_bars(rows: Sequence[Row], value: str, parameter: str = "parameter") -> str:
    """R² of each recovered parameter, one panel a garment, one bar a variant."""
    garments = list(dict.fromkeys(str(r.get("garment") or "") for r in rows))
    names = list(dict.fromkeys(str(r[parameter]) for r in rows))
    series = list(dict.fromkeys(_series(r, (value, parameter, "garment")) for r in rows))
    with matplotlib.rc_context(_STYLE):
        figure = _figure(WIDTH, 0.34 * len(names) + 0.9)
        for number, garment in enumerate(garments):
            axes = figure.add_subplot(1, len(garments), number + 1)
            height = 0.8 / len(series)
            for k, name in enumerate(series):
                found = {
                    str(r[parameter]): float(r[value])
                    for r in rows
                    if str(r.get("garment") or "") == garment
                    and _series(r, (value, parameter, "garment")) == name
                    and is_number(r.get(value))
                }
                place = [i + (k - (len(series) - 1) / 2) * height for i, n in enumerate(names) if n in found]
                # Far below nought says no more than "not recovered".
                shown = [max(found[n], -0.25) for n in names if n in found]
                axes.barh(place, shown, height * 0.88, color=PALETTE[k % len(PALETTE)], label=name or None)
            axes.set_yticks(range(len(names)), [n.replace("_", " ") for n in names] if number == 0 else [])
            axes.invert_yaxis()
            axes.axvline(0, color=INK, lw=0.7)
            axes.set_xlim(-0.27, 1.0)
            axes.tick_params(axis="y", length=0)
            axes.set_title(garment)
            axes.set_xlabel("R² (1 = recovered, 0 = no better than the mean)")
        _legend(figure, columns=4)
        return svg(figure, "recovery")


def svg(figure: Figure, prefix: str) -> str:
    """The figure as an inline ``<svg>``: ids made unique by the prefix, ink taken from the surrounding text."""
    stream = io.StringIO()
    FigureCanvasSVG(figure)
    figure.savefig(stream, format="svg", transparent=True, metadata={"Date": None, "Creator": None})
    text = stream.getvalue()
    text = text[text.index("<svg") :]
    text = re.sub(r"<metadata>.*?</metadata>", "", text, flags=re.DOTALL)
    text = re.sub(r'xmlns:xlink="[^"]*"', "", text).replace("xlink:href", "href")
    prefix = re.sub(r"[^a-z0-9]+", "-", prefix.lower()).strip("-")
    text = re.sub(r'(\bid=")', rf"\g<1>{prefix}-", text)
    text = re.sub(r'(href="#|url\(#)', rf"\g<1>{prefix}-", text)
    text = re.sub(r'<svg[^>]*?viewBox="([^"]*)"[^>]*>', r'<svg class="plot" viewBox="\1" role="img" xmlns="http://www.w3.org/2000/svg">', text, count=1)  # fmt: skip  # noqa: E501
    text = text.replace("font: 9px sans-serif", "font: 9px var(--sans, sans-serif)")
    text = re.sub(r"(?<=[\d ])'?sans-serif'?(?=[;\"])", "var(--sans, sans-serif)", text)
    text = text.replace(INK, "currentColor").replace(MUTED, "var(--muted-bar, #9a9a9c)")
    for number, colour in enumerate(PALETTE, start=1):
        text = text.replace(colour, f"var(--c{number}, {colour})")
    return text


def _figure(width: float, height: float) -> Figure:
    return Figure(figsize=(width, height), layout="constrained")


def _log_axis(axes: Axes, which: str, text=significant) -> None:
    """Few ticks with plain numbers on a logarithmic axis, at 1, 2 and 5 where it spans little."""
    axis = axes.xaxis if which == "x" else axes.yaxis
    low, high = axes.get_xlim() if which == "x" else axes.get_ylim()
    span = high / max(low, 1e-300)
    axis.set_minor_locator(NullLocator())
    axis.set_minor_formatter(NullFormatter())
    if span < 8:
        # Less than a decade: evenly spaced values tell more than powers.
        axis.set_major_locator(MaxNLocator(3))
        axis.set_major_formatter(FuncFormatter(lambda v, _: f"{v:.3g}"))
        return
    axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0) if span < 30 else (1.0,), numticks=6))
    axis.set_major_formatter(FuncFormatter(lambda v, _: text(v, 1)))


def _bars(axes: Axes, names: list[str], values: list[float], colours: list[str], unit=significant) -> None:
    place = np.arange(len(names))
    axes.barh(place, values, 0.68, color=colours)
    axes.set_yticks(place, names)
    axes.invert_yaxis()
    axes.tick_params(axis="y", length=0)
    axes.spines["left"].set_visible(False)
    for i, value in enumerate(values):
        axes.annotate(unit(value), (value, i), xytext=(4, 0), textcoords="offset points", va="center", fontsize=8)
    if values:
        log = axes.get_xscale() == "log"
        axes.set_xlim(right=max(values) * (4.0 if log else 1.18))


def _legend(figure: Figure, columns: int = 4) -> None:
    """One legend for all panels, above them."""
    found = {}
    for axes in figure.axes:
        for handle, label in zip(*axes.get_legend_handles_labels()):
            found.setdefault(label, handle)
    if found:
        figure.legend(found.values(), found.keys(), loc="outside upper right", ncols=columns, fontsize=8.5)


def _method_colour(name: str) -> str:
    if "regressor" in name:
        return PALETTE[1] if "tuned" in name else PALETTE[0]
    return PALETTE[4]


def _solver_colour(name: str) -> str:
    if "XPBD" in name:
        return PALETTE[2]
    return PALETTE[5] if "implicit" in name else PALETTE[0]


def _family(row: Row, method: str, dimension: str) -> str:
    """A method's name without its size, so that PCA-10 and PCA-50 make one line."""
    return re.sub(rf"[-\s(]*\b{row.get(dimension)}\b\)?", "", str(row.get(method))).strip()


def _series(row: Row, other: tuple[str, ...]) -> str:
    names = [n for n in ("variant", "method") if n not in other and row.get(n) not in (None, "")]
    return " · ".join(str(row[n]).replace("_", " ") for n in names)


def _positive(value: object) -> bool:
    return is_number(value) and math.isfinite(value) and value > 0


def _readable_time(seconds: float, digits: int = 3) -> str:
    # Rounded first, so that a tick at a rounding error below 1 ms reads 1 ms.
    seconds = float(f"{seconds:.6g}")
    for unit, size in (("s", 1.0), ("ms", 1e-3)):
        if seconds >= size:
            return f"{significant(seconds / size, digits)} {unit}"
    return f"{significant(1e6 * seconds, digits)} µs"
