"""Stage ``train_shape_descriptor``: garment frames to a short code and back (Wang 2019, section 3.3).

In: the template and all shards of a garment. Out: a model file and the table of losses. Trained on every frame of the
training split, of both plans; watched on frames whose parameters and motion are both unseen.
"""

from __future__ import annotations

from datasets.splits import TRAIN, UNSEEN_BOTH
from garments.template import GarmentTemplate
from models.descriptor_fitting import fit_shape_descriptor
from models.shape_descriptor import ShapeDescriptorConfig, save_shape_descriptor
from pipeline.sequence_data import canonical_frames, job_body, job_sequences
from pipeline.stage import Job, run_stage
from pipeline.training_job import TrainingProgress, settings_of, training_settings, work_dir

VALIDATION_STRIDE = 10
"""Neighbouring frames are alike: every tenth tells the validation error."""


def main(job: Job) -> None:
    """Train and save."""
    template, *shards = job.inputs
    body, model, variant = job_body(job), job.spec["model"], job.spec["variant"]
    # Read once: whichever splits are asked for, all of a shard has to be decompressed.
    sequences = job_sequences(job, shards, (TRAIN, UNSEEN_BOTH))
    for split in (TRAIN, UNSEEN_BOTH):
        if not any(s.split == split for s in sequences):
            raise ValueError(
                f"{job.spec['garment']}: no simulated sequence in split {split}; were all of them dropped?"
            )
    training, held_out = (
        canonical_frames([s for s in sequences if s.split == split], body) for split in (TRAIN, UNSEEN_BOTH)
    )
    del sequences
    module = fit_shape_descriptor(
        training,
        GarmentTemplate.load(template).faces,
        settings_of(ShapeDescriptorConfig, model, variant=variant),
        training_settings(job, model),
        work_dir(job.outputs[1]),
        validation=held_out[::VALIDATION_STRIDE],
        progress=TrainingProgress(f"{job.spec['garment']} shape descriptor {variant}"),
    )
    save_shape_descriptor(job.outputs[0], module)


if __name__ == "__main__":
    run_stage(main)
