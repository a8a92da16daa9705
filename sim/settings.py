"""How a clip is simulated: everything that is not an intrinsic parameter of the cloth."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class SimulationSettings:
    """Settings of one simulation; the intrinsic parameters come with each clip.

    Attributes:
        fps: Frames of the clip a second [Hz].
        device: ``auto`` (CUDA where Warp finds it), ``cpu`` or ``cuda``.
        queries_per_frame: Exact closest-point queries a frame; two at 30 fps make the 60 Hz that fast limbs need.
        reach: Distance up to which a vertex at rest is in contact [m]; one that approaches is from farther away.
        contact: ``own`` (a vertex that the body pinches follows the parts it belongs to) or ``whole`` (it follows the
            nearest surface).
        self_contact: Whether layers of the garment keep apart.
        tethers: Whether cloth that hangs on pins is kept from artificial stretch by tethers.
        settle_seconds: Longest time the garment may settle on the standing body [s].
        settle_speed: Settled when the root mean square speed falls below this [m/s].
        settle_damping: Extra velocity damping while settling [1/s]; it does not change where the cloth comes to rest.
        absurd_strain: Edge strain that counts as divergence.
        check_every: Triangles inside the body are counted every this many recorded frames and in the last one; at 10
            it takes 2% of the time.
        start_depth: Deepest that a garment vertex may lie inside the bind-pose body [m].
        max_speed: Cap on the speed of a vertex [m/s]; far above that of any limb.
    """

    fps: float = 30.0
    device: str = "auto"
    queries_per_frame: int = 2
    reach: float = 0.03
    contact: str = "own"
    self_contact: bool = True
    tethers: bool = True
    settle_seconds: float = 1.5
    settle_speed: float = 0.02
    settle_damping: float = 3.0
    absurd_strain: float = 3.0
    check_every: int = 10
    start_depth: float = 0.005
    max_speed: float = 40.0

    def __post_init__(self) -> None:
        _require("fps", self.fps, 1.0, 1000.0, "Hz")
        _require("queries_per_frame", self.queries_per_frame, 1, 64, "queries")
        _require("reach", self.reach, 0.005, 0.5, "m")
        _require("settle_seconds", self.settle_seconds, 0.0, 60.0, "s")
        _require("settle_speed", self.settle_speed, 0.0, 10.0, "m/s")
        _require("settle_damping", self.settle_damping, 0.0, 100.0, "1/s")
        _require("absurd_strain", self.absurd_strain, 0.1, 1000.0, "1")
        _require("check_every", self.check_every, 1, 100000, "frames")
        _require("start_depth", self.start_depth, 0.0, 0.1, "m")
        _require("max_speed", self.max_speed, 1.0, 1000.0, "m/s")
        if self.device not in ("auto", "cpu", "cuda"):
            raise ValueError(f"device {self.device!r}: allowed are auto, cpu and cuda")
        if self.contact not in ("own", "whole"):
            raise ValueError(f"contact {self.contact!r}: allowed are own and whole")


def _require(name: str, value: float, low: float, high: float, unit: str) -> None:
    if not np.isfinite(value) or not low <= value <= high:
        raise ValueError(f"simulation setting {name} = {value}: allowed are {low:g} to {high:g} {unit}")
