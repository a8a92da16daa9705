"""Per-substep constants of the parameter sets: rows of an array that holds one value a lane.

They are read from device memory, so that a captured graph serves every set. Density is folded into the stiffnesses, and
with it every lane shares the inverse masses of unit density.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import warp as wp

_ROWS = (
    "DT",  # substep [s]
    "OVER_DT",  # [1/s]
    "KEEP",  # factor on velocities from damping that is not air's, 1
    "DRAG_ACROSS",  # factor on the velocity against the air at right angles to the sheet, 1
    "DRAG_ALONG",  # the same along the sheet, 1
    "WIND_X",  # [m/s]
    "WIND_Z",  # [m/s]
    "GRAVITY_STEP",  # g dt [m/s]
    "STRETCH_ROOT",  # sqrt(k_stretch dt^2 / density) [m]
    "SHEAR_ROOT",  # sqrt(k_shear dt^2 / density) [m]
    "COMPRESSION_ROOT",  # sqrt(compression), 1
    "STRETCH_DAMPING",  # tau / dt, 1
    "BEND",  # k_bend dt^2 / density [m^4]
    "BEND_DAMPING",  # tau / dt, 1
    "BEND_YIELD",  # [1/m]
    "FRICTION",  # 1
    "SELF_FRICTION",  # 1
    "THICKNESS",  # [m]
    "MAX_SPEED",  # [m/s]
    "TETHER_SLACK",  # length of a taut tether over its rest length, 1
)
ROW_COUNT = len(_ROWS)

DT = wp.constant(0)
OVER_DT = wp.constant(1)
KEEP = wp.constant(2)
DRAG_ACROSS = wp.constant(3)
DRAG_ALONG = wp.constant(4)
WIND_X = wp.constant(5)
WIND_Z = wp.constant(6)
GRAVITY_STEP = wp.constant(7)
STRETCH_ROOT = wp.constant(8)
SHEAR_ROOT = wp.constant(9)
COMPRESSION_ROOT = wp.constant(10)
STRETCH_DAMPING = wp.constant(11)
BEND = wp.constant(12)
BEND_DAMPING = wp.constant(13)
BEND_YIELD = wp.constant(14)
FRICTION = wp.constant(15)
SELF_FRICTION = wp.constant(16)
THICKNESS = wp.constant(17)
MAX_SPEED = wp.constant(18)
TETHER_SLACK = wp.constant(19)


# A tether may be this much longer than the cloth at rest [1], and than the cloth under this many times the weight that
# hangs on it: what the material really stretches is left to the membrane.
_TETHER_MARGIN = 0.005
_TETHER_LOAD = 4.0
_GRAVITY = 9.81


def substep_constants(
    values: Mapping[str, float],
    dt: float,
    extra_damping: float = 0.0,
    max_speed: float = 1.0e6,
    tether: float = 0.0,
) -> np.ndarray:
    """The column of one lane, shape [ROW_COUNT] float32.

    Args:
        values: Every intrinsic parameter.
        dt: Substep [s].
        extra_damping: Rate at which velocities decay besides air drag [1/s].
        max_speed: Cap on the speed of a vertex [m/s].
        tether: Length of the longest tether [m].
    """
    scale = dt * dt / values["density"]
    drag = values["air_drag"] / values["density"]
    rows = {
        "DT": dt,
        "OVER_DT": 1.0 / dt,
        "KEEP": np.exp(-extra_damping * dt),
        "DRAG_ACROSS": np.exp(-drag * dt),
        "DRAG_ALONG": np.exp(-drag * values["drag_ratio"] * dt),
        "WIND_X": values["wind_speed"] * np.sin(values["wind_heading"]),
        "WIND_Z": values["wind_speed"] * np.cos(values["wind_heading"]),
        "GRAVITY_STEP": values["gravity"] * dt,
        "STRETCH_ROOT": np.sqrt(values["stretch"] * scale),
        "SHEAR_ROOT": np.sqrt(values["shear"] * scale),
        "COMPRESSION_ROOT": np.sqrt(values["compression"]),
        "STRETCH_DAMPING": values["stretch_damping"] / dt,
        "BEND": values["bend"] * scale,
        "BEND_DAMPING": values["bend_damping"] / dt,
        "BEND_YIELD": values["bend_yield"],
        "FRICTION": values["friction"],
        "SELF_FRICTION": values["self_friction"],
        "THICKNESS": values["thickness"],
        "MAX_SPEED": max_speed,
        "TETHER_SLACK": 1.0 + _TETHER_MARGIN + _TETHER_LOAD * values["density"] * _GRAVITY * tether / values["stretch"],
    }
    return np.array([rows[name] for name in _ROWS], dtype=np.float32)
