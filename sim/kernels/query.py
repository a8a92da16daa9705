"""Closest points of the body to the garment's vertices, at the end of a query interval.

A search of the body's tree takes a microsecond a vertex, a *walk* over the surface from the face of the last query a
tenth of it. So a vertex near the body walks, and a face that another found is tried too, for a walk can end in a local
minimum; in turn, one vertex in a few is searched for exactly. A vertex far from the body is left alone until it
and the body together could have covered the distance.
"""

from __future__ import annotations

from typing import Any

import warp as wp

from sim.kernels.contact import FAR, blend
from sim.kernels.lanes import LANE_OPTIONS, WIDTHS, declare
from sim.kernels.parameters import DT, THICKNESS

wp.set_module_options(LANE_OPTIONS)

# A vertex whose direction from its closest point leans further than this (cosine) from the smooth normal is beside
# the surface, not above or below it.
_ALIGNED = wp.constant(0.5)
# Below this distance [m] the direction from the closest point is rounding noise and the normal decides alone.
_TOUCHING = wp.constant(1.0e-4)
_LONGEST_WALK = wp.constant(24)
_LONGEST_CIRCLE = wp.constant(8)
# How much further than the reach a search looks [1]: what it finds there is left alone for a while.
_LOOKOUT = wp.constant(3.0)
# The way of a vertex is taken from its velocity at the end, with this margin [1] and [m] for what it was before.
_MARGIN = wp.constant(1.5)
_MARGIN_LENGTH = wp.constant(0.002)
# A neighbour's face must be this much nearer [1] to be worth a walk.
_NEARER = wp.constant(0.99)


@wp.struct
class Surface:
    """The parts of the stacked bodies: trees, faces, and the faces across the edges 12, 20 and 01 of each face."""

    meshes: wp.array(dtype=wp.uint64)
    first_face: wp.array(dtype=int)
    faces: wp.array(dtype=wp.vec3i)
    neighbours: wp.array(dtype=wp.vec3i)
    part: wp.array(dtype=int)
    points: wp.array(dtype=wp.vec3)
    normals: wp.array(dtype=wp.vec3)
    part_count: int
    body_count: int


@wp.struct
class Hit:
    """Closest point of a vertex on the parts of the body that it belongs to."""

    face: int  # -1: none within reach
    barycentric: wp.vec3
    point: wp.vec3
    normal: wp.vec3  # smooth
    distance: float  # signed [m], negative inside


@wp.func
def signed(s: Surface, first: int, face: int, barycentric: wp.vec3, position: wp.vec3):
    """The hit at a point of a face; none where the vertex lies past the rim of a part, which is an open surface."""
    hit = Hit()
    corner = s.faces[face]
    hit.barycentric = barycentric
    hit.point = blend(s.points, first, corner, barycentric)
    hit.normal = wp.normalize(blend(s.normals, first, corner, barycentric))
    away = position - hit.point
    distance = wp.length(away)
    above = wp.dot(away, hit.normal)
    hit.distance = wp.where(above < 0.0, -distance, distance)
    hit.face = face
    if above < 0.0 and -above <= _ALIGNED * distance and distance >= _TOUCHING:
        hit.face = -1
    return hit


@wp.func
def search(s: Surface, motion: int, owned: wp.vec4i, position: wp.vec3, reach: float):
    """Closest point within ``reach`` by the trees of the owned parts."""
    best = Hit()
    best.face = -1
    nearest = float(reach)
    for slot in range(4):
        part = owned[slot]
        if part >= 0:
            query = wp.mesh_query_point_no_sign(s.meshes[motion * s.part_count + part], position, nearest)
            if query.result:
                barycentric = wp.vec3(query.u, query.v, 1.0 - query.u - query.v)
                face = s.first_face[part] + query.face
                hit = signed(s, motion * s.body_count, face, barycentric, position)
                if hit.face >= 0:
                    nearest = wp.abs(hit.distance)
                    best = hit
    return best


