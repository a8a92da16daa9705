"""Captions: motions from a label."""

from __future__ import annotations

from report.captions.caption import OTHER_DATA, Caption, made_by

CAPTIONS: dict[str, Caption] = {
    "motion_reconstruction": Caption(
        "Reconstructed motions",
        "Poses in 6-D form, body vertices and joints with the root at rest. ACTOR and Action2Motion are compact "
        "implementations of our own, trained on the same clips for the same time of one core. Vertex weight 0 is "
        "training without the loss on body vertices. Two ways that learn nothing stand beside the networks.",
        "Shi 2023, Table 3, and Table 8 (with and without the vertex loss).",
        made_by("evaluate_motion", "evaluation/motion.py", "motion_reconstruction"),
        "Clips that were not trained on.",
        (
            "method",
            "vertex_weight",
            "pose_rmse",
            "joint_error_m",
            "vertex_rmse_m",
            "hausdorff_m",
            "sted",
            "motions",
            "training_s",
        ),
    ),
    "motion_generation": Caption(
        "Generated motions",
        "Mean and 95% interval over repetitions. FID: lower is better; diversity, multimodality and label spread: "
        "nearest to the real ones is better, so none is marked. Label spread is the mean distance of the joints of two "
        "motions of a label, for the features of a network that tells labels apart hardly differ within one. The mean "
        "pose standing still is a control that must fail. Nearest: distance to the nearest training motion of the "
        "label; far below that of the real, unseen motions would be copying. Discontinuous: share of motions with a "
        "joint acceleration above the 99.9th percentile of the real ones. The judge's own accuracy is that of the "
        "real, unseen motions.",
        "Shi 2023, Tables 4 and 5 (the user study is replaced by the discontinuity).",
        made_by("evaluate_motion", "evaluation/motion.py", "motion_generation"),
        "As many motions as the test split has, with its labels.",
        (
            "source",
            "fid",
            "accuracy_percent",
            "diversity",
            "multimodality",
            "label_spread_m",
            "nearest_training_m",
            "discontinuous_percent",
            "motions",
        ),
    ),
    "motion_quality": Caption(
        "Can a body move like that?",
        "Mean and 95% interval over motions. Foot skate: 99th percentile of the speed of a touching foot. The dense "
        "generators make the root translation too; the others make poses, and the root is derived from them, under "
        "which nothing leaves the ground: the real poses with a derived root show what that costs alone. Planted: the "
        "motion as it is dressed, after inverse kinematics have put its touching feet on the ground, where they stay. "
        "Floating: largest height of the lower foot, a jump's flight. "
        "Refused: share of motions that no body can make.",
        "In none of the papers.",
        made_by("evaluate_motion", "evaluation/motion_quality.py", "motion_quality"),
        "Clips that were not trained on, and as many generated ones with their labels.",
        (
            "source",
            "root",
            "foot_skate_cm_s",
            "planted_foot_skate_cm_s",
            "ground_penetration_cm",
            "planted_ground_penetration_cm",
            "planted_floating_cm",
            "joint_jerk_rad_s3",
            "refused_percent",
            "motions",
        ),
    ),
    "published_reconstruction": Caption("Published reconstruction", OTHER_DATA, "Shi 2023, Table 3.", other=True),
    "published_generation": Caption("Published generation", OTHER_DATA, "Shi 2023, Table 4.", other=True),
}
