"""Stage ``simulate``: one shard of ground truth.

In: a garment template, motion batches, and in the spec the (parameter set, clip) pairs of the shard. Out: an HDF5
shard. A simulation outside the quality bounds is tried again with more substeps; what no attempt brings inside is
dropped and recorded in the shard, never written as good and never silently missing.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np

from body.model import Body
from datasets.shards import DroppedSimulation, ShardHeader, ShardWriter, SimulatedSequence
from garments.template import GarmentTemplate
from motions.clip import Clip
from pipeline.canonical import canonical
from pipeline.progress import Progress
from pipeline.simulation_inputs import checked_inputs, naming
from pipeline.stage import Job, run_stage
from sim.parameters import INTRINSIC_PARAMETERS
from sim.result import SimulationResult
from sim.settings import SimulationSettings
from sim.simulate import SOLVER_VERSION, Simulator


def main(job: Job) -> None:
    """Simulate every pair of the shard and write what holds."""
    spec = job.spec
    inputs = checked_inputs(job)
    body, template, clips = inputs.body, inputs.template, inputs.clips
    solver = spec["solver"]
    settings = SimulationSettings(fps=spec["fps"], device=job.device, settle_seconds=solver["settle"])
    with naming(job.inputs[0]):
        simulator = Simulator(template, body, settings)

    frames = sum(clips[name].frames + spec["lead_in"] for _, name, _ in spec["simulations"])
    progress = Progress(f"simulate {spec['garment']} {spec['plan']}", frames, "frames")
    with ShardWriter(job.outputs[0], _header(spec, template, body)) as shard:
        for phi, clip_name, take_index in spec["simulations"]:
            clip = clips[clip_name]
            parameters = inputs.parameters[phi]
            lead_pose, lead_root = inputs.leads[clip_name]
            result, used, attempts = simulate_within_bounds(simulator, clip, lead_pose, lead_root, parameters, solver)
            if result.failure is not None:
                print(f"[simulate] dropped {spec['garment']} set {phi} on {clip_name}: {result.failure}", flush=True)
                shard.drop(DroppedSimulation(clip_name, clip.label, phi, result.failure, attempts))
            else:
                shard.add(
                    SimulatedSequence(
                        clip=clip_name,
                        take=clip.take,
                        take_index=take_index,
                        label=clip.label,
                        phi=phi,
                        parameters=used,
                        vertices=result.vertices,
                        pose=clip.pose,
                        root=clip.root,
                        joints=body.joint_positions(clip.pose, clip.root),
                        lead_pose=lead_pose,
                        lead_root=lead_root,
                        lead_joints=body.joint_positions(lead_pose, lead_root),
                        quality=result.quality | {"attempts": attempts},
                    )
                )
            progress(clip.frames + spec["lead_in"])
    progress.finish()


def simulate_within_bounds(
    simulator: Simulator,
    clip: Clip,
    lead_pose: np.ndarray,
    lead_root: np.ndarray,
    parameters: Mapping[str, float],
    solver: Mapping[str, Any],
) -> tuple[SimulationResult, dict[str, float], int]:
    """Simulate a clip, with more substeps at every further attempt, until the result is inside the bounds.

    Returns:
        The last result (its ``failure`` says why no attempt held), the parameters it was made with (the substeps are
        those of the last attempt) and the number of attempts.
    """
    pose, root = np.concatenate([lead_pose, clip.pose]), np.concatenate([lead_root, clip.root])
    used = dict(parameters)
    for attempt in range(1, solver["attempts"] + 1):
        result = simulator.run(pose, root, len(lead_pose), used)
        if result.failure is None:
            result.failure = out_of_bounds(result.quality, solver["bounds"], len(simulator.template.vertices))
        if result.failure is None or attempt == solver["attempts"]:
            break
        used["substeps"] = float(round(used["substeps"] * solver["substeps_factor"]))
    return result, used, attempt


def out_of_bounds(quality: Mapping[str, float], bounds: Mapping[str, float], vertex_count: int) -> str | None:
    """The first quality figure outside its bound, in one sentence; None when all are inside."""
    figures = (
        ("p99_edge_strain", quality["p99_edge_strain"], "p99 edge strain", ""),
        ("penetration", quality["deepest_penetration_m"], "penetration", " m"),
        ("vertices_inside", quality["vertices_inside"] / vertex_count, "share of vertices inside the body", ""),
        ("residual_speed", quality["residual_speed_m_s"], "residual speed", " m/s"),
    )
    for key, value, name, unit in figures:
        if not value <= bounds[key]:
            return f"{name} {value:.3g}{unit} above {bounds[key]:g}{unit}"
    return None


def _header(spec: Mapping[str, Any], template: GarmentTemplate, body: Body) -> ShardHeader:
    return ShardHeader(
        garment=spec["garment"],
        plan=spec["plan"],
        solver_version=SOLVER_VERSION,
        seed=spec["seed"],
        fps=spec["fps"],
        spec=canonical(spec),
        template_vertices=template.vertices,
        template_faces=template.faces,
        pinned=template.pinned,
        body_name=body.name,
        body_digest=body.digest,
        body_faces=body.faces,
        body_shape=np.asarray(spec["body"]["shape"], dtype=np.float64),
        parameter_names=tuple(p.name for p in INTRINSIC_PARAMETERS),
        parameter_units=tuple(p.unit for p in INTRINSIC_PARAMETERS),
        parameter_groups=tuple(p.group for p in INTRINSIC_PARAMETERS),
    )


if __name__ == "__main__":
    run_stage(main)