@wp.func
def closest_on_triangle(a: wp.vec3, b: wp.vec3, c: wp.vec3, p: wp.vec3):
    """Barycentric coordinates of the closest point of a triangle (Ericson 2005, section 5.1.5)."""
    ab = b - a
    ac = c - a
    ap = p - a
    d1 = wp.dot(ab, ap)
    d2 = wp.dot(ac, ap)
    if d1 <= 0.0 and d2 <= 0.0:
        return wp.vec3(1.0, 0.0, 0.0)
    bp = p - b
    d3 = wp.dot(ab, bp)
    d4 = wp.dot(ac, bp)
    if d3 >= 0.0 and d4 <= d3:
        return wp.vec3(0.0, 1.0, 0.0)
    vc = d1 * d4 - d3 * d2
    if vc <= 0.0 and d1 >= 0.0 and d3 <= 0.0:
        t = d1 / (d1 - d3)
        return wp.vec3(1.0 - t, t, 0.0)
    cp = p - c
    d5 = wp.dot(ab, cp)
    d6 = wp.dot(ac, cp)
    if d6 >= 0.0 and d5 <= d6:
        return wp.vec3(0.0, 0.0, 1.0)
    vb = d5 * d2 - d1 * d6
    if vb <= 0.0 and d2 >= 0.0 and d6 <= 0.0:
        t = d2 / (d2 - d6)
        return wp.vec3(1.0 - t, 0.0, t)
    va = d3 * d6 - d5 * d4
    if va <= 0.0 and d4 - d3 >= 0.0 and d5 - d6 >= 0.0:
        t = (d4 - d3) / ((d4 - d3) + (d5 - d6))
        return wp.vec3(0.0, 1.0 - t, t)
    over = 1.0 / (va + vb + vc)
    return wp.vec3(va * over, vb * over, vc * over)


@wp.func
def walk(s: Surface, first: int, start: int, position: wp.vec3):
    """From a face to the neighbour that comes nearer, until none does: the hit there."""
    face = start
    corner = s.faces[face]
    barycentric = closest_on_triangle(
        s.points[first + corner[0]], s.points[first + corner[1]], s.points[first + corner[2]], position
    )
    beyond = barycentric
    distance = wp.length_sq(position - blend(s.points, first, corner, barycentric))
    circled = int(0)
    for _ in range(_LONGEST_WALK):
        across = s.neighbours[face]
        onward = int(-1)
        aside = int(-1)
        for edge in range(3):
            other = across[edge]
            if barycentric[edge] == 0.0 and other >= 0 and onward < 0:
                c = s.faces[other]
                b = closest_on_triangle(
                    s.points[first + c[0]], s.points[first + c[1]], s.points[first + c[2]], position
                )
                d = wp.length_sq(position - blend(s.points, first, c, b))
                if d < distance * 0.99999:
                    onward = other
                    barycentric = b
                    distance = d
                elif barycentric[(edge + 1) % 3] == 0.0:
                    aside = other
                    beyond = b
        if onward >= 0:
            face = onward
            circled = 0
        elif aside >= 0 and circled < _LONGEST_CIRCLE:
            # The closest point is a vertex: a nearer face may come further around it.
            face = aside
            barycentric = beyond
            circled += 1
        else:
            break
    return signed(s, first, face, barycentric, position)


@wp.func
def owns(owned: wp.vec4i, part: int):
    return owned[0] == part or owned[1] == part or owned[2] == part or owned[3] == part


@wp.func
def distance_to_face(s: Surface, first: int, face: int, position: wp.vec3):
    corner = s.faces[face]
    a = s.points[first + corner[0]]
    b = s.points[first + corner[1]]
    c = s.points[first + corner[2]]
    w = closest_on_triangle(a, b, c, position)
    return wp.length(position - (a * w[0] + b * w[1] + c * w[2]))


