"""Captions: the garment regressors."""

from __future__ import annotations

from report.captions.caption import OTHER_DATA, Caption, made_by

CAPTIONS: dict[str, Caption] = {
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
        made_by("evaluate_garment_regressor", "evaluation/regressor.py", "garment_regressor"),
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
        made_by("evaluate_garment_regressor", "evaluation/drift.py", "regressor_drift"),
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
    "published_regressors": Caption("Published regressors", OTHER_DATA, "Shi 2023, Tables 6 and 9.", other=True),
    "published_gsnet": Caption("Published regressors, GSNet's figures", OTHER_DATA, "Peng 2023, Table 1.", other=True),
    "pictures_error_still": Caption(
        "Truth, prediction, error",
        "The frame with the median error of each motion; the error in millimetres on the cloth.",
        "Shi 2023, Figure 6.",
        "render → pipeline/render.py",
        "A motion that was not trained on.",
    ),
}
