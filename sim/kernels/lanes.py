"""Four 3-D vectors side by side: arithmetic for kernels that solve four constraints a thread in SIMD lanes.

One triangle solve is a long chain of dependent operations; four at once keep a CPU core busy (40 -> 22 ns a triangle).
"""

from __future__ import annotations

import warp as wp

wp.set_module_options({"enable_backward": False})


@wp.struct
class Vectors:
    """Components of four vectors."""

    x: wp.vec4
    y: wp.vec4
    z: wp.vec4


@wp.func
def gather(values: wp.array(dtype=wp.vec3), index: wp.vec4i):
    r = Vectors()
    a = values[index[0]]
    b = values[index[1]]
    c = values[index[2]]
    d = values[index[3]]
    r.x = wp.vec4(a[0], b[0], c[0], d[0])
    r.y = wp.vec4(a[1], b[1], c[1], d[1])
    r.z = wp.vec4(a[2], b[2], c[2], d[2])
    return r


@wp.func
def gather_scalars(values: wp.array(dtype=float), index: wp.vec4i):
    return wp.vec4(values[index[0]], values[index[1]], values[index[2]], values[index[3]])


@wp.func
def scatter(values: wp.array(dtype=wp.vec3), index: wp.vec4i, count: int, r: Vectors):
    """Store the first ``count`` lanes."""
    values[index[0]] = wp.vec3(r.x[0], r.y[0], r.z[0])
    if count > 1:
        values[index[1]] = wp.vec3(r.x[1], r.y[1], r.z[1])
    if count > 2:
        values[index[2]] = wp.vec3(r.x[2], r.y[2], r.z[2])
    if count > 3:
        values[index[3]] = wp.vec3(r.x[3], r.y[3], r.z[3])


@wp.func
def times(a: wp.vec4, b: wp.vec4):
    return wp.cw_mul(a, b)


@wp.func
def scaled(a: Vectors, b: wp.vec4):
    r = Vectors()
    r.x = wp.cw_mul(a.x, b)
    r.y = wp.cw_mul(a.y, b)
    r.z = wp.cw_mul(a.z, b)
    return r


@wp.func
def plus(a: Vectors, b: Vectors):
    r = Vectors()
    r.x = a.x + b.x
    r.y = a.y + b.y
    r.z = a.z + b.z
    return r


@wp.func
def minus(a: Vectors, b: Vectors):
    r = Vectors()
    r.x = a.x - b.x
    r.y = a.y - b.y
    r.z = a.z - b.z
    return r


@wp.func
def inner(a: Vectors, b: Vectors):
    return wp.cw_mul(a.x, b.x) + wp.cw_mul(a.y, b.y) + wp.cw_mul(a.z, b.z)


@wp.func
def root(a: wp.vec4):
    return wp.vec4(wp.sqrt(a[0]), wp.sqrt(a[1]), wp.sqrt(a[2]), wp.sqrt(a[3]))


@wp.func
def inverse(a: wp.vec4):
    return wp.cw_div(wp.vec4(1.0, 1.0, 1.0, 1.0), a)
