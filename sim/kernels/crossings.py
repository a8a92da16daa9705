"""Crossings of triangles with triangles, and the depth of a garment below the surface of a body.

Two triangles cross where an edge of one passes through the inside of the other. The determinants are taken in float64
of float32 coordinates relative to one corner of the pair. A determinant of exactly zero (touching, lying in one plane,
an edge through an edge) is no crossing.
"""

from __future__ import annotations

import warp as wp

from sim.kernels.winding import winding_number

wp.set_module_options({"enable_backward": False})

_FAR = wp.constant(1.0e3)  # [m] radius of a closest-point query that must find something


@wp.struct
class BodyTree:
    """A closed triangle mesh and its search tree."""

    mesh: wp.uint64
    points: wp.array(dtype=wp.vec3)
    indices: wp.array(dtype=int)


@wp.struct
class Corners:
    """Vertices of a triangle and its box."""

    i: wp.vec3i
    p0: wp.vec3
    p1: wp.vec3
    p2: wp.vec3
    low: wp.vec3
    high: wp.vec3


@wp.func
def corners_of(points: wp.array(dtype=wp.vec3), indices: wp.array(dtype=int), face: int):
    c = Corners()
    c.i = wp.vec3i(indices[3 * face], indices[3 * face + 1], indices[3 * face + 2])
    c.p0 = points[c.i[0]]
    c.p1 = points[c.i[1]]
    c.p2 = points[c.i[2]]
    c.low = wp.min(wp.min(c.p0, c.p1), c.p2)
    c.high = wp.max(wp.max(c.p0, c.p1), c.p2)
    return c


@wp.func
def _from(origin: wp.vec3, p: wp.vec3):
    return wp.vec3d(
        wp.float64(p[0]) - wp.float64(origin[0]),
        wp.float64(p[1]) - wp.float64(origin[1]),
        wp.float64(p[2]) - wp.float64(origin[2]),
    )


@wp.func
def _pierces(p: wp.vec3d, q: wp.vec3d, a: wp.vec3d, b: wp.vec3d, c: wp.vec3d):
    """Whether the line through p and q passes through the inside of triangle a b c."""
    along = q - p
    s = wp.dot(wp.cross(a - p, b - p), along)
    t = wp.dot(wp.cross(b - p, c - p), along)
    u = wp.dot(wp.cross(c - p, a - p), along)
    zero = wp.float64(0.0)
    return (s > zero and t > zero and u > zero) or (s < zero and t < zero and u < zero)


@wp.func
def triangles_cross(a: Corners, b: Corners):
    """Whether two triangles cross: most pairs are told apart by their planes, the rest by edges through the inside."""
    zero = wp.float64(0.0)
    a1 = _from(a.p0, a.p1)
    a2 = _from(a.p0, a.p2)
    b0 = _from(a.p0, b.p0)
    b1 = _from(a.p0, b.p1)
    b2 = _from(a.p0, b.p2)
    normal = wp.cross(a1, a2)
    t0 = wp.dot(normal, b0)
    t1 = wp.dot(normal, b1)
    t2 = wp.dot(normal, b2)
    if (t0 >= zero and t1 >= zero and t2 >= zero) or (t0 <= zero and t1 <= zero and t2 <= zero):
        return False
    a0 = wp.vec3d()
    normal = wp.cross(b1 - b0, b2 - b0)
    s0 = wp.dot(normal, a0 - b0)
    s1 = wp.dot(normal, a1 - b0)
    s2 = wp.dot(normal, a2 - b0)
    if (s0 >= zero and s1 >= zero and s2 >= zero) or (s0 <= zero and s1 <= zero and s2 <= zero):
        return False
    crossing = False
    if s0 * s1 < zero:
        crossing = crossing or _pierces(a0, a1, b0, b1, b2)
    if s1 * s2 < zero:
        crossing = crossing or _pierces(a1, a2, b0, b1, b2)
    if s2 * s0 < zero:
        crossing = crossing or _pierces(a2, a0, b0, b1, b2)
    if t0 * t1 < zero:
        crossing = crossing or _pierces(b0, b1, a0, a1, a2)
    if t1 * t2 < zero:
        crossing = crossing or _pierces(b1, b2, a0, a1, a2)
    if t2 * t0 < zero:
        crossing = crossing or _pierces(b2, b0, a0, a1, a2)
    return crossing


@wp.func
def _share_vertex(a: wp.vec3i, b: wp.vec3i):
    shared = False
    for k in range(3):
        shared = shared or a[k] == b[0] or a[k] == b[1] or a[k] == b[2]
    return shared


