"""Captions: GSNet and what it is compared with, on the wardrobe."""

from __future__ import annotations

from report.captions.caption import Caption, made_by

_MADE = "evaluation/wardrobe.py"

CAPTIONS: dict[str, Caption] = {
    "gsnet": Caption(
        "Garments of six kinds",
        "Means over sequences. Edge: change of length against the template; bend: vertex normals against their "
        "neighbours'; collisions: vertices inside the body, before any correction. Training: seconds of the steps on "
        "one thread, and of what is done in closed form; our GSNet and the baselines have about as many as each other. "
        "The ridge regression goes from the motion of the last second to what skinning leaves over. It, TailorNet and "
        "PBNS are of single garments, so they have no rows for templates that they were not made for; PBNS sees no "
        "simulation.",
        "Peng 2023, Table 1.",
        made_by("evaluate_gsnet", _MADE, "gsnet"),
        "Takes that nobody trained on, on templates that were trained on; templates that nobody trained on, on takes "
        "of the training and on new ones. Training: two sequences a garment, to compare with.",
        (
            "split",
            "method",
            "error_mm",
            "edge_mm",
            "bend",
            "collision_percent",
            "training_s",
            "parameters",
            "garments",
            "sequences",
        ),
    ),
    "gsnet_categories": Caption(
        "Error by category",
        "Mean vertex error in millimetres.",
        "Peng 2023, Table 2.",
        made_by("evaluate_gsnet", _MADE, "gsnet_categories"),
        "As above.",
    ),
    "gsnet_ablation": Caption(
        "What the past is worth",
        "Our network from random weights, told the pose alone, the garment of the frame before too, the motion of the "
        "last second too, or that motion without the garment; all trained for the same number of epochs. A roll-out "
        "through its own garments costs several times as much an epoch.",
        "Peng 2023, Table 3.",
        made_by("evaluate_gsnet", _MADE, "gsnet"),
        columns=("split", "method", "error_mm", "edge_mm", "bend", "collision_percent", "training_s"),
    ),
    "gsnet_gap": Caption(
        "Train-test gap",
        "Error on training clips, on new ones, and on the new clips that all templates were simulated on: templates "
        "that were trained on, and others.",
        "Peng 2023, Figure 7.",
        made_by("evaluate_gsnet", _MADE, "gsnet_gap"),
    ),
    "gsnet_stability": Caption(
        "Error over the epochs",
        "Held-out takes on templates that are trained on, dressed free-running. Epochs are of different lengths.",
        "Peng 2023, Figure 8.",
        "train_gsnet → training/gsnet → tables/gsnet_stability.csv",
        "One sequence a template.",
    ),
    "gsnet_contact": Caption(
        "Inside the body",
        "Vertices inside the body as the network leaves them, after its physical regressor, and after the projection "
        "(by exact distance to the body's surface).",
        "Peng 2023, section 3.4.",
        made_by("evaluate_gsnet", _MADE, "gsnet_contact"),
        "All test splits, garment by garment.",
    ),
    "gsnet_drift": Caption(
        "Errors along long roll-outs",
        "Each motion is dressed in one go. The run's own garments, which are no part of the wardrobe: templates that "
        "no network saw. Linear blend skinning, which cannot drift, is the control.",
        "In none of the papers; auto-regressive networks feed on their own errors.",
        made_by("evaluate_gsnet", "evaluation/drift.py", "gsnet_drift"),
        "Generated motions that nobody trained on.",
        (
            "garment",
            "method",
            "tenth_1_rmse_mm",
            "tenth_10_rmse_mm",
            "last_tenth_over_first",
            "first_60_frames_rmse_mm",
            "frames",
            "sequences",
        ),
    ),
    "gsnet_timing": Caption(
        "Seconds a frame, GSNet and the simulator",
        "One thread. The template is encoded beforehand. Regressor and projection: what brings the vertices out of the "
        "body, its nearest points included. The simulator's time is with self-contact, one clip at a time.",
        "Peng 2023, Figure 9.",
        made_by("time_gsnet", "pipeline/time_gsnet.py", "gsnet_timing"),
        columns=("garment", "what", "vertices", "median_s_per_frame", "p95_s_per_frame", "speed_up_over_xpbd"),
    ),
    "gsnet_timing_bars": Caption(
        "Seconds a frame",
        "Logarithmic. Green: the simulator; blue: the network and what follows it.",
        "Peng 2023, Figure 9.",
        "time_gsnet → report/plots.py",
    ),
    "pictures_gsnet": Caption(
        "Unseen templates",
        "From left to right: simulated; GSNet and its error; the best of the baselines that dress any garment, and its "
        "error; both as the networks leave them, before any vertex is brought out of the body. The frame is the one in "
        "which the simulated cloth is farthest from being skinned.",
        "Peng 2023, Figures 5 and 6.",
        "render_gsnet → pipeline/render_gsnet.py",
        "Templates and takes that nobody trained on.",
    ),
}
