"""The moving body and the contact of garment vertices with it.

The body is exact at the ends of a query interval and linear in between. At the end of an interval every garment vertex
is put outside the exact surface and remembers the closest point there; during the next interval it collides with the
plane that this point and its smooth normal carry along.
"""

from __future__ import annotations

import warp as wp

from sim.kernels.parameters import SubstepParameters

wp.set_module_options({"enable_backward": False})

# A vertex whose direction from its closest point leans further than this (cosine) from the smooth normal is beside
# the surface, not above or below it.
_ALIGNED = wp.constant(0.5)
# Below this distance [m] the direction from the closest point is rounding noise and the normal decides alone.
_TOUCHING = wp.constant(1.0e-4)


@wp.kernel
def skin_points(
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
    start[i] = end[i] + shift[0]
    p = bind[i]
    joints = index[i]
    w = weight[i]
    posed = wp.vec3(0.0, 0.0, 0.0)
    for k in range(4):
        posed += (rotation[joints[k]] * p + translation[joints[k]]) * w[k]
    end[i] = posed


@wp.kernel
def smooth_normals(
    first_corner: wp.array(dtype=int),
    corners: wp.array(dtype=wp.vec2i),
    points: wp.array(dtype=wp.vec3),
    start: wp.array(dtype=wp.vec3),
    end: wp.array(dtype=wp.vec3),
):
    """Area-weighted vertex normals at the interval's end; ``corners`` holds the other two vertices of each face."""
    i = wp.tid()
    start[i] = end[i]
    p = points[i]
    total = wp.vec3(0.0, 0.0, 0.0)
    for c in range(first_corner[i], first_corner[i + 1]):
        pair = corners[c]
        total += wp.cross(points[pair[0]] - p, points[pair[1]] - p)
    end[i] = wp.normalize(total)


@wp.func
def blend(values: wp.array(dtype=wp.vec3), corner: wp.vec3i, barycentric: wp.vec3):
    return values[corner[0]] * barycentric[0] + values[corner[1]] * barycentric[1] + values[corner[2]] * barycentric[2]


@wp.kernel
def carry_planes(
    corner: wp.array(dtype=wp.vec3i),
    barycentric: wp.array(dtype=wp.vec3),
    points_start: wp.array(dtype=wp.vec3),
    points_end: wp.array(dtype=wp.vec3),
    normals_start: wp.array(dtype=wp.vec3),
    normals_end: wp.array(dtype=wp.vec3),
    lean: wp.array(dtype=wp.vec3),
    plane_point: wp.array(dtype=wp.vec3),
    plane_travel: wp.array(dtype=wp.vec3),
    plane_normal: wp.array(dtype=wp.vec3),
    plane_turn: wp.array(dtype=wp.vec3),
):
    """Contact plane of each vertex over the interval: point [m] and normal at its start, and their changes."""
    i = wp.tid()
    c = corner[i]
    if c[0] < 0:
        return
    b = barycentric[i]
    p0 = blend(points_start, c, b)
    n0 = wp.normalize(blend(normals_start, c, b))
    plane_point[i] = p0
    plane_travel[i] = blend(points_end, c, b) - p0
    plane_normal[i] = n0 + lean[i]
    plane_turn[i] = wp.normalize(blend(normals_end, c, b)) - n0


@wp.kernel
def solve_contact(
    fraction: float,
    step: float,
    inverse_mass: wp.array(dtype=float),
    corner: wp.array(dtype=wp.vec3i),
    clearance: wp.array(dtype=float),
    plane_point: wp.array(dtype=wp.vec3),
    plane_travel: wp.array(dtype=wp.vec3),
    plane_normal: wp.array(dtype=wp.vec3),
    plane_turn: wp.array(dtype=wp.vec3),
    x_prev: wp.array(dtype=wp.vec3),
    parameters: wp.array(dtype=SubstepParameters),
    x: wp.array(dtype=wp.vec3),
):
    """Unilateral contact with the cached plane at ``fraction`` of the interval, and Coulomb friction.

    Friction takes away the sliding against the body within the substep (``step`` = 1 / substeps of the interval), at
    most ``mu`` times the depth that was resolved.
    """
    i = wp.tid()
    if corner[i][0] < 0 or inverse_mass[i] == 0.0:
        return
    normal = wp.normalize(plane_normal[i] + plane_turn[i] * fraction)
    position = x[i]
    depth = clearance[i] - wp.dot(position - (plane_point[i] + plane_travel[i] * fraction), normal)
    if depth > 0.0:
        position = position + normal * depth
        slide = position - x_prev[i] - plane_travel[i] * step
        slide = slide - normal * wp.dot(slide, normal)
        length = wp.length(slide)
        limit = parameters[0].friction * depth
        if length > limit:
            slide = slide * (limit / length)
        x[i] = position - slide


@wp.struct
class SurfaceHit:
    """Closest point of a vertex on the parts of the body that it belongs to."""

    found: int
    corner: wp.vec3i
    barycentric: wp.vec3
    point: wp.vec3
    normal: wp.vec3  # smooth
    distance: float  # signed [m], negative inside


@wp.func
def closest_point(
    position: wp.vec3,
    reach: float,
    owned: wp.vec4i,
    meshes: wp.array(dtype=wp.uint64),
    first_face: wp.array(dtype=int),
    faces: wp.array(dtype=wp.vec3i),
    points: wp.array(dtype=wp.vec3),
    normals: wp.array(dtype=wp.vec3),
):
    hit = SurfaceHit()
    hit.found = 0
    nearest = float(reach)
    for slot in range(4):
        part = owned[slot]
        if part >= 0:
            query = wp.mesh_query_point_no_sign(meshes[part], position, nearest)
            if query.result:
                corner = faces[first_face[part] + query.face]
                barycentric = wp.vec3(query.u, query.v, 1.0 - query.u - query.v)
                point = blend(points, corner, barycentric)
                normal = wp.normalize(blend(normals, corner, barycentric))
                away = position - point
                distance = wp.length(away)
                above = wp.dot(away, normal)
                # A part is an open surface: a vertex past its rim is neither above nor below it.
                if above >= 0.0 or -above > _ALIGNED * distance or distance < _TOUCHING:
                    nearest = distance
                    hit.found = 1
                    hit.corner = corner
                    hit.barycentric = barycentric
                    hit.point = point
                    hit.normal = normal
                    hit.distance = wp.where(above < 0.0, -distance, distance)
    return hit


@wp.kernel
def find_contacts(
    reach: float,
    passes: int,
    inverse_mass: wp.array(dtype=float),
    standoff: wp.array(dtype=float),
    owned: wp.array(dtype=wp.vec4i),
    meshes: wp.array(dtype=wp.uint64),
    first_face: wp.array(dtype=int),
    faces: wp.array(dtype=wp.vec3i),
    points: wp.array(dtype=wp.vec3),
    normals: wp.array(dtype=wp.vec3),
    parameters: wp.array(dtype=SubstepParameters),
    x: wp.array(dtype=wp.vec3),
    corner: wp.array(dtype=wp.vec3i),
    barycentric: wp.array(dtype=wp.vec3),
    lean: wp.array(dtype=wp.vec3),
    clearance: wp.array(dtype=float),
    distance: wp.array(dtype=float),
):
    """End an interval: move vertices that are too deep out to the thickness and cache their closest points.

    The move leaves velocities alone (position and previous position go together). Moving out along one face can lead
    under another, so the query is repeated, at most ``passes`` times.
    """
    i = wp.tid()
    thickness = parameters[0].thickness + standoff[i]
    position = x[i]
    # The face of the last query bounds the distance, which prunes most of the search.
    bound = reach
    if corner[i][0] >= 0:
        bound = wp.min(reach, wp.length(position - blend(points, corner[i], barycentric[i])) + 1.0e-4)
    hit = closest_point(position, bound, owned[i], meshes, first_face, faces, points, normals)
    for _ in range(passes):
        if hit.found == 1 and hit.distance < 0.999 * thickness and inverse_mass[i] > 0.0:
            away = hit.normal
            if wp.abs(hit.distance) > _TOUCHING:
                away = (position - hit.point) / hit.distance
            moved = thickness - hit.distance
            position = hit.point + away * thickness
            if moved < 0.25 * thickness:
                hit.distance = thickness  # too short a move to come under another face
                break
            hit = closest_point(position, 2.0 * thickness, owned[i], meshes, first_face, faces, points, normals)
    x[i] = position

    if hit.found == 0:
        corner[i] = wp.vec3i(-1, -1, -1)
        distance[i] = reach
        return
    corner[i] = hit.corner
    barycentric[i] = hit.barycentric
    distance[i] = hit.distance
    away = position - hit.point
    above = wp.dot(away, hit.normal)
    if hit.distance > _TOUCHING and above < _ALIGNED * hit.distance:
        # Beside a pointed feature: the smooth normal would claim contact where there is air.
        lean[i] = away / hit.distance - hit.normal
        above = hit.distance
    else:
        lean[i] = wp.vec3(0.0, 0.0, 0.0)
    # Where the smooth normal's plane lies nearer than the surface itself, keep that gap: closing it would be a kick.
    clearance[i] = wp.min(thickness, above)
