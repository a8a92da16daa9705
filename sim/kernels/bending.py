"""Bending constraint of one hinge: isometric quadratic energy (Bergou et al. 2006), solved by XPBD.

Energy ``k/2 |C - C0 n|^2`` with the vector constraint ``C = sum_i weight_i x_i``, which is the hinge's curvature times
its normal n; the components have the same gradient, so that one scalar solve moves the hinge. ``C0`` is the crease that
plastic bending left; elastic cloth has none, and its kernel does without the normal.

The weights add up to zero: C is taken from differences of positions, which keep their digits far from the origin.
"""

from __future__ import annotations

from typing import Any

import warp as wp

from sim.kernels.lanes import LANE_OPTIONS, WIDTHS, declare
from sim.kernels.parameters import BEND, BEND_DAMPING, BEND_YIELD

wp.set_module_options(LANE_OPTIONS)

_TINY = wp.constant(1.0e-20)


@wp.struct
class Hinge:
    """Vertices (0, 1 on the edge, 2, 3 opposite), weights [1/m] and their norm under the inverse masses [1/m^4].

    ``over_curvature`` turns a curvature [1/m] into the constraint's length [1].
    """

    i0: int
    i1: int
    i2: int
    i3: int
    weight: wp.vec4
    norm: float
    over_curvature: float


@wp.kernel
def solve_bending(
    first: int,
    span: float,
    hinges: wp.array(dtype=Hinge),
    inverse_mass: wp.array(dtype=float),
    parameters: wp.array(dtype=Any),
    x: wp.array(dtype=Any),
):
    """One XPBD step of the hinges of a colour, with the impulse of ``span`` substeps; updates ``x`` [m]."""
    h = hinges[first + wp.tid()]
    bend = parameters[BEND]
    lanes = len(bend)
    x0 = x[h.i0]
    x1 = x[h.i1]
    x2 = x[h.i2]
    x3 = x[h.i3]
    w0 = h.weight[0]
    w1 = h.weight[1]
    w2 = h.weight[2]
    w3 = h.weight[3]
    m0 = w0 * inverse_mass[h.i0]
    m1 = w1 * inverse_mass[h.i1]
    m2 = w2 * inverse_mass[h.i2]
    m3 = w3 * inverse_mass[h.i3]
    norm = h.norm
    for k in range(lanes):
        stiffness = span * bend[k]
        scale = -stiffness / (1.0 + stiffness * norm)
        for c in range(3):
            j = c * lanes + k
            push = scale * (w1 * (x1[j] - x0[j]) + w2 * (x2[j] - x0[j]) + w3 * (x3[j] - x0[j]))
            x0[j] = x0[j] + push * m0
            x1[j] = x1[j] + push * m1
            x2[j] = x2[j] + push * m2
            x3[j] = x3[j] + push * m3
    x[h.i0] = x0
    x[h.i1] = x1
    x[h.i2] = x2
    x[h.i3] = x3


@wp.struct
class Bent:
    """Normal of a hinge, its constraint [1], and the constraint's part along the normal."""

    nx: float
    ny: float
    nz: float
    cx: float
    cy: float
    cz: float
    along: float


@wp.func
def bent(
    w1: float,
    w2: float,
    w3: float,
    x0: float,
    y0: float,
    z0: float,
    x1: float,
    y1: float,
    z1: float,
    x2: float,
    y2: float,
    z2: float,
    x3: float,
    y3: float,
    z3: float,
):
    # The mean normal of the wings is that of the plane through the edge's ends which halves their angle.
    ex = x1 - x0
    ey = y1 - y0
    ez = z1 - z0
    fx = x2 - x3
    fy = y2 - y3
    fz = z2 - z3
    nx = ey * fz - ez * fy
    ny = ez * fx - ex * fz
    nz = ex * fy - ey * fx
    over = 1.0 / wp.sqrt(nx * nx + ny * ny + nz * nz + _TINY)
    b = Bent()
    b.nx = nx * over
    b.ny = ny * over
    b.nz = nz * over
    b.cx = w1 * (x1 - x0) + w2 * (x2 - x0) + w3 * (x3 - x0)
    b.cy = w1 * (y1 - y0) + w2 * (y2 - y0) + w3 * (y3 - y0)
    b.cz = w1 * (z1 - z0) + w2 * (z2 - z0) + w3 * (z3 - z0)
    b.along = b.cx * b.nx + b.cy * b.ny + b.cz * b.nz
    return b


