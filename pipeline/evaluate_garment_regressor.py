"""Stage ``evaluate_garment_regressor``: every regressor beside mean shape, skinning and ridge regression.

In: the template, the tuned regressor, all variants, the simulations that are tested on alone and all shards of a
garment. Out: the garment's rows of the table ``garment_regressor`` (Shi 2023, Tables 6, 7 and 9, Figure 10), with the
base parameters, on new clips of known labels, unseen styles and unseen labels; and of the table ``regressor_drift``:
errors along long sequences.
"""

from __future__ import annotations

from datasets.sequences import Sequence, load_sequences
from datasets.shards import LONG, MOTIONS, REPEATED
from datasets.splits import TRAIN, UNSEEN_LABELS, UNSEEN_MOTIONS, UNSEEN_STYLES, SplitRule
from evaluation.baselines import SimulatedAgain, fit_baselines
from evaluation.drift import drift_rows
from evaluation.regressor import Predictor, RegressorEvaluation, regressor_rows
from evaluation.table import write_table
from garments.template import GarmentTemplate
from models.garment_fitting import load_regressor
from models.refinement import RefinementSettings
from models.sequence_regressor import SequenceRegressor
from pipeline.garment_data import regressor_predictor, started_predictor, taught_predictor
from pipeline.progress import Progress
from pipeline.sequence_data import job_body, job_sequences
from pipeline.stage import Job, run_stage

BLIND = ("mean shape", "ridge, pose history")
"""Baselines without a memory of the garment, which stand beside the networks in the drift table."""

DETAILED = 4
"""Sequences of a split of which more than the errors is computed."""

TESTS = 2
"""Shards of simulations that are tested on alone."""


def main(job: Job) -> None:
    """Fit the baselines, load the networks, evaluate all on the same sequences."""
    spec, evaluation = job.spec, job.spec["evaluation"]
    template_path, fine_tuned_path, *rest = job.inputs
    variant_paths = dict(zip(spec["variants"], rest))
    tests, shards = rest[len(variant_paths) :][:TESTS], rest[len(variant_paths) + TESTS :]
    body, template = job_body(job), GarmentTemplate.load(template_path)
    baselines = fit_baselines(
        job_sequences(job, shards, (TRAIN,), (MOTIONS,)), body, template, max(evaluation["pca_dimensions"])
    )
    networks: dict[str, Predictor] = {}
    bos: dict[str, Predictor] = {}
    for variant, path in variant_paths.items():
        regressor = load_regressor(path)
        networks[f"regressor, {variant}"] = regressor_predictor(regressor, body)
        if variant == "paper" and isinstance(regressor, SequenceRegressor):
            bos[f"regressor, {variant}, from the true frame before (reference)"] = started_predictor(regressor, body)
            bos[f"regressor, {variant}, true past in every frame (reference)"] = taught_predictor(regressor, body)
    tuned = f"regressor, {spec['use']}, collision-tuned"
    networks[tuned] = regressor_predictor(load_regressor(fine_tuned_path), body)
    predictors: dict[str, Predictor] = {
        "simulation": lambda sequence: sequence.vertices,
        "simulated again (chaos floor)": SimulatedAgain(_tested(job, tests, REPEATED)).predict,
    }
    predictors |= baselines | networks | bos

    held_out = job_sequences(job, shards, (UNSEEN_MOTIONS, UNSEEN_STYLES, UNSEEN_LABELS), (MOTIONS,))
    chosen = set(spec["tested_clips"])
    test = [s for s in held_out if s.clip in chosen] or held_out
    order = (UNSEEN_MOTIONS, UNSEEN_STYLES, UNSEEN_LABELS)
    test.sort(key=lambda s: order.index(s.split))
    progress = Progress(f"evaluate regressors {spec['garment']}", len(test) * len(predictors), "sequences")
    settings = RegressorEvaluation(
        frames_stride=evaluation["frames_stride"],
        detailed=DETAILED,
        refinement=RefinementSettings(**spec["refinement"]),
    )
    rows = regressor_rows(test, predictors, body, template, settings, progress, refined=(tuned,))
    progress.finish()
    write_table(job.outputs[0], rows)

    watched = {name: predict for name, predict in baselines.items() if name in BLIND} | networks
    long = _tested(job, tests, LONG)
    none = [{"garment": spec["garment"], "method": "no long motion stayed inside the quality bounds", "sequences": 0}]
    write_table(job.outputs[1], drift_rows(long, watched) if long else none)


def _tested(job: Job, paths: list[str], plan: str) -> list[Sequence]:
    """Simulations of a plan that is tested on alone; all of them may have been dropped."""
    return load_sequences(paths, SplitRule(**job.spec["splits"]), plans=(plan,))


if __name__ == "__main__":
    run_stage(main)
