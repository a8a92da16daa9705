"""This project's implicit solver (ARCSim-style, ``sim/implicit``) on the scene: the same material without a mapping."""

from __future__ import annotations

from benchmarks.peers.recording import FrameClock, PeerRun
from benchmarks.scene import BODY, SETTLE_SECONDS, Scene, motion
from body.model import Body
from garments.template import GarmentTemplate
from sim.implicit.settings import ImplicitSettings
from sim.implicit.simulate import simulate_clip_implicit


def run(scene: Scene, settings: ImplicitSettings | None = None) -> PeerRun:
    """Simulate the scene with implicit Euler.

    Raises:
        ValueError: The scene asks for self-contact, which this solver lacks, or the run diverged.
    """
    if scene.self_contact:
        raise ValueError("the implicit solver has no self-contact")
    settings = settings or ImplicitSettings(fps=scene.fps, settle_seconds=SETTLE_SECONDS)
    body = Body.load(BODY)
    pose, root = motion(body, scene.frames)
    clock = FrameClock()
    result = simulate_clip_implicit(
        GarmentTemplate.load(scene.template), body, pose, root, scene.lead_in, scene.parameters, settings, clock
    )
    if result.failure is not None:
        raise ValueError(result.failure)
    wall, cpu = clock.recorded(scene.frames)
    words = f"{settings.steps_per_frame} steps"
    return PeerRun("implicit Euler (ours)", words, settings.steps_per_frame, result.vertices, wall, cpu)