@wp.kernel
def solve_creased_bending(
    first: int,
    span: float,
    hinges: wp.array(dtype=Hinge),
    inverse_mass: wp.array(dtype=float),
    parameters: wp.array(dtype=Any),
    crease: wp.array(dtype=Any),
    x: wp.array(dtype=Any),
):
    """:func:`solve_bending` towards the ``crease`` C0 [1] of each hinge."""
    i = first + wp.tid()
    h = hinges[i]
    bend = parameters[BEND]
    rest = crease[i]
    lanes = len(bend)
    x0 = x[h.i0]
    x1 = x[h.i1]
    x2 = x[h.i2]
    x3 = x[h.i3]
    w1 = h.weight[1]
    w2 = h.weight[2]
    w3 = h.weight[3]
    m0 = h.weight[0] * inverse_mass[h.i0]
    m1 = w1 * inverse_mass[h.i1]
    m2 = w2 * inverse_mass[h.i2]
    m3 = w3 * inverse_mass[h.i3]
    norm = h.norm
    for k in range(lanes):
        y = lanes + k
        z = 2 * lanes + k
        stiffness = span * bend[k]
        scale = -stiffness / (1.0 + stiffness * norm)
        b = bent(w1, w2, w3, x0[k], x0[y], x0[z], x1[k], x1[y], x1[z], x2[k], x2[y], x2[z], x3[k], x3[y], x3[z])
        px = scale * (b.cx - rest[k] * b.nx)
        py = scale * (b.cy - rest[k] * b.ny)
        pz = scale * (b.cz - rest[k] * b.nz)
        x0[k] = x0[k] + px * m0
        x0[y] = x0[y] + py * m0
        x0[z] = x0[z] + pz * m0
        x1[k] = x1[k] + px * m1
        x1[y] = x1[y] + py * m1
        x1[z] = x1[z] + pz * m1
        x2[k] = x2[k] + px * m2
        x2[y] = x2[y] + py * m2
        x2[z] = x2[z] + pz * m2
        x3[k] = x3[k] + px * m3
        x3[y] = x3[y] + py * m3
        x3[z] = x3[z] + pz * m3
    x[h.i0] = x0
    x[h.i1] = x1
    x[h.i2] = x2
    x[h.i3] = x3


@wp.kernel
def yield_hinges(
    hinges: wp.array(dtype=Hinge),
    parameters: wp.array(dtype=Any),
    x: wp.array(dtype=Any),
    crease: wp.array(dtype=Any),
):
    """Ideal plasticity: what a hinge is bent beyond the yield curvature, away from its crease, becomes crease."""
    i = wp.tid()
    h = hinges[i]
    limit = parameters[BEND_YIELD]
    rest = crease[i]
    lanes = len(limit)
    x0 = x[h.i0]
    x1 = x[h.i1]
    x2 = x[h.i2]
    x3 = x[h.i3]
    w1 = h.weight[1]
    w2 = h.weight[2]
    w3 = h.weight[3]
    over_curvature = h.over_curvature
    for k in range(lanes):
        y = lanes + k
        z = 2 * lanes + k
        b = bent(w1, w2, w3, x0[k], x0[y], x0[z], x1[k], x1[y], x1[z], x2[k], x2[y], x2[z], x3[k], x3[y], x3[z])
        elastic = limit[k] * over_curvature
        rest[k] = wp.max(b.along - elastic, wp.min(rest[k], b.along + elastic))
    crease[i] = rest


@wp.kernel
def damp_bending(
    first: int,
    span: float,
    hinges: wp.array(dtype=Hinge),
    inverse_mass: wp.array(dtype=float),
    parameters: wp.array(dtype=Any),
    v: wp.array(dtype=Any),
):
    """Stiffness-proportional damping of a colour over ``span`` substeps, implicit in each hinge; moves ``v`` [m/s]."""
    h = hinges[first + wp.tid()]
    bend = parameters[BEND]
    damping = parameters[BEND_DAMPING]
    lanes = len(bend)
    v0 = v[h.i0]
    v1 = v[h.i1]
    v2 = v[h.i2]
    v3 = v[h.i3]
    w0 = h.weight[0]
    w1 = h.weight[1]
    w2 = h.weight[2]
    w3 = h.weight[3]
    m0 = w0 * inverse_mass[h.i0]
    m1 = w1 * inverse_mass[h.i1]
    m2 = w2 * inverse_mass[h.i2]
    m3 = w3 * inverse_mass[h.i3]
    norm = h.norm
    for k in range(lanes):
        stiffness = bend[k] * damping[k] * span
        scale = -stiffness / (1.0 + stiffness * norm)
        for c in range(3):
            j = c * lanes + k
            push = scale * (w1 * (v1[j] - v0[j]) + w2 * (v2[j] - v0[j]) + w3 * (v3[j] - v0[j]))
            v0[j] = v0[j] + push * m0
            v1[j] = v1[j] + push * m1
            v2[j] = v2[j] + push * m2
            v3[j] = v3[j] + push * m3
    v[h.i0] = v0
    v[h.i1] = v1
    v[h.i2] = v2
    v[h.i3] = v3


for _width in WIDTHS:
    declare(solve_bending, _width, parameters="scalars", x="vectors")
    declare(solve_creased_bending, _width, parameters="scalars", crease="scalars", x="vectors")
    declare(yield_hinges, _width, parameters="scalars", x="vectors", crease="scalars")
    declare(damp_bending, _width, parameters="scalars", v="vectors")
