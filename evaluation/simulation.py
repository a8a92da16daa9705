"""Summary of simulated data from the quality figures that every sequence carries.

In: plain dictionaries, one a kept sequence and one a dropped simulation. Out: rows for the table of the data set.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Mapping, Sequence

import numpy as np

from evaluation.table import Row

# figure of a sequence -> (column, factor, reduction); quantiles are over sequences.
_FIGURES = (
    ("p99_edge_strain", "p99_edge_strain_median_percent", 100.0, np.median),
    ("p99_edge_strain", "p99_edge_strain_max_percent", 100.0, np.max),
    ("max_edge_strain", "max_edge_strain_percent", 100.0, np.max),
    ("deepest_penetration_m", "deepest_penetration_median_mm", 1e3, np.median),
    ("deepest_penetration_m", "deepest_penetration_max_mm", 1e3, np.max),
    ("vertices_inside", "vertices_inside_max", 1.0, np.max),
    ("triangles_inside_sampled", "triangles_inside_sampled_max", 1.0, np.max),
    ("pinched_vertices", "pinched_vertices_max", 1.0, np.max),
    ("pinched_frames", "pinched_frames_mean", 1.0, np.mean),
    ("longest_pinch_frames", "longest_pinch_max_frames", 1.0, np.max),
    ("crossing_pairs", "crossing_pairs_max", 1.0, np.max),
    ("crossing_frames", "crossing_frames_mean", 1.0, np.mean),
    ("residual_speed_m_s", "residual_speed_max_mm_s", 1e3, np.max),
    ("substeps", "substeps_median", 1.0, np.median),
    ("seconds_per_frame", "time_a_frame_median_s", 1.0, np.median),
    ("seconds_per_frame", "time_a_frame_p95_s", 1.0, lambda values: np.percentile(values, 95)),
)


def simulation_rows(kept: Sequence[Mapping], dropped: Sequence[Mapping]) -> list[Row]:
    """One row a garment and plan, in order of first appearance.

    Args:
        kept: One mapping a sequence: ``garment``, ``plan``, ``phi``, ``clip``, ``frames``, ``body_index`` where there
            are several bodies, and any quality figures by the names of the simulation's result (``p99_edge_strain``,
            ``deepest_penetration_m``, ...).
        dropped: One mapping a given-up simulation: ``garment``, ``plan``, ``reason``, ``attempts``.

    Returns:
        Rows with counts, the dropped simulations by reason and the quality figures that the sequences carry.
    """
    rows = []
    for garment, plan in dict.fromkeys((m["garment"], m["plan"]) for m in (*kept, *dropped)):
        mine = [m for m in kept if (m["garment"], m["plan"]) == (garment, plan)]
        lost = [m for m in dropped if (m["garment"], m["plan"]) == (garment, plan)]
        reasons = Counter(reason_class(str(m["reason"])) for m in lost)
        row: Row = {
            "garment": garment,
            "plan": plan,
            "sequences": len(mine),
            "frames": int(sum(m["frames"] for m in mine)),
            "parameter_sets": len({m["phi"] for m in mine}),
            "bodies": len({m.get("body_index", 0) for m in mine}),
            "clips": len({m["clip"] for m in mine}),
            "dropped": len(lost),
            "dropped_percent": 100.0 * len(lost) / (len(mine) + len(lost)),
            "dropped_reasons": "; ".join(f"{count} x {reason}" for reason, count in reasons.most_common()),
            "retried": sum(m.get("attempts", 1) > 1 for m in mine),
        }
        for figure, column, factor, reduce in _FIGURES:
            values = np.array([m[figure] for m in mine if m.get(figure) is not None], dtype=np.float64)
            row[column] = float(factor * reduce(values)) if len(values) else None
        rows.append(row)
    return rows


def reason_class(reason: str) -> str:
    """A failure's sentence without its numbers, so that equal failures count together."""
    return re.sub(r"\s+", " ", re.sub(r"(?<![A-Za-z0-9])[-+]?\d+(\.\d+)?([eE][-+]?\d+)?", "N", reason)).strip()
