"""Closest points of the body to the garment's vertices, at the end of a query interval.

A vertex *walks* over the surface from the face of the last query, and from the seeds of ``sim.kernels.seeds`` where
another limb may have come nearer or where it had no face.

Every vertex belongs to some parts of the body, and follows its own surface whatever happens. It also collides with the
rest of the body, where there is room for that: between two surfaces that face each other across less than twice the
thickness, an arm and the trunk say, cloth can satisfy only one. It is *pinched*, and follows its own.
"""

from __future__ import annotations

from typing import Any

import warp as wp

from sim.kernels.contact import FAR, blend
from sim.kernels.lanes import LANE_OPTIONS, WIDTHS, declare
from sim.kernels.parameters import DT, THICKNESS
from sim.kernels.seeds import Seeds, cell_at, seed_in

wp.set_module_options(LANE_OPTIONS)

# A vertex whose direction from its closest point leans further than this (cosine) from the smooth normal is beside
# the surface, not above or below it.
_ALIGNED = wp.constant(0.5)
# Below this distance [m] the direction from the closest point is rounding noise and the normal decides alone.
_TOUCHING = wp.constant(1.0e-4)
_LONGEST_WALK = wp.constant(24)
_LONGEST_CIRCLE = wp.constant(8)
# A vertex that is not followed has no walk to start from: so far [m] it is followed, as cells reach.
_FOLLOWED = wp.constant(0.10)
# Contact is kept within the reach and this much [1] of the way that body and vertex went relative to each other.
_AHEAD = wp.constant(1.5)
# A seed may be this much farther [m] than the closest point on the same limb, or hardly ever is: it is near the middle
# of the cell, not near the vertex.
_SEED_SLACK = wp.constant(0.06)
# Cloth this near its own surface [m] has no room for another limb that comes from behind: it is enough to look close.
_SNUG = wp.constant(0.01)
_SNUG_SLACK = wp.constant(0.025)
# What is left of a raised floor after a query [1].
_FORGET = wp.constant(0.95)
# How near another part of the body must be to matter [m].
_OTHER_REACH = wp.constant(0.05)
# Cloth deeper [m] in a part of the body that it does not belong to is nearer to the wrong side of a forearm or hand.
_DEEPEST_PUSH = wp.constant(0.015)
# Cloth on a limb that is not its own, stretched to this multiple [1] of its length at rest, lets go of it for a while.
_TORN = wp.constant(1.5)
_LET_GO = wp.constant(16)  # queries
# Normals that meet at more than this (cosine) face each other.
_OPPOSED = wp.constant(-0.2)


@wp.struct
class Surface:
    """The stacked bodies: faces with their parts and region, and the faces across the edges 12, 20 and 01 of each."""

    faces: wp.array(dtype=wp.vec4i)  # corners, then parts as bits and region << 16
    neighbours: wp.array(dtype=wp.vec3i)
    start: wp.array(dtype=wp.vec3)
    points: wp.array(dtype=wp.vec3)
    normals: wp.array(dtype=wp.vec3)
    joined: wp.array(dtype=int)  # regions that each region borders on, as bits
    body_count: int


@wp.struct
class Hit:
    """Closest point of a vertex on a part of the body."""

    face: int  # -1: none
    barycentric: wp.vec3
    point: wp.vec3
    normal: wp.vec3  # smooth
    distance: float  # signed [m], negative inside


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
def is_own(corner: wp.vec4i, owned: int):
    """1 where a face belongs to one of the owned parts, else 0."""
    return wp.where((corner[3] & owned) != 0, 1, 0)


