"""Membrane constraints of triangles: warp, weft and shear of Baraff & Witkin (1998), solved together by XPBD.

Energy: ``A/2 [k_stretch ((|w_u| - 1)^2 + (|w_v| - 1)^2) + k_shear (w_u . w_v)^2]``; where ``|w| < 1``, ``k_stretch`` is
multiplied by the compression ratio.

Here the worlds are in the lanes; ``packed_membrane`` has the same for a single world on a CPU, where sixteen triangles
of one colour take the lanes instead. See ``lanes`` for why everything is spelt in components.
"""

from __future__ import annotations

from typing import Any

import warp as wp

from sim.kernels.lanes import LANE_OPTIONS, WIDTHS, declare
from sim.kernels.parameters import COMPRESSION_ROOT, SHEAR_ROOT, STRETCH_DAMPING, STRETCH_ROOT

wp.set_module_options(LANE_OPTIONS)

# Keeps a collapsed direction from a division by zero; its gradient vanishes with it.
_TINY = wp.constant(1.0e-12)


@wp.struct
class Triangle:
    """Rest state: vertices, inverse rest matrix [1/m], root of the rest area [m]."""

    i0: int
    i1: int
    i2: int
    du1: float
    du2: float
    dv1: float
    dv2: float
    root_area: float


@wp.struct
class Shape:
    """What a triangle's solve needs of its rest state: ``w = e1 d1 + e2 d2`` for the edges from its first vertex.

    ``mu`` and ``mv`` are the gradients of w_u and w_v by each vertex times its inverse mass, ``uu``, ``uv`` and ``vv``
    their products.
    """

    du1: float
    du2: float
    dv1: float
    dv2: float
    mu0: float
    mu1: float
    mu2: float
    mv0: float
    mv1: float
    mv2: float
    uu: float
    uv: float
    vv: float


@wp.struct
class Corners:
    """Vectors at the three vertices of a triangle."""

    x0: float
    y0: float
    z0: float
    x1: float
    y1: float
    z1: float
    x2: float
    y2: float
    z2: float


@wp.struct
class Multipliers:
    """Solved multipliers: a vertex moves by ``(w_u u + w_v across) mu + (w_v v + w_u across) mv``."""

    u: float
    v: float
    across: float
    # A struct of at most 16 bytes would be returned in vector registers, and the vectoriser would give up.
    _pad0: float
    _pad1: float


@wp.func
def shape_of(du1: float, du2: float, dv1: float, dv2: float, m0: float, m1: float, m2: float):
    s = Shape()
    s.du1 = du1
    s.du2 = du2
    s.dv1 = dv1
    s.dv2 = dv2
    s.mu0 = -m0 * (du1 + du2)
    s.mu1 = m1 * du1
    s.mu2 = m2 * du2
    s.mv0 = -m0 * (dv1 + dv2)
    s.mv1 = m1 * dv1
    s.mv2 = m2 * dv2
    s.uu = s.mu1 * du1 + s.mu2 * du2 - s.mu0 * (du1 + du2)
    s.uv = s.mu1 * dv1 + s.mu2 * dv2 - s.mu0 * (dv1 + dv2)
    s.vv = s.mv1 * dv1 + s.mv2 * dv2 - s.mv0 * (dv1 + dv2)
    return s


@wp.func
def solve(
    t: Shape,
    lu: float,
    lv: float,
    shear: float,
    stretch_root: float,
    shear_root: float,
    compression_root: float,
    cu: float,
    cv: float,
    cs: float,
):
    """Solve ``(J W J^T + alpha) dl = -c`` with ``alpha = 1 / (k A dt^2 / density)``.

    Both sides are scaled by the roots of the stiffnesses, ``I + S J W J^T S``: sound for every stiffness, zero
    included, and each pivot of its LDL^T is at least 1, rounding included.
    """
    over_lu = 1.0 / lu
    over_lv = 1.0 / lv
    su = stretch_root * wp.where(lu < 1.0, compression_root, 1.0)
    sv = stretch_root * wp.where(lv < 1.0, compression_root, 1.0)
    ss = shear_root
    cosine_lv = shear * over_lu
    cosine_lu = shear * over_lv
    a11 = 1.0 + su * su * t.uu
    a12 = su * sv * t.uv * cosine_lv * over_lv
    a13 = su * ss * (t.uu * cosine_lv + t.uv * lu)
    a22 = 1.0 + sv * sv * t.vv
    a23 = sv * ss * (t.uv * lv + t.vv * cosine_lu)
    a33 = 1.0 + ss * ss * (t.uu * lv * lv + 2.0 * t.uv * shear + t.vv * lu * lu)

    q1 = 1.0 / a11
    l21 = a12 * q1
    l31 = a13 * q1
    q2 = 1.0 / wp.max(a22 - l21 * a12, 1.0)
    b23 = a23 - l31 * a12
    l32 = b23 * q2
    q3 = 1.0 / wp.max(a33 - l31 * a13 - l32 * b23, 1.0)
    ru = -su * cu
    rv = -sv * cv - l21 * ru
    rs = -ss * cs - l31 * ru - l32 * rv
    rs = rs * q3
    rv = rv * q2 - l32 * rs
    ru = ru * q1 - l21 * rv - l31 * rs
    m = Multipliers()
    m.u = su * ru * over_lu
    m.v = sv * rv * over_lv
    m.across = ss * rs
    return m


