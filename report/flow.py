"""The way of the data through a run as an inline SVG, each station with its count."""

from __future__ import annotations

from collections.abc import Mapping
from html import escape

BOX = (186, 60)
STEP = (212, 92)
# name -> (column, row, title); what stands below the title comes from the run.
_STATIONS = {
    "parameters": (0, 0, "Parameter sets"),
    "garments": (0, 1, "Garments"),
    "motions": (0, 2, "Motions"),
    "simulation": (1, 1, "XPBD simulation"),
    "shards": (2, 1, "Shards"),
    "shape_descriptor": (3, 0, "Shape descriptor"),
    "garment_regressor": (3, 1, "Garment regressor"),
    "motion_cvae": (3, 2, "Motion CVAE"),
    "motion_invariant": (4, 0, "Motion-invariant AE"),
    "collision_tuning": (4, 1, "Collision tuning"),
    "animation": (4, 2, "Clothed animation"),
}
_ARROWS = (
    ("parameters", "simulation"),
    ("garments", "simulation"),
    ("motions", "simulation"),
    ("simulation", "shards"),
    ("shards", "shape_descriptor"),
    ("shards", "garment_regressor"),
    ("motions", "motion_cvae"),
    ("shape_descriptor", "motion_invariant"),
    ("garment_regressor", "collision_tuning"),
    ("motion_cvae", "collision_tuning"),
    ("collision_tuning", "animation"),
    ("motion_cvae", "animation"),
)


def flow_diagram(counts: Mapping[str, str]) -> str:
    """SVG of the stations; ``counts`` maps a station's name to the line below its title."""
    width, height = 4 * STEP[0] + BOX[0] + 4, 2 * STEP[1] + BOX[1] + 4
    parts = [
        f'<svg class="flow" viewBox="-2 -2 {width} {height}" role="img" xmlns="http://www.w3.org/2000/svg">',
        "<title>From parameter sets, garments and motions to simulated shards, trained models and clothed "
        "animations</title>",
        '<defs><marker id="flow-head" viewBox="0 0 8 8" refX="7" refY="4" markerWidth="7" markerHeight="7" '
        'orient="auto"><path d="M0 0.8 7 4 0 7.2z" fill="currentColor"/></marker></defs>',
    ]
    parts += [f'<path class="arrow" d="{_path(a, b)}" marker-end="url(#flow-head)"/>' for a, b in _ARROWS]
    for name, (_, _, title) in _STATIONS.items():
        x, y = _corner(name)
        parts.append(
            f'<g class="station {"model" if x > 2 * STEP[0] else "data"}"><rect x="{x}" y="{y}" width="{BOX[0]}" '
            f'height="{BOX[1]}" rx="9"/><text class="name" x="{x + 14}" y="{y + 25}">{title}</text>'
            f'<text class="count" x="{x + 14}" y="{y + 45}">{escape(counts.get(name, ""))}</text></g>'
        )
    return "".join(parts) + "</svg>"


def _corner(name: str) -> tuple[int, int]:
    column, row, _ = _STATIONS[name]
    return column * STEP[0], row * STEP[1]


def _path(start: str, end: str) -> str:
    """From the right side of one box to the left side of another; straight down or up inside a column."""
    (x0, y0), (x1, y1) = _corner(start), _corner(end)
    if x0 == x1:
        x, down = x0 + BOX[0] // 2, y1 > y0
        return f"M{x} {y0 + (BOX[1] if down else 0)}V{y1 - 4 if down else y1 + BOX[1] + 4}"
    a, b, c = x0 + BOX[0], y0 + BOX[1] // 2, y1 + BOX[1] // 2
    if abs(y1 - y0) == 0:
        return f"M{a} {b}H{x1 - 3}"
    middle = (a + x1) / 2
    # Arrows that meet at one box end a little apart.
    c += 16 if y0 > y1 else -16
    return f"M{a} {b}C{middle} {b} {middle} {c} {x1 - 3} {c}"
