"""Captions: simulated data, what was dropped, and the parameters it was made with."""

from __future__ import annotations

from report.captions.caption import Caption, made_by

CAPTIONS: dict[str, Caption] = {
    "simulation": Caption(
        "Simulated data",
        "One row a garment and plan. Strain is the change of an edge's length against the template; penetration and "
        "time are those of the simulator. Pinched: vertices that the body leaves no room for, in the worst frame. "
        "Crossing pairs: of triangles of the garment, in the worst frame.",
        "Wang 2019, section 4; Shi 2023, section 4.1 (data sets).",
        made_by("evaluate_simulation", "evaluation/simulation.py", "simulation"),
        "All splits together.",
        (
            "garment",
            "plan",
            "sequences",
            "frames",
            "parameter_sets",
            "bodies",
            "clips",
            "dropped",
            "retried",
            "p99_edge_strain_median_percent",
            "p99_edge_strain_max_percent",
            "deepest_penetration_max_mm",
            "pinched_vertices_max",
            "crossing_pairs_max",
            "residual_speed_max_mm_s",
            "time_a_frame_median_s",
        ),
    ),
    "dropped": Caption(
        "Dropped simulations",
        "Each with the reason of its last attempt.",
        made=made_by("evaluate_simulation", "evaluation/simulation.py", "dropped"),
        columns=("garment", "plan", "clip", "label", "phi", "attempts", "reason"),
    ),
    "ranges": Caption(
        "Intrinsic parameters",
        "Drawn once for each parameter set, fixed for a whole simulation, stored with it. The base values are those of "
        "the motions plan.",
        "Wang 2019, section 4 (three groups of parameters).",
        "configuration → sim/parameters.py",
    ),
    "pictures_material": Caption(
        "One motion, several materials",
        "The frame in which three parameter sets of a clip differ most.",
        "Wang 2019, section 4 (data set).",
        "render → pipeline/render.py",
    ),
    "pictures_contact": Caption("Sequences of the data", made="render → pipeline/render.py"),
}
