"""Captions: the shape descriptor."""

from __future__ import annotations

from report.captions.caption import Caption, made_by

CAPTIONS: dict[str, Caption] = {
    "shape_descriptor": Caption(
        "Reconstruction of single frames",
        "Root mean squared vertex distance of a frame that went through the descriptor and back: mean over frames, and "
        "over clips, so that a clip under many parameter sets weighs as much as one under a single set. Over PCA: that "
        "error over the one of as many principal components, fitted on the same training frames; below 1 is better. "
        "Hidden: widths of the encoder's layers, which the decoder mirrors.",
        "Wang 2019, Figure 7 (descriptor against PCA), Figure 6 (Laplacian term).",
        made_by("evaluate_shape_descriptor", "evaluation/descriptor.py", "shape_descriptor"),
        "Named in each group; best values are marked among methods of equal dimension.",
        (
            "garment",
            "split",
            "method",
            "dimension",
            "hidden",
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
        made_by("evaluate_shape_descriptor", "evaluation/descriptor_shapes.py", "descriptor_interpolation"),
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
        made_by("evaluate_shape_descriptor", "evaluation/descriptor_shapes.py", "descriptor_projection"),
        "Named in each group.",
        ("garment", "split", "shape", "method", "p50_strain_percent", "p99_strain_percent", "moved_mm", "nearest_mm"),
    ),
    "descriptor_curve": Caption(
        "Error against the length of the code",
        "Lower and further left is better. One panel a garment and split.",
        "Wang 2019, Figure 7.",
        "evaluate_shape_descriptor → report/plots.py",
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
}
