"""The moving body, and contact of the garment with the planes that it carries along.

The body is exact at the ends of a query interval and linear in between. ``query`` finds, at the end of an interval, the
closest point of the body to every vertex; during the next interval the vertex collides with the plane that this point
and its smooth normal carry along.

Worlds may share a motion: bodies are stacked by *motion*, and ``lane_motion`` says which one each lane dances to.
"""

from __future__ import annotations

from typing import Any

import warp as wp

from sim.kernels.lanes import LANE_OPTIONS, WIDTHS, declare
from sim.kernels.parameters import FRICTION

wp.set_module_options(LANE_OPTIONS)

FAR = wp.constant(-1.0e6)
"""Clearance of a vertex without a contact plane [m]: whatever the plane, there is no depth to resolve."""


@wp.kernel
def skin_points(
    count: int,
    joint_count: int,
    bind: wp.array(dtype=wp.vec3),
    index: wp.array(dtype=wp.vec4i),
    weight: wp.array(dtype=wp.vec4),
    rotation: wp.array(dtype=wp.mat33),
    translation: wp.array(dtype=wp.vec3),
    shift: wp.array(dtype=wp.vec3),
    start: wp.array(dtype=wp.vec3),
    end: wp.array(dtype=wp.vec3),
):
    """Begin an interval: its start is the last end in the new origin, its end is skinned linearly."""
    i = wp.tid()
    motion = i // count
    start[i] = end[i] + shift[motion]
    p = bind[i - motion * count]
    joints = index[i - motion * count]
    w = weight[i - motion * count]
    posed = wp.vec3(0.0, 0.0, 0.0)
    for k in range(4):
        joint = motion * joint_count + joints[k]
        posed += (rotation[joint] * p + translation[joint]) * w[k]
    end[i] = posed


