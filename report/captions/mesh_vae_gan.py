"""Captions: clothing as a layer on the body mesh."""

from __future__ import annotations

from report.captions.caption import Caption, made_by

CAPTIONS: dict[str, Caption] = {
    "mesh_vae_gan": Caption(
        "Layers through a short code and back",
        "Mean distance of the covered vertices from the true ones. Every method has as long a code and sees the same "
        "training frames; every network sees each of them as often, in batches of one size. “Anchored” is ours: it "
        "starts from a regression on pose and type and from the principal components of what that leaves over, each "
        "type's its own, and has most of its lead before the first step: in so short a training networks alone stay "
        "behind principal components. “PCA a type” are those of each type of clothing. “Paper” is Ma 2019 at our size; "
        "its four ablations leave out what their names say. CoMA knows neither pose nor type. Wrinkle error: earth "
        "mover's distance between the distributions of the angles between neighbouring faces, method against "
        "simulation; a smooth layer is as wrong as a noisy one. "
        "Parameters: numbers that are fitted to the data, without a discriminator's.",
        "Ma 2019, Table 1 with its ablations.",
        made_by("evaluate_mesh_vae_gan", "evaluation/clothing_layer.py", "mesh_vae_gan"),
        "Seen bodies in unseen clips, unseen bodies in clips that another body was seen in, and both unseen. What "
        "moves the layer most is the pose: an unseen clip is harder than an unseen body.",
        ("split", "method", "error_mm", "error_deviation_mm", "wrinkle_error_degrees", "frames", "parameters"),
    ),
    "mesh_vae_gan_generation": Caption(
        "Layers of a random code",
        "One layer for each pose and type of the held-out frames, its code drawn from a standard normal distribution. "
        "The paper asked people which of two pictures is real. Instead of them, a logistic regression is shown the "
        "mean, the spread and two percentiles of the angles between neighbouring faces in five regions of the body, of "
        "simulated and of generated layers; it learns on half of the sequences and is asked about the others. 50 % "
        "right is the best: it cannot tell them apart. It is a stricter eye than a person's for roughness, and blind "
        "for where a wrinkle lies. Time: of one layer of the whole body, on one core. Principal components know no "
        "pose and no type.",
        "Ma 2019, section 5.2 (user study) and Figures 4 to 6.",
        made_by("evaluate_mesh_vae_gan", "evaluation/clothing_layer.py", "mesh_vae_gan_generation"),
        "Unseen bodies in unseen clips.",
        ("method", "wrinkle_error_degrees", "judge_right_percent", "time_ms_per_frame", "frames", "vertices"),
    ),
    "layer_transfer": Caption(
        "What the body's mesh loses of the clothing",
        "Distance of the visible cloth of the simulation to the displaced body mesh, on one frame of every sequence. "
        "Cloth more than 30 mm off the skin is loose. This is in no error above: those compare layers with layers.",
        "Ma 2019 registers scans and gives no such figure.",
        made_by("transfer_layer", "garments/body_layer.py", "layer_transfer"),
        "All splits together.",
        (
            "type",
            "mean_mm",
            "p95_mm",
            "loose_share_percent",
            "loose_mean_mm",
            "loose_p95_mm",
            "displacement_mm",
            "largest_mm",
            "covered_vertices",
            "sequences",
            "left_out",
        ),
    ),
    "pictures_layer_types": Caption(
        "Types of clothing and random codes",
        answers="Ma 2019, Figure 4.",
        made="render_mesh_vae_gan → figures/mesh_vae_gan/",
    ),
    "pictures_layer_poses": Caption(
        "Poses and random codes",
        answers="Ma 2019, Figure 5.",
        made="render_mesh_vae_gan → figures/mesh_vae_gan/",
    ),
    "pictures_layer_between": Caption(
        "From one type of clothing to another",
        answers="Ma 2019, Figure 6.",
        made="render_mesh_vae_gan → figures/mesh_vae_gan/",
    ),
}
