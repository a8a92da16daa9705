"""Membrane constraint of one triangle: warp, weft and shear of Baraff & Witkin (1998), solved together by XPBD.

Energy: ``A/2 [k_stretch ((|w_u| - 1)^2 + (|w_v| - 1)^2) + k_shear (w_u . w_v)^2]``; where ``|w| < 1``, ``k_stretch`` is
multiplied by the compression ratio.
"""

from __future__ import annotations

import warp as wp

from sim.kernels.parameters import SubstepParameters

wp.set_module_options({"enable_backward": False})


@wp.struct
class Triangle:
    """Rest state of a triangle, 32 bytes: vertices, inverse rest matrix [1/m], root of the rest area [m]."""

    i0: int
    i1: int
    i2: int
    du1: float
    du2: float
    dv1: float
    dv2: float
    root_area: float


@wp.struct
class Deformation:
    """Deformation of a triangle: columns of its gradient, their lengths and directions, and ``J W J^T``'s scalars."""

    wu: wp.vec3
    wv: wp.vec3
    nu: wp.vec3
    nv: wp.vec3
    lu: float
    lv: float
    shear: float
    cosine: float  # of the angle between the columns
    gu0: float  # gradient of w_u by the first vertex, a multiple of the identity [1/m]
    gv0: float
    uu: float  # sums of inverse mass times gradients, per density
    uv: float
    vv: float


@wp.func
def deform(t: Triangle, x0: wp.vec3, x1: wp.vec3, x2: wp.vec3, m0: float, m1: float, m2: float):
    s = Deformation()
    d1 = x1 - x0
    d2 = x2 - x0
    s.wu = d1 * t.du1 + d2 * t.du2
    s.wv = d1 * t.dv1 + d2 * t.dv2
    s.lu = wp.max(wp.length(s.wu), 1.0e-6)
    s.lv = wp.max(wp.length(s.wv), 1.0e-6)
    s.shear = wp.dot(s.wu, s.wv)
    over_lu = 1.0 / s.lu
    over_lv = 1.0 / s.lv
    s.nu = s.wu * over_lu
    s.nv = s.wv * over_lv
    s.cosine = s.shear * over_lu * over_lv
    s.gu0 = -(t.du1 + t.du2)
    s.gv0 = -(t.dv1 + t.dv2)
    s.uu = m0 * s.gu0 * s.gu0 + m1 * t.du1 * t.du1 + m2 * t.du2 * t.du2
    s.uv = m0 * s.gu0 * s.gv0 + m1 * t.du1 * t.dv1 + m2 * t.du2 * t.dv2
    s.vv = m0 * s.gv0 * s.gv0 + m1 * t.dv1 * t.dv1 + m2 * t.dv2 * t.dv2
    return s


@wp.func
def solve_triangle(s: Deformation, scale: wp.vec3, constraint: wp.vec3):
    """Multipliers of ``(J W J^T + alpha) dl = -constraint`` for compliances ``alpha = 1 / scale^2``.

    Both sides are scaled, ``I + S J W J^T S``, so that the matrix is sound for every stiffness including zero, and
    each pivot of its LDL^T is at least 1, rounding included.
    """
    su = scale[0]
    sv = scale[1]
    ss = scale[2]
    a11 = 1.0 + su * su * s.uu
    a12 = su * sv * s.uv * s.cosine
    a13 = su * ss * (s.uu * s.cosine * s.lv + s.uv * s.lu)
    a22 = 1.0 + sv * sv * s.vv
    a23 = sv * ss * (s.uv * s.lv + s.vv * s.cosine * s.lu)
    a33 = 1.0 + ss * ss * (s.uu * s.lv * s.lv + 2.0 * s.uv * s.shear + s.vv * s.lu * s.lu)
    ru = -su * constraint[0]
    rv = -sv * constraint[1]
    rs = -ss * constraint[2]
    q1 = 1.0 / a11
    l21 = a12 * q1
    l31 = a13 * q1
    q2 = 1.0 / wp.max(a22 - l21 * a12, 1.0)
    b23 = a23 - l31 * a12
    l32 = b23 * q2
    q3 = 1.0 / wp.max(a33 - l31 * a13 - l32 * b23, 1.0)
    rv = rv - l21 * ru
    rs = (rs - l31 * ru - l32 * rv) * q3
    rv = rv * q2 - l32 * rs
    ru = ru * q1 - l21 * rv - l31 * rs
    return wp.vec3(su * ru, sv * rv, ss * rs)


