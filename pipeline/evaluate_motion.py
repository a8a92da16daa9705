"""Stage ``evaluate_motion``: how well the motion CVAE reconstructs and invents (Shi 2023, Tables 3, 4 and 5).

In: the recognition network, the CVAE and all motion batches. Out: the tables ``motion_reconstruction`` and
``motion_generation``.
"""

from __future__ import annotations

from evaluation.motion import MotionSet, generation_rows, reconstruction_rows
from evaluation.table import write_table
from models.motion_fitting import load_motion_cvae, load_recognition
from pipeline.motion_data import labelled_poses
from pipeline.sequence_data import job_body
from pipeline.stage import Job, run_stage


def main(job: Job) -> None:
    """Evaluate on the held-out clips."""
    recognition_path, cvae_path, *motions = job.inputs
    body, cvae, recognition = job_body(job), load_motion_cvae(cvae_path), load_recognition(recognition_path)
    sets = {}
    for held_out in (False, True):
        poses, labels = labelled_poses(job, motions, held_out)
        sets[held_out] = MotionSet(poses, tuple(labels), job.spec["fps"])
    train, test = sets[False], sets[True]
    print(f"[motion] {len(train.labels)} training and {len(test.labels)} held-out clips", flush=True)
    write_table(job.outputs[0], reconstruction_rows(cvae, train, test, body))
    rows = generation_rows(
        cvae, recognition, train, test, body, job.spec["seed"], job.spec["evaluation"]["repetitions"]
    )
    write_table(job.outputs[1], rows)


if __name__ == "__main__":
    run_stage(main)
