"""Garment triangles, in every lane, that cross the surface of the body or lie below it."""

from __future__ import annotations

import warp as wp

from sim.kernels.crossings import BodyTree, Corners, corners_of, triangles_cross

wp.set_module_options({"enable_backward": False})


@wp.kernel
def count_inside(
    first_lane: int,
    width: int,
    faces: wp.array(dtype=wp.vec3i),
    x: wp.array(dtype=float),
    distance: wp.array(dtype=float),
    body: BodyTree,
    total: wp.array(dtype=int),
):
    """Add up the triangles that cross the body or have three corners below it, from ``first_lane`` on; ``total`` [W].

    Args:
        x, distance: Positions [m] and signed distances to the body [m] as ``sim.kernels.lanes`` lays them out, flat.
    """
    i, k = wp.tid()
    lane = first_lane + k
    a = Corners()
    a.i = faces[i]
    below = float(-1.0e9)
    for c in range(3):
        below = wp.max(below, distance[a.i[c] * width + lane])
    start = a.i * (3 * width)
    a.p0 = wp.vec3(x[start[0] + lane], x[start[0] + width + lane], x[start[0] + 2 * width + lane])
    a.p1 = wp.vec3(x[start[1] + lane], x[start[1] + width + lane], x[start[1] + 2 * width + lane])
    a.p2 = wp.vec3(x[start[2] + lane], x[start[2] + width + lane], x[start[2] + 2 * width + lane])
    a.low = wp.min(wp.min(a.p0, a.p1), a.p2)
    a.high = wp.max(wp.max(a.p0, a.p1), a.p2)
    inside = int(0)
    if below < 0.0:
        inside = 1
    else:
        query = wp.mesh_query_aabb(body.mesh, a.low, a.high)
        j = wp.int32(0)
        while wp.mesh_query_next(query, j):
            if triangles_cross(a, corners_of(body.points, body.indices, j)):
                inside = 1
                break
    if inside == 1:
        wp.atomic_add(total, lane, 1)
