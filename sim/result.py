"""What every cloth solver of this project hands back for one clip."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np


@dataclass
class SimulationResult:
    """Simulated garment over the recorded frames of a clip.

    Attributes:
        vertices: World positions [m] at the end of each recorded frame, shape [T, V, 3], float32. After a failure the
            frames that were not reached repeat the last good one.
        quality: Figures by name: ``max_edge_strain``, ``p99_edge_strain``, ``deepest_penetration_m``,
            ``vertices_inside`` (largest number in any frame), ``residual_speed_m_s`` (after settling), ``substeps``,
            ``seconds_per_frame`` (mean). Of XPBD also ``triangles_inside_sampled`` (largest number in any of the frames
            that they were counted in; hands are left out, pinched cloth is not), ``pinched_vertices`` (largest number
            in any frame that the body leaves no room), ``pinched_frames`` (with any of them), ``longest_pinch_frames``
            (in a row) and, with self-contact, ``crossing_pairs`` (most edges in any frame that pierce a triangle of the
            garment: about one for each pair of triangles that cross) and ``crossing_frames`` (with any of them).
        failure: One sentence on why the simulation cannot be used, None when it ran to its end.
        timing: Wall seconds spent in each part of the solver over the recorded frames.
        frame_seconds: Wall seconds of each recorded frame, shape [T], so that median and p95 can be told.
    """

    vertices: np.ndarray
    quality: dict[str, float]
    failure: str | None = None
    timing: dict[str, float] = field(default_factory=dict)
    frame_seconds: np.ndarray = field(default_factory=lambda: np.zeros(0))
