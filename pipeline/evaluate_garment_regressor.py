"""Stage ``evaluate_garment_regressor``: every regressor beside mean shape, skinning and ridge regression.

In: the template, the tuned regressor, the shape descriptor with the codes that it made and the motion-invariant
autoencoders on it, all variants, the simulations that are tested on alone and all shards of a garment. Out: the
garment's rows of the table ``garment_regressor`` (Shi 2023, Tables 6, 7 and 9, Figure 10), with the base parameters, on
new clips of known labels, unseen styles and unseen labels, and with unseen parameters and on unseen bodies, where what
ignores them is the control; and of the table ``regressor_drift``: errors along long sequences.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from collections.abc import Sequence as Many

import numpy as np

from body.model import Body
from datasets.sequences import Sequence, load_sequences
from datasets.shards import BODIES, LONG, MATERIALS, MOTIONS, REPEATED
from datasets.splits import (
    TRAIN,
    UNSEEN_BODIES,
    UNSEEN_BODIES_AND_MOTIONS,
    UNSEEN_BOTH,
    UNSEEN_LABELS,
    UNSEEN_MOTIONS,
    UNSEEN_PARAMETERS,
    UNSEEN_STYLES,
    SplitRule,
)
from evaluation.baselines import SimulatedAgain, fit_baselines
from evaluation.drift import drift_rows
from evaluation.regressor import Predictor, RegressorEvaluation, regressor_rows
from evaluation.seeds import average_seeds
from evaluation.table import write_table
from garments.grading import graded
from garments.template import GarmentTemplate
from models.conditioned_regressor import ConditionedRegressor, Conditions
from models.garment_fitting import load_regressor
from models.garment_regressor import Regressor
from models.intrinsic_fitting import frame_evidence, load_motion_invariant, pooled
from models.refinement import RefinementSettings
from models.sequence_regressor import SequenceRegressor
from models.shape_descriptor import load_shape_descriptor
from pipeline.garment_data import other_bodies, sequence_conditions
from pipeline.garment_predictors import (
    autoencoder_predictor,
    graded_predictor,
    load_variant,
    regressor_predictor,
    started_predictor,
    taught_predictor,
    told_predictor,
)
from pipeline.intrinsic_data import all_codes, intrinsic_frames, job_codes, varied_parameters
from pipeline.progress import Progress
from pipeline.sequence_data import job_bodies, job_body, job_sequences
from pipeline.stage import Job, run_stage

BASE_SPLITS = (UNSEEN_MOTIONS, UNSEEN_STYLES, UNSEEN_LABELS)
VARIED = {MATERIALS: (UNSEEN_PARAMETERS, UNSEEN_BOTH), BODIES: (UNSEEN_BODIES, UNSEEN_BODIES_AND_MOTIONS)}
"""Plans that vary more than the motion, and their splits in which it is unseen."""

BLIND = ("mean shape", "ridge, pose history")
"""Baselines without a memory of the garment, which stand beside the networks in the drift table."""

DETAILED = 4
"""Sequences of a split of which more than the errors is computed."""

VARIED_TESTS = 16
"""Sequences of a split of ``VARIED``, evenly spread, that are tested on."""

TESTS = 2
"""Shards of simulations that are tested on alone."""

LATENT_FRAMES = 2000
"""Training frames, evenly spread, that tell an autoencoder's z of the base material."""


def main(job: Job) -> None:
    """Fit the baselines, load the networks, evaluate all on the same sequences."""
    spec, evaluation = job.spec, job.spec["evaluation"]
    template_path, fine_tuned_path, descriptor_path, codes_path, *rest = job.inputs
    encoder_paths, rest = _named(spec["autoencoders"], rest)
    variant_paths, rest = _named(spec["variants"], rest)
    tests, shards = rest[:TESTS], rest[TESTS:]
    body, template = job_body(job), GarmentTemplate.load(template_path)
    sequences = job_sequences(job, shards, (TRAIN, *BASE_SPLITS), (MOTIONS,))
    training = [s for s in sequences if s.split == TRAIN]
    baselines = fit_baselines(training, body, template, max(evaluation["pca_dimensions"]))
    test, varied, base_material = _test(job, sequences), _varied(job, shards), sequences[0].parameters
    del sequences, training

    used, tuned = (f"regressor, {spec['use']}{end}" for end in ("", ", collision-tuned"))
    regressors = {f"regressor, {variant}": load_variant(variant, path) for variant, path in variant_paths.items()}
    regressors[tuned] = load_regressor(fine_tuned_path)
    autoencoders = _autoencoders(job, descriptor_path, codes_path, encoder_paths)
    predictors: dict[str, Predictor] = {
        "simulation": lambda sequence: sequence.vertices,
        "simulated again (chaos floor)": SimulatedAgain(_simulated(job, tests, REPEATED)).predict,
    }
    predictors |= baselines | _networks(regressors, test) | autoencoders | _started(regressors, test)
    # Where more varies than the motion: what ignores it, and what is told of it.
    few = {n: p for n, p in predictors.items() if n in ("simulation", *BLIND) or "PCA" in n}
    bodies = job_bodies(job)
    others = other_bodies(template, body, bodies)
    conditioned = {n: r for n, r in regressors.items() if isinstance(r, ConditionedRegressor)}
    few |= {n: regressor_predictor(r, varied) for n, r in regressors.items() if n == used}
    few |= {n: told_predictor(r, sequence_conditions, others) for n, r in conditioned.items()}
    controls = {
        MATERIALS: ("material", lambda sequence: Conditions(base_material, sequence.shape)),
        BODIES: ("body", lambda sequence: Conditions(sequence.parameters, spec["body"]["shape"])),
    }

    progress = Progress(f"evaluate regressors {spec['garment']}", len(test) * len(predictors), "sequences")
    settings = RegressorEvaluation(
        frames_stride=evaluation["frames_stride"],
        detailed=DETAILED,
        refinement=RefinementSettings(**spec["refinement"]),
    )
    rows = regressor_rows(test, predictors, body, template, settings, progress, refined=(tuned,))
    progress.finish()
    for plan, (what, conditions) in controls.items():
        mine = [s for s in varied if s.plan == plan]
        told = {
            f"{name}, told the base {what} (control)": told_predictor(regressor, conditions, others)
            for name, regressor in conditioned.items()
        }
        if plan == BODIES:
            told[f"{used}, graded to the body"] = graded_predictor(regressors[used], others)
        rest_shape = _rest_shapes(template, body, bodies)
        rows += regressor_rows(mine, few | told, bodies, template, settings, rest=rest_shape)
    write_table(job.outputs[0], average_seeds(rows, ["rmse_mm"]))

    long = _simulated(job, tests, LONG)
    watched = {name: baselines[name] for name in BLIND} | _networks(regressors, long) | autoencoders
    none = [{"garment": spec["garment"], "method": "no long motion stayed inside the quality bounds", "sequences": 0}]
    drift = drift_rows(long, watched) if long else none
    write_table(job.outputs[1], average_seeds(drift, ["last_tenth_over_first"]))


