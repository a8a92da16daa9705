"""Captions: animations made of keyframes, and what shapes tell of their material."""

from __future__ import annotations

from report.captions.caption import Caption, made_by

_MADE = made_by("evaluate_composition", "evaluation/composition.py", "composition")
_LONG = (
    "Long: as many frames as in the paper, 96, from the long simulations, motions that were not trained on in the base "
    "material. Unseen both: the run's clips, of parameters and motions that were not trained on."
)

CAPTIONS: dict[str, Caption] = {
    "composition_curve": Caption(
        "Error between keyframes",
        "Against the number of keyframes, spread evenly over the sequence.",
        "Wang 2019, Figure 13.",
        _MADE,
        _LONG,
    ),
    "composition": Caption(
        "Sequences composed from keyframes: RMSE [mm] by number of keyframes",
        "Keyframes are simulated shapes; what is filled in between is held against the simulation, keyframes left out. "
        "Interpolation of vertices or of descriptors knows nothing of the motion. In the intrinsic space, the latents "
        "of the keyframes are interpolated and decoded along the motion; with their detail kept, what a given shape "
        "has beyond the decoded one fades from there, and more keyframes help. Nothing is refined here: the full table "
        "has the vertices inside the body, which refinement would have to move.",
        "Wang 2019, Figure 13.",
        _MADE,
        _LONG,
    ),
    "composition_share": Caption(
        "Keyframes for the same error, in percent of the frames",
        "What a method needs for the error that the intrinsic space has with two keyframes.",
        "Wang 2019, section 4 (iii): keyframes of 20% of the frames become 1 to 2%.",
        _MADE,
        _LONG,
    ),
    "inference": Caption(
        "Parameters told from a shape: R² by frames that are looked at",
        "Estimates by the autoencoder in use, from one frame and from stretches of more. The full table has the "
        "other split.",
        "Wang 2019 has no figure.",
        made_by("evaluate_composition", "evaluation/parameter_reader.py", "inference"),
        "Parameter sets that were not trained on.",
    ),
    "inference_coverage": Caption(
        "Coverage of the intervals [%] by frames that are looked at",
        "How often an interval that is made to hold nine of ten truths held the truth. Each set is judged by intervals "
        "made on all other held-out sets. Few sets say little: of sixteen, one more or less is 6%.",
        made=made_by("evaluate_composition", "evaluation/parameter_reader.py", "inference"),
        split="Parameter sets that were not trained on.",
    ),
    "inference_width": Caption(
        "Width of the intervals over that of the sampled values by frames that are looked at",
        "Near one, the shape does not show the parameter, and the estimate says so.",
        made=made_by("evaluate_composition", "evaluation/parameter_reader.py", "inference"),
        split="Parameter sets that were not trained on.",
    ),
}
