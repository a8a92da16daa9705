"""Walks over the body's surface to the closest point of a vertex, from face to neighbouring face."""

from __future__ import annotations

import warp as wp

from sim.kernels.contact import blend
from sim.kernels.lanes import LANE_OPTIONS

wp.set_module_options(LANE_OPTIONS)

FOLLOWED = 0.10
"""A vertex that is not followed has no walk to start from: so far [m] it is followed, as cells reach."""
ALIGNED = wp.constant(0.5)
"""A vertex whose direction from its closest point leans further than this (cosine) from the smooth normal is beside
the surface, not above or below it."""
TOUCHING = wp.constant(1.0e-4)
"""Below this distance [m] the direction from the closest point is rounding noise and the normal decides alone."""

_FOLLOWED = wp.constant(FOLLOWED)
_LONGEST_WALK = wp.constant(24)
_LONGEST_CIRCLE = wp.constant(8)
# Cloth deeper [m] in a part of the body that it does not belong to is nearer to the wrong side of a forearm or hand.
_DEEPEST_PUSH = wp.constant(0.015)
# Cloth does not get deeper into the body [m] in an interval than the two go relative to each other, and this.
_JUMP = wp.constant(0.01)
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
    bp = p - b
    cp = p - c
    d1 = wp.dot(ab, ap)
    d2 = wp.dot(ac, ap)
    d3 = wp.dot(ab, bp)
    d4 = wp.dot(ac, bp)
    d5 = wp.dot(ab, cp)
    d6 = wp.dot(ac, cp)
    va = d3 * d6 - d5 * d4
    vb = d5 * d2 - d1 * d6
    vc = d1 * d4 - d3 * d2
    # One result that stays in registers: several returns would go through memory, at half of the time of a walk.
    u = float(0.0)
    v = float(0.0)
    w = float(0.0)
    if d1 <= 0.0 and d2 <= 0.0:
        u = 1.0
    elif d3 >= 0.0 and d4 <= d3:
        v = 1.0
    elif vc <= 0.0 and d1 >= 0.0 and d3 <= 0.0:
        v = d1 / (d1 - d3)
        u = 1.0 - v
    elif d6 >= 0.0 and d5 <= d6:
        w = 1.0
    elif vb <= 0.0 and d2 >= 0.0 and d6 <= 0.0:
        w = d2 / (d2 - d6)
        u = 1.0 - w
    elif va <= 0.0 and d4 - d3 >= 0.0 and d5 - d6 >= 0.0:
        w = (d4 - d3) / ((d4 - d3) + (d5 - d6))
        v = 1.0 - w
    else:
        over = 1.0 / (va + vb + vc)
        u = va * over
        v = vb * over
        w = vc * over
    return wp.vec3(u, v, w)


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
    if rim == 1 and above < 0.0 and -above <= ALIGNED * length and length >= TOUCHING:
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
def bit_of(s: Surface, face: int):
    """The bit of the region that a face lies in, 0 for none."""
    bit = int(0)
    if face >= 0:
        bit = 1 << (s.faces[face][3] >> 16)
    return bit


@wp.func
def way_out(hit: Hit, position: wp.vec3):
    """Direction from the closest point to the outside."""
    away = hit.normal
    if wp.abs(hit.distance) > TOUCHING:
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


@wp.func
def reached_in(s: Surface, first: int, found: Hit, step: wp.vec3, lowest: float):
    """A hit, or none where it lies deeper than a vertex that was at ``lowest`` [m] and moved by ``step`` [m] can be.

    A walk can end on the far side of a neck or a wrist: seen from there, cloth in front of it lies deep inside.
    """
    hit = found
    if found.face >= 0:
        if found.distance < lowest - _JUMP - wp.length(way_towards(s, first, found, step)):
            hit.face = -1
    return hit
