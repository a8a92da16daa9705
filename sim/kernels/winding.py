"""Winding number of points with respect to a closed triangle mesh, by signed crossings of one axis-parallel ray.

The winding number tells how often a surface goes around a point: 0 outside, 1 inside, 2 where the body overlaps itself
and a negative number where its skin is turned inside out. It equals the number of times that a ray from the point
leaves the surface minus the number of times that it enters.

The decision per triangle is exact: float32 coordinates are compared in float64, where the differences and products of
the two-dimensional orientation test are exact, and a ray through an edge or a vertex is moved aside by an
infinitesimal (Edelsbrunner & Muecke 1990, "Simulation of simplicity"), the same way for every triangle around it.
"""

from __future__ import annotations

import warp as wp

wp.set_module_options({"enable_backward": False})

_FAR = wp.constant(1.0e6)  # [m] end of every ray


@wp.func
def _side(ax: wp.float64, ay: wp.float64, bx: wp.float64, by: wp.float64):
    """1 where the origin lies left of a -> b, else -1; antisymmetric in a and b, ties as if the origin were shifted."""
    area = ax * by - ay * bx
    if area == wp.float64(0.0):
        area = ay - by
    if area == wp.float64(0.0):
        area = bx - ax
    return wp.where(area > wp.float64(0.0), 1, -1)


@wp.func
def winding_number(
    mesh: wp.uint64,
    points: wp.array(dtype=wp.vec3),
    indices: wp.array(dtype=int),
    origin: wp.vec3,
    axis: int,
    direction: float,
    skipped: int,
):
    """Signed crossings of the ray from ``origin`` along ``direction`` (1 or -1) times coordinate ``axis`` (0, 1, 2).

    A point exactly on the surface counts as outside of it. Face ``skipped`` (-1: none) is left out: with the ray on its
    outer side, the number is that of the point just outside of it.
    """
    low = origin
    high = origin
    if direction > 0.0:
        high[axis] = _FAR
    else:
        low[axis] = -_FAR
    u = (axis + 1) % 3
    v = (axis + 2) % 3
    total = wp.int32(0)
    face = wp.int32(0)
    query = wp.mesh_query_aabb(mesh, low, high)
    while wp.mesh_query_next(query, face):
        if face != skipped:
            a = points[indices[3 * face]]
            b = points[indices[3 * face + 1]]
            c = points[indices[3 * face + 2]]
            au = wp.float64(a[u]) - wp.float64(origin[u])
            av = wp.float64(a[v]) - wp.float64(origin[v])
            bu = wp.float64(b[u]) - wp.float64(origin[u])
            bv = wp.float64(b[v]) - wp.float64(origin[v])
            cu = wp.float64(c[u]) - wp.float64(origin[u])
            cv = wp.float64(c[v]) - wp.float64(origin[v])
            turn = _side(au, av, bu, bv)
            if turn == _side(bu, bv, cu, cv) and turn == _side(cu, cv, au, av):
                aw = wp.float64(a[axis]) - wp.float64(origin[axis])
                bw = wp.float64(b[axis]) - wp.float64(origin[axis])
                cw = wp.float64(c[axis]) - wp.float64(origin[axis])
                # Height of the face over the origin along the axis, times twice its projected area.
                height = aw * (bu * cv - bv * cu) + bw * (cu * av - cv * au) + cw * (au * bv - av * bu)
                height *= wp.float64(float(turn) * direction)
                leaving = wp.where(direction > 0.0, turn, -turn)
                if height > wp.float64(0.0) or (height == wp.float64(0.0) and leaving < 0):
                    total += leaving
    return total
