"""Many simulations of one garment, sixteen at a time, tried with more substeps until they are inside the bounds.

In: planned simulations. Out: for each, its last result, the parameters it was made with and the number of attempts.
Simulations go together where they take the same number of substeps and either share a clip or each have their own.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from motions.clip import Clip
from sim.bounds import out_of_bounds
from sim.parameters import ENSEMBLE
from sim.result import SimulationResult
from sim.simulate import Simulator, World


@dataclass(frozen=True)
class Planned:
    """A simulation to be made.

    Attributes:
        phi: Number of the parameter set.
        clip: Motion.
        take_index: Number of the take that the clip was cut from.
        lead: Poses [L, 24, 3] and roots [L, 3] that lead from the bind pose into the clip.
        parameters: Every intrinsic parameter.
    """

    phi: int
    clip: Clip
    take_index: int
    lead: tuple[np.ndarray, np.ndarray]
    parameters: dict[str, float]


@dataclass(frozen=True)
class Outcome:
    """What came of a planned simulation; ``result.failure`` says why no attempt held."""

    planned: Planned
    result: SimulationResult
    parameters: dict[str, float]
    attempts: int


Pending = tuple[Planned, dict[str, float]]
"""A simulation and the parameters of its next attempt."""


def simulate_all(
    simulators: Callable[[bool], Simulator],
    planned: Sequence[Planned],
    own_motions: bool,
    solver: Mapping[str, Any],
    progress: Callable[[int], None],
) -> Iterator[Outcome]:
    """Simulate everything, in groups; what falls outside the bounds is gathered from all groups and tried again.

    Args:
        simulators: Gives a simulator of ``ENSEMBLE`` worlds, of their own motions (True) or of one that they share.
        planned: Simulations.
        own_motions: Whether the first attempt groups different clips. Later ones always do: few are left of any clip.
        solver: ``attempts``, ``substeps_factor`` and ``bounds`` of the configuration.
        progress: Called with the number of frames done, once for every simulation.
    """
    pending = [(one, dict(one.parameters)) for one in planned]
    for attempt in range(1, solver["attempts"] + 1):
        own, again = own_motions or attempt > 1, []
        for group in _groups(pending, own):
            lead = len(group[0][0].lead[0])
            results = simulators(own).run_worlds([_world(one, used) for one, used in group], lead)
            for (one, used), result in zip(group, results):
                if result.failure is None:
                    result.failure = out_of_bounds(result.quality, solver["bounds"], result.vertices.shape[1])
                if result.failure is None or attempt == solver["attempts"]:
                    progress(lead + one.clip.frames)
                    yield Outcome(one, result, used, attempt)
                else:
                    again.append((one, used | {"substeps": float(round(used["substeps"] * solver["substeps_factor"]))}))
        pending = again


def _groups(pending: Sequence[Pending], own_motions: bool) -> list[list[Pending]]:
    """At most ``ENSEMBLE`` each, of one number of substeps and, unless each may move as it likes, of one clip."""
    kinds: dict[tuple, list[Pending]] = {}
    for one, used in pending:
        shared = (one.clip.frames,) if own_motions else (one.clip.name,)
        kinds.setdefault((round(used["substeps"]), *shared), []).append((one, used))
    return [many[i : i + ENSEMBLE] for many in kinds.values() for i in range(0, len(many), ENSEMBLE)]


def _world(one: Planned, parameters: Mapping[str, float]) -> World:
    lead_pose, lead_root = one.lead
    pose, root = np.concatenate([lead_pose, one.clip.pose]), np.concatenate([lead_root, one.clip.root])
    return World(pose, root, parameters)