@wp.func
def walk(s: Surface, first: int, start: int, position: wp.vec3, owned: int, own: int):
    """From a face to the neighbour that comes nearer, until none does: the hit there.

    The walk stays on owned faces (``own`` = 1) or on others (0). Past the rim of these, an open surface, there is no
    hit for a vertex that seems to lie below it.
    """
    hit = Hit()
    hit.face = start
    corner = s.faces[start]
    barycentric = closest_on_triangle(
        s.points[first + corner[0]], s.points[first + corner[1]], s.points[first + corner[2]], position
    )
    point = blend(s.points, first, corner, barycentric)
    beyond = barycentric
    distance = wp.length_sq(position - point)
    circled = int(0)
    rim = int(0)
    for _ in range(_LONGEST_WALK):
        if barycentric[0] > 0.0 and barycentric[1] > 0.0 and barycentric[2] > 0.0:
            break
        across = s.neighbours[hit.face]
        onward = int(-1)
        aside = int(-1)
        rim = int(0)
        for edge in range(3):
            if barycentric[edge] == 0.0 and onward < 0:
                other = across[edge]
                within = int(0)
                if other >= 0:
                    c = s.faces[other]
                    if is_own(c, owned) == own:
                        within = 1
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
                if within == 0:
                    rim = 1
        if onward >= 0:
            hit.face = onward
            circled = 0
        elif aside >= 0 and circled < _LONGEST_CIRCLE:
            # The closest point is a vertex: a nearer face may come further around it.
            hit.face = aside
            barycentric = beyond
            circled += 1
        else:
            break
    corner = s.faces[hit.face]
    hit.barycentric = barycentric
    hit.point = blend(s.points, first, corner, barycentric)
    hit.normal = wp.normalize(blend(s.normals, first, corner, barycentric))
    away = position - hit.point
    length = wp.length(away)
    above = wp.dot(away, hit.normal)
    hit.distance = wp.where(above < 0.0, -length, length)
    if rim == 1 and above < 0.0 and -above <= _ALIGNED * length and length >= _TOUCHING:
        hit.face = -1
    return hit


@wp.func
def follow(s: Surface, first: int, last: int, position: wp.vec3, owned: int, own: int):
    """The hit of a walk from the face of the last query, if there was one and it is not far by now."""
    hit = Hit()
    hit.face = -1
    if last >= 0:
        hit = walk(s, first, last, position, owned, own)
        if wp.abs(hit.distance) > _FOLLOWED:
            hit.face = -1
    return hit


@wp.func
def nearer(one: Hit, another: Hit):
    """The nearer of two hits, each of which may be none, or far by mistake: cells repeat in space."""
    best = one
    distance = wp.abs(another.distance)
    if another.face >= 0 and distance < _FOLLOWED and (one.face < 0 or distance < wp.abs(one.distance)):
        best = another
    return best


@wp.func
def bit_of(s: Surface, hit: Hit):
    """The bit of the region that a hit lies in, 0 for none."""
    bit = int(0)
    if hit.face >= 0:
        bit = 1 << (s.faces[hit.face][3] >> 16)
    return bit


@wp.func
def way_out(hit: Hit, position: wp.vec3):
    """Direction from the closest point to the outside."""
    away = hit.normal
    if wp.abs(hit.distance) > _TOUCHING:
        away = (position - hit.point) / hit.distance
    return away


@wp.func
def pinches(s: Surface, own: Hit, other: Hit, thickness: float):
    """Whether there is too little room for cloth between its own surface and another, or it is deep in that.

    On the limb next to its own, below a bulging shoulder, cloth has room still: that skin looks the same way.
    """
    tight = other.distance < -_DEEPEST_PUSH
    if own.face >= 0 and not tight:
        if own.distance + other.distance < 2.0 * thickness:
            here = s.faces[own.face][3] >> 16
            there = s.faces[other.face][3] >> 16
            joined = (s.joined[here] >> there) & 1
            tight = joined == 0 or wp.dot(own.normal, other.normal) < _OPPOSED
    return tight


@wp.func
def way_towards(s: Surface, first: int, hit: Hit, step: wp.vec3):
    """How the closest point moved in the last interval relative to a vertex that moved by ``step`` [m]."""
    return hit.point - blend(s.start, first, s.faces[hit.face], hit.barycentric) - step


