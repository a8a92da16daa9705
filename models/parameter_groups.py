"""Intrinsic parameters and their groups, on the scale on which networks and regressions take them.

A shape cannot tell all parameters apart: cloth that bends twice as hard and weighs twice as much hangs the same. So the
ratios by which the equations of motion depend on the parameters (``GROUPS``) stand beside the parameters themselves.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping

import numpy as np

GROUPS: dict[str, dict[str, float]] = {
    "bend / (density gravity)": {"bend": 1, "density": -1, "gravity": -1},
    "stretch / (density gravity)": {"stretch": 1, "density": -1, "gravity": -1},
    "air_drag / density": {"air_drag": 1, "density": -1},
    "gravity time_scale^2": {"gravity": 1, "time_scale": 2},
}
"""Products of powers of parameters: bending and stretching against weight, drag against inertia, and gravity in the
time of the clip, which a second of the simulation is not."""


def with_groups(parameters: Mapping[str, float]) -> dict[str, float]:
    """The parameters of a set, and those of ``GROUPS`` that can be made of them."""
    groups = {
        name: float(np.prod([parameters[p] ** power for p, power in powers.items()]))
        for name, powers in GROUPS.items()
        if all(parameters.get(p, 0.0) > 0.0 for p in powers)
    }
    return {**parameters, **groups}


def scale_values(values: Mapping[str, float], logarithmic: Collection[str]) -> np.ndarray:
    """The values in their order, those named as their logarithm, shape [P]."""
    return np.array([scale_value(value, name in logarithmic) for name, value in values.items()])


def scale_value(value: float, logarithm: bool) -> float:
    """One value, as its logarithm where asked for."""
    return float(np.log(value)) if logarithm else float(value)
