"""Captions: collision tuning and refinement."""

from __future__ import annotations

from report.captions.caption import Caption, made_by

CAPTIONS: dict[str, Caption] = {
    "collision_tuning": Caption(
        "Collision tuning",
        "On generated motions. Motions with heavy interpenetration are left out of the tuning: inside and depth are of "
        "those kept, by the nearest body vertex. Untuned, tuned and refined are of all motions, by exact distances.",
        "Shi 2023, section 3.4 and Figure 10.",
        "fine_tune_regressor → models/collision_tuning.py → tables/collision_tuning.csv",
        "Generated motions, no ground truth.",
    ),
    "refinement": Caption(
        "Before and after refinement",
        "Share of vertices inside the body, or nearer than 1 mm, and the deepest one, before and after the refinement; "
        "its cost in error against the truth.",
        "Wang 2019, section 3.5; Shi 2023, Figure 10.",
        made_by("evaluate_garment_regressor", "models/refinement.py", "garment_regressor"),
        "Motions that nobody trained on, every vertex in every frame.",
        (
            "garment",
            "split",
            "method",
            "all_frames_collision_rate_percent",
            "refined_collision_rate_percent",
            "all_frames_deepest_mm",
            "refined_deepest_mm",
            "rmse_mm",
            "refined_rmse_mm",
            "refinement_laplacian_percent",
        ),
    ),
    "pictures_refined": Caption(
        "A frame before and after refinement",
        "The frame with the most vertices inside the body, of all motions shown.",
        "Wang 2019, section 3.5.",
        "render → pipeline/render.py",
    ),
}
