"""Stage ``time_gsnet``: seconds a frame of GSNet and of the simulator on the same garments (Peng 2023, Fig. 9).

In: the network in use, a batch of motions and the templates. Out: the table ``gsnet_timing``. One template of
every category, seen in training, and a skirt of the 3,326 vertices that the papers' garments have. One thread. The
template is encoded beforehand; the network goes frame by frame, as in an interactive program, and through the whole
clip at once. The simulator poses the body too.
"""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np
import torch

from body.model import Body
from evaluation.table import Row, write_table
from garments.build import build_template
from garments.spec import GarmentSpec
from garments.template import GarmentTemplate
from models.garment_animator import Motion
from models.garment_graph import GarmentGraph, material_row
from models.gsnet import GSNet
from models.gsnet_fitting import load_animator
from models.motion_features import MotionTrack
from models.physical_regressor import corrector
from models.refinement import RefinementSettings, Refiner
from motions.clip_file import read_clips
from motions.lead_in import lead_in
from pipeline.sequence_data import job_body
from pipeline.stage import Job, run_stage
from sim.parameters import base_parameters
from sim.settings import SimulationSettings
from sim.simulate import simulate_clip

FINE = GarmentSpec("skirt_3326", "skirt", 3326)
"""The papers' skirt."""

REPETITIONS = 5
"""Times that the network's road is travelled, after one that warms up."""


def main(job: Job) -> None:
    """Time the network and the simulator garment by garment."""
    torch.set_num_threads(1)
    spec, timing = job.spec, job.spec["timing"]
    model_path, motions_path, *templates = job.inputs
    network, body = load_animator(model_path), job_body(job)
    if not isinstance(network, GSNet):
        raise ValueError(f"{model_path}: only the network of kind {GSNet.kind!r} is timed, this is {network.kind!r}")
    clip = read_clips(motions_path)[0]
    lead_pose, lead_root = lead_in(clip, body, spec["lead_in"])
    needed = spec["lead_in"] + timing["warmup"] + timing["frames"]
    pose = np.concatenate([lead_pose, clip.pose])[:needed]
    root = np.concatenate([lead_root, clip.root])[:needed]
    track = MotionTrack(pose, body.joint_positions(pose, root), spec["lead_in"], spec["fps"])
    made = [(GarmentTemplate.load(path), base) for path, base in zip(templates, spec["bases"], strict=True)]
    if job.spec["fine"]:
        made.append((build_template(FINE, body), spec["bases"][0]))
    rows: list[Row] = []
    for template, base in made:
        parameters = base_parameters(base)
        mine = network_rows(network, template, body, track, root, parameters, RefinementSettings(**spec["refinement"]))
        settings = SimulationSettings(fps=spec["fps"], device="cpu")
        result = simulate_clip(template, body, pose, root, spec["lead_in"], parameters, settings)
        if result.failure is not None:
            raise ValueError(f"timing: the simulation of {template.name} failed: {result.failure}")
        mine.append(_row("XPBD with self-contact", template, result.frame_seconds[timing["warmup"] :]))
        simulated = mine[-1]["median_s_per_frame"]
        rows += [row | {"speed_up_over_xpbd": simulated / row["median_s_per_frame"]} for row in mine]
    write_table(job.outputs[0], rows)


@torch.no_grad()
def network_rows(
    network: GSNet,
    template: GarmentTemplate,
    body: Body,
    track: MotionTrack,
    root: np.ndarray,
    parameters: dict[str, float],
    refinement: RefinementSettings,
) -> list[Row]:
    """Times of the network on one garment, and of what brings its vertices out of the body."""
    graph, material = GarmentGraph.of(template, body), material_row(parameters, network.config.materials)
    motion, frames = Motion.of([track], body), track.frames
    encoding = network.encode(graph, torch.as_tensor(material)[None])
    refiner = Refiner(template.topology, body.faces, len(body.vertices), refinement)
    correct = corrector(network, graph, material, refinement.clearance)
    rotation, position = (x[track.lead :] for x in track.pelvis_frames())
    under = body.posed(track.pose[track.lead :], root[track.lead :])
    under = np.matmul(under - position[:, None], rotation)
    dressed = network.unroll(encoding, motion)[0].numpy()
    previous = torch.as_tensor(dressed)[None]

    def encode(_: int) -> None:
        network.encode(graph, torch.as_tensor(material)[None])

    def whole(_: int) -> None:
        network.unroll(encoding, motion)

    def step(t: int) -> None:
        network.step(encoding, motion, track.lead + t, previous[:, max(t - 1, 0)])

    def bring_out(t: int) -> None:
        posed = refiner.body.at(under[t])
        hits = refiner.near(dressed[t], posed)
        inside = hits.distance < 0.0
        if inside.any():
            corrected = correct(dressed[t], hits.point, hits.normal)
            refiner.refine_hits(corrected, posed, refiner.near(corrected, posed))

    return [
        _row("template encoding, once", template, _seconds(1, encode)),
        _row("gsnet, frame by frame", template, _seconds(frames, step)),
        _row("gsnet, whole clip", template, _seconds(1, whole) / len(track.pose)),
        _row("physical regressor and projection", template, _seconds(frames, bring_out)),
    ]


def _seconds(count: int, work: Callable[[int], None]) -> np.ndarray:
    """Seconds of ``work(0..count - 1)``, of each the median over repetitions; the first repetition warms up."""
    taken = np.empty((REPETITIONS + 1, count))
    for repetition in taken:
        for t in range(count):
            start = time.perf_counter()
            work(t)
            repetition[t] = time.perf_counter() - start
    return np.median(taken[1:], axis=0)


def _row(what: str, template: GarmentTemplate, seconds: np.ndarray) -> Row:
    return {
        "garment": template.name,
        "vertices": len(template.vertices),
        "what": what,
        "threads": 1,
        "median_s_per_frame": float(np.median(seconds)),
        "p95_s_per_frame": float(np.quantile(seconds, 0.95)),
    }


if __name__ == "__main__":
    run_stage(main)
