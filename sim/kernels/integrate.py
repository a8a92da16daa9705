"""Time integration of a substep: prediction under gravity and air, pins, velocities, and the change of the origin."""

from __future__ import annotations

from typing import Any

import warp as wp

from sim.kernels.lanes import LANE_OPTIONS, WIDTHS, declare
from sim.kernels.parameters import (
    DRAG_ACROSS,
    DRAG_ALONG,
    DT,
    GRAVITY_STEP,
    KEEP,
    MAX_SPEED,
    OVER_DT,
    WIND_X,
    WIND_Z,
)

wp.set_module_options(LANE_OPTIONS)


@wp.struct
class Motion:
    """Position [m] and velocity [m/s] of one vertex."""

    px: float
    py: float
    pz: float
    vx: float
    vy: float
    vz: float


@wp.func
def blown(
    dt: float,
    keep: float,
    across: float,
    along: float,
    wind_x: float,
    wind_z: float,
    gravity: float,
    nx: float,
    ny: float,
    nz: float,
    vx: float,
    vy: float,
    vz: float,
    px: float,
    py: float,
    pz: float,
):
    """Semi-implicit Euler; the air is integrated exactly over the substep: the velocity against it decays.

    Drag comes before gravity, or it would take away from the weight of cloth at rest.
    """
    rx = vx * keep - wind_x
    ry = vy * keep
    rz = vz * keep - wind_z
    face = (across - along) * (rx * nx + ry * ny + rz * nz)
    m = Motion()
    m.vx = wind_x + along * rx + face * nx
    m.vy = along * ry + face * ny - gravity
    m.vz = wind_z + along * rz + face * nz
    m.px = px + m.vx * dt
    m.py = py + m.vy * dt
    m.pz = pz + m.vz * dt
    return m


@wp.kernel
def predict(
    inverse_mass: wp.array(dtype=float),
    parameters: wp.array(dtype=Any),
    normals: wp.array(dtype=Any),
    v: wp.array(dtype=Any),
    x: wp.array(dtype=Any),
    x_prev: wp.array(dtype=Any),
    x_pred: wp.array(dtype=Any),
):
    """Let the free vertices go on in the air, under gravity."""
    i = wp.tid()
    p = x[i]
    x_prev[i] = p
    if inverse_mass[i] > 0.0:
        dt = parameters[DT]
        keep = parameters[KEEP]
        across = parameters[DRAG_ACROSS]
        along = parameters[DRAG_ALONG]
        wind_x = parameters[WIND_X]
        wind_z = parameters[WIND_Z]
        gravity = parameters[GRAVITY_STEP]
        n = normals[i]
        u = v[i]
        lanes = len(dt)
        for k in range(lanes):
            y = lanes + k
            z = 2 * lanes + k
            m = blown(
                dt[k],
                keep[k],
                across[k],
                along[k],
                wind_x[k],
                wind_z[k],
                gravity[k],
                n[k],
                n[y],
                n[z],
                u[k],
                u[y],
                u[z],
                p[k],
                p[y],
                p[z],
            )
            u[k] = m.vx
            u[y] = m.vy
            u[z] = m.vz
            p[k] = m.px
            p[y] = m.py
            p[z] = m.pz
        v[i] = u
        x[i] = p
        x_pred[i] = p


@wp.kernel
def move_pins(
    fraction: float,
    pinned: wp.array(dtype=int),
    lane_motion: wp.array(dtype=int),
    pin_count: int,
    pin_from: wp.array(dtype=wp.vec3),
    pin_to: wp.array(dtype=wp.vec3),
    x: wp.array(dtype=Any),
):
    """Kinematic vertices on their way through the interval."""
    p = wp.tid()
    position = x[pinned[p]]
    lanes = lane_motion.shape[0]
    for k in range(lanes):
        source = lane_motion[k] * pin_count + p
        target = pin_from[source] * (1.0 - fraction) + pin_to[source] * fraction
        position[k] = target[0]
        position[lanes + k] = target[1]
        position[2 * lanes + k] = target[2]
    x[pinned[p]] = position


@wp.func
def capped(max_speed: float, vx: float, vy: float, vz: float):
    """Factor that keeps a velocity to a speed, 1 [both m/s]."""
    speed = wp.sqrt(vx * vx + vy * vy + vz * vz)
    return wp.where(speed > max_speed, max_speed / speed, 1.0)


@wp.kernel
def update_velocity(
    inverse_mass: wp.array(dtype=float),
    parameters: wp.array(dtype=Any),
    x: wp.array(dtype=Any),
    x_prev: wp.array(dtype=Any),
    x_pred: wp.array(dtype=Any),
    v: wp.array(dtype=Any),
):
    """``v += (x - x_pred) / dt``: the difference of positions alone would lose the velocity in float32 rounding."""
    i = wp.tid()
    over_dt = parameters[OVER_DT]
    max_speed = parameters[MAX_SPEED]
    position = x[i]
    velocity = v[i]
    before = x_prev[i]
    # A pinned vertex is where its target is: its velocity is what that took.
    free = wp.where(inverse_mass[i] > 0.0, 1.0, 0.0)
    if inverse_mass[i] > 0.0:
        before = x_pred[i]
    lanes = len(over_dt)
    for k in range(lanes):
        y = lanes + k
        z = 2 * lanes + k
        vx = velocity[k] * free + (position[k] - before[k]) * over_dt[k]
        vy = velocity[y] * free + (position[y] - before[y]) * over_dt[k]
        vz = velocity[z] * free + (position[z] - before[z]) * over_dt[k]
        factor = capped(max_speed[k], vx, vy, vz)
        velocity[k] = vx * factor
        velocity[y] = vy * factor
        velocity[z] = vz * factor
    v[i] = velocity


@wp.kernel
def shift_origin(lane_motion: wp.array(dtype=int), shift: wp.array(dtype=wp.vec3), x: wp.array(dtype=Any)):
    """Positions in the coordinates of a new origin; velocities are those of the world and stay."""
    i = wp.tid()
    position = x[i]
    lanes = lane_motion.shape[0]
    for k in range(lanes):
        by = shift[lane_motion[k]]
        position[k] = position[k] + by[0]
        position[lanes + k] = position[lanes + k] + by[1]
        position[2 * lanes + k] = position[2 * lanes + k] + by[2]
    x[i] = position


for _width in WIDTHS:
    _state = {"x": "vectors", "x_prev": "vectors", "x_pred": "vectors"}
    declare(predict, _width, parameters="scalars", normals="vectors", v="vectors", **_state)
    declare(update_velocity, _width, parameters="scalars", v="vectors", **_state)
    declare(move_pins, _width, x="vectors")
    declare(shift_origin, _width, x="vectors")
