"""Stage ``train_garment_regressor``: from a body motion to a garment in motion (Shi 2023, section 3.3).

In: the template, for the variant ``descriptor-space`` the shape descriptor and the codes that it made, and all shards
of a garment. Out: a model file and the table of losses. Trained on the motions plan, whose sequences share the base
parameters, and watched on unseen motions; the variant ``conditioned`` is trained on the plans that vary parameters and
bodies too, and watched where these are unseen as well.
"""

from __future__ import annotations

from collections.abc import Iterator

from datasets.sequences import Sequence, load_sequences
from datasets.shards import BODIES, MATERIALS, MOTIONS
from datasets.splits import TRAIN, UNSEEN_BODIES_AND_MOTIONS, UNSEEN_BOTH, UNSEEN_MOTIONS, SplitRule
from garments.template import GarmentTemplate
from models.conditioned_regressor import Conditions, fit_conditioned_regressor, save_conditioned_regressor
from models.descriptor_regressor import fit_descriptor_regressor, save_descriptor_regressor
from models.garment_fitting import GarmentExample, RegressorTraining, fit_garment_regressor, save_regressor
from models.garment_mirror import mirror_map, mirrored_example
from models.garment_regressor import RegressorConfig, variant_config
from models.motion_features import sequence_track
from models.shape_descriptor import load_shape_descriptor
from pipeline.garment_data import (
    CONDITIONED,
    DESCRIPTOR_SPACE,
    conditioned_examples,
    garment_examples,
    other_bodies,
)
from pipeline.intrinsic_data import LOGARITHMIC, SHARED, all_codes, job_codes
from pipeline.sequence_data import job_bodies, job_body, job_sequences
from pipeline.stage import Job, run_stage
from pipeline.training_job import TrainingProgress, settings_of, training_settings, values_of, work_dir

NETWORK = "window"
"""Variant whose features, window and sizes the variants with a training of their own take over."""


def main(job: Job) -> None:
    """Train and save."""
    trainings = {DESCRIPTOR_SPACE: _train_descriptor_space, CONDITIONED: _train_conditioned}
    trainings.get(job.spec["variant"], _train)(job)


def _train(job: Job) -> None:
    template_path, *shards = job.inputs
    template, model = GarmentTemplate.load(template_path), job.spec["model"]
    training = garment_examples(job_sequences(job, shards, (TRAIN,), (MOTIONS,)))
    if model.get("mirror"):
        training += _mirrored(training, template)
    held_out = garment_examples(job_sequences(job, shards, (UNSEEN_MOTIONS,), (MOTIONS,)))
    regressor, _ = fit_garment_regressor(
        training,
        template.faces,
        _config(job, template, job.spec["variant"]),
        _settings(job),
        work_dir(job.outputs[1]),
        validation=held_out,
        progress=_progress(job),
    )
    save_regressor(job.outputs[0], regressor)


def _train_descriptor_space(job: Job) -> None:
    template_path, descriptor_path, codes_path, *shards = job.inputs
    template = GarmentTemplate.load(template_path)
    descriptor = load_shape_descriptor(descriptor_path, template.faces)
    coded = job_codes(job, codes_path, descriptor_path, (TRAIN,), (MOTIONS,))
    frames = {s.frames for s in coded}
    if len(frames) > 1:
        raise ValueError(f"{template.name}: sequences of different lengths are encoded: {sorted(frames)} frames")
    regressor = fit_descriptor_regressor(
        [sequence_track(s) for s in coded],
        all_codes(coded).reshape(len(coded), *frames, -1),
        descriptor,
        _config(job, template, NETWORK),
        _settings(job),
        work_dir(job.outputs[1]),
        validation=garment_examples(job_sequences(job, shards, (UNSEEN_MOTIONS,), (MOTIONS,))),
        progress=_progress(job),
    )
    save_descriptor_regressor(job.outputs[0], regressor)


def _train_conditioned(job: Job) -> None:
    template_path, *shards = job.inputs
    template, base = GarmentTemplate.load(template_path), None
    watched = (UNSEEN_MOTIONS, UNSEEN_BOTH, UNSEEN_BODIES_AND_MOTIONS)
    others = other_bodies(template, job_body(job), job_bodies(job))
    training, held_out = [], []
    for sequence in _one_by_one(job, shards, (TRAIN, *watched), (MOTIONS, MATERIALS, BODIES)):
        # Of the material plans' unseen motions there are as many as of all else: where both are unseen is enough.
        if sequence.split == TRAIN:
            training += conditioned_examples([sequence], others)
        elif sequence.split != UNSEEN_MOTIONS or sequence.plan == MOTIONS:
            held_out += conditioned_examples([sequence], others)
        if sequence.plan == MOTIONS and base is None:
            base = Conditions(sequence.parameters, sequence.shape)
    if not training or base is None:
        raise ValueError(f"{template.name}: no simulated sequence to train on; were all of them dropped?")
    regressor = fit_conditioned_regressor(
        training,
        base,
        LOGARITHMIC,
        template.faces,
        _config(job, template, NETWORK),
        _settings(job),
        work_dir(job.outputs[1]),
        validation=held_out,
        progress=_progress(job),
        # Sixteen sets that are simulated together have these in common, and their clips too: the clip gives them away.
        without=SHARED,
    )
    save_conditioned_regressor(job.outputs[0], regressor)


def _one_by_one(job: Job, shards: list[str], splits: tuple[str, ...], plans: tuple[str, ...]) -> Iterator[Sequence]:
    """Sequences of the shards, a shard at a time: the world vertices of all would be in memory beside the examples."""
    for shard in shards:
        yield from load_sequences([shard], SplitRule(**job.spec["splits"]), splits, plans)


def _config(job: Job, template: GarmentTemplate, variant: str) -> RegressorConfig:
    own = {"variant": job.spec["variant"]} | values_of(RegressorConfig, job.spec["model"])
    return variant_config(variant, len(template.vertices), **own)


def _settings(job: Job) -> RegressorTraining:
    return settings_of(RegressorTraining, job.spec["model"], training=training_settings(job, job.spec["model"]))


def _progress(job: Job) -> TrainingProgress:
    return TrainingProgress(f"{job.spec['garment']} regressor {job.spec['variant']}")


def _mirrored(examples: list[GarmentExample], template: GarmentTemplate) -> list[GarmentExample]:
    """The examples with left and right exchanged; none of a garment that is not its own mirror image."""
    if template.pieces > 1:  # the nearest triangle to a mirrored vertex may be another layer's
        print(f"[train_garment_regressor] {template.name}: garments in layers are not mirrored", flush=True)
        return []
    try:
        weights = mirror_map(template.vertices, template.faces)
    except ValueError as error:
        print(f"[train_garment_regressor] {template.name}: {error}; trained without mirrored clips", flush=True)
        return []
    return [mirrored_example(example, weights) for example in examples]


if __name__ == "__main__":
    run_stage(main)
