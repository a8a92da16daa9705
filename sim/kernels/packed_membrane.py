"""The membrane of a single world on a CPU: sixteen triangles of one colour, which share no vertex, a thread.

Same constraints and arithmetic as ``membrane``: 5 ns a triangle instead of 28.
"""

from __future__ import annotations

import warp as wp

from sim.kernels.lanes import LANE_OPTIONS, scalars
from sim.kernels.membrane import corners_of, moved, shape_of
from sim.kernels.packs import PACK, gather, packed_float, packed_int, scatter
from sim.kernels.parameters import COMPRESSION_ROOT, SHEAR_ROOT, STRETCH_DAMPING, STRETCH_ROOT

wp.set_module_options(LANE_OPTIONS)

_one = scalars(1)


@wp.struct
class Pack:
    """Rest states of sixteen triangles, as in ``membrane.Triangle``, and the inverse masses of their vertices.

    A pack that is not full repeats a triangle: the repetition computes and stores the same.
    """

    i0: packed_int
    i1: packed_int
    i2: packed_int
    m0: packed_float
    m1: packed_float
    m2: packed_float
    du1: packed_float
    du2: packed_float
    dv1: packed_float
    dv2: packed_float
    root_area: packed_float


@wp.kernel
def solve_packed_membrane(
    first: int, packs: wp.array(dtype=Pack), parameters: wp.array(dtype=_one), x: wp.array(dtype=wp.vec3)
):
    """:func:`solve_membrane` of a single world, sixteen triangles a thread."""
    t = packs[first + wp.tid()]
    stretch_root = parameters[STRETCH_ROOT][0]
    shear_root = parameters[SHEAR_ROOT][0]
    compression_root = parameters[COMPRESSION_ROOT][0]
    x0 = gather(x, t.i0)
    x1 = gather(x, t.i1)
    x2 = gather(x, t.i2)
    m0 = t.m0
    m1 = t.m1
    m2 = t.m2
    du1 = t.du1
    du2 = t.du2
    dv1 = t.dv1
    dv2 = t.dv2
    root_area = t.root_area
    for k in range(PACK):
        y = PACK + k
        z = 2 * PACK + k
        s = shape_of(du1[k], du2[k], dv1[k], dv2[k], m0[k], m1[k], m2[k])
        p = corners_of(x0[k], x0[y], x0[z], x1[k], x1[y], x1[z], x2[k], x2[y], x2[z])
        r = moved(s, p, p, 0.0, stretch_root * root_area[k], shear_root * root_area[k], compression_root)
        x0[k] = r.x0
        x0[y] = r.y0
        x0[z] = r.z0
        x1[k] = r.x1
        x1[y] = r.y1
        x1[z] = r.z1
        x2[k] = r.x2
        x2[y] = r.y2
        x2[z] = r.z2
    scatter(x, t.i0, x0)
    scatter(x, t.i1, x1)
    scatter(x, t.i2, x2)


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
    scale = wp.sqrt(span * parameters[STRETCH_DAMPING][0])
    stretch_root = parameters[STRETCH_ROOT][0] * scale
    shear_root = parameters[SHEAR_ROOT][0] * scale
    compression_root = parameters[COMPRESSION_ROOT][0]
    x0 = gather(x, t.i0)
    x1 = gather(x, t.i1)
    x2 = gather(x, t.i2)
    v0 = gather(v, t.i0)
    v1 = gather(v, t.i1)
    v2 = gather(v, t.i2)
    m0 = t.m0
    m1 = t.m1
    m2 = t.m2
    du1 = t.du1
    du2 = t.du2
    dv1 = t.dv1
    dv2 = t.dv2
    root_area = t.root_area
    for k in range(PACK):
        y = PACK + k
        z = 2 * PACK + k
        s = shape_of(du1[k], du2[k], dv1[k], dv2[k], m0[k], m1[k], m2[k])
        p = corners_of(x0[k], x0[y], x0[z], x1[k], x1[y], x1[z], x2[k], x2[y], x2[z])
        w = corners_of(v0[k], v0[y], v0[z], v1[k], v1[y], v1[z], v2[k], v2[y], v2[z])
        r = moved(s, p, w, 1.0, stretch_root * root_area[k], shear_root * root_area[k], compression_root)
        v0[k] = r.x0
        v0[y] = r.y0
        v0[z] = r.z0
        v1[k] = r.x1
        v1[y] = r.y1
        v1[z] = r.z1
        v2[k] = r.x2
        v2[y] = r.y2
        v2[z] = r.z2
    scatter(v, t.i0, v0)
    scatter(v, t.i1, v1)
    scatter(v, t.i2, v2)


@wp.kernel
def add_packed_normals(
    first: int, packs: wp.array(dtype=Pack), x: wp.array(dtype=wp.vec3), normals: wp.array(dtype=wp.vec3)
):
    """:func:`add_normals` of a single world, sixteen triangles a thread."""
    t = packs[first + wp.tid()]
    x0 = gather(x, t.i0)
    x1 = gather(x, t.i1)
    x2 = gather(x, t.i2)
    n0 = gather(normals, t.i0)
    n1 = gather(normals, t.i1)
    n2 = gather(normals, t.i2)
    for k in range(PACK):
        y = PACK + k
        z = 2 * PACK + k
        ax = x1[k] - x0[k]
        ay = x1[y] - x0[y]
        az = x1[z] - x0[z]
        bx = x2[k] - x0[k]
        by = x2[y] - x0[y]
        bz = x2[z] - x0[z]
        cx = ay * bz - az * by
        cy = az * bx - ax * bz
        cz = ax * by - ay * bx
        n0[k] = n0[k] + cx
        n0[y] = n0[y] + cy
        n0[z] = n0[z] + cz
        n1[k] = n1[k] + cx
        n1[y] = n1[y] + cy
        n1[z] = n1[z] + cz
        n2[k] = n2[k] + cx
        n2[y] = n2[y] + cy
        n2[z] = n2[z] + cz
    scatter(normals, t.i0, n0)
    scatter(normals, t.i1, n1)
    scatter(normals, t.i2, n2)
