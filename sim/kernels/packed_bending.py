"""The bending of a single world on a CPU: sixteen hinges of one colour, which share no vertex, a thread.

Same constraints and arithmetic as ``bending``: 4 ns a hinge instead of 7, and 5 with creases.
"""

from __future__ import annotations

import warp as wp

from sim.kernels.bending import bent
from sim.kernels.lanes import LANE_OPTIONS, scalars
from sim.kernels.packs import PACK, gather, packed_float, packed_int, scatter
from sim.kernels.parameters import BEND, BEND_DAMPING, BEND_YIELD

wp.set_module_options(LANE_OPTIONS)

_one = scalars(1)


@wp.struct
class HingePack:
    """Sixteen hinges as in ``bending.Hinge``: weights [1/m], and these times the inverse masses.

    The weight of vertex 0 is the negative sum of the others.
    """

    i0: packed_int
    i1: packed_int
    i2: packed_int
    i3: packed_int
    w1: packed_float
    w2: packed_float
    w3: packed_float
    m0: packed_float
    m1: packed_float
    m2: packed_float
    m3: packed_float


@wp.kernel
def solve_packed_bending(
    first: int,
    span: float,
    rates: int,
    packs: wp.array(dtype=HingePack),
    parameters: wp.array(dtype=_one),
    values: wp.array(dtype=wp.vec3),
):
    """:func:`solve_bending` of a single world, sixteen hinges a thread; :func:`damp_bending` where ``rates`` is 1.

    The constraint is linear: damping does with velocities what bending does with positions.
    """
    t = packs[first + wp.tid()]
    stiffness = span * parameters[BEND][0] * wp.where(rates != 0, parameters[BEND_DAMPING][0], 1.0)
    x0 = gather(values, t.i0)
    x1 = gather(values, t.i1)
    x2 = gather(values, t.i2)
    x3 = gather(values, t.i3)
    w1 = t.w1
    w2 = t.w2
    w3 = t.w3
    m0 = t.m0
    m1 = t.m1
    m2 = t.m2
    m3 = t.m3
    for k in range(PACK):
        y = PACK + k
        z = 2 * PACK + k
        norm = w1[k] * (m1[k] - m0[k]) + w2[k] * (m2[k] - m0[k]) + w3[k] * (m3[k] - m0[k])
        scale = -stiffness / (1.0 + stiffness * norm)
        px = scale * (w1[k] * (x1[k] - x0[k]) + w2[k] * (x2[k] - x0[k]) + w3[k] * (x3[k] - x0[k]))
        py = scale * (w1[k] * (x1[y] - x0[y]) + w2[k] * (x2[y] - x0[y]) + w3[k] * (x3[y] - x0[y]))
        pz = scale * (w1[k] * (x1[z] - x0[z]) + w2[k] * (x2[z] - x0[z]) + w3[k] * (x3[z] - x0[z]))
        x0[k] = x0[k] + px * m0[k]
        x0[y] = x0[y] + py * m0[k]
        x0[z] = x0[z] + pz * m0[k]
        x1[k] = x1[k] + px * m1[k]
        x1[y] = x1[y] + py * m1[k]
        x1[z] = x1[z] + pz * m1[k]
        x2[k] = x2[k] + px * m2[k]
        x2[y] = x2[y] + py * m2[k]
        x2[z] = x2[z] + pz * m2[k]
        x3[k] = x3[k] + px * m3[k]
        x3[y] = x3[y] + py * m3[k]
        x3[z] = x3[z] + pz * m3[k]
    scatter(values, t.i0, x0)
    scatter(values, t.i1, x1)
    scatter(values, t.i2, x2)
    scatter(values, t.i3, x3)


@wp.kernel
def solve_packed_creased_bending(
    first: int,
    span: float,
    packs: wp.array(dtype=HingePack),
    parameters: wp.array(dtype=_one),
    crease: wp.array(dtype=packed_float),
    x: wp.array(dtype=wp.vec3),
):
    """:func:`solve_creased_bending` of a single world, sixteen hinges a thread."""
    pack = first + wp.tid()
    t = packs[pack]
    stiffness = span * parameters[BEND][0]
    rest = crease[pack]
    x0 = gather(x, t.i0)
    x1 = gather(x, t.i1)
    x2 = gather(x, t.i2)
    x3 = gather(x, t.i3)
    w1 = t.w1
    w2 = t.w2
    w3 = t.w3
    m0 = t.m0
    m1 = t.m1
    m2 = t.m2
    m3 = t.m3
    for k in range(PACK):
        y = PACK + k
        z = 2 * PACK + k
        norm = w1[k] * (m1[k] - m0[k]) + w2[k] * (m2[k] - m0[k]) + w3[k] * (m3[k] - m0[k])
        scale = -stiffness / (1.0 + stiffness * norm)
        b = bent(
            w1[k], w2[k], w3[k], x0[k], x0[y], x0[z], x1[k], x1[y], x1[z], x2[k], x2[y], x2[z], x3[k], x3[y], x3[z]
        )
        px = scale * (b.cx - rest[k] * b.nx)
        py = scale * (b.cy - rest[k] * b.ny)
        pz = scale * (b.cz - rest[k] * b.nz)
        x0[k] = x0[k] + px * m0[k]
        x0[y] = x0[y] + py * m0[k]
        x0[z] = x0[z] + pz * m0[k]
        x1[k] = x1[k] + px * m1[k]
        x1[y] = x1[y] + py * m1[k]
        x1[z] = x1[z] + pz * m1[k]
        x2[k] = x2[k] + px * m2[k]
        x2[y] = x2[y] + py * m2[k]
        x2[z] = x2[z] + pz * m2[k]
        x3[k] = x3[k] + px * m3[k]
        x3[y] = x3[y] + py * m3[k]
        x3[z] = x3[z] + pz * m3[k]
    scatter(x, t.i0, x0)
    scatter(x, t.i1, x1)
    scatter(x, t.i2, x2)
    scatter(x, t.i3, x3)


@wp.kernel
def yield_packed_hinges(
    packs: wp.array(dtype=HingePack),
    over_curvature: wp.array(dtype=packed_float),
    parameters: wp.array(dtype=_one),
    x: wp.array(dtype=wp.vec3),
    crease: wp.array(dtype=packed_float),
):
    """:func:`yield_hinges` of a single world, sixteen hinges a thread."""
    pack = wp.tid()
    t = packs[pack]
    limit = parameters[BEND_YIELD][0]
    rest = crease[pack]
    over = over_curvature[pack]
    x0 = gather(x, t.i0)
    x1 = gather(x, t.i1)
    x2 = gather(x, t.i2)
    x3 = gather(x, t.i3)
    w1 = t.w1
    w2 = t.w2
    w3 = t.w3
    for k in range(PACK):
        y = PACK + k
        z = 2 * PACK + k
        b = bent(
            w1[k], w2[k], w3[k], x0[k], x0[y], x0[z], x1[k], x1[y], x1[z], x2[k], x2[y], x2[z], x3[k], x3[y], x3[z]
        )
        elastic = limit * over[k]
        rest[k] = wp.max(b.along - elastic, wp.min(rest[k], b.along + elastic))
    crease[pack] = rest