@wp.kernel
def find_contacts(
    reach: float,
    passes: int,
    turn: int,
    turns: int,
    steps: float,
    lane_motion: wp.array(dtype=int),
    inverse_mass: wp.array(dtype=float),
    standoff: wp.array(dtype=float),
    owned: wp.array(dtype=int),
    first_neighbour: wp.array(dtype=int),
    neighbour: wp.array(dtype=int),
    spacing: wp.array(dtype=float),
    surface: Surface,
    seeds: Seeds,
    parameters: wp.array(dtype=Any),
    v: wp.array(dtype=Any),
    x: wp.array(dtype=Any),
    near: wp.array(dtype=int),
    own_face: wp.array(dtype=int),
    other_face: wp.array(dtype=int),
    let_go: wp.array(dtype=int),
    face: wp.array(dtype=int),
    barycentric: wp.array(dtype=wp.vec3),
    lean: wp.array(dtype=wp.vec3),
    clearance: wp.array(dtype=Any),
    distance: wp.array(dtype=Any),
    pinched: wp.array(dtype=Any),
    plane_point: wp.array(dtype=Any),
    plane_normal: wp.array(dtype=Any),
    floor: wp.array(dtype=Any),
):
    """End an interval: move vertices that are too deep out to the thickness and cache their closest points.

    The move leaves velocities alone (position and previous position go together). Moving out along one face can lead
    under another, so the search is repeated, at most ``passes`` times.

    Args:
        turn, turns: A vertex looks for another place on its own limb where its number is ``turn`` modulo ``turns``.
        steps: Substeps since the last query.
        owned: Parts of the body that each vertex belongs to, as bits.
        first_neighbour, neighbour, spacing: Neighbours of each vertex in the garment, and how far they are at rest [m].
        let_go: Queries that a vertex still does without parts of the body that are not its own.
        own_face, other_face: Where the walks on owned and on other parts ended, -1 for none; kept from query to query.
        face: Face of the contact plane, -1 for none.
        distance: Signed distance to the body [m]; of a vertex out of reach, a lower bound.
        pinched: 1 where a vertex is pinched, else 0.
        plane_point, plane_normal: Closest point of the contact plane [m] and smooth normal there.
        floor: Distance that vertices keep where the body would poke through the triangles around them [m].
    """
    i = wp.tid()
    positions = x[i]
    gaps = clearance[i]
    distances = distance[i]
    pinches_here = pinched[i]
    points = plane_point[i]
    normals = plane_normal[i]
    floors = floor[i]
    velocities = v[i]
    thickness = parameters[THICKNESS]
    dt = parameters[DT]
    lanes = lane_motion.shape[0]
    parts = owned[i]
    any_near = int(0)
    known = int(-1)  # cell that ``present`` holds for
    present = int(0)  # regions that have a seed there, as bits
    for k in range(lanes):
        c = i * lanes + k
        position = wp.vec3(positions[k], positions[lanes + k], positions[2 * lanes + k])
        motion = lane_motion[k]
        first = motion * surface.body_count
        own = follow(surface, first, own_face[c], position, parts, 1)
        other = follow(surface, first, other_face[c], position, parts, 0)
        loose = wp.max(let_go[c] - 1, 0)
        base = cell_at(seeds.cells, motion, position) * seeds.regions
        if base != known:
            known = base
            present = int(0)
            for r in range(seeds.regions):
                if seed_in(seeds, seeds.grid[base + r]) >= 0:
                    present = present | (1 << r)
        if (i + k) % turns == turn:
            strange = present
        else:
            strange = present & ~(bit_of(surface, own) | bit_of(surface, other))
        if strange != 0:
            for r in range(seeds.regions):
                if ((strange >> r) & 1) == 1:
                    seed = seed_in(seeds, seeds.grid[base + r])
                    start = seeds.face[seed]
                    to_seed = wp.length(seeds.point[motion * seeds.count + seed] - position)
                    if is_own(surface.faces[start], parts) == 1:
                        slack = wp.where(wp.abs(own.distance) < _SNUG, _SNUG_SLACK, _SEED_SLACK)
                        if to_seed - slack < wp.where(own.face < 0, _FOLLOWED, wp.abs(own.distance)):
                            own = nearer(own, walk(surface, first, start, position, parts, 1))
                    elif loose == 0 and to_seed - _SEED_SLACK < _OTHER_REACH:
                        other = nearer(other, walk(surface, first, start, position, parts, 0))
        if loose > 0:
            other.face = -1
        own_face[c] = own.face
        other_face[c] = other.face

        keep = thickness[k] + standoff[i]
        floors[k] = keep + wp.max(floors[k] - keep, 0.0) * _FORGET
        keep = floors[k]
        pinch = float(0.0)
        hit = own
        for attempt in range(passes + 1):
            pinch = 0.0
            hit = own
            if other.face >= 0:
                if pinches(surface, own, other, thickness[k]):
                    pinch = wp.where(other.distance < thickness[k], 1.0, 0.0)
                elif own.face < 0 or other.distance < own.distance:
                    hit = other
            if hit.face < 0 or hit.distance >= 0.999 * keep or inverse_mass[i] == 0.0 or attempt == passes:
                break
            moved = keep - hit.distance
            position = hit.point + way_out(hit, position) * keep
            if moved < 0.25 * keep and other.face < 0:
                hit.distance = keep  # too short a move to come under another face
                break
            if own.face >= 0:
                own = walk(surface, first, own.face, position, parts, 1)
            if other.face >= 0:
                other = walk(surface, first, other.face, position, parts, 0)
        positions[k] = position[0]
        positions[lanes + k] = position[1]
        positions[2 * lanes + k] = position[2]

        step = wp.vec3(velocities[k], velocities[lanes + k], velocities[2 * lanes + k]) * (dt[k] * steps)
        if hit.face >= 0 and own.face >= 0 and other.face >= 0 and pinch == 0.0:
            # The plane for the next interval is that of the surface that will be nearer at its end.
            to_own = own.distance - wp.dot(way_towards(surface, first, own, step), own.normal)
            to_other = other.distance - wp.dot(way_towards(surface, first, other, step), other.normal)
            hit = own
            if to_other < to_own and not pinches(surface, own, other, thickness[k]):
                hit = other
        if hit.face >= 0 and hit.face == other.face:
            # A limb that cloth is caught on would tear it: what it holds too far from its neighbours lets go.
            for e in range(first_neighbour[i], first_neighbour[i + 1]):
                beside = x[neighbour[e]]
                along = position - wp.vec3(beside[k], beside[lanes + k], beside[2 * lanes + k])
                if wp.length(along) > _TORN * spacing[e]:
                    loose = _LET_GO
        let_go[c] = loose

        face[c] = hit.face
        gaps[k] = FAR
        distances[k] = _FOLLOWED
        pinches_here[k] = pinch
        if hit.face >= 0:
            distances[k] = hit.distance
            way = wp.length(way_towards(surface, first, hit, step))
            if hit.distance < reach + _AHEAD * way:
                any_near = 1
                barycentric[c] = hit.barycentric
                for axis in range(3):
                    points[axis * lanes + k] = hit.point[axis]
                    normals[axis * lanes + k] = hit.normal[axis]
                away = position - hit.point
                above = wp.dot(away, hit.normal)
                leaning = wp.vec3(0.0, 0.0, 0.0)
                if hit.distance > _TOUCHING and above < _ALIGNED * hit.distance:
                    # Beside a pointed feature: the smooth normal would claim contact where there is air.
                    leaning = away / hit.distance - hit.normal
                    above = hit.distance
                lean[c] = leaning
                # Where the smooth normal's plane lies nearer than the surface itself, keep that gap: closing it would
                # be a kick.
                gaps[k] = wp.min(keep, above)
    near[i] = any_near
    x[i] = positions
    clearance[i] = gaps
    distance[i] = distances
    pinched[i] = pinches_here
    plane_point[i] = points
    plane_normal[i] = normals
    floor[i] = floors


for _width in WIDTHS:
    _kinds = {"parameters": "scalars", "v": "vectors", "x": "vectors", "clearance": "scalars", "distance": "scalars"}
    _kinds |= {"pinched": "scalars", "floor": "scalars", "plane_point": "vectors", "plane_normal": "vectors"}
    declare(find_contacts, _width, **_kinds)
