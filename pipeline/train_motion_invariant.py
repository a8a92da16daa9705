"""Stage ``train_motion_invariant``: what a garment is made of, apart from its wearer's motion (Wang 2019, section 3.4).

In: the shape descriptor in use and all shards of a garment. Out: a model file and the table of losses. Trained on the
materials plan, where many parameter sets meet the same motions; watched where both are unseen.
"""

from __future__ import annotations

from datasets.shards import MATERIALS
from datasets.splits import TRAIN, UNSEEN_BOTH
from models.motion_invariant import MotionInvariantConfig, fit_motion_invariant, save_motion_invariant
from models.shape_descriptor import load_shape_descriptor
from pipeline.intrinsic_data import intrinsic_frames
from pipeline.sequence_data import job_body, job_sequences
from pipeline.stage import Job, run_stage
from pipeline.training_job import TrainingProgress, settings_of, training_settings, work_dir


def main(job: Job) -> None:
    """Train and save."""
    descriptor_path, *shards = job.inputs
    body, model, variant, window = job_body(job), job.spec["model"], job.spec["variant"], job.spec["window"]
    descriptor = load_shape_descriptor(descriptor_path)
    training = intrinsic_frames(job_sequences(job, shards, (TRAIN,), (MATERIALS,)), descriptor, window, body)
    held_out = intrinsic_frames(job_sequences(job, shards, (UNSEEN_BOTH,), (MATERIALS,)), descriptor, window, body)
    module = fit_motion_invariant(
        training,
        settings_of(MotionInvariantConfig, model, variant=variant),
        training_settings(job, model),
        work_dir(job.outputs[1]),
        validation=held_out,
        progress=TrainingProgress(f"{job.spec['garment']} motion-invariant {variant}"),
    )
    save_motion_invariant(job.outputs[0], module)


if __name__ == "__main__":
    run_stage(main)
