"""Stage ``time_solvers``: seconds a frame of simulators and networks, on the same machine in the same run.

In: the template, a batch of motions and the trained models. Out: the garment's rows of the table ``timing``: the XPBD
simulator and the implicit baseline on the same garment, body and clip; the networks' roads to the same frames (Shi
2023, Table 2; Wang 2019, section 3.6); ARCSim itself on that clip where ``timing.arcsim.binary`` names the program;
and its published figures, on other hardware. One thread throughout.
"""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np
import torch

from body.model import Body
from evaluation.table import write_table
from garments.template import GarmentTemplate
from geometry.rotations import axis_angle_to_6d
from models.garment_fitting import load_regressor
from models.intrinsic_fitting import decode_frames, load_motion_invariant
from models.motion_features import MotionTrack
from models.motion_fitting import load_motion_cvae
from models.refinement import RefinementSettings, Refiner
from models.shape_descriptor import decode_all, load_shape_descriptor
from motions.clip import Clip
from motions.clip_file import read_clips
from motions.lead_in import lead_in
from pipeline.sequence_data import job_body
from pipeline.stage import Job, run_stage
from sim.arcsim.run import arcsim_rows, find_binary
from sim.arcsim.scene import ArcsimSettings
from sim.implicit.settings import ImplicitSettings
from sim.parameters import base_parameters
from sim.timing import PUBLISHED_ARCSIM, time_solvers

REPETITIONS = 5
"""Times that a network's road is travelled; the median counts, the first time warms up."""


def main(job: Job) -> None:
    """Time the simulators, then the networks."""
    torch.set_num_threads(1)
    spec, timing = job.spec, job.spec["timing"]
    binary = timing["arcsim"]["binary"]
    if binary:
        find_binary(binary)  # before time is spent
    template_path, motions_path, *models = job.inputs
    body, template = job_body(job), GarmentTemplate.load(template_path)
    clip = read_clips(motions_path)[0]
    lead_pose, lead_root = lead_in(clip, body, spec["lead_in"])
    pose, root = np.concatenate([lead_pose, clip.pose]), np.concatenate([lead_root, clip.root])
    implicit = ImplicitSettings(fps=spec["fps"], **timing["implicit"])
    parameters = base_parameters(spec["base"])
    timed = (template, body, pose, root, spec["lead_in"], parameters, timing["frames"])
    rows = time_solvers(*timed, implicit, warm_up=timing["warmup"])
    if binary:
        settings = ArcsimSettings(spec["fps"], implicit.steps_per_frame, spec["settle"])
        rows += arcsim_rows(binary, *timed, timing["warmup"], settings)
    baseline = next(row for row in rows if row["solver"].startswith("implicit"))["median_s_per_frame"]
    track = MotionTrack(pose, body.joint_positions(pose, root), spec["lead_in"], spec["fps"])
    rows += network_rows(template, body, clip, track, models, RefinementSettings(**spec["refinement"]))
    for row in rows:
        row["speed_up_over_implicit"] = baseline / row["median_s_per_frame"]
    measured = [{"garment": spec["garment"], "clip": clip.name} | row for row in rows]
    published = [{"garment": spec["garment"], "clip": ""} | row for row in PUBLISHED_ARCSIM.get(template.kind, ())]
    write_table(job.outputs[0], measured + published)


def network_rows(
    template: GarmentTemplate,
    body: Body,
    clip: Clip,
    track: MotionTrack,
    models: list[str],
    refinement: RefinementSettings,
) -> list[dict]:
    """Seconds a frame of what the networks do for one clip: a median over repetitions of the whole clip."""
    descriptor, intrinsic = load_shape_descriptor(models[0]), load_motion_invariant(models[1])
    cvae, regressor = load_motion_cvae(models[2]), load_regressor(models[3])
    frames = clip.frames
    body_vertices = body.posed(clip.pose, clip.root)
    refiner = Refiner(template.topology, body.faces, len(body.vertices), refinement)
    pose6d = axis_angle_to_6d(clip.pose).astype(np.float32)[None]
    signatures = np.zeros((frames, intrinsic.signature_mean.numel()), dtype=np.float32)
    latents = np.zeros((frames, intrinsic.config.latent), dtype=np.float32)

    def intrinsic_decode() -> np.ndarray:
        return decode_all(descriptor, decode_frames(intrinsic, latents, signatures))

    roads: dict[str, Callable[[], object]] = {
        "garment regressor": lambda: regressor.dress(track),
        "motion-invariant decode + shape decode": intrinsic_decode,
        "motion CVAE, encode and decode": lambda: cvae.reconstruct(pose6d, [clip.label]),
        "body, linear blend skinning": lambda: body.posed(clip.pose, clip.root),
    }
    rows = [_row(name, template, frames, road) for name, road in roads.items()]
    predicted = track.in_world(regressor.dress(track))
    rows.append(
        _row("collision refinement", template, frames, lambda: refiner.refine_sequence(predicted, body_vertices))
    )
    return rows


def _row(name: str, template: GarmentTemplate, frames: int, road: Callable[[], object]) -> dict:
    seconds = []
    for _ in range(REPETITIONS + 1):
        start = time.perf_counter()
        road()
        seconds.append((time.perf_counter() - start) / frames)
    counted = np.array(seconds[1:])
    return {
        "solver": name,
        "vertices": len(template.vertices),
        "frames": frames,
        "threads": 1,
        "median_s_per_frame": float(np.median(counted)),
        "p95_s_per_frame": float(np.quantile(counted, 0.95)),
        "source": f"measured in this run, batch 1, {REPETITIONS} repetitions of the clip",
    }


if __name__ == "__main__":
    run_stage(main)
