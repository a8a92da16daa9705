"""Stage ``train_recognition``: the judge of generated motions (Action2Motion's metrics, on our own training split).

In: all motion batches. Out: a model file and the table of losses.
"""

from __future__ import annotations

from models.motion_fitting import fit_recognition, save_recognition
from models.recognition import RecognitionConfig
from pipeline.motion_data import labelled_motions, split_clips
from pipeline.stage import Job, run_stage
from pipeline.training_job import TrainingProgress, settings_of, training_settings, work_dir


def main(job: Job) -> None:
    """Train and save."""
    model = job.spec["model"]
    (poses, labels, _), (*held_out, _) = (labelled_motions(clips) for clips in split_clips(job, job.inputs))
    network, _ = fit_recognition(
        poses,
        labels,
        settings_of(RecognitionConfig, model, labels=tuple(job.spec["labels"])),
        training_settings(job, model),
        model["batch"],
        work_dir(job.outputs[1]),
        validation=held_out,
        progress=TrainingProgress("recognition"),
    )
    save_recognition(job.outputs[0], network)


if __name__ == "__main__":
    run_stage(main)
