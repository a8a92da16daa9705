"""Stage ``simulate_tests``: simulations that are only tested on.

In: a garment template and the motion batches of the run. Out: two shards, base parameters. ``repeated``: held-out
clips simulated once more from a start that differs by ``shift``. How far the two garments part is what nobody can know
from the motion: the chaos floor. ``long``: generated motions many times as long as a clip, to see whether a regressor
drifts. What falls outside the quality bounds is dropped and recorded, as everywhere.
"""

from __future__ import annotations

from functools import cache

import numpy as np

from body.model import Body
from datasets.shards import LONG, REPEATED, DroppedSimulation, ShardWriter
from motions.lead_in import lead_in
from motions.procedural import generate_clip
from pipeline.ensembles import Planned, simulate_all
from pipeline.progress import Progress
from pipeline.simulate import shard_header, simulated_sequence
from pipeline.simulation_inputs import SimulationInputs, checked_inputs
from pipeline.stage import Job, run_stage
from sim.parameters import ENSEMBLE
from sim.settings import SimulationSettings
from sim.simulate import Simulator

VARIANT = 100_000
"""First variant of the long motions: no clip of a run has such a number, so that none of them was trained on."""

DIRECTION = np.array([0.6, 0.0, 0.8])
"""Of the shift: horizontal, along no axis of the body."""


def main(job: Job) -> None:
    """Simulate both shards."""
    spec, inputs = job.spec, checked_inputs(job)
    settings = SimulationSettings(
        fps=spec["fps"],
        device=job.device,
        settle_seconds=spec["solver"]["settle"],
        self_contact=spec["solver"]["self_contact"],
    )

    @cache
    def simulators(own_motions: bool) -> Simulator:
        return Simulator(inputs.template, inputs.body, settings, worlds=ENSEMBLE, own_motions=own_motions)

    # One attempt at a long motion: with twice the substeps it would cost as much as all else together.
    once = spec["solver"] | {"attempts": 1}
    plans = (
        (REPEATED, _repeated(spec, inputs), spec["solver"]),
        (LONG, _long(spec, inputs.body, inputs.parameters[0]), once),
    )
    for path, (plan, planned, solver) in zip(job.outputs, plans, strict=True):
        frames = sum(one.clip.frames + spec["lead_in"] for one in planned)
        progress = Progress(f"simulate {spec['garment']} {plan}", frames, "frames")
        with ShardWriter(path, shard_header(spec | {"plan": plan}, inputs.template, inputs.body)) as shard:
            for outcome in simulate_all(simulators, planned, True, solver, progress):
                if outcome.result.failure is None:
                    shard.add(simulated_sequence(outcome, inputs))
                    continue
                clip, why = outcome.planned.clip, outcome.result.failure
                print(f"[simulate_tests] dropped {spec['garment']} on {clip.name}: {why}", flush=True)
                shard.drop(DroppedSimulation(clip.name, clip.label, 0, why, outcome.attempts))
        progress.finish()


def _repeated(spec: dict, inputs: SimulationInputs) -> list[Planned]:
    """The clips with a lead-in that begins ``shift`` beside the first one and glides onto it before the clip begins."""
    planned = []
    for phi, name, take_index in spec["simulations"]:
        pose, root = inputs.leads[name]
        away = 0.5 + 0.5 * np.cos(np.pi * np.arange(len(root)) / max(len(root), 1))
        beside = (root + spec["tests"]["shift"] * away[:, None] * DIRECTION).astype(root.dtype)
        planned.append(Planned(phi, inputs.clips[name], take_index, (pose, beside), inputs.parameters[phi]))
    return planned


def _long(spec: dict, body: Body, parameters: dict[str, float]) -> list[Planned]:
    """Long motions, one a label and then another of each."""
    planned, labels = [], spec["long_labels"]
    for number in range(spec["tests"]["long_clips"]):
        label, variant = labels[number % len(labels)], VARIANT + number // len(labels)
        clip = generate_clip(label, variant, spec["tests"]["long_frames"], spec["fps"], spec["seed"], body)
        planned.append(Planned(0, clip, number, lead_in(clip, body, spec["lead_in"]), parameters))
    return planned


if __name__ == "__main__":
    run_stage(main)