@wp.func
def stiffness_roots(s: Deformation, root_area: float, p: SubstepParameters):
    """Square roots of area times stiffness times dt^2 over density for warp, weft and shear [m^2]."""
    stretch = root_area * p.stretch_root
    soft = stretch * p.compression_root
    return wp.vec3(wp.where(s.lu < 1.0, soft, stretch), wp.where(s.lv < 1.0, soft, stretch), root_area * p.shear_root)


@wp.kernel
def solve_membrane(
    first: int,
    triangles: wp.array(dtype=Triangle),
    inverse_mass: wp.array(dtype=float),
    parameters: wp.array(dtype=SubstepParameters),
    x: wp.array(dtype=wp.vec3),
):
    """One XPBD step of the triangles of a colour; updates ``x`` [m].

    With one iteration a substep the multipliers start at zero (Macklin et al. 2019).
    """
    t = triangles[first + wp.tid()]
    x0 = x[t.i0]
    x1 = x[t.i1]
    x2 = x[t.i2]
    m0 = inverse_mass[t.i0]
    m1 = inverse_mass[t.i1]
    m2 = inverse_mass[t.i2]
    s = deform(t, x0, x1, x2, m0, m1, m2)
    scale = stiffness_roots(s, t.root_area, parameters[0])
    push = solve_triangle(s, scale, wp.vec3(s.lu - 1.0, s.lv - 1.0, s.shear))
    push_u = s.nu * push[0] + s.wv * push[2]
    push_v = s.nv * push[1] + s.wu * push[2]
    x[t.i0] = x0 + (push_u * s.gu0 + push_v * s.gv0) * m0
    x[t.i1] = x1 + (push_u * t.du1 + push_v * t.dv1) * m1
    x[t.i2] = x2 + (push_u * t.du2 + push_v * t.dv2) * m2


@wp.kernel
def damp_membrane(
    first: int,
    span: float,
    triangles: wp.array(dtype=Triangle),
    inverse_mass: wp.array(dtype=float),
    parameters: wp.array(dtype=SubstepParameters),
    x: wp.array(dtype=wp.vec3),
    v: wp.array(dtype=wp.vec3),
):
    """Stiffness-proportional damping of a colour over ``span`` substeps, implicit in each triangle; updates ``v`` [m/s].

    Force ``-k tau dC/dt`` per constraint. It acts on velocities, apart from the positions' solve: inside it (Macklin et
    al. 2016, eq. 26), damping holds back the corrections themselves, and cloth sags ``1 + tau/dt`` times as far.
    """
    t = triangles[first + wp.tid()]
    p = parameters[0]
    v0 = v[t.i0]
    v1 = v[t.i1]
    v2 = v[t.i2]
    m0 = inverse_mass[t.i0]
    m1 = inverse_mass[t.i1]
    m2 = inverse_mass[t.i2]
    s = deform(t, x[t.i0], x[t.i1], x[t.i2], m0, m1, m2)
    scale = stiffness_roots(s, t.root_area, p) * wp.sqrt(span * p.stretch_damping)
    e1 = v1 - v0
    e2 = v2 - v0
    du = e1 * t.du1 + e2 * t.du2
    dv = e1 * t.dv1 + e2 * t.dv2
    rate = wp.vec3(wp.dot(s.nu, du), wp.dot(s.nv, dv), wp.dot(du, s.wv) + wp.dot(s.wu, dv))
    push = solve_triangle(s, scale, rate)
    push_u = s.nu * push[0] + s.wv * push[2]
    push_v = s.nv * push[1] + s.wu * push[2]
    v[t.i0] = v0 + (push_u * s.gu0 + push_v * s.gv0) * m0
    v[t.i1] = v1 + (push_u * t.du1 + push_v * t.dv1) * m1
    v[t.i2] = v2 + (push_u * t.du2 + push_v * t.dv2) * m2
