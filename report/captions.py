"""What is said about each table, chart and row of pictures: content, the paper's counterpart, origin and split."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Caption:
    """Caption of a block.

    Attributes:
        title: A few words.
        what: What is shown and how to read it.
        answers: Table or figure of a paper that it stands for.
        made: Rule, module and file that made it.
        split: Which part of the data it is measured on.
        columns: Columns of the short form of a table, in order; empty: all.
        other: True for figures that others published, on other data.
    """

    title: str
    what: str = ""
    answers: str = ""
    made: str = ""
    split: str = ""
    columns: tuple[str, ...] = ()
    other: bool = False


def _made(rule: str, module: str, table: str) -> str:
    return f"{rule} → {module} → tables/{table}.csv"


_OTHER = "Other data, other garments, other machines: for orientation, not for a comparison."

CAPTIONS: dict[str, Caption] = {
    "simulation": Caption(
        "Simulated data",
        "One row a garment and plan. Strain is the change of an edge's length against the template; penetration and "
        "time are those of the simulator. Pinched: vertices that the body leaves no room for, in the worst frame. "
        "Crossing pairs: of triangles of the garment, in the worst frame.",
        "Wang 2019, section 4; Shi 2023, section 4.1 (data sets).",
        _made("evaluate_simulation", "evaluation/simulation.py", "simulation"),
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
        made=_made("evaluate_simulation", "evaluation/simulation.py", "dropped"),
        columns=("garment", "plan", "clip", "label", "phi", "attempts", "reason"),
    ),
    "ranges": Caption(
        "Intrinsic parameters",
        "Drawn once for each parameter set, fixed for a whole simulation, stored with it. The base values are those of "
        "the motions plan.",
        "Wang 2019, section 4 (three groups of parameters).",
        "configuration → sim/parameters.py",
    ),
    "shape_descriptor": Caption(
        "Reconstruction of single frames",
        "Root mean squared vertex distance of a frame that went through the descriptor and back: mean over frames, and "
        "over clips, so that a clip under many parameter sets weighs as much as one under a single set. Over PCA: that "
        "error over the one of as many principal components, fitted on the same training frames; below 1 is better.",
        "Wang 2019, Figure 7 (descriptor against PCA), Figure 6 (Laplacian term).",
        _made("evaluate_shape_descriptor", "evaluation/descriptor.py", "shape_descriptor"),
        "Named in each group; best values are marked among methods of equal dimension.",
        (
            "garment",
            "split",
            "method",
            "dimension",
            "rmse_mm",
            "over_pca",
            "clip_rmse_mm",
            "clip_over_pca",
            "laplacian_rmse_mm",
            "frames",
            "clips",
        ),
    ),
    "descriptor_interpolation": Caption(
        "Between two shapes",
        "Strain of the edges of shapes between two frames of different clips, against the template: along the straight "
        "line between their descriptors, and along the straight way of each vertex. The strain of the two ends, as the "
        "method has them, stands beside; edge deviation is the distance from a straight change of each edge's length.",
        "Wang 2019, Figure 8.",
        _made("evaluate_shape_descriptor", "evaluation/descriptor_shapes.py", "descriptor_interpolation"),
        "Named in each group.",
        (
            "garment",
            "split",
            "method",
            "p50_strain_percent",
            "p99_strain_percent",
            "ends_p50_strain_percent",
            "ends_p99_strain_percent",
            "edge_deviation_percent",
            "pairs",
        ),
    ),
    "descriptor_projection": Caption(
        "Implausible shapes",
        "Held-out frames with noise of 10 mm, with a place pulled out by 20 cm, inflated by half, and torn into halves "
        "of two frames: as given, through each descriptor, through PCA of equal dimension, and as the nearest training "
        "frame. Plausible code (ours): the descriptor is moved to the nearest one inside the ellipsoid of half of the "
        "training's. Less strain and a smaller distance to the nearest training frame are more plausible; as simulated "
        "are the frames before anything was done to them.",
        "Wang 2019, Figure 9.",
        _made("evaluate_shape_descriptor", "evaluation/descriptor_shapes.py", "descriptor_projection"),
        "Named in each group.",
        ("garment", "split", "shape", "method", "p50_strain_percent", "p99_strain_percent", "moved_mm", "nearest_mm"),
    ),
    "descriptor_curve": Caption(
        "Error against the length of the code",
        "Lower and further left is better. One panel a garment and split.",
        "Wang 2019, Figure 7.",
        "evaluate_shape_descriptor → report/plots.py",
    ),
    "motion_invariant": Caption(
        "Own and transferred latents: RMSE [mm] by variant",
        "Lower is better. Reconstruction decodes a frame's own latent z with its own motion. Transfer decodes the z of "
        "one clip, or of one frame of it, with the motion of another clip under the same parameters, and is held "
        "against the simulation of that motion. In italics what it has to beat: the z of wrong parameters, one mean z "
        "for all, the mean shape; and the floor, what the shape descriptor alone loses. Two variants are controls with "
        "the decoder of ours: motion-only has no z, true-parameters is given the parameters that z stands for.",
        "Wang 2019, Figures 10 and 11.",
        _made("evaluate_motion_invariant", "evaluation/intrinsic.py", "motion_invariant"),
        "Named in each group; parameter sets and takes are disjoint.",
    ),
    "transfer_gain": Caption(
        "Share of the gain of the true parameters by variant",
        "How much of what the true parameters gain over motion alone a transferred z gains: 1 as much, 0 none, below 0 "
        "worse than no z.",
        made=_made("evaluate_motion_invariant", "evaluation/intrinsic.py", "motion_invariant"),
    ),
    "transfer_over_true": Caption(
        "Transfer error over that with the true parameters by variant",
        "The decoder of ours, given the true parameters, is the measure.",
        made=_made("evaluate_motion_invariant", "evaluation/intrinsic.py", "motion_invariant"),
    ),
    "latent_variance": Caption(
        "Variance of the latent by variant",
        "Variance within one parameter set over the variance across parameter sets, of single frames; 0 is a latent "
        "that knows nothing of the motion. A latent that never varies has none.",
        "Wang 2019, section 3.4 (the first term of the loss).",
        _made("evaluate_motion_invariant", "evaluation/intrinsic.py", "motion_invariant"),
        "Named in each group.",
    ),
    "clip_latent_variance": Caption(
        "Variance of the latent of a clip by variant",
        "The same of the one latent that all frames of a clip have together. A single frame tells little of most "
        "parameters, a clip more.",
        made=_made("evaluate_motion_invariant", "evaluation/intrinsic.py", "motion_invariant"),
    ),
    "parameter_recovery": Caption(
        "What the latent knows of the parameters: R² by variant",
        "R² of a ridge regression from the latent to each parameter (its logarithm where it is drawn so): 1 is "
        "recovered, 0 no better than the mean, below 0 worse. A shape tells the ratios by which the motion of cloth "
        "depends on the parameters (bending over weight, drag over inertia) better than the parameters themselves, so "
        "both stand here. The full table has how far the garment moves with a parameter, one deviation of it.",
        "Wang 2019 shows it by pictures; no published figure.",
        _made("evaluate_motion_invariant", "evaluation/intrinsic.py", "parameter_recovery"),
        "Parameter sets that were not trained on.",
    ),
    "recovery_bars": Caption(
        "Recovered parameters",
        "Bars are cut off at −0.25.",
        made="evaluate_motion_invariant → report/plots.py",
    ),
    "motion_reconstruction": Caption(
        "Reconstructed motions",
        "Poses in 6-D form, body vertices and joints with the root at rest. ACTOR and Action2Motion are compact "
        "implementations of our own, trained on the same clips for the same time of one core. Vertex weight 0 is "
        "training without the loss on body vertices. Two ways that learn nothing stand beside the networks.",
        "Shi 2023, Table 3, and Table 8 (with and without the vertex loss).",
        _made("evaluate_motion", "evaluation/motion.py", "motion_reconstruction"),
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
        _made("evaluate_motion", "evaluation/motion.py", "motion_generation"),
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
        _made("evaluate_motion", "evaluation/motion_quality.py", "motion_quality"),
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
    "garment_regressor": Caption(
        "Regressors and baselines",
        "Figures of each sequence, averaged over sequences. Reference rows (italic) see the truth and are no methods: "
        "the simulation itself; the chaos floor, the same clip simulated once more from a start that differs by 1 mm, "
        "their difference over the root of 2; and the floor that a linear space of its size cannot get below. Rows "
        "with the true frame before, or the true past, show what start token and roll-out lose. Wang's autoencoder, "
        "which infers the material from given garments, is given the z of the base material's training clips. With "
        "unseen parameters and on unseen bodies the regressor that is told of them stands beside one that is not, and "
        "beside itself told the base ones.",
        "Shi 2023, Tables 6, 7 and 9; Peng 2023 (GSNet), Table 1 for edge, bend and collision.",
        _made("evaluate_garment_regressor", "evaluation/regressor.py", "garment_regressor"),
        "Base parameters: new clips of known labels, known movements in another manner, labels that nobody trained on. "
        "Parameters, or bodies, that nobody trained on: on motions that were seen with others, and on new ones.",
        (
            "garment",
            "split",
            "method",
            "rmse_mm",
            "mean_vertex_mm",
            "hausdorff_mm",
            "sted",
            "normal_cosine",
            "edge_mm",
            "bend",
            "collision_rate_percent",
            "sequences",
        ),
    ),
    "regressor_drift": Caption(
        "Errors along long sequences",
        "Each sequence is dressed as a whole, but by the paper's decoder, which takes it in segments. The error of the "
        "last tenth over that of the first: mean shape and ridge regression, which cannot drift, are the control.",
        "In none of the papers: Shi 2023 names sequences above 1,000 frames as a limit.",
        _made("evaluate_garment_regressor", "evaluation/drift.py", "regressor_drift"),
        "Generated motions that nobody trained on, base parameters.",
        (
            "garment",
            "method",
            "tenth_1_rmse_mm",
            "tenth_10_rmse_mm",
            "last_tenth_over_first",
            "first_60_frames_rmse_mm",
            "first_250_frames_rmse_mm",
            "first_1000_frames_rmse_mm",
            "sequences",
        ),
    ),
    "regressor_bars": Caption(
        "Error by method",
        "Blue: networks; orange: tuned against collisions; light blue: baselines; grey: references.",
        "Shi 2023, Tables 6 and 7.",
        "evaluate_garment_regressor → report/plots.py",
        "Unseen motions.",
    ),
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
        _made("evaluate_garment_regressor", "models/refinement.py", "garment_regressor"),
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
    "timing": Caption(
        "Seconds a frame",
        "Median and 95th percentile after a warm-up. The speed-up is against the implicit solver of this project on "
        "this machine, in this run.",
        "Shi 2023, Table 2; Wang 2019, section 3.6.",
        _made("time_solvers", "sim/timing.py", "timing"),
        columns=(
            "garment",
            "solver",
            "vertices",
            "frames",
            "substeps",
            "median_s_per_frame",
            "p95_s_per_frame",
            "speed_up_over_implicit",
        ),
    ),
    "timing_bars": Caption(
        "Seconds a frame",
        "Logarithmic. Green: XPBD; yellow: implicit Euler; blue: networks; grey: ARCSim on other hardware.",
        "Shi 2023, Table 2.",
        "time_solvers → report/plots.py",
    ),
    "losses": Caption(
        "Losses",
        "Logarithmic; blue: training, orange: validation. Losses of different networks have different units.",
        made="train_* → models/training.py → training/**/losses.csv",
    ),
    "stages": Caption(
        "Time and memory by stage",
        "Seconds of all jobs of a stage added up; jobs run side by side, so the run took less. Memory is the largest "
        "resident set of a job.",
        made="benchmark files of the workflow",
    ),
    "published_reconstruction": Caption("Published reconstruction", _OTHER, "Shi 2023, Table 3.", other=True),
    "published_generation": Caption("Published generation", _OTHER, "Shi 2023, Table 4.", other=True),
    "published_regressors": Caption("Published regressors", _OTHER, "Shi 2023, Tables 6 and 9.", other=True),
    "published_gsnet": Caption("Published regressors, GSNet's figures", _OTHER, "Peng 2023, Table 1.", other=True),
    "published_timing": Caption(
        "Times elsewhere",
        "Published on other hardware, or measured once outside of this run. Means, where no median was published.",
        "Shi 2023, Table 2; Wang 2019, section 3.6.",
        other=True,
    ),
    "pictures_simulated": Caption("Simulated", "Lively sequences of the data set.", made="render → pipeline/render.py"),
    "pictures_materials": Caption(
        "One motion, several materials",
        "The same clip under clearly different parameter sets.",
        "Wang 2019, section 4 (data set).",
        "render → pipeline/render.py",
    ),
    "pictures_contact": Caption("More of the data", made="render → pipeline/render.py"),
    "pictures_error": Caption(
        "Truth, prediction, error",
        "From left to right; the error in millimetres on the cloth.",
        "Shi 2023, Figure 6.",
        "render → pipeline/render.py",
        "A motion that was not trained on.",
    ),
    "pictures_descriptor_error": Caption(
        "A frame through the descriptor",
        "Top: the frame and its reconstructions from equally many numbers. Bottom: their error in millimetres.",
        "Wang 2019, Figure 6.",
        "render_descriptor → pipeline/render_descriptor.py",
        "A sequence that was not trained on.",
    ),
    "pictures_descriptor_between": Caption(
        "Between two shapes",
        "Top: along the straight line between the descriptors. Bottom: along the straight way of each vertex.",
        "Wang 2019, Figure 8.",
        "render_descriptor → pipeline/render_descriptor.py",
        "Sequences that were not trained on.",
    ),
    "pictures_descriptor_implausible": Caption(
        "Implausible shapes",
        "Made from held-out frames, and what the descriptor, principal components and the nearest frame make of them.",
        "Wang 2019, Figure 9.",
        "render_descriptor → pipeline/render_descriptor.py",
    ),
    "pictures_refined": Caption(
        "A frame before and after refinement",
        "The frame with the most vertices inside the body, of all motions shown.",
        "Wang 2019, section 3.5.",
        "render → pipeline/render.py",
    ),
    "pictures_generated": Caption(
        "Generated",
        "Label → motion CVAE → ground → garment regressor → refinement. No simulator was involved.",
        "Shi 2023, Figure 1.",
        "render → pipeline/render.py",
    ),
}
