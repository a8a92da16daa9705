"""What every peer hands back, and the clock that it is timed with."""

from __future__ import annotations

import json
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks.scene import SETTLE_SECONDS, Scene


class PeerMissing(Exception):
    """The peer is not installed in this Python environment."""


@dataclass(frozen=True)
class PeerRun:
    """Recorded frames of a peer.

    Attributes:
        solver: Name and version.
        settings: What it was set to, in a few words for the table.
        steps: Its own time steps a frame.
        vertices: Positions at the end of each recorded frame [m], shape [T, V, 3], float32.
        wall: Wall seconds of each recorded frame, shape [T].
        cpu: Processor seconds of each recorded frame, shape [T].
    """

    solver: str
    settings: str
    steps: int
    vertices: np.ndarray
    wall: np.ndarray
    cpu: np.ndarray

    def save(self, path: str | Path) -> None:
        """Write the run as one NumPy archive."""
        facts = json.dumps([self.solver, self.settings, self.steps])
        np.savez(
            path,
            facts=np.frombuffer(facts.encode(), dtype=np.uint8),
            vertices=self.vertices,
            wall=self.wall,
            cpu=self.cpu,
        )

    @classmethod
    def load(cls, path: str | Path) -> PeerRun:
        """Read a run that ``save`` wrote."""
        with np.load(path) as archive:
            facts = json.loads(archive["facts"].tobytes())
            return cls(*facts, archive["vertices"], archive["wall"], archive["cpu"])


class FrameClock:
    """Progress callback of this project's solvers that takes the time of every frame."""

    def __init__(self) -> None:
        self.stamps: list[tuple[float, float]] = []

    def __call__(self, done: int, total: int) -> None:
        """A frame is done."""
        self.stamps.append((time.perf_counter(), time.process_time()))

    def recorded(self, count: int) -> tuple[np.ndarray, np.ndarray]:
        """Wall and processor seconds of the last ``count`` frames, shape [T] each."""
        wall, cpu = np.diff(np.array(self.stamps), axis=0)[-count:].T
        return wall, cpu


def record(
    scene: Scene, step: Callable[[int, int], None], positions: Callable[[], np.ndarray]
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Drive a peer through the scene: settle, lead-in, recorded frames; only the recorded ones are timed.

    Args:
        scene: What to simulate.
        step: Advances the cloth by one frame, from the body of one frame (first argument) to that of another.
        positions: Garment vertices now [m], shape [V, 3].

    Returns:
        Vertices [T, V, 3], wall seconds [T] and processor seconds [T] of the recorded frames.
    """
    for _ in range(round(SETTLE_SECONDS * scene.fps)):
        step(0, 0)
    vertices = np.empty((scene.frames, len(scene.vertices), 3), dtype=np.float32)
    wall, cpu = np.zeros(scene.frames), np.zeros(scene.frames)
    for frame in range(1, len(scene.body)):
        wall_start, cpu_start = time.perf_counter(), time.process_time()
        step(frame - 1, frame)
        now = positions()
        index = frame - scene.lead_in
        if index >= 0:
            wall[index], cpu[index] = time.perf_counter() - wall_start, time.process_time() - cpu_start
            vertices[index] = now
    return vertices, wall, cpu
