"""Stage ``fine_tune_regressor``: self-supervised collision refinement (Shi 2023, section 3.4).

In: the template, the motion CVAE and a trained regressor. Out: the tuned regressor, and a table of what tuning did, and
of what refinement leaves inside the body on every one of the motions. They are sampled from the CVAE, every label that
may be trained on as often, put on the ground and dressed; no ground truth is used.
"""

from __future__ import annotations

from dataclasses import asdict

import numpy as np
import torch

from body.model import Body
from evaluation.collisions import Contact, refine_and_judge
from evaluation.table import write_table
from garments.template import GarmentTemplate
from models.collision_tuning import CollisionTuning, fine_tune_collisions
from models.garment_fitting import load_regressor, save_regressor
from models.motion_features import MotionTrack
from models.motion_fitting import load_motion_cvae
from models.refinement import RefinementSettings, Refiner
from pipeline.motion_data import generated_tracks
from pipeline.sequence_data import job_body
from pipeline.stage import Job, run_stage
from pipeline.training_job import TrainingProgress, settings_of, training_settings

STRIDE = 3
"""Every how many frames the untuned garments are looked at."""


def main(job: Job) -> None:
    """Sample, dress, tune, refine, save."""
    spec, model = job.spec, job.spec["model"]
    template_path, cvae_path, regressor_path = job.inputs
    body, cvae, regressor = job_body(job), load_motion_cvae(cvae_path), load_regressor(regressor_path)
    labels = [spec["labels"][i % len(spec["labels"])] for i in range(model["motions"])]
    generator = torch.Generator().manual_seed(spec["seed"])
    tracks = generated_tracks(cvae, labels, spec["frames"], spec["fps"], spec["lead_in"], body, generator)
    untuned = regressor.dress_all(tracks)
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
    row |= _all_motions(untuned, regressor.dress_all(tracks), tracks, body, GarmentTemplate.load(template_path), spec)
    write_table(job.outputs[1], [row])
    save_regressor(job.outputs[0], regressor)


def _all_motions(
    untuned: list[np.ndarray],
    tuned: list[np.ndarray],
    tracks: list[MotionTrack],
    body: Body,
    template: GarmentTemplate,
    spec: dict,
) -> dict[str, float]:
    """Collisions on all generated motions, kept or not, by exact distances: before, after tuning, after refinement.

    Rates are means over motions, depths and moves maxima. Before tuning every ``STRIDE``-th frame is looked at.
    """
    refiner = Refiner(template.topology, body.faces, len(body.vertices), RefinementSettings(**spec["refinement"]))
    laplacian, before, found = template.topology.uniform_laplacian(), Contact(), []
    for track, first, garment in zip(tracks, untuned, tuned, strict=True):
        rotation, position = (x[track.lead :] for x in track.pelvis_frames())
        under = body.posed(track.pose[track.lead :], position - body.joints[0])
        first, garment = (np.matmul(v, np.swapaxes(rotation, 1, 2)) + position[:, None] for v in (first, garment))
        for vertices, surface in zip(first[::STRIDE], under[::STRIDE], strict=True):
            before.add(refiner.body.at(surface).query(vertices).distance)
        found.append(refine_and_judge(refiner, laplacian, garment.astype(np.float32), under)[1])
    most = {name: max if "deepest" in name or "largest" in name else np.mean for name in found[0]}
    every = {name: float(choose([f[name] for f in found])) for name, choose in most.items()}
    renamed = {name.replace("all_frames_", "tuned_"): value for name, value in every.items()}
    return before.figures("untuned_") | renamed


if __name__ == "__main__":
    run_stage(main)
