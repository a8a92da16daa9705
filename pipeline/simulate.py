"""Stage ``simulate``: one shard of ground truth.

In: a garment template, motion batches, and in the spec the (parameter set, clip) pairs of the shard; in the plan of
bodies (body shape, clip) pairs. Out: an HDF5 shard. Sixteen simulations run at a time, all on one body. One outside the
quality bounds is tried again with more substeps; what no attempt brings inside is dropped and recorded in the shard,
never written as good and never silently missing.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import cache
from typing import Any

import numpy as np

from body.model import Body
from datasets.shards import BODIES, MATERIALS, DroppedSimulation, ShardHeader, ShardWriter, SimulatedSequence
from garments.template import GarmentTemplate
from motions.clip import Clip
from pipeline.canonical import canonical
from pipeline.ensembles import Outcome, Planned, simulate_all
from pipeline.progress import Progress
from pipeline.simulation_inputs import SimulationInputs, checked_inputs, inputs_by_body, naming
from pipeline.stage import Job, run_stage
from sim.parameters import ENSEMBLE, INTRINSIC_PARAMETERS
from sim.settings import SimulationSettings
from sim.simulate import SOLVER_VERSION, Simulator


def main(job: Job) -> None:
    """Simulate every pair of the shard and write what holds."""
    spec, own = job.spec, checked_inputs(job)
    parts = inputs_by_body(own, spec)
    planned = [_planned(spec, inputs) for inputs in parts]
    frames = sum(one.clip.frames + spec["lead_in"] for part in planned for one in part)
    progress = Progress(f"simulate {spec['garment']} {spec['plan']}", frames, "frames")
    own_motions = spec["plan"] != MATERIALS
    simulators = [_simulators(job, inputs) for inputs in parts]
    if planned[0]:
        with naming(job.inputs[0]):
            simulators[0](own_motions)
    with ShardWriter(job.outputs[0], shard_header(spec, own.template, own.body)) as shard:
        for inputs, mine in zip(parts, planned):
            for name, why in inputs.unusable.items():
                _drop(shard, spec, inputs, 0, inputs.clips[name], why, 0)
            for outcome in simulate_all(simulators.pop(0), mine, own_motions, spec["solver"], progress):
                one, result = outcome.planned, outcome.result
                if result.failure is None:
                    shard.add(simulated_sequence(outcome, inputs))
                else:
                    _drop(shard, spec, inputs, one.phi, one.clip, result.failure, outcome.attempts)
    progress.finish()


def _planned(spec: Mapping[str, Any], inputs: SimulationInputs) -> list[Planned]:
    """The simulations on one body; numbers are those of bodies in their plan, of parameter sets in all others."""
    planned = []
    for number, name, take_index in spec["simulations"]:
        body_index, phi = (number, 0) if spec["plan"] == BODIES else (0, number)
        if body_index == inputs.body_index and name not in inputs.unusable:
            one = Planned(phi, inputs.clips[name], take_index, inputs.leads[name], inputs.parameters[phi])
            planned.append(one)
    return planned


def _simulators(job: Job, inputs: SimulationInputs) -> Callable[[bool], Simulator]:
    """Simulators of one garment on one body, made when they are asked for."""
    solver = job.spec["solver"]
    settings = SimulationSettings(
        fps=job.spec["fps"],
        device=job.device,
        settle_seconds=solver["settle"],
        self_contact=solver["self_contact"],
    )

    @cache
    def simulators(own_motions: bool) -> Simulator:
        return Simulator(inputs.template, inputs.body, settings, worlds=ENSEMBLE, own_motions=own_motions)

    return simulators


def _drop(
    shard: ShardWriter, spec: Mapping[str, Any], inputs: SimulationInputs, phi: int, clip: Clip, why: str, attempts: int
) -> None:
    """Say and record that a simulation is missing."""
    which = f"body {inputs.body_index}" if spec["plan"] == BODIES else f"set {phi}"
    print(f"[simulate] dropped {spec['garment']} {which} on {clip.name}: {why}", flush=True)
    shard.drop(DroppedSimulation(clip.name, clip.label, phi, why, attempts, inputs.body_index))


def simulated_sequence(outcome: Outcome, inputs: SimulationInputs) -> SimulatedSequence:
    """A simulation that held, as a shard stores it."""
    one, clip, body = outcome.planned, outcome.planned.clip, inputs.body
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
        shape=inputs.shape,
        body_index=inputs.body_index,
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
