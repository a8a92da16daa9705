"""What a run is judged by besides its time: strain, vertices inside the body, distance from our own result; and the
facts of the process that it ran in.
"""

from __future__ import annotations

import os
import resource
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks.scene import Scene

DEPTH = 5.0e-4
"""A vertex counts as inside the body when it is deeper than this [m]: less is rounding of the closest point."""


@dataclass(frozen=True)
class Cleanliness:
    """How a simulated garment looks, over all recorded frames.

    Attributes:
        p99_strain: 99th percentile of the edges' strain, absolute [1].
        max_strain: Largest [1].
        inside: Vertices inside the body, mean share of all [1].
        deepest: Deepest of them [m].
        apart: Root mean square distance from another run's vertices [m]; None where there is none.
    """

    p99_strain: float
    max_strain: float
    inside: float
    deepest: float
    apart: float | None


def cleanliness(scene: Scene, vertices: np.ndarray, other: np.ndarray | None = None, every: int = 4) -> Cleanliness:
    """Judge recorded frames.

    The body is taken as a whole. Where it passes through itself (armpits), cloth cannot be outside of all of it, and
    its vertices count as inside for every solver alike.

    Args:
        scene: What was simulated.
        vertices: Recorded frames [m], shape [T, V, 3].
        other: Frames to compare with, the same shape.
        every: Frames between those whose vertices are sought in the body.

    Raises:
        ValueError: Vertices that are not finite.
    """
    from geometry.proximity import SurfaceQuery

    vertices = np.asarray(vertices, dtype=np.float64)
    if not np.isfinite(vertices).all():
        bad = int(np.argmin(np.isfinite(vertices).all(axis=(1, 2))))
        raise ValueError(f"vertices are not finite from recorded frame {bad} on")
    i, j = scene.edges.T
    span = np.linalg.norm(vertices[:, i] - vertices[:, j], axis=-1)
    strain = np.abs(span / scene.edge_length - 1.0)
    query = SurfaceQuery(scene.body_faces, scene.body.shape[1])
    depths = []
    for frame in range(0, len(vertices), every):
        hits = query.query(vertices[frame], scene.body[scene.lead_in + frame].astype(np.float64))
        depths.append(np.maximum(-hits.distance, 0.0))
    depth = np.stack(depths)
    apart = None
    if other is not None:
        apart = float(np.sqrt(((vertices - other) ** 2).sum(axis=-1).mean()))
    return Cleanliness(
        p99_strain=float(np.quantile(strain, 0.99)),
        max_strain=float(strain.max()),
        inside=float((depth > DEPTH).mean()),
        deepest=float(depth.max()),
        apart=apart,
    )


def pin_to_one_core() -> int | None:
    """Run this process and what it starts on one core; returns its number, None where the system cannot do it.

    Taken is the last core that is allowed: the first one usually serves the system's interrupts.
    """
    if not hasattr(os, "sched_setaffinity"):
        return None
    core = max(os.sched_getaffinity(0))
    os.sched_setaffinity(0, {core})
    return core


def peak_memory() -> float:
    """Largest resident memory of this process so far [MB].

    Where the system tells it of the program alone (Linux), that figure: ``getrusage`` starts with the memory of the
    process that launched this one.
    """
    status = Path("/proc/self/status")
    if status.exists():
        for line in status.read_text().splitlines():
            if line.startswith("VmHWM:"):
                return float(line.split()[1]) * 1024.0 / 1e6
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024.0 / 1e6


def children_seconds() -> float:
    """Processor seconds of all child processes that have ended."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime
