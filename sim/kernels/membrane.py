"""Membrane constraints of triangles: warp, weft and shear of Baraff & Witkin (1998), solved together by XPBD.

Energy: ``A/2 [k_stretch ((|w_u| - 1)^2 + (|w_v| - 1)^2) + k_shear (w_u . w_v)^2]``; where ``|w| < 1``, ``k_stretch`` is
multiplied by the compression ratio. A thread solves four triangles of one colour in SIMD lanes: in what follows, every
scalar is a ``vec4`` and every vector is ``Vectors``.
"""

from __future__ import annotations

import warp as wp

from sim.kernels.lanes import Vectors, gather, gather_scalars, inner, inverse, minus, plus, root, scaled, scatter, times
from sim.kernels.parameters import SubstepParameters

# Contracted products and full inlining make a triangle twice as fast as the default flags do.
_FLAGS = "-march=native -ffp-contract=fast -mllvm=-inline-threshold=9000"
wp.set_module_options({"enable_backward": False, "cpu_compiler_flags": _FLAGS})

LANES = 4


@wp.struct
class Triangles:
    """Rest states of up to four triangles: vertices, inverse rest matrices [1/m], roots of the rest areas [m]."""

    count: int
    i0: wp.vec4i
    i1: wp.vec4i
    i2: wp.vec4i
    du1: wp.vec4
    du2: wp.vec4
    dv1: wp.vec4
    dv2: wp.vec4
    root_area: wp.vec4


@wp.struct
class Deformation:
    """Deformed triangles: gradient columns, their lengths, and what the constraints' gradients are made of."""

    wu: Vectors
    wv: Vectors
    lu: wp.vec4
    lv: wp.vec4
    over_lu: wp.vec4
    over_lv: wp.vec4
    shear: wp.vec4  # w_u . w_v
    # Gradients of w_u and w_v by the vertices (multiples of the identity) times inverse mass.
    mu0: wp.vec4
    mu1: wp.vec4
    mu2: wp.vec4
    mv0: wp.vec4
    mv1: wp.vec4
    mv2: wp.vec4
    # Gradients under the inverse masses.
    uu: wp.vec4
    uv: wp.vec4
    vv: wp.vec4


@wp.func
def column(e1: Vectors, e2: Vectors, d1: wp.vec4, d2: wp.vec4):
    return plus(scaled(e1, d1), scaled(e2, d2))


@wp.func
def deform(t: Triangles, x0: Vectors, x1: Vectors, x2: Vectors, inverse_mass: wp.array(dtype=float)):
    s = Deformation()
    e1 = minus(x1, x0)
    e2 = minus(x2, x0)
    s.wu = column(e1, e2, t.du1, t.du2)
    s.wv = column(e1, e2, t.dv1, t.dv2)
    tiny = wp.vec4(1.0e-12, 1.0e-12, 1.0e-12, 1.0e-12)
    s.lu = root(inner(s.wu, s.wu) + tiny)
    s.lv = root(inner(s.wv, s.wv) + tiny)
    s.over_lu = inverse(s.lu)
    s.over_lv = inverse(s.lv)
    s.shear = inner(s.wu, s.wv)
    m0 = gather_scalars(inverse_mass, t.i0)
    m1 = gather_scalars(inverse_mass, t.i1)
    m2 = gather_scalars(inverse_mass, t.i2)
    du0 = -(t.du1 + t.du2)
    dv0 = -(t.dv1 + t.dv2)
    s.mu0 = times(m0, du0)
    s.mu1 = times(m1, t.du1)
    s.mu2 = times(m2, t.du2)
    s.mv0 = times(m0, dv0)
    s.mv1 = times(m1, t.dv1)
    s.mv2 = times(m2, t.dv2)
    s.uu = times(s.mu0, du0) + times(s.mu1, t.du1) + times(s.mu2, t.du2)
    s.uv = times(s.mu0, dv0) + times(s.mu1, t.dv1) + times(s.mu2, t.dv2)
    s.vv = times(s.mv0, dv0) + times(s.mv1, t.dv1) + times(s.mv2, t.dv2)
    return s


@wp.func
def soften(length: wp.vec4, ratio: float):
    return wp.vec4(
        wp.where(length[0] < 1.0, ratio, 1.0),
        wp.where(length[1] < 1.0, ratio, 1.0),
        wp.where(length[2] < 1.0, ratio, 1.0),
        wp.where(length[3] < 1.0, ratio, 1.0),
    )


@wp.struct
class Push:
    """What each vertex moves by, per gradient of w_u and w_v times inverse mass."""

    u: Vectors
    v: Vectors


