"""Whether a simulation is ground truth: its quality figures against the bounds of the configuration."""

from __future__ import annotations

from collections.abc import Mapping


def out_of_bounds(quality: Mapping[str, float], bounds: Mapping[str, float], vertex_count: int) -> str | None:
    """The first quality figure outside its bound, in one sentence; None when all are inside.

    Counts are held against bounds of counts a vertex. Crossings are judged where they were counted, with self-contact.
    """
    figures = (
        ("p99_edge_strain", quality["p99_edge_strain"], "p99 edge strain", ""),
        ("penetration", quality["deepest_penetration_m"], "penetration", " m"),
        ("vertices_inside", quality["vertices_inside"] / vertex_count, "share of vertices inside the body", ""),
        (
            "triangles_inside",
            quality["triangles_inside_sampled"] / vertex_count,
            "triangles inside the body",
            " a vertex",
        ),
        ("pinched_vertices", quality["pinched_vertices"] / vertex_count, "share of vertices that are pinched", ""),
        ("crossing_pairs", quality.get("crossing_pairs", 0.0) / vertex_count, "crossing pairs", " a vertex"),
        ("residual_speed", quality["residual_speed_m_s"], "residual speed", " m/s"),
    )
    for key, value, name, unit in figures:
        if not value <= bounds[key]:
            return f"{name} {value:.3g}{unit} above {bounds[key]:g}{unit}"
    return None