@wp.func
def moved(
    t: Shape, p: Corners, values: Corners, rates: float, stretch_root: float, shear_root: float, compression_root: float
):
    """``values`` after the solve at positions ``p``: the positions themselves, or velocities where ``rates`` is 1.

    For positions the constraints are ``|w_u| - 1``, ``|w_v| - 1`` and ``w_u . w_v``, for velocities their rates.
    """
    ux = (p.x1 - p.x0) * t.du1 + (p.x2 - p.x0) * t.du2
    uy = (p.y1 - p.y0) * t.du1 + (p.y2 - p.y0) * t.du2
    uz = (p.z1 - p.z0) * t.du1 + (p.z2 - p.z0) * t.du2
    vx = (p.x1 - p.x0) * t.dv1 + (p.x2 - p.x0) * t.dv2
    vy = (p.y1 - p.y0) * t.dv1 + (p.y2 - p.y0) * t.dv2
    vz = (p.z1 - p.z0) * t.dv1 + (p.z2 - p.z0) * t.dv2
    lu = wp.sqrt(ux * ux + uy * uy + uz * uz + _TINY)
    lv = wp.sqrt(vx * vx + vy * vy + vz * vz + _TINY)
    shear = ux * vx + uy * vy + uz * vz
    cu = lu - 1.0
    cv = lv - 1.0
    cs = shear
    if rates > 0.0:
        fx = (values.x1 - values.x0) * t.du1 + (values.x2 - values.x0) * t.du2
        fy = (values.y1 - values.y0) * t.du1 + (values.y2 - values.y0) * t.du2
        fz = (values.z1 - values.z0) * t.du1 + (values.z2 - values.z0) * t.du2
        gx = (values.x1 - values.x0) * t.dv1 + (values.x2 - values.x0) * t.dv2
        gy = (values.y1 - values.y0) * t.dv1 + (values.y2 - values.y0) * t.dv2
        gz = (values.z1 - values.z0) * t.dv1 + (values.z2 - values.z0) * t.dv2
        cu = (ux * fx + uy * fy + uz * fz) / lu
        cv = (vx * gx + vy * gy + vz * gz) / lv
        cs = fx * vx + fy * vy + fz * vz + ux * gx + uy * gy + uz * gz
    m = solve(t, lu, lv, shear, stretch_root, shear_root, compression_root, cu, cv, cs)
    px = ux * m.u + vx * m.across
    py = uy * m.u + vy * m.across
    pz = uz * m.u + vz * m.across
    qx = vx * m.v + ux * m.across
    qy = vy * m.v + uy * m.across
    qz = vz * m.v + uz * m.across
    r = Corners()
    r.x0 = values.x0 + px * t.mu0 + qx * t.mv0
    r.y0 = values.y0 + py * t.mu0 + qy * t.mv0
    r.z0 = values.z0 + pz * t.mu0 + qz * t.mv0
    r.x1 = values.x1 + px * t.mu1 + qx * t.mv1
    r.y1 = values.y1 + py * t.mu1 + qy * t.mv1
    r.z1 = values.z1 + pz * t.mu1 + qz * t.mv1
    r.x2 = values.x2 + px * t.mu2 + qx * t.mv2
    r.y2 = values.y2 + py * t.mu2 + qy * t.mv2
    r.z2 = values.z2 + pz * t.mu2 + qz * t.mv2
    return r


