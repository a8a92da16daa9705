"""The figures of a cleanliness survey, gathered by clip and laid out as a table by garment and motion label."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field

import numpy as np

FIGURES: dict[str, str] = {
    "vertices": "vertices inside the body",
    "triangles": "triangles that cross the body or lie inside it",
    "deepest_mm": "deepest point of them [mm]",
    "pinched_vertices": "vertices inside where the body is closed to cloth",
    "pinched_triangles": "triangles there",
    "pinched_deepest_mm": "deepest point of them [mm]",
    "hand_vertices": "vertices inside the hands, which are left out of contact",
    "hand_triangles": "triangles that cross the hands or lie inside them",
    "self_pairs": "pairs of triangles of the garment that cross",
    "pinched_self_pairs": "those of them where the body is closed to cloth",
    "p99_strain": "99th percentile of the edges' strain",
    "max_strain": "largest strain of an edge",
    "place": "joint that carries the body at the deepest fault",
}
"""Figures of one frame."""


@dataclass
class ClipReport:
    """One garment on one clip.

    Attributes:
        garment: Name of the garment.
        vertex_count: Its vertices.
        clip: Name of the clip.
        label: Class of the motion.
        failure: Why the simulation failed, None when it ran to its end; a failed one has no frames.
        frames: Figures of every recorded frame, by the names of ``FIGURES``.
        positions: Simulated vertices [m], shape [T, V, 3], while they are needed.
    """

    garment: str
    vertex_count: int
    clip: str
    label: str
    failure: str | None = None
    frames: dict[str, list] = field(default_factory=lambda: {name: [] for name in FIGURES})
    positions: np.ndarray | None = None

    def add(self, **figures: float | str) -> None:
        """Add the figures of the next frame: all of ``FIGURES``."""
        if figures.keys() != FIGURES.keys():
            raise ValueError(f"figures of a frame: expected {', '.join(FIGURES)}, got {', '.join(figures)}")
        for name, value in figures.items():
            self.frames[name].append(value)

    def worst_frame(self, *names: str) -> int:
        """The frame where the first figure is largest; the others break ties."""
        return int(np.lexsort([np.asarray(self.frames[name]) for name in names[::-1]])[-1])

    def as_dict(self) -> dict:
        """What JSON can hold."""
        return {
            "garment": self.garment,
            "vertices": self.vertex_count,
            "clip": self.clip,
            "label": self.label,
            "failure": self.failure,
            "frames": self.frames,
        }


_HEAD = (
    ("", ("label", "frames")),
    ("inside the body", ("V worst", "V mean", "T worst", "T mean", "mm")),
    ("pinched", ("V worst", "V mean", "T worst", "T mean", "mm")),
    ("hands", ("V worst", "T worst", "T mean")),
    ("self crossings", ("worst", "mean", "last", "pinched")),
    ("strain %", ("p99", "max")),
    ("", ("clean %",)),
)


def report_text(reports: Sequence[ClipReport], worst: int) -> str:
    """Tables by garment and label, totals, and the worst clips with the frame that is worst in each."""
    groups: dict[tuple[str, int], list[ClipReport]] = defaultdict(list)
    for report in reports:
        groups[report.garment, report.vertex_count].append(report)
    parts = []
    for (garment, count), members in groups.items():
        labels: dict[str, list[ClipReport]] = defaultdict(list)
        for report in members:
            labels[report.label].append(report)
        rows = [_row(label, labels[label]) for label in labels]
        parts.append(f"{garment}, {count} vertices\n" + _laid_out([*rows, _row("all", members)]))
    parts += [
        "V vertices and T triangles inside, per frame; clean: frames without any fault inside and self crossing.",
        _worst(reports, worst, "deepest in the body", ("deepest_mm", "triangles")),
        _worst(reports, worst, "most self crossings", ("self_pairs", "max_strain")),
    ]
    failures = [f"{r.garment} {r.vertex_count} on {r.clip}: {r.failure}" for r in reports if r.failure is not None]
    if failures:
        parts.append("\n".join(["failed:", *failures]))
    return "\n\n".join(part for part in parts if part)


def _row(label: str, reports: Iterable[ClipReport]) -> list[str]:
    """One line of the table: worst and mean over the frames of some clips."""
    done = [report for report in reports if report.failure is None]
    frames = {name: [v for r in done for v in r.frames[name]] for name in FIGURES}
    count = len(frames["vertices"])
    if count == 0:
        return [label, "failed"]

    def top(name: str, scale: float = 1.0, digits: int = 0) -> str:
        return f"{scale * max(frames[name]):.{digits}f}"

    def mean(name: str) -> str:
        return f"{np.mean(frames[name]):.2f}"

    clean = np.mean([t == 0 and s == 0 for t, s in zip(frames["triangles"], frames["self_pairs"])])
    cells = [label, str(count)]
    for kind in ("", "pinched_"):
        cells += [top(kind + "vertices"), mean(kind + "vertices"), top(kind + "triangles"), mean(kind + "triangles")]
        cells.append(top(kind + "deepest_mm", digits=1))
    cells += [top("hand_vertices"), top("hand_triangles"), mean("hand_triangles")]
    last = max(report.frames["self_pairs"][-1] for report in done)
    cells += [top("self_pairs"), mean("self_pairs"), str(last), top("pinched_self_pairs")]
    # The mean over frames of their 99th percentiles is near that of all edges and frames, and needs no positions.
    cells += [f"{100 * np.mean(frames['p99_strain']):.1f}", top("max_strain", 100.0, 1), f"{100 * clean:.0f}"]
    return cells


def _laid_out(rows: list[list[str]]) -> str:
    """Columns of equal width under two lines of headings."""
    names = [name for _, columns in _HEAD for name in columns]
    rows = [row + [""] * (len(names) - len(row)) for row in rows]
    widths = [max(len(name), *(len(row[k]) for row in rows)) for k, name in enumerate(names)]
    lines = ["", "", ""]
    start = 0
    for title, columns in _HEAD:
        mine = range(start, start + len(columns))
        width = sum(widths[k] for k in mine) + 2 * (len(columns) - 1)
        lines[0] += title.center(width) + " | "
        lines[1] += "  ".join(names[k].rjust(widths[k]) for k in mine) + " | "
        lines[2] += "-" * width + "-+-"
        start += len(columns)
    for row in rows:
        line, start = "", 0
        for _, columns in _HEAD:
            mine = range(start, start + len(columns))
            line += "  ".join(row[k].rjust(widths[k]) for k in mine) + " | "
            start += len(columns)
        lines.append(line)
    return "\n".join(line.rstrip(" |+-") if not line.startswith("-") else line[:-3] for line in lines)


def _worst(reports: Sequence[ClipReport], count: int, title: str, names: tuple[str, str]) -> str:
    """The clips whose worst frame is worst of all, by the first figure; empty when no clip has any."""
    found = []
    for report in reports:
        if report.failure is None:
            frame = report.worst_frame(*names)
            if report.frames[names[0]][frame] > 0:
                found.append((report, frame))
    found.sort(key=lambda entry: tuple(-entry[0].frames[name][entry[1]] for name in names))
    lines = [f"worst frames, {title}:"]
    for report, frame in found[:count]:
        at = {name: report.frames[name][frame] for name in FIGURES}
        lines.append(
            f"  {report.garment} {report.vertex_count} {report.clip} frame {frame}: {at['vertices']} vertices and "
            f"{at['triangles']} triangles inside, {at['deepest_mm']:.1f} mm deep{_at(at['place'])}; "
            f"{at['self_pairs']} self crossings ({at['pinched_self_pairs']} pinched), "
            f"strain at most {at['max_strain']:.0%}"
        )
    return "\n".join(lines) if found else ""


def _at(place: str) -> str:
    return f" at the {place.replace('_', ' ')}" if place else ""