@wp.kernel
def cross_self(
    mesh: wp.uint64, points: wp.array(dtype=wp.vec3), indices: wp.array(dtype=int), pairs: wp.array(dtype=int)
):
    """Number of triangles of the same mesh that each triangle crosses, ``pairs`` [F], cleared before."""
    i = wp.tid()
    a = corners_of(points, indices, i)
    query = wp.mesh_query_aabb(mesh, a.low, a.high)
    j = wp.int32(0)
    while wp.mesh_query_next(query, j):
        if j > i:
            b = corners_of(points, indices, j)
            if not _share_vertex(a.i, b.i) and triangles_cross(a, b):
                wp.atomic_add(pairs, i, 1)
                wp.atomic_add(pairs, j, 1)


@wp.kernel
def count_pinched_pairs(
    mesh: wp.uint64,
    points: wp.array(dtype=wp.vec3),
    indices: wp.array(dtype=int),
    pairs: wp.array(dtype=int),
    pinched: wp.array(dtype=wp.bool),
    total: wp.array(dtype=int),
):
    """Pairs of ``cross_self`` of which a triangle is pinched."""
    i = wp.tid()
    if pairs[i] == 0:
        return
    a = corners_of(points, indices, i)
    query = wp.mesh_query_aabb(mesh, a.low, a.high)
    j = wp.int32(0)
    while wp.mesh_query_next(query, j):
        if j > i and pairs[j] > 0 and (pinched[i] or pinched[j]):
            b = corners_of(points, indices, j)
            if not _share_vertex(a.i, b.i) and triangles_cross(a, b):
                wp.atomic_add(total, 0, 1)


@wp.kernel
def cross_body(
    points: wp.array(dtype=wp.vec3),
    indices: wp.array(dtype=int),
    body: BodyTree,
    aside: wp.array(dtype=wp.bool),
    pairs: wp.array(dtype=int),
    aside_pairs: wp.array(dtype=int),
):
    """Number of body triangles that each garment triangle crosses, ``pairs`` [F], and how many of them are aside."""
    i = wp.tid()
    a = corners_of(points, indices, i)
    query = wp.mesh_query_aabb(body.mesh, a.low, a.high)
    j = wp.int32(0)
    count = wp.int32(0)
    set_aside = wp.int32(0)
    while wp.mesh_query_next(query, j):
        if triangles_cross(a, corners_of(body.points, body.indices, j)):
            count += 1
            set_aside += wp.where(aside[j], 1, 0)
    pairs[i] = count
    aside_pairs[i] = set_aside


@wp.func
def winding_at(body: BodyTree, p: wp.vec3):
    """Winding number; the ray leaves sideways or ahead, away from the origin inside the trunk, to meet little."""
    axis = wp.where(wp.abs(p[0]) > wp.abs(p[2]), 0, 2)
    direction = wp.where(p[axis] > 0.0, 1.0, -1.0)
    return winding_number(body.mesh, body.points, body.indices, p, axis, direction, -1)


@wp.func
def _flagged_near(body: BodyTree, flagged: wp.array(dtype=wp.bool), low: wp.vec3, high: wp.vec3):
    """Whether a flagged body face has a box that meets this box."""
    query = wp.mesh_query_aabb(body.mesh, low, high)
    j = wp.int32(0)
    found = wp.bool(False)
    while wp.mesh_query_next(query, j):
        found = found or flagged[j]
    return found


@wp.kernel
def measure_vertices(
    points: wp.array(dtype=wp.vec3),
    body: BodyTree,
    closing: wp.array(dtype=wp.bool),
    reach: float,
    depth: wp.array(dtype=float),
    face: wp.array(dtype=int),
    pinched: wp.array(dtype=wp.bool),
):
    """Depth of each vertex inside the body [m], 0 outside, the nearest body face, whether the body closes on it."""
    i = wp.tid()
    p = points[i]
    depth[i] = 0.0
    face[i] = -1
    pinched[i] = False
    if winding_at(body, p) > 0:
        near = wp.mesh_query_point_no_sign(body.mesh, p, _FAR)
        surface = wp.mesh_eval_position(body.mesh, near.face, near.u, near.v)
        margin = wp.vec3(reach, reach, reach)
        depth[i] = wp.length(p - surface)
        face[i] = near.face
        pinched[i] = _flagged_near(body, closing, surface - margin, surface + margin)