@wp.kernel
def smooth_normals(
    count: int,
    first_corner: wp.array(dtype=int),
    corners: wp.array(dtype=wp.vec2i),
    points: wp.array(dtype=wp.vec3),
    start: wp.array(dtype=wp.vec3),
    end: wp.array(dtype=wp.vec3),
):
    """Area-weighted vertex normals at the interval's end; ``corners`` holds the other two vertices of each face."""
    i = wp.tid()
    start[i] = end[i]
    first = (i // count) * count
    p = points[i]
    total = wp.vec3(0.0, 0.0, 0.0)
    for c in range(first_corner[i - first], first_corner[i - first + 1]):
        pair = corners[c]
        total += wp.cross(points[first + pair[0]] - p, points[first + pair[1]] - p)
    end[i] = wp.normalize(total)


@wp.func
def blend(values: wp.array(dtype=wp.vec3), first: int, corner: wp.vec4i, barycentric: wp.vec3):
    """Value at a point of a face with the first three of ``corner``, of the body whose points begin at ``first``."""
    return (
        values[first + corner[0]] * barycentric[0]
        + values[first + corner[1]] * barycentric[1]
        + values[first + corner[2]] * barycentric[2]
    )


@wp.kernel
def carry_planes(
    body_count: int,
    lane_motion: wp.array(dtype=int),
    shift: wp.array(dtype=wp.vec3),
    faces: wp.array(dtype=wp.vec4i),
    face: wp.array(dtype=int),
    barycentric: wp.array(dtype=wp.vec3),
    points_end: wp.array(dtype=wp.vec3),
    normals_end: wp.array(dtype=wp.vec3),
    lean: wp.array(dtype=wp.vec3),
    plane_point: wp.array(dtype=Any),
    plane_travel: wp.array(dtype=Any),
    plane_normal: wp.array(dtype=Any),
    plane_turn: wp.array(dtype=Any),
):
    """Contact plane of each vertex over the interval, from where the query left it: its travel [m] and turn."""
    i = wp.tid()
    lanes = lane_motion.shape[0]
    point = plane_point[i]
    travel = plane_travel[i]
    normal = plane_normal[i]
    turn = plane_turn[i]
    for k in range(lanes):
        f = face[i * lanes + k]
        if f >= 0:
            motion = lane_motion[k]
            c = faces[f]
            b = barycentric[i * lanes + k]
            p1 = blend(points_end, motion * body_count, c, b)
            n1 = wp.normalize(blend(normals_end, motion * body_count, c, b))
            leaning = lean[i * lanes + k]
            for axis in range(3):
                a = axis * lanes + k
                start = point[a] + shift[motion][axis]
                travel[a] = p1[axis] - start
                point[a] = start
                turn[a] = n1[axis] - normal[a]
                normal[a] = normal[a] + leaning[axis]
    plane_point[i] = point
    plane_travel[i] = travel
    plane_normal[i] = normal
    plane_turn[i] = turn


@wp.struct
class Place:
    """Position of one vertex [m], and how deep it was [m]; padded as ``membrane.Multipliers``."""

    x: float
    y: float
    z: float
    depth: float
    _pad: float


@wp.func
def put_outside(
    fraction: float,
    step: float,
    friction: float,
    gap: float,
    ax: float,
    ay: float,
    az: float,
    tx: float,
    ty: float,
    tz: float,
    nx: float,
    ny: float,
    nz: float,
    ux: float,
    uy: float,
    uz: float,
    bx: float,
    by: float,
    bz: float,
    px: float,
    py: float,
    pz: float,
):
    """Unilateral contact with a plane at ``fraction`` of the interval, and Coulomb friction.

    The plane goes through a, travels by t; its normal n turns by u. The vertex is at p and began the substep at b.
    Friction takes away the sliding against the body within the substep (``step`` = 1 / substeps of the interval), at
    most ``mu`` times the depth that was resolved.
    """
    nx = nx + ux * fraction
    ny = ny + uy * fraction
    nz = nz + uz * fraction
    over = 1.0 / wp.sqrt(nx * nx + ny * ny + nz * nz + 1.0e-20)
    nx = nx * over
    ny = ny * over
    nz = nz * over
    rx = px - ax - tx * fraction
    ry = py - ay - ty * fraction
    rz = pz - az - tz * fraction
    depth = wp.max(gap - (rx * nx + ry * ny + rz * nz), 0.0)
    px = px + nx * depth
    py = py + ny * depth
    pz = pz + nz * depth
    sx = px - bx - tx * step
    sy = py - by - ty * step
    sz = pz - bz - tz * step
    along = sx * nx + sy * ny + sz * nz
    sx = sx - nx * along
    sy = sy - ny * along
    sz = sz - nz * along
    length = wp.sqrt(sx * sx + sy * sy + sz * sz + 1.0e-20)
    limit = friction * depth
    held = wp.where(length > limit, limit / length, 1.0) * wp.where(depth > 0.0, 1.0, 0.0)
    r = Place()
    r.x = px - sx * held
    r.y = py - sy * held
    r.z = pz - sz * held
    r.depth = depth
    return r


@wp.kernel
def solve_contact(
    fraction: float,
    step: float,
    inverse_mass: wp.array(dtype=float),
    near: wp.array(dtype=int),
    clearance: wp.array(dtype=Any),
    plane_point: wp.array(dtype=Any),
    plane_travel: wp.array(dtype=Any),
    plane_normal: wp.array(dtype=Any),
    plane_turn: wp.array(dtype=Any),
    x_prev: wp.array(dtype=Any),
    parameters: wp.array(dtype=Any),
    x: wp.array(dtype=Any),
):
    """Contact of each vertex with its cached plane."""
    i = wp.tid()
    if near[i] == 0 or inverse_mass[i] == 0.0:
        return
    friction = parameters[FRICTION]
    gap = clearance[i]
    a = plane_point[i]
    t = plane_travel[i]
    n = plane_normal[i]
    u = plane_turn[i]
    b = x_prev[i]
    p = x[i]
    lanes = len(friction)
    for k in range(lanes):
        y = lanes + k
        z = 2 * lanes + k
        r = put_outside(
            fraction,
            step,
            friction[k],
            gap[k],
            a[k],
            a[y],
            a[z],
            t[k],
            t[y],
            t[z],
            n[k],
            n[y],
            n[z],
            u[k],
            u[y],
            u[z],
            b[k],
            b[y],
            b[z],
            p[k],
            p[y],
            p[z],
        )
        p[k] = r.x
        p[y] = r.y
        p[z] = r.z
    x[i] = p


for _width in WIDTHS:
    _planes = dict.fromkeys(("plane_point", "plane_travel", "plane_normal", "plane_turn"), "vectors")
    declare(carry_planes, _width, **_planes)
    declare(solve_contact, _width, clearance="scalars", parameters="scalars", x_prev="vectors", x="vectors", **_planes)
