"""Stage ``fine_tune_regressor``: self-supervised collision refinement (Shi 2023, section 3.4).

In: the template, the motion CVAE and a trained regressor. Out: the tuned regressor, and a table of what tuning did.
Motions are sampled from the CVAE, every label as often, put on the ground and dressed; no ground truth is used.
"""

from __future__ import annotations

from dataclasses import asdict

import torch

from evaluation.table import write_table
from models.collision_tuning import CollisionTuning, fine_tune_collisions
from models.garment_fitting import load_regressor, save_regressor
from models.motion_fitting import load_motion_cvae
from pipeline.motion_data import generated_tracks
from pipeline.sequence_data import job_body
from pipeline.stage import Job, run_stage
from pipeline.training_job import TrainingProgress, settings_of, training_settings


def main(job: Job) -> None:
    """Sample, dress, tune, save."""
    spec, model = job.spec, job.spec["model"]
    _, cvae_path, regressor_path = job.inputs
    body, cvae, regressor = job_body(job), load_motion_cvae(cvae_path), load_regressor(regressor_path)
    labels = [spec["labels"][i % len(spec["labels"])] for i in range(model["motions"])]
    generator = torch.Generator().manual_seed(spec["seed"])
    tracks = generated_tracks(cvae, labels, spec["frames"], spec["fps"], spec["lead_in"], body, generator)
    report = fine_tune_collisions(
        regressor,
        tracks,
        body,
        settings_of(CollisionTuning, model, training=training_settings(job, model)),
        f"{job.outputs[0].removesuffix('.pt')}_training",
        progress=TrainingProgress(f"{spec['garment']} collision tuning"),
    )
    figures = asdict(report)
    row = {
        "garment": spec["garment"],
        "generated_motions": figures["motions"],
        "discarded_motions": figures["discarded"],
        "inside_before_percent": 100.0 * figures["inside_before"],
        "inside_after_percent": 100.0 * figures["inside_after"],
        "depth_before_mm": 1000.0 * figures["depth_before"],
        "depth_after_mm": 1000.0 * figures["depth_after"],
        "moved_rms_mm": 1000.0 * figures["moved"],
    }
    write_table(job.outputs[1], [row])
    save_regressor(job.outputs[0], regressor)


if __name__ == "__main__":
    run_stage(main)