@wp.kernel
def find_contacts(
    reach: float,
    passes: int,
    turn: int,
    turns: int,
    steps: float,
    travel: wp.array(dtype=float),
    lane_motion: wp.array(dtype=int),
    shared_motion: int,
    inverse_mass: wp.array(dtype=float),
    standoff: wp.array(dtype=float),
    owned: wp.array(dtype=wp.vec4i),
    beside: wp.array(dtype=wp.vec2i),
    surface: Surface,
    parameters: wp.array(dtype=Any),
    v: wp.array(dtype=Any),
    x: wp.array(dtype=Any),
    near: wp.array(dtype=int),
    face: wp.array(dtype=int),
    barycentric: wp.array(dtype=wp.vec3),
    lean: wp.array(dtype=wp.vec3),
    clearance: wp.array(dtype=Any),
    distance: wp.array(dtype=Any),
):
    """End an interval: move vertices that are too deep out to the thickness and cache their closest points.

    The move leaves velocities alone (position and previous position go together). Moving out along one face can lead
    under another, so the search is repeated, at most ``passes`` times.

    Args:
        turn, turns: A lane of a vertex is searched for exactly where its number is ``turn`` modulo ``turns``.
        steps: Substeps since the last query.
        travel: Longest way of a point of each body since then [m].
        shared_motion: 1 where all lanes follow one motion.
        beside: Two garment neighbours of each vertex.
        distance: Signed distance to the body [m]; of a vertex out of reach, a lower bound.
    """
    i = wp.tid()
    positions = x[i]
    gaps = clearance[i]
    distances = distance[i]
    velocities = v[i]
    thickness = parameters[THICKNESS]
    dt = parameters[DT]
    lanes = lane_motion.shape[0]
    own = owned[i]
    any_near = int(0)
    for k in range(lanes):
        c = i * lanes + k
        position = wp.vec3(positions[k], positions[lanes + k], positions[2 * lanes + k])
        motion = lane_motion[k]
        first = motion * surface.body_count
        last = face[c]
        hit = Hit()
        hit.face = -1
        velocity = wp.vec3(velocities[k], velocities[lanes + k], velocities[2 * lanes + k])
        safe = distances[k] - travel[motion] - _MARGIN * (wp.length(velocity) * steps * dt[k] + _MARGIN_LENGTH)
        if last >= 0:
            hit = walk(surface, first, last, position)
            # What another found may be nearer: the lane before of the same motion, or a garment neighbour.
            other = int(-1)
            if shared_motion == 1 and k > 0:
                other = face[c - 1]
            else:
                other = face[beside[i][turn % 2] * lanes + k]
            if hit.face >= 0 and other >= 0 and other != hit.face:
                if owns(own, surface.part[other]):
                    if distance_to_face(surface, first, other, position) < _NEARER * wp.abs(hit.distance):
                        better = walk(surface, first, other, position)
                        if better.face >= 0 and wp.abs(better.distance) < wp.abs(hit.distance):
                            hit = better
        if hit.face >= 0:
            if (i + k) % turns == turn and wp.abs(hit.distance) < reach:
                better = search(surface, motion, own, position, wp.abs(hit.distance))
                if better.face >= 0:
                    hit = better
        elif last >= 0 or safe < reach:
            hit = search(surface, motion, own, position, _LOOKOUT * reach)
            safe = _LOOKOUT * reach

        keep = thickness[k] + standoff[i]
        for _ in range(passes):
            if hit.face >= 0 and hit.distance < 0.999 * keep and inverse_mass[i] > 0.0:
                away = hit.normal
                if wp.abs(hit.distance) > _TOUCHING:
                    away = (position - hit.point) / hit.distance
                moved = keep - hit.distance
                position = hit.point + away * keep
                if moved < 0.25 * keep:
                    hit.distance = keep  # too short a move to come under another face
                    break
                hit = search(surface, motion, own, position, 2.0 * keep)
        positions[k] = position[0]
        positions[lanes + k] = position[1]
        positions[2 * lanes + k] = position[2]

        face[c] = hit.face
        gaps[k] = FAR
        distances[k] = safe
        if hit.face >= 0:
            distances[k] = hit.distance
        if hit.face >= 0 and hit.distance < reach:
            any_near = 1
            barycentric[c] = hit.barycentric
            away = position - hit.point
            above = wp.dot(away, hit.normal)
            leaning = wp.vec3(0.0, 0.0, 0.0)
            if hit.distance > _TOUCHING and above < _ALIGNED * hit.distance:
                # Beside a pointed feature: the smooth normal would claim contact where there is air.
                leaning = away / hit.distance - hit.normal
                above = hit.distance
            lean[c] = leaning
            # Where the smooth normal's plane lies nearer than the surface itself, keep that gap: closing it would be a
            # kick.
            gaps[k] = wp.min(keep, above)
    near[i] = any_near
    x[i] = positions
    clearance[i] = gaps
    distance[i] = distances


for _width in WIDTHS:
    _kinds = {"parameters": "scalars", "v": "vectors", "x": "vectors", "clearance": "scalars", "distance": "scalars"}
    declare(find_contacts, _width, **_kinds)
