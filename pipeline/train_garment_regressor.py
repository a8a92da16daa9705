"""Stage ``train_garment_regressor``: from a body motion to a garment in motion (Shi 2023, section 3.3).

In: the template and all shards of a garment. Out: a model file and the table of losses. Trained on the motions plan,
whose sequences share the base parameters; watched on unseen motions.
"""

from __future__ import annotations

from datasets.shards import MOTIONS
from datasets.splits import TRAIN, UNSEEN_MOTIONS
from garments.template import GarmentTemplate
from models.garment_fitting import GarmentExample, RegressorTraining, fit_garment_regressor, save_regressor
from models.garment_mirror import mirror_map, mirrored_example
from models.garment_regressor import RegressorConfig, variant_config
from pipeline.garment_data import garment_examples
from pipeline.sequence_data import job_sequences
from pipeline.stage import Job, run_stage
from pipeline.training_job import TrainingProgress, settings_of, training_settings, values_of, work_dir


def main(job: Job) -> None:
    """Train and save."""
    template_path, *shards = job.inputs
    template, model, variant = GarmentTemplate.load(template_path), job.spec["model"], job.spec["variant"]
    training = garment_examples(job_sequences(job, shards, (TRAIN,), (MOTIONS,)))
    if model.get("mirror"):
        training += _mirrored(training, template)
    held_out = garment_examples(job_sequences(job, shards, (UNSEEN_MOTIONS,), (MOTIONS,)))
    regressor, _ = fit_garment_regressor(
        training,
        template.faces,
        variant_config(variant, len(template.vertices), **values_of(RegressorConfig, model)),
        settings_of(RegressorTraining, model, training=training_settings(job, model)),
        work_dir(job.outputs[1]),
        validation=held_out,
        progress=TrainingProgress(f"{job.spec['garment']} regressor {variant}"),
    )
    save_regressor(job.outputs[0], regressor)


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
