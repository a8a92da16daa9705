"""The membrane of a single world on a CPU: sixteen triangles of one colour, which share no vertex, a thread.

Same constraints and arithmetic as ``membrane``: 9 ns a triangle instead of 28.
"""

from __future__ import annotations

import warp as wp

from sim.kernels.lanes import LANE_OPTIONS, scalars
from sim.kernels.membrane import corners_of, moved, shape_of
from sim.kernels.parameters import COMPRESSION_ROOT, SHEAR_ROOT, STRETCH_DAMPING, STRETCH_ROOT

wp.set_module_options(LANE_OPTIONS)

PACK = 16
_one = scalars(1)
_packed_float = wp.types.vector(length=PACK, dtype=wp.float32)
_packed_int = wp.types.vector(length=PACK, dtype=wp.int32)


@wp.struct
class Pack:
    """Rest states of sixteen triangles, as in ``membrane.Triangle``, and the inverse masses of their vertices.

    A pack that is not full repeats a triangle: the repetition computes and stores the same.
    """

    i0: _packed_int
    i1: _packed_int
    i2: _packed_int
    m0: _packed_float
    m1: _packed_float
    m2: _packed_float
    du1: _packed_float
    du2: _packed_float
    dv1: _packed_float
    dv2: _packed_float
    root_area: _packed_float


@wp.struct
class Lanes:
    """Vectors at one vertex of each triangle of a pack."""

    x: _packed_float
    y: _packed_float
    z: _packed_float


@wp.func
def gather(values: wp.array(dtype=wp.vec3), index: _packed_int):
    x = _packed_float()
    y = _packed_float()
    z = _packed_float()
    for k in range(PACK):
        value = values[index[k]]
        x[k] = value[0]
        y[k] = value[1]
        z[k] = value[2]
    r = Lanes()
    r.x = x
    r.y = y
    r.z = z
    return r


@wp.func
def scatter(values: wp.array(dtype=wp.vec3), index: _packed_int, x: _packed_float, y: _packed_float, z: _packed_float):
    for k in range(PACK):
        values[index[k]] = wp.vec3(x[k], y[k], z[k])


@wp.kernel
def solve_packed_membrane(
    first: int, packs: wp.array(dtype=Pack), parameters: wp.array(dtype=_one), x: wp.array(dtype=wp.vec3)
):
    """:func:`solve_membrane` of a single world, sixteen triangles a thread."""
    t = packs[first + wp.tid()]
    stretch_root = parameters[STRETCH_ROOT][0]
    shear_root = parameters[SHEAR_ROOT][0]
    compression_root = parameters[COMPRESSION_ROOT][0]
    i0 = t.i0
    i1 = t.i1
    i2 = t.i2
    m0 = t.m0
    m1 = t.m1
    m2 = t.m2
    du1 = t.du1
    du2 = t.du2
    dv1 = t.dv1
    dv2 = t.dv2
    root_area = t.root_area
    p0 = gather(x, i0)
    p1 = gather(x, i1)
    p2 = gather(x, i2)
    x0 = p0.x
    y0 = p0.y
    z0 = p0.z
    x1 = p1.x
    y1 = p1.y
    z1 = p1.z
    x2 = p2.x
    y2 = p2.y
    z2 = p2.z
    for k in range(PACK):
        s = shape_of(du1[k], du2[k], dv1[k], dv2[k], m0[k], m1[k], m2[k])
        p = corners_of(x0[k], y0[k], z0[k], x1[k], y1[k], z1[k], x2[k], y2[k], z2[k])
        a = root_area[k]
        r = moved(s, p, p, 0.0, stretch_root * a, shear_root * a, compression_root)
        x0[k] = r.x0
        y0[k] = r.y0
        z0[k] = r.z0
        x1[k] = r.x1
        y1[k] = r.y1
        z1[k] = r.z1
        x2[k] = r.x2
        y2[k] = r.y2
        z2[k] = r.z2
    scatter(x, i0, x0, y0, z0)
    scatter(x, i1, x1, y1, z1)
    scatter(x, i2, x2, y2, z2)


@wp.kernel
def damp_packed_membrane(
    first: int,
    span: float,
    packs: wp.array(dtype=Pack),
    parameters: wp.array(dtype=_one),
    x: wp.array(dtype=wp.vec3),
    v: wp.array(dtype=wp.vec3),
):
    """:func:`damp_membrane` of a single world, sixteen triangles a thread."""
    t = packs[first + wp.tid()]
    stretch_root = parameters[STRETCH_ROOT][0]
    shear_root = parameters[SHEAR_ROOT][0]
    compression_root = parameters[COMPRESSION_ROOT][0]
    scale = wp.sqrt(span * parameters[STRETCH_DAMPING][0])
    stretch_root = stretch_root * scale
    shear_root = shear_root * scale
    i0 = t.i0
    i1 = t.i1
    i2 = t.i2
    m0 = t.m0
    m1 = t.m1
    m2 = t.m2
    du1 = t.du1
    du2 = t.du2
    dv1 = t.dv1
    dv2 = t.dv2
    root_area = t.root_area
    p0 = gather(x, i0)
    p1 = gather(x, i1)
    p2 = gather(x, i2)
    x0 = p0.x
    y0 = p0.y
    z0 = p0.z
    x1 = p1.x
    y1 = p1.y
    z1 = p1.z
    x2 = p2.x
    y2 = p2.y
    z2 = p2.z
    v0 = gather(v, i0)
    v1 = gather(v, i1)
    v2 = gather(v, i2)
    f0 = v0.x
    g0 = v0.y
    h0 = v0.z
    f1 = v1.x
    g1 = v1.y
    h1 = v1.z
    f2 = v2.x
    g2 = v2.y
    h2 = v2.z
    for k in range(PACK):
        s = shape_of(du1[k], du2[k], dv1[k], dv2[k], m0[k], m1[k], m2[k])
        p = corners_of(x0[k], y0[k], z0[k], x1[k], y1[k], z1[k], x2[k], y2[k], z2[k])
        w = corners_of(f0[k], g0[k], h0[k], f1[k], g1[k], h1[k], f2[k], g2[k], h2[k])
        a = root_area[k]
        r = moved(s, p, w, 1.0, stretch_root * a, shear_root * a, compression_root)
        f0[k] = r.x0
        g0[k] = r.y0
        h0[k] = r.z0
        f1[k] = r.x1
        g1[k] = r.y1
        h1[k] = r.z1
        f2[k] = r.x2
        g2[k] = r.y2
        h2[k] = r.z2
    scatter(v, i0, f0, g0, h0)
    scatter(v, i1, f1, g1, h1)
    scatter(v, i2, f2, g2, h2)
