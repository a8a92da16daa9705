"""Captions: the motion-invariant autoencoder."""

from __future__ import annotations

from report.captions.caption import Caption, made_by

CAPTIONS: dict[str, Caption] = {
    "motion_invariant": Caption(
        "Own and transferred latents: RMSE [mm] by variant",
        "Lower is better. Reconstruction decodes a frame's own latent z with its own motion. Transfer decodes the z of "
        "one clip, or of one frame of it, with the motion of another clip under the same parameters, and is held "
        "against the simulation of that motion. In italics what it has to beat: the z of wrong parameters, one mean z "
        "for all, the mean shape; and the floor, what the shape descriptor alone loses. Two variants are controls with "
        "the decoder of ours: motion-only has no z, true-parameters is given the parameters that z stands for.",
        "Wang 2019, Figures 10 and 11.",
        made_by("evaluate_motion_invariant", "evaluation/intrinsic.py", "motion_invariant"),
        "Named in each group; parameter sets and takes are disjoint.",
    ),
    "transfer_gain": Caption(
        "Share of the gain of the true parameters by variant",
        "How much of what the true parameters gain over motion alone a transferred z gains: 1 as much, 0 none, below 0 "
        "worse than no z.",
        made=made_by("evaluate_motion_invariant", "evaluation/intrinsic.py", "motion_invariant"),
    ),
    "transfer_over_true": Caption(
        "Transfer error over that with the true parameters by variant",
        "The decoder of ours, given the true parameters, is the measure.",
        made=made_by("evaluate_motion_invariant", "evaluation/intrinsic.py", "motion_invariant"),
    ),
    "latent_variance": Caption(
        "Variance of the latent by variant",
        "Variance within one parameter set over the variance across parameter sets, of single frames; 0 is a latent "
        "that knows nothing of the motion. A latent that never varies has none.",
        "Wang 2019, section 3.4 (the first term of the loss).",
        made_by("evaluate_motion_invariant", "evaluation/intrinsic.py", "motion_invariant"),
        "Named in each group.",
    ),
    "clip_latent_variance": Caption(
        "Variance of the latent of a clip by variant",
        "The same of the one latent that all frames of a clip have together. A single frame tells little of most "
        "parameters, a clip more.",
        made=made_by("evaluate_motion_invariant", "evaluation/intrinsic.py", "motion_invariant"),
    ),
    "parameter_recovery": Caption(
        "What the latent knows of the parameters: R² by variant",
        "R² of a ridge regression from the latent to each parameter (its logarithm where it is drawn so): 1 is "
        "recovered, 0 no better than the mean, below 0 worse. A shape tells the ratios by which the motion of cloth "
        "depends on the parameters (bending over weight, drag over inertia) better than the parameters themselves, so "
        "both stand here. The full table has how far the garment moves with a parameter, one deviation of it.",
        "Wang 2019 shows it by pictures; no published figure.",
        made_by("evaluate_motion_invariant", "evaluation/intrinsic.py", "parameter_recovery"),
        "Parameter sets that were not trained on.",
    ),
    "recovery_bars": Caption(
        "Recovered parameters",
        "Bars are cut off at −0.25.",
        made="evaluate_motion_invariant → report/plots.py",
    ),
}
