"""Stage ``evaluate_garment_regressor``: every regressor beside mean shape, skinning and ridge regression.

In: the template, the tuned regressor, all variants and all shards of a garment. Out: the garment's rows of the table
``garment_regressor`` (Shi 2023, Tables 6 and 7, Figure 10), on motions that were not trained on, with the base
parameters, before and after refinement.
"""

from __future__ import annotations

from datasets.shards import MOTIONS
from datasets.splits import TRAIN, UNSEEN_MOTIONS
from evaluation.baselines import fit_baselines
from evaluation.regressor import Predictor, RegressorEvaluation, regressor_rows
from evaluation.table import write_table
from garments.template import GarmentTemplate
from models.garment_fitting import load_regressor
from models.refinement import RefinementSettings
from pipeline.garment_data import regressor_predictor
from pipeline.progress import Progress
from pipeline.sequence_data import job_body, job_sequences
from pipeline.stage import Job, run_stage


def main(job: Job) -> None:
    """Fit the baselines, load the networks, evaluate all on the same sequences."""
    spec, evaluation = job.spec, job.spec["evaluation"]
    template_path, fine_tuned_path = job.inputs[:2]
    variant_paths = dict(zip(spec["variants"], job.inputs[2:]))
    shards = job.inputs[2 + len(variant_paths) :]
    body, template = job_body(job), GarmentTemplate.load(template_path)
    predictors: dict[str, Predictor] = {"simulation": lambda sequence: sequence.vertices}
    predictors |= fit_baselines(
        job_sequences(job, shards, (TRAIN,), (MOTIONS,)), body, template, max(evaluation["pca_dimensions"])
    )
    for variant, path in variant_paths.items():
        predictors[f"regressor, {variant}"] = regressor_predictor(load_regressor(path), body)
    predictors[f"regressor, {spec['use']}, collision-tuned"] = regressor_predictor(
        load_regressor(fine_tuned_path), body
    )

    test = job_sequences(job, shards, (UNSEEN_MOTIONS,), (MOTIONS,))
    progress = Progress(f"evaluate regressors {spec['garment']}", len(test) * len(predictors), "sequences")
    settings = RegressorEvaluation(
        frames_stride=evaluation["frames_stride"], refinement=RefinementSettings(**spec["refinement"])
    )
    write_table(job.outputs[0], regressor_rows(test, predictors, body, template, settings, progress))
    progress.finish()


if __name__ == "__main__":
    run_stage(main)
