"""The vertices of a single world on a CPU, sixteen successive ones a thread, from one substep into the next.

Same arithmetic as ``integrate`` and ``contact``, but contact, velocity and the next prediction in one pass over memory:
all of it takes 4 ns a vertex instead of 17. The last pack ends with the last vertex; what it shares with the one before
is left to that. (A way of its own for a pack that is not full would double the time of all the others, for the compiler
then no longer keeps the lanes in registers.)
"""

from __future__ import annotations

import warp as wp

from sim.kernels.contact import put_outside
from sim.kernels.integrate import blown, capped
from sim.kernels.lanes import LANE_OPTIONS, scalars
from sim.kernels.packs import PACK, load, load_integers, load_scalars, packed_float, packed_vector, store
from sim.kernels.parameters import (
    DRAG_ACROSS,
    DRAG_ALONG,
    DT,
    FRICTION,
    GRAVITY_STEP,
    KEEP,
    MAX_SPEED,
    OVER_DT,
    WIND_X,
    WIND_Z,
)

wp.set_module_options(LANE_OPTIONS)

_one = scalars(1)


@wp.func
def first_of(pack: int, count: int):
    """First vertex of a pack; all of its vertices exist."""
    return wp.min(PACK * pack, count - PACK)


@wp.func
def go_on(
    first: int,
    skip: int,
    mass: packed_float,
    position: packed_vector,
    velocity: packed_vector,
    position_before: packed_vector,
    position_predicted: packed_vector,
    parameters: wp.array(dtype=_one),
    normals: wp.array(dtype=wp.vec3),
    v: wp.array(dtype=wp.vec3),
    x: wp.array(dtype=wp.vec3),
    x_prev: wp.array(dtype=wp.vec3),
    x_pred: wp.array(dtype=wp.vec3),
):
    """:func:`predict` of the lanes from ``skip`` on; those before it are stored as they are."""
    p = position
    u = velocity
    b = position_before
    q = position_predicted
    n = load(normals, first)
    dt = parameters[DT][0]
    keep = parameters[KEEP][0]
    across = parameters[DRAG_ACROSS][0]
    along = parameters[DRAG_ALONG][0]
    wind_x = parameters[WIND_X][0]
    wind_z = parameters[WIND_Z][0]
    gravity = parameters[GRAVITY_STEP][0]
    for k in range(PACK):
        y = PACK + k
        z = 2 * PACK + k
        vx = u[k]
        vy = u[y]
        vz = u[z]
        px = p[k]
        py = p[y]
        pz = p[z]
        m = blown(dt, keep, across, along, wind_x, wind_z, gravity, n[k], n[y], n[z], vx, vy, vz, px, py, pz)
        mine = k >= skip
        free = mine and mass[k] > 0.0
        b[k] = wp.where(mine, px, b[k])
        b[y] = wp.where(mine, py, b[y])
        b[z] = wp.where(mine, pz, b[z])
        u[k] = wp.where(free, m.vx, vx)
        u[y] = wp.where(free, m.vy, vy)
        u[z] = wp.where(free, m.vz, vz)
        p[k] = wp.where(free, m.px, px)
        p[y] = wp.where(free, m.py, py)
        p[z] = wp.where(free, m.pz, pz)
        q[k] = wp.where(free, m.px, q[k])
        q[y] = wp.where(free, m.py, q[y])
        q[z] = wp.where(free, m.pz, q[z])
    store(v, first, u)
    store(x, first, p)
    store(x_prev, first, b)
    store(x_pred, first, q)


@wp.kernel
def begin_packed_substep(
    inverse_mass: wp.array(dtype=float),
    parameters: wp.array(dtype=_one),
    normals: wp.array(dtype=wp.vec3),
    v: wp.array(dtype=wp.vec3),
    x: wp.array(dtype=wp.vec3),
    x_prev: wp.array(dtype=wp.vec3),
    x_pred: wp.array(dtype=wp.vec3),
):
    """:func:`predict` of a single world, sixteen vertices a thread."""
    pack = wp.tid()
    first = first_of(pack, x.shape[0])
    mass = load_scalars(inverse_mass, first)
    p = load(x, first)
    w = load(v, first)
    b = load(x_prev, first)
    q = load(x_pred, first)
    go_on(first, PACK * pack - first, mass, p, w, b, q, parameters, normals, v, x, x_prev, x_pred)


@wp.kernel
def end_packed_substep(
    fraction: float,
    step: float,
    goes_on: int,
    inverse_mass: wp.array(dtype=float),
    near: wp.array(dtype=int),
    clearance: wp.array(dtype=float),
    plane_point: wp.array(dtype=wp.vec3),
    plane_travel: wp.array(dtype=wp.vec3),
    plane_normal: wp.array(dtype=wp.vec3),
    plane_turn: wp.array(dtype=wp.vec3),
    parameters: wp.array(dtype=_one),
    normals: wp.array(dtype=wp.vec3),
    v: wp.array(dtype=wp.vec3),
    x: wp.array(dtype=wp.vec3),
    x_prev: wp.array(dtype=wp.vec3),
    x_pred: wp.array(dtype=wp.vec3),
):
    """:func:`solve_contact`, :func:`update_velocity` and, where ``goes_on`` is 1, the next :func:`predict`."""
    pack = wp.tid()
    first = first_of(pack, x.shape[0])
    skip = PACK * pack - first
    touching = load_integers(near, first)
    mass = load_scalars(inverse_mass, first)
    gap = load_scalars(clearance, first)
    a = load(plane_point, first)
    t = load(plane_travel, first)
    n = load(plane_normal, first)
    u = load(plane_turn, first)
    b = load(x_prev, first)
    q = load(x_pred, first)
    p = load(x, first)
    w = load(v, first)
    friction = parameters[FRICTION][0]
    over_dt = parameters[OVER_DT][0]
    max_speed = parameters[MAX_SPEED][0]
    for k in range(PACK):
        y = PACK + k
        z = 2 * PACK + k
        r = put_outside(
            fraction,
            step,
            friction,
            gap[k],
            a[k],
            a[y],
            a[z],
            t[k],
            t[y],
            t[z],
            n[k],
            n[y],
            n[z],
            u[k],
            u[y],
            u[z],
            b[k],
            b[y],
            b[z],
            p[k],
            p[y],
            p[z],
        )
        free = mass[k] > 0.0
        mine = k >= skip
        meets = mine and touching[k] != 0 and free
        px = wp.where(meets, r.x, p[k])
        py = wp.where(meets, r.y, p[y])
        pz = wp.where(meets, r.z, p[z])
        keeps = wp.where(free, 1.0, 0.0)
        vx = w[k] * keeps + (px - wp.where(free, q[k], b[k])) * over_dt
        vy = w[y] * keeps + (py - wp.where(free, q[y], b[y])) * over_dt
        vz = w[z] * keeps + (pz - wp.where(free, q[z], b[z])) * over_dt
        factor = capped(max_speed, vx, vy, vz)
        w[k] = wp.where(mine, vx * factor, w[k])
        w[y] = wp.where(mine, vy * factor, w[y])
        w[z] = wp.where(mine, vz * factor, w[z])
        p[k] = px
        p[y] = py
        p[z] = pz
    if goes_on != 0:
        go_on(first, skip, mass, p, w, b, q, parameters, normals, v, x, x_prev, x_pred)
    else:
        store(v, first, w)
        store(x, first, p)