@wp.func
def solve(s: Deformation, t: Triangles, p: SubstepParameters, span: float, cu: wp.vec4, cv: wp.vec4, cs: wp.vec4):
    """Solve ``(J W J^T + alpha) dl = -c`` with ``alpha = 1 / (span k A dt^2 / density)`` and apply ``J^T dl``.

    Both sides are scaled by the roots of the stiffnesses, ``I + S J W J^T S``: sound for every stiffness, zero
    included, and each pivot of its LDL^T is at least 1, rounding included.
    """
    one = wp.vec4(1.0, 1.0, 1.0, 1.0)
    stretch = t.root_area * (p.stretch_root * wp.sqrt(span))
    su = times(stretch, soften(s.lu, p.compression_root))
    sv = times(stretch, soften(s.lv, p.compression_root))
    ss = t.root_area * (p.shear_root * wp.sqrt(span))

    cosine_lv = times(s.shear, s.over_lu)
    cosine_lu = times(s.shear, s.over_lv)
    a11 = one + times(times(su, su), s.uu)
    a12 = times(times(su, sv), times(s.uv, times(cosine_lv, s.over_lv)))
    a13 = times(times(su, ss), times(s.uu, cosine_lv) + times(s.uv, s.lu))
    a22 = one + times(times(sv, sv), s.vv)
    a23 = times(times(sv, ss), times(s.uv, s.lv) + times(s.vv, cosine_lu))
    a33 = times(s.uu, times(s.lv, s.lv)) + times(s.uv, s.shear) * 2.0 + times(s.vv, times(s.lu, s.lu))
    a33 = one + times(times(ss, ss), a33)

    q1 = inverse(a11)
    l21 = times(a12, q1)
    l31 = times(a13, q1)
    q2 = inverse(wp.max(a22 - times(l21, a12), one))
    b23 = a23 - times(l31, a12)
    l32 = times(b23, q2)
    q3 = inverse(wp.max(a33 - times(l31, a13) - times(l32, b23), one))
    ru = -times(su, cu)
    rv = -times(sv, cv) - times(l21, ru)
    rs = -times(ss, cs) - times(l31, ru) - times(l32, rv)
    rs = times(rs, q3)
    rv = times(rv, q2) - times(l32, rs)
    ru = times(ru, q1) - times(l21, rv) - times(l31, rs)

    along_u = times(times(su, ru), s.over_lu)
    along_v = times(times(sv, rv), s.over_lv)
    across = times(ss, rs)
    push = Push()
    push.u = plus(scaled(s.wu, along_u), scaled(s.wv, across))
    push.v = plus(scaled(s.wv, along_v), scaled(s.wu, across))
    return push


@wp.kernel
def solve_membrane(
    first: int,
    triangles: wp.array(dtype=Triangles),
    inverse_mass: wp.array(dtype=float),
    parameters: wp.array(dtype=SubstepParameters),
    x: wp.array(dtype=wp.vec3),
):
    """One XPBD step of the triangles of a colour; updates ``x`` [m].

    With one iteration a substep the multipliers start at zero (Macklin et al. 2019).
    """
    t = triangles[first + wp.tid()]
    x0 = gather(x, t.i0)
    x1 = gather(x, t.i1)
    x2 = gather(x, t.i2)
    s = deform(t, x0, x1, x2, inverse_mass)
    one = wp.vec4(1.0, 1.0, 1.0, 1.0)
    push = solve(s, t, parameters[0], 1.0, s.lu - one, s.lv - one, s.shear)
    scatter(x, t.i0, t.count, plus(x0, column(push.u, push.v, s.mu0, s.mv0)))
    scatter(x, t.i1, t.count, plus(x1, column(push.u, push.v, s.mu1, s.mv1)))
    scatter(x, t.i2, t.count, plus(x2, column(push.u, push.v, s.mu2, s.mv2)))


@wp.kernel
def damp_membrane(
    first: int,
    span: float,
    triangles: wp.array(dtype=Triangles),
    inverse_mass: wp.array(dtype=float),
    parameters: wp.array(dtype=SubstepParameters),
    x: wp.array(dtype=wp.vec3),
    v: wp.array(dtype=wp.vec3),
):
    """Stiffness-proportional damping of a colour over ``span`` substeps, implicit in each triangle; moves ``v`` [m/s].

    Force ``-k tau dC/dt`` per constraint. It acts on velocities, apart from the positions' solve: inside it (Macklin et
    al. 2016, eq. 26), damping holds back the corrections themselves, and cloth sags ``1 + tau/dt`` times as far.
    """
    t = triangles[first + wp.tid()]
    p = parameters[0]
    s = deform(t, gather(x, t.i0), gather(x, t.i1), gather(x, t.i2), inverse_mass)
    v0 = gather(v, t.i0)
    v1 = gather(v, t.i1)
    v2 = gather(v, t.i2)
    e1 = minus(v1, v0)
    e2 = minus(v2, v0)
    rate_u = column(e1, e2, t.du1, t.du2)
    rate_v = column(e1, e2, t.dv1, t.dv2)
    cu = times(inner(s.wu, rate_u), s.over_lu)
    cv = times(inner(s.wv, rate_v), s.over_lv)
    cs = inner(rate_u, s.wv) + inner(s.wu, rate_v)
    push = solve(s, t, p, span * p.stretch_damping, cu, cv, cs)
    scatter(v, t.i0, t.count, plus(v0, column(push.u, push.v, s.mu0, s.mv0)))
    scatter(v, t.i1, t.count, plus(v1, column(push.u, push.v, s.mu1, s.mv1)))
    scatter(v, t.i2, t.count, plus(v2, column(push.u, push.v, s.mu2, s.mv2)))