def _named(names: Many[str], paths: list[str]) -> tuple[dict[str, str], list[str]]:
    """The first paths by name, and the rest of them."""
    return dict(zip(names, paths)), paths[len(names) :]


def _test(job: Job, sequences: Many[Sequence]) -> list[Sequence]:
    """Sequences with the base parameters that regressors are tested on, split by split."""
    held_out = [s for s in sequences if s.split in BASE_SPLITS]
    chosen = set(job.spec["tested_clips"])
    return sorted([s for s in held_out if s.clip in chosen] or held_out, key=lambda s: BASE_SPLITS.index(s.split))


def _varied(job: Job, shards: Many[str]) -> list[Sequence]:
    """Sequences with unseen parameters or on unseen bodies, as many of each split, evenly spread; perhaps none."""
    rule = SplitRule(**job.spec["splits"])
    chosen = []
    for plan, splits in VARIED.items():
        found = [s for shard in shards for s in load_sequences([shard], rule, splits, (plan,))]
        for split in splits:
            mine = [s for s in found if s.split == split]
            count = min(VARIED_TESTS, len(mine))
            chosen += [mine[i * len(mine) // count] for i in range(count)]
    return chosen


def _simulated(job: Job, paths: list[str], plan: str) -> list[Sequence]:
    """Simulations of a plan that is tested on alone; all of them may have been dropped."""
    return load_sequences(paths, SplitRule(**job.spec["splits"]), plans=(plan,))


def _networks(regressors: Mapping[str, Regressor], sequences: Many[Sequence]) -> dict[str, Predictor]:
    return {name: regressor_predictor(regressor, sequences) for name, regressor in regressors.items()}


def _started(regressors: Mapping[str, Regressor], sequences: Many[Sequence]) -> dict[str, Predictor]:
    """What the paper's decoder makes of a true frame before, and of a true past: what its start and roll-out lose."""
    made: dict[str, Predictor] = {}
    for name, regressor in regressors.items():
        if name == "regressor, paper" and isinstance(regressor, SequenceRegressor):
            made[f"{name}, from the true frame before (reference)"] = started_predictor(regressor, sequences)
            made[f"{name}, true past in every frame (reference)"] = taught_predictor(regressor)
    return made


def _autoencoders(
    job: Job, descriptor_path: str, codes_path: str, encoder_paths: Mapping[str, str]
) -> dict[str, Predictor]:
    """Wang's autoencoders as regressors: the z of the base material's training clips along every other motion."""
    descriptor = load_shape_descriptor(descriptor_path)
    coded = job_codes(job, codes_path, descriptor_path, (TRAIN,))
    names = varied_parameters(coded)
    coded = [s for s in coded if s.plan == MOTIONS]
    codes = all_codes(coded)
    rows = np.unique(np.linspace(0, len(codes) - 1, min(LATENT_FRAMES, len(codes))).astype(int))
    made: dict[str, Predictor] = {}
    for variant, path in encoder_paths.items():
        network = load_motion_invariant(path)
        frames = intrinsic_frames(coded, codes, network.config, names).at(rows)
        latent = pooled(network, *frame_evidence(network, frames))
        name = f"regressor, Wang's autoencoder ({variant}), z of the base material's training clips"
        made[name] = autoencoder_predictor(network, descriptor, latent)
    return made


def _rest_shapes(
    template: GarmentTemplate, body: Body, bodies: Callable[[Sequence], Body]
) -> Callable[[Sequence], np.ndarray]:
    """The rest shape of each sequence's garment: on another body it is graded to it."""
    made = {0: template.vertices}

    def rest(sequence: Sequence) -> np.ndarray:
        if sequence.body_index not in made:
            made[sequence.body_index] = graded(template, body, bodies(sequence)).vertices
        return made[sequence.body_index]

    return rest


if __name__ == "__main__":
    run_stage(main)
