"""Stage ``train_motion_cvae``: from a label to body motions (Shi 2023, section 3.2), or a baseline of that.

In: all motion batches. Out: a model file and the table of losses.
"""

from __future__ import annotations

from models.motion_fitting import fit_motion_cvae, save_motion_cvae, variant_config
from pipeline.motion_data import labelled_motions, split_clips
from pipeline.sequence_data import job_body
from pipeline.stage import Job, run_stage
from pipeline.training_job import TrainingProgress, training_settings, work_dir


def main(job: Job) -> None:
    """Train and save."""
    model, variant = job.spec["model"], job.spec["variant"]
    (poses, labels, root), held_out = (labelled_motions(clips) for clips in split_clips(job, job.inputs))
    sizes = {name: value for name, value in model.items() if name not in ("batch", "training")}
    cvae, _ = fit_motion_cvae(
        poses,
        labels,
        job_body(job),
        variant_config(variant, job.spec["labels"], poses, **sizes),
        training_settings(job, model),
        model["batch"],
        work_dir(job.outputs[1]),
        validation=held_out,
        progress=TrainingProgress(f"motion CVAE {variant}"),
        root=root,
    )
    save_motion_cvae(job.outputs[0], cvae)


if __name__ == "__main__":
    run_stage(main)
