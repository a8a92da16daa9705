"""Figures that the papers print, to hold beside ours. All are on other data and other machines: orientation only.

Sources: Shi, Feng, Gao, Zhu 2023, "Generating diverse clothed 3D human animations via a generative model" (Tables 2,
3, 4, 6, 9); Peng et al. 2023, "GSNet" (Table 1); Wang, Shao, Fu, Mitra 2019, "Learning an Intrinsic Garment Space"
(section on speed). Units are converted to those of our tables.
"""

from __future__ import annotations

from evaluation.table import Row


def _regressors(source: str, data: str, *rows: tuple) -> list[Row]:
    names = ("method", "rmse_mm", "hausdorff_mm", "sted", "normal_cosine")
    return [{"source": source, "data": data} | dict(zip(names, row)) for row in rows]


REGRESSORS: list[Row] = [
    *_regressors(
        "Shi 2023, Table 6",
        "dress03 of Pan 2022",
        ("Wang 2019", 17.825, 51.03, 0.10730, 0.3383),
        ("Pan 2022", 6.487, 41.65, 0.07805, 0.1904),
        ("Shi 2023", 4.834, 25.21, 0.06394, 0.1695),
    ),
    *_regressors(
        "Shi 2023, Table 9",
        "their own",
        ("fixed start token", 9.535, 71.68, 0.06263, 0.1197),
        ("learnable start token", 3.384, 38.58, 0.06158, 0.1073),
    ),
]

REGRESSORS_GSNET: list[Row] = [
    {
        "source": "GSNet (Peng 2023)",
        "method": method,
        "mean_vertex_mm": error,
        "edge_mm": edge,
        "bend": bend,
        "collision_rate_vertex_percent": collision,
    }
    for method, error, edge, bend, collision in (
        ("PBNS", 64.51, 0.72, 0.033, 0.96),
        ("DeePSD", 29.75, 1.13, 0.029, 1.29),
        ("TailorNet", 21.63, 0.68, 0.031, 0.81),
        ("GSNet", 13.15, 0.60, 0.037, 0.70),
    )
]

RECONSTRUCTION: list[Row] = [
    {
        "source": "Shi 2023, Table 3",
        "method": method,
        "pose_rmse": pose,
        "vertex_rmse_m": vertex,
        "hausdorff_m": distance,
        "sted": sted,
    }
    for method, pose, vertex, distance, sted in (
        ("Action2Motion", 0.195, 0.15366, 0.2653, 0.03269),
        ("ACTOR", 0.09634, 0.07155, 0.2510, 0.01965),
        ("Shi 2023", 0.07933, 0.06038, 0.2405, 0.01533),
    )
]

GENERATION: list[Row] = [
    {
        "source": "Shi 2023, Table 4",
        "method": method,
        "fid": fid,
        "accuracy_percent": accuracy,
        "diversity": diversity,
        "multimodality": multimodality,
    }
    for method, fid, accuracy, diversity, multimodality in (
        ("real motions", 0.039, 94.0, 7.06, 2.91),
        ("Action2Motion", 0.182, 89.9, 6.99, 2.59),
        ("ACTOR", 0.062, 90.3, 7.01, 3.07),
        ("Shi 2023", 0.042, 93.3, 7.05, 2.89),
    )
]

TIMING: list[Row] = [
    {"solver": solver, "vertices": vertices, "median_s_per_frame": seconds, "source": source}
    for solver, vertices, seconds, source in (
        ("garment regressor (skirt)", 3326, 0.0117, "Shi 2023, Table 2: RTX 3090"),
        ("garment regressor (T-shirt)", 3170, 0.0123, "Shi 2023, Table 2: RTX 3090"),
        ("garment regressor (pants)", 4473, 0.0132, "Shi 2023, Table 2: RTX 3090"),
        ("motion-invariant autoencoder (skirt)", 5787, 0.024, "Wang 2019, section 3.6: Titan X, without refinement"),
    )
]
"""Published means of networks; no medians were published. ARCSim's times come with the run's own table."""
