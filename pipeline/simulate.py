"""Stage ``simulate``: one shard of ground truth.

In: a garment template, motion batches, and in the spec the (parameter set, clip) pairs of the shard. Out: an HDF5
shard. Sixteen simulations run at a time. One outside the quality bounds is tried again with more substeps; what no
attempt brings inside is dropped and recorded in the shard, never written as good and never silently missing.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache
from typing import Any

import numpy as np

from body.model import Body
from datasets.shards import MOTIONS, DroppedSimulation, ShardHeader, ShardWriter, SimulatedSequence
from garments.template import GarmentTemplate
from pipeline.canonical import canonical
from pipeline.ensembles import Outcome, Planned, simulate_all
from pipeline.progress import Progress
from pipeline.simulation_inputs import checked_inputs, naming
from pipeline.stage import Job, run_stage
from sim.parameters import ENSEMBLE, INTRINSIC_PARAMETERS
from sim.settings import SimulationSettings
from sim.simulate import SOLVER_VERSION, Simulator


def main(job: Job) -> None:
    """Simulate every pair of the shard and write what holds."""
    spec = job.spec
    inputs = checked_inputs(job)
    body, template, clips = inputs.body, inputs.template, inputs.clips
    solver = spec["solver"]
    settings = SimulationSettings(
        fps=spec["fps"], device=job.device, settle_seconds=solver["settle"], self_contact=solver["self_contact"]
    )
    own_motions = spec["plan"] == MOTIONS

    @cache
    def simulators(own_motions: bool) -> Simulator:
        return Simulator(template, body, settings, worlds=ENSEMBLE, own_motions=own_motions)

    with naming(job.inputs[0]):
        simulators(own_motions)

    planned = [
        Planned(phi, clips[name], take_index, inputs.leads[name], inputs.parameters[phi])
        for phi, name, take_index in spec["simulations"]
    ]
    frames = sum(one.clip.frames + spec["lead_in"] for one in planned)
    progress = Progress(f"simulate {spec['garment']} {spec['plan']}", frames, "frames")
    with ShardWriter(job.outputs[0], shard_header(spec, template, body)) as shard:
        for outcome in simulate_all(simulators, planned, own_motions, solver, progress):
            one, result = outcome.planned, outcome.result
            if result.failure is None:
                shard.add(simulated_sequence(outcome, body))
            else:
                what = f"{spec['garment']} set {one.phi} on {one.clip.name}"
                print(f"[simulate] dropped {what}: {result.failure}", flush=True)
                dropped = DroppedSimulation(one.clip.name, one.clip.label, one.phi, result.failure, outcome.attempts)
                shard.drop(dropped)
    progress.finish()


def simulated_sequence(outcome: Outcome, body: Body) -> SimulatedSequence:
    """A simulation that held, as a shard stores it."""
    one, clip = outcome.planned, outcome.planned.clip
    return SimulatedSequence(
        clip=clip.name,
        take=clip.take,
        take_index=one.take_index,
        label=clip.label,
        phi=one.phi,
        parameters=outcome.parameters,
        vertices=outcome.result.vertices,
        pose=clip.pose,
        root=clip.root,
        joints=body.joint_positions(clip.pose, clip.root),
        lead_pose=one.lead[0],
        lead_root=one.lead[1],
        lead_joints=body.joint_positions(*one.lead),
        quality=outcome.result.quality | {"attempts": outcome.attempts},
    )


def shard_header(spec: Mapping[str, Any], template: GarmentTemplate, body: Body) -> ShardHeader:
    """What all sequences of a shard share."""
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