@wp.func
def closest_on_triangle(p: wp.vec3, a: wp.vec3, b: wp.vec3, c: wp.vec3):
    """Closest point of a triangle (Ericson 2005, section 5.1.5)."""
    ab = b - a
    ac = c - a
    d1 = wp.dot(ab, p - a)
    d2 = wp.dot(ac, p - a)
    if d1 <= 0.0 and d2 <= 0.0:
        return a
    d3 = wp.dot(ab, p - b)
    d4 = wp.dot(ac, p - b)
    if d3 >= 0.0 and d4 <= d3:
        return b
    vc = d1 * d4 - d3 * d2
    if vc <= 0.0 and d1 >= 0.0 and d3 <= 0.0:
        return a + ab * (d1 / (d1 - d3))
    d5 = wp.dot(ab, p - c)
    d6 = wp.dot(ac, p - c)
    if d6 >= 0.0 and d5 <= d6:
        return c
    vb = d5 * d2 - d1 * d6
    if vb <= 0.0 and d2 >= 0.0 and d6 <= 0.0:
        return a + ac * (d2 / (d2 - d6))
    va = d3 * d6 - d5 * d4
    if va <= 0.0 and d4 >= d3 and d5 >= d6:
        return b + (c - b) * ((d4 - d3) / ((d4 - d3) + (d5 - d6)))
    scale = 1.0 / (va + vb + vc)
    return a + ab * (vb * scale) + ac * (vc * scale)


@wp.struct
class Deepest:
    """The deepest garment point found so far and the body face nearest to it."""

    depth: float
    face: int


@wp.func
def _sounded(best: Deepest, p: wp.vec3, body: BodyTree):
    result = best
    if winding_at(body, p) > 0:
        near = wp.mesh_query_point_no_sign(body.mesh, p, _FAR)
        depth = wp.length(p - wp.mesh_eval_position(body.mesh, near.face, near.u, near.v))
        if depth > result.depth:
            result.depth = depth
            result.face = near.face
    return result


@wp.kernel
def measure_triangles(
    points: wp.array(dtype=wp.vec3),
    indices: wp.array(dtype=int),
    body: BodyTree,
    closing: wp.array(dtype=wp.bool),
    reach: float,
    body_pairs: wp.array(dtype=int),
    self_pairs: wp.array(dtype=int),
    vertex_depth: wp.array(dtype=float),
    vertex_pinched: wp.array(dtype=wp.bool),
    depth: wp.array(dtype=float),
    face: wp.array(dtype=int),
    pinched: wp.array(dtype=wp.bool),
):
    """Depth of each triangle inside the body [m], the body face nearest to its deepest point, whether it is pinched.

    Sounded are the corners, the edge midpoints, the centroid and, where the triangle crosses the body, its closest
    points to the corners of the body triangles that it crosses: those poke through between the other samples.
    """
    i = wp.tid()
    depth[i] = 0.0
    face[i] = -1
    pinched[i] = False
    a = corners_of(points, indices, i)
    inside = vertex_depth[a.i[0]] > 0.0 or vertex_depth[a.i[1]] > 0.0 or vertex_depth[a.i[2]] > 0.0
    if not inside and body_pairs[i] == 0 and self_pairs[i] == 0:
        return
    margin = wp.vec3(reach, reach, reach)
    pinched[i] = (
        _flagged_near(body, closing, a.low - margin, a.high + margin)
        or vertex_pinched[a.i[0]]
        or vertex_pinched[a.i[1]]
        or vertex_pinched[a.i[2]]
    )
    if not inside and body_pairs[i] == 0:
        return
    best = Deepest()
    best.depth = 0.0
    best.face = -1
    best = _sounded(best, a.p0, body)
    best = _sounded(best, a.p1, body)
    best = _sounded(best, a.p2, body)
    best = _sounded(best, (a.p0 + a.p1) * 0.5, body)
    best = _sounded(best, (a.p1 + a.p2) * 0.5, body)
    best = _sounded(best, (a.p2 + a.p0) * 0.5, body)
    best = _sounded(best, (a.p0 + a.p1 + a.p2) / 3.0, body)
    if body_pairs[i] > 0:
        query = wp.mesh_query_aabb(body.mesh, a.low, a.high)
        j = wp.int32(0)
        while wp.mesh_query_next(query, j):
            b = corners_of(body.points, body.indices, j)
            if triangles_cross(a, b):
                if best.face < 0:
                    best.face = j
                best = _sounded(best, closest_on_triangle(b.p0, a.p0, a.p1, a.p2), body)
                best = _sounded(best, closest_on_triangle(b.p1, a.p0, a.p1, a.p2), body)
                best = _sounded(best, closest_on_triangle(b.p2, a.p0, a.p1, a.p2), body)
    depth[i] = best.depth
    face[i] = best.face