@wp.func
def corners_of(x0: float, y0: float, z0: float, x1: float, y1: float, z1: float, x2: float, y2: float, z2: float):
    c = Corners()
    c.x0 = x0
    c.y0 = y0
    c.z0 = z0
    c.x1 = x1
    c.y1 = y1
    c.z1 = z1
    c.x2 = x2
    c.y2 = y2
    c.z2 = z2
    return c


@wp.kernel
def solve_membrane(
    first: int,
    triangles: wp.array(dtype=Triangle),
    inverse_mass: wp.array(dtype=float),
    parameters: wp.array(dtype=Any),
    x: wp.array(dtype=Any),
):
    """One XPBD step of the triangles of a colour; updates ``x`` [m].

    With one iteration a substep the multipliers start at zero (Macklin et al. 2019).
    """
    t = triangles[first + wp.tid()]
    stretch_root = parameters[STRETCH_ROOT]
    shear_root = parameters[SHEAR_ROOT]
    compression_root = parameters[COMPRESSION_ROOT]
    x0 = x[t.i0]
    x1 = x[t.i1]
    x2 = x[t.i2]
    s = shape_of(t.du1, t.du2, t.dv1, t.dv2, inverse_mass[t.i0], inverse_mass[t.i1], inverse_mass[t.i2])
    root_area = t.root_area
    lanes = len(stretch_root)
    for k in range(lanes):
        y = lanes + k
        z = 2 * lanes + k
        p = corners_of(x0[k], x0[y], x0[z], x1[k], x1[y], x1[z], x2[k], x2[y], x2[z])
        r = moved(s, p, p, 0.0, stretch_root[k] * root_area, shear_root[k] * root_area, compression_root[k])
        x0[k] = r.x0
        x0[y] = r.y0
        x0[z] = r.z0
        x1[k] = r.x1
        x1[y] = r.y1
        x1[z] = r.z1
        x2[k] = r.x2
        x2[y] = r.y2
        x2[z] = r.z2
    x[t.i0] = x0
    x[t.i1] = x1
    x[t.i2] = x2


@wp.kernel
def damp_membrane(
    first: int,
    span: float,
    triangles: wp.array(dtype=Triangle),
    inverse_mass: wp.array(dtype=float),
    parameters: wp.array(dtype=Any),
    x: wp.array(dtype=Any),
    v: wp.array(dtype=Any),
):
    """Stiffness-proportional damping of a colour over ``span`` substeps, implicit in each triangle; moves ``v`` [m/s].

    Force ``-k tau dC/dt`` per constraint. It acts on velocities, apart from the positions' solve: inside it (Macklin et
    al. 2016, eq. 26), damping holds back the corrections themselves, and cloth sags ``1 + tau/dt`` times as far.
    """
    t = triangles[first + wp.tid()]
    stretch_root = parameters[STRETCH_ROOT]
    shear_root = parameters[SHEAR_ROOT]
    compression_root = parameters[COMPRESSION_ROOT]
    damping = parameters[STRETCH_DAMPING]
    x0 = x[t.i0]
    x1 = x[t.i1]
    x2 = x[t.i2]
    v0 = v[t.i0]
    v1 = v[t.i1]
    v2 = v[t.i2]
    s = shape_of(t.du1, t.du2, t.dv1, t.dv2, inverse_mass[t.i0], inverse_mass[t.i1], inverse_mass[t.i2])
    root_area = t.root_area
    lanes = len(stretch_root)
    for k in range(lanes):
        y = lanes + k
        z = 2 * lanes + k
        p = corners_of(x0[k], x0[y], x0[z], x1[k], x1[y], x1[z], x2[k], x2[y], x2[z])
        w = corners_of(v0[k], v0[y], v0[z], v1[k], v1[y], v1[z], v2[k], v2[y], v2[z])
        scale = wp.sqrt(span * damping[k]) * root_area
        r = moved(s, p, w, 1.0, stretch_root[k] * scale, shear_root[k] * scale, compression_root[k])
        v0[k] = r.x0
        v0[y] = r.y0
        v0[z] = r.z0
        v1[k] = r.x1
        v1[y] = r.y1
        v1[z] = r.z1
        v2[k] = r.x2
        v2[y] = r.y2
        v2[z] = r.z2
    v[t.i0] = v0
    v[t.i1] = v1
    v[t.i2] = v2


for _width in WIDTHS:
    declare(solve_membrane, _width, parameters="scalars", x="vectors")
    declare(damp_membrane, _width, parameters="scalars", x="vectors", v="vectors")
