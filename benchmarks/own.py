"""The simulator's own rows: one world or an ensemble, in a process of their own.

``python -m benchmarks.own job.json``: the job names a template, frames, substeps, worlds and self-contact, and where
the result goes; see :class:`OwnJob`. One file so that what the benchmark asks of the simulator is in one place.
"""

from __future__ import annotations

import json
import sys
import time
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from benchmarks.measure import peak_memory, pin_to_one_core
from benchmarks.peers.recording import FrameClock
from benchmarks.scene import BODY, FPS, LEAD_IN, MATERIALS, SEED, SETTLE_SECONDS, motion

RANGES: dict[str, tuple[float, float]] = {
    "density": (0.10, 0.40),
    "stretch": (300.0, 3000.0),
    "shear": (60.0, 1000.0),
    "bend": (1.0e-5, 1.0e-3),
    "air_drag": (0.3, 2.0),
    "friction": (0.15, 0.6),
}
"""Ranges of an ensemble's parameter sets; its first one is the garment's own material."""


@dataclass(frozen=True)
class OwnJob:
    """One run of the simulator.

    Attributes:
        template: File of the garment's template.
        out: NumPy archive to write: vertices of the first world, times of the frames, facts.
        frames: Recorded frames.
        substeps: Substeps a frame.
        worlds: Parameter sets at once.
        self_contact: Whether the cloth collides with itself.
        first_frame: Stop at the first frame and do not settle: for the time of a start.
    """

    template: str
    out: str
    frames: int = 60
    substeps: int = 32
    worlds: int = 1
    self_contact: bool = False
    first_frame: bool = False


def run(job: OwnJob) -> dict[str, float]:
    """Simulate a job and write its archive; returns the facts that are in it.

    Raises:
        ValueError: The first world, which has the garment's own material, cannot be used.
    """
    started = time.perf_counter()
    # Imports belong to the time of a start.
    from body.model import Body
    from garments.template import GarmentTemplate
    from sim.compile import load_kernels, resolve_device
    from sim.parameters import base_parameters, sample_parameters
    from sim.settings import SimulationSettings
    from sim.simulate import Simulator, World

    settle = 0.0 if job.first_frame else SETTLE_SECONDS
    settings = SimulationSettings(fps=FPS, device="cpu", settle_seconds=settle, self_contact=job.self_contact)
    template, body = GarmentTemplate.load(job.template), Body.load(BODY)
    pose, root = motion(body, job.frames)
    lead = LEAD_IN
    if job.first_frame:
        pose, root, lead = pose[:2], root[:2], 1
    base = base_parameters(MATERIALS[template.kind] | {"substeps": job.substeps})
    sets = [sample_parameters(base, RANGES, SEED, template.kind, index) for index in range(job.worlds)]
    imported = time.perf_counter()
    load_kernels(resolve_device("cpu"), job.worlds)
    compiled = time.perf_counter()

    clock = FrameClock()
    simulator = Simulator(template, body, settings, worlds=job.worlds)
    results = simulator.run_worlds([World(pose, root, one) for one in sets], lead, clock)
    ended = time.perf_counter()
    failed = [result.failure for result in results if result.failure is not None]
    if results[0].failure is not None:
        raise ValueError(f"{len(failed)} of {len(results)} worlds failed: {results[0].failure}")
    wall, cpu = results[0].frame_seconds, clock.recorded(len(results[0].frame_seconds))[1]
    facts = {
        "imports_s": imported - started,
        "kernels_s": compiled - imported,
        "simulation_s": ended - compiled,
        "memory_mb": peak_memory(),
        "failed_worlds": len(failed),
    }
    np.savez(
        job.out,
        facts=np.frombuffer(json.dumps(facts).encode(), dtype=np.uint8),
        vertices=results[0].vertices,
        wall=wall,
        cpu=cpu,
    )
    return facts


def write_job(job: OwnJob, path: Path) -> None:
    """Write a job for a process of its own."""
    path.write_text(json.dumps(asdict(job)))


if __name__ == "__main__":
    pin_to_one_core()
    run(OwnJob(**json.loads(Path(sys.argv[1]).read_text())))
