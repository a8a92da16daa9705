"""What a column of a table is called on the page, which way is better, and how its numbers are written.

A column's unit is the end of its name, as the evaluation writes it: ``rmse_mm`` becomes "RMSE [mm]".
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence

from evaluation.table import Cell

LOWER, HIGHER = -1, 1

# Longest first: the first that fits the end of a name is its unit.
_UNITS = (
    ("_s_per_frame", "s/frame"),
    ("_ms_per_frame", "ms/frame"),
    ("_frames_per_s", "frames/s"),
    ("_percent", "%"),
    ("_mm_s", "mm/s"),
    ("_m_s3", "m/s³"),
    ("_m_s2", "m/s²"),
    ("_m_s", "m/s"),
    ("_cm_s", "cm/s"),
    ("_rad_s3", "rad/s³"),
    ("_rad_s", "rad/s"),
    ("_mm", "mm"),
    ("_cm", "cm"),
    ("_ms", "ms"),
    ("_mb", "MB"),
    ("_gb", "GB"),
    ("_m", "m"),
    ("_s", "s"),
)
_WORDS = {
    "rmse": "RMSE",
    "sted": "STED",
    "kg": "KG",
    "fid": "FID",
    "pca": "PCA",
    "cvae": "CVAE",
    "r2": "R²",
    "phi": "φ",
    "z": "z",
    "xpbd": "XPBD",
    "p50": "p50",
    "p95": "p95",
    "p99": "p99",
    "hausdorff": "Hausdorff",
    "laplacian": "Laplacian",
}
_TITLES = {
    "fid_against": "FID against",
    "hausdorff_every_frames": "Hausdorff: every n-th frame",
    "mean_vertex_mm": "Mean vertex error [mm]",
    "normal_cosine": "Normal cosine distance",
    "collision_rate_vertex_percent": "Collisions, nearest vertex [%]",
    "collision_rate_percent": "Collisions [%]",
    "collision_rate_1mm_percent": "Collisions below 1 mm [%]",
    "deepest_mm": "Deepest [mm]",
    "all_frames_collision_rate_percent": "Collisions [%]",
    "all_frames_deepest_mm": "Deepest [mm]",
    "refinement_laplacian_percent": "Refinement: change of the Laplacian [%]",
    "last_tenth_over_first": "Last tenth over first",
    "refined_collision_rate_percent": "Refined: collisions [%]",
    "refined_collision_rate_1mm_percent": "Refined: below 1 mm [%]",
    "refined_deepest_mm": "Refined: deepest [mm]",
    "refined_rmse_mm": "Refined: RMSE [mm]",
    "refinement_largest_move_mm": "Refinement: largest move [mm]",
    "refinement_projected_percent": "Refinement: projected [%]",
    "max_rss": "Peak memory [MB]",
    "discontinuous_percent": "Discontinuous [%]",
    "r_squared": "R²",
    "phi_count": "Parameter sets",
    "laplacian_rmse_mm": "Laplacian RMSE [mm]",
    "p95_frame_rmse_mm": "95th percentile of frames [mm]",
    "source": "Source",
}
_LOWER = re.compile(
    r"rmse|mean_vertex|hausdorff|^sted|kg_error|normal_cosine|collision|deepest|penetration|inside|error|fid$"
    r"|discontinu|variance_ratio|^ratio$|strain_|edge_strain|residual_speed|dropped_percent|s_per_frame$|ms_per_frame$"
    r"|^depth_|chamfer|jerk|skate|^mean_mm$|_ratio$"
)
_HIGHER = re.compile(r"(^|_)r2(_|$)|^r_squared$|accuracy|frames_per_s$|explained|speed_?up")
# Settings, counts and what is neither good nor bad; their names may hold a word of the above.
_NEITHER = re.compile(
    r"parameters$|every_|stride|^frames$|sequences|motions$|projected|largest_move|retried|substeps|count$|_interval$"
    r"|against$|dimension|vertices$|before|moved"
)


def column_title(name: str) -> str:
    """Readable header of a column, with its unit in brackets."""
    if name in _TITLES:
        return _TITLES[name]
    stem, unit = split_unit(name)
    words = [_WORDS.get(word, word) for word in stem.split("_")]
    text = " ".join(words)
    text = text[:1].upper() + text[1:] if words[0] not in _WORDS.values() else text
    return f"{text} [{unit}]" if unit else text


def split_unit(name: str) -> tuple[str, str]:
    """Column name without its unit, and the unit; an empty unit for a ratio, a count or a text."""
    for ending, unit in _UNITS:
        if name.endswith(ending) and len(name) > len(ending):
            return name[: -len(ending)], unit
    return name, ""


def better(name: str) -> int:
    """``LOWER`` or ``HIGHER`` for a column in which that is better, 0 where neither is."""
    if _NEITHER.search(name):
        return 0
    if _HIGHER.search(name):
        return HIGHER
    return LOWER if _LOWER.search(name) else 0


def is_number(value: Cell) -> bool:
    """True for integers and floats, not for truth values."""
    return isinstance(value, int | float) and not isinstance(value, bool)


def format_column(values: Sequence[Cell], like: Sequence[Cell] | None = None) -> list[str]:
    """Cells of one column as text: about three significant digits, decimals aligned unless values span decades.

    ``like`` names the values that choose the decimals, by default the column itself.
    """
    chosen = values if like is None else like
    numbers = [abs(float(v)) for v in chosen if is_number(v) and math.isfinite(v) and v != 0]
    # What is nought but for rounding says nothing of how the others are to be written.
    numbers = [n for n in numbers if n > 1e-6 * max(numbers)]
    whole = all(isinstance(v, int) for v in chosen if is_number(v))
    spread = bool(numbers) and max(numbers) / min(numbers) > 100
    decimals = 0
    if numbers and not whole and not spread:
        typical = sorted(numbers)[len(numbers) // 2]
        decimals = min(max(2 - math.floor(math.log10(typical)), 0), 7)
    return [_format(v, decimals, whole, spread) for v in values]


def _format(value: Cell, decimals: int, whole: bool, spread: bool) -> str:
    if value is None:
        return "–"
    if isinstance(value, bool):
        return "yes" if value else "no"
    if isinstance(value, str):
        return value
    if not math.isfinite(value):
        return "–"
    if whole and isinstance(value, int):
        return f"{value:,}".replace(",", "\u202f")
    if spread:
        return significant(value)
    return f"{value:.{decimals}f}".replace("-", "−")


def significant(value: float, digits: int = 3) -> str:
    """A number with that many significant digits, without an exponent where it stays readable."""
    if value == 0 or not math.isfinite(value):
        return "0" if value == 0 else "–"
    exponent = math.floor(math.log10(abs(value)))
    if -5 <= exponent < 7:
        text = f"{value:,.{max(digits - 1 - exponent, 0)}f}".replace(",", "\u202f")
    else:
        mantissa = value / 10.0**exponent
        text = f"{mantissa:.{digits - 1}f}·10{str(exponent).translate(str.maketrans('-0123456789', '⁻⁰¹²³⁴⁵⁶⁷⁸⁹'))}"
    return text.replace("-", "−")


def readable_seconds(seconds: float) -> str:
    """A duration as a person says it."""
    if seconds < 1:
        return f"{1e3 * seconds:.0f} ms"
    if seconds < 60:
        return f"{seconds:.1f} s"
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours} h {minutes:02d} min" if hours else f"{minutes} min {rest:02d} s"
