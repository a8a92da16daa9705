"""Seconds a frame of the XPBD solver and of the implicit baseline on the same garment, body and clip, one after the
other in one process and on one thread; beside them what others published for ARCSim.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from sim.implicit.settings import ImplicitSettings
from sim.implicit.simulate import simulate_clip_implicit
from sim.parameters import ENSEMBLE, parameter
from sim.result import SimulationResult
from sim.settings import SimulationSettings
from sim.simulate import Simulator, World, simulate_clip

if TYPE_CHECKING:
    from body.model import Body
    from garments.template import GarmentTemplate

Row = dict[str, str | int | float | None]

_PARTS = ("forces", "solve", "contact", "strain_limits", "other")


def _published(solver: str, vertices: int, seconds: float, steps: int | None, frames: int | None, source: str) -> Row:
    return {
        "solver": solver,
        "vertices": vertices,
        "frames": frames,
        "threads": None,
        "median_s_per_frame": seconds,
        "p95_s_per_frame": None,
        "substeps": steps,
        "source": source,
    }


_SHI = "published on other hardware: Shi 2023, Table 2, mean on an i9-10900K"
_OWN = "measured once on a 2-core AMD Zen 5 (mean of 60 frames of 0.04 s), not in this run"

PUBLISHED_ARCSIM: dict[str, tuple[Row, ...]] = {
    "skirt": (
        _published("ARCSim", 3326, 3.2841, None, None, _SHI),
        _published("ARCSim 0.2.1, fixed mesh, strain limits 0.95-1.05", 3320, 3.66, 8, 60, _OWN),
        _published("ARCSim 0.2.1, fixed mesh, no strain limits", 3320, 1.39, 8, 60, _OWN),
    ),
    "tshirt": (_published("ARCSim", 3170, 3.9047, None, None, _SHI),),
    "pants": (_published("ARCSim", 4473, 8.9763, None, None, _SHI),),
}
"""By kind of garment, times of ARCSim that were not taken in this run; the column is their mean, for no median was
published."""


def time_solvers(
    template: GarmentTemplate,
    body: Body,
    pose: np.ndarray,
    root: np.ndarray,
    lead_in: int,
    parameters: Mapping[str, float],
    frames: int,
    implicit: ImplicitSettings,
    warm_up: int = 2,
    strain_limits: tuple[float, float] | None = (0.95, 1.05),
) -> list[Row]:
    """Time both solvers on one thread of this machine.

    Kernels are compiled and memory is touched by the settling and the lead-in, which are not timed; the first
    ``warm_up`` recorded frames are not counted either. The time of a frame is that of the cloth and its contact with
    the body. Posing the body is part of it for XPBD, while the implicit solver gets the posed body for nothing.

    Args:
        template: Garment made for this body.
        body: Body of the clip.
        pose: Axis-angle poses [rad], shape [L + T, 24, 3].
        root: Root translations [m], shape [L + T, 3].
        lead_in: Number L of leading frames.
        parameters: Every intrinsic parameter by name; ``substeps`` is the XPBD solver's. Creases are left out for all
            solvers alike, since the implicit one forms none.
        frames: Recorded frames to time after the warm-up.
        implicit: Settings of the implicit solver; its frame rate is the clip's.
        warm_up: Recorded frames before the timed ones.
        strain_limits: Limits for a further row of the implicit solver, as ARCSim's materials use them; None: no such
            row.

    Returns:
        One row a solver: ``solver``, ``vertices``, ``frames``, ``threads``, ``median_s_per_frame``,
        ``p95_s_per_frame``, ``substeps``, ``source``; rows of the implicit solver also ``<part>_s_per_frame`` (mean).

    Raises:
        ValueError: The clip has too few frames, or a solver failed on it.
    """
    if frames < 1 or warm_up < 0:
        raise ValueError(f"timing: frames = {frames} and warm_up = {warm_up}: at least 1 and 0 are needed")
    needed = lead_in + warm_up + frames
    if len(pose) < needed:
        raise ValueError(f"timing: {needed} frames are needed (lead-in, warm-up and timed), the clip has {len(pose)}")
    pose, root = pose[:needed], root[:needed]
    uncreased = dict(parameters) | {"bend_yield": parameter("bend_yield").allowed[1]}
    clip = (template, body, pose, root, lead_in, uncreased)

    fast = simulate_clip(*clip, SimulationSettings(fps=implicit.fps, device="cpu", self_contact=False))
    rows = [_row("XPBD", template, fast, warm_up)]
    apart = simulate_clip(*clip, SimulationSettings(fps=implicit.fps, device="cpu"))
    rows.append(_row("XPBD with self-contact", template, apart, warm_up))
    settings = SimulationSettings(fps=implicit.fps, device="cpu")
    ensemble = Simulator(template, body, settings, worlds=ENSEMBLE)
    together = ensemble.run_worlds([World(pose, root, uncreased)] * ENSEMBLE, lead_in)[0]
    rows.append(_row(f"XPBD with self-contact, one of {ENSEMBLE} at once", template, together, warm_up, ENSEMBLE))
    plain = simulate_clip_implicit(*clip, implicit)
    rows.append(_row("implicit Euler", template, plain, warm_up))
    if strain_limits is not None:
        limited = simulate_clip_implicit(*clip, replace(implicit, strain_limits=strain_limits))
        low, high = strain_limits
        rows.append(_row(f"implicit Euler, strain limits {low:g}-{high:g}", template, limited, warm_up))
    return rows


def _row(solver: str, template: GarmentTemplate, result: SimulationResult, warm_up: int, worlds: int = 1) -> Row:
    if result.failure is not None:
        raise ValueError(f"timing: {solver} failed on garment {template.name!r}: {result.failure}")
    seconds = result.frame_seconds[warm_up:] / worlds
    row: Row = {
        "solver": solver,
        "vertices": len(template.vertices),
        "frames": len(seconds),
        "threads": 1,
        "median_s_per_frame": float(np.median(seconds)),
        "p95_s_per_frame": float(np.quantile(seconds, 0.95)),
        "substeps": int(result.quality["substeps"]),
        "source": "measured in this run",
    }
    for part in _PARTS:
        if part in result.timing:
            row[f"{part}_s_per_frame"] = result.timing[part] / len(result.frame_seconds)
    return row
