"""Closest points of the body to the garment's vertices, at the end of a query interval.

A vertex whose contact still holds (``sim.kernels.kept_contacts``) keeps it. Any other *walks* over the surface from the
face of the last query, and from the seeds of ``sim.kernels.seeds`` where another limb may have come nearer or where it
had no face.

Every vertex belongs to some parts of the body, and follows its own surface whatever happens. It also collides with the
rest of the body, where there is room for that: between two surfaces that face each other across less than twice the
thickness, an arm and the trunk say, cloth can satisfy only one. It is *pinched*, and follows its own.
"""

from __future__ import annotations

from typing import Any

import warp as wp

from sim.kernels.contact import FAR
from sim.kernels.kept_contacts import AHEAD
from sim.kernels.lanes import LANE_OPTIONS, WIDTHS, declare
from sim.kernels.parameters import DT, THICKNESS
from sim.kernels.seeds import Seeds, cell_at, holds_now, seed_of
from sim.kernels.surface_walk import (
    ALIGNED,
    FOLLOWED,
    TOUCHING,
    Hit,
    Surface,
    bit_of,
    follow,
    is_own,
    nearer,
    pinches,
    reached_in,
    walk,
    way_out,
    way_towards,
)

wp.set_module_options(LANE_OPTIONS)

_FOLLOWED = wp.constant(FOLLOWED)
# A seed may be this much farther [m] than the closest point on the same limb, or hardly ever is: it is near the middle
# of the cell, not near the vertex.
_SEED_SLACK = wp.constant(0.06)
# Cloth this near its own surface [m] has no room for another limb that comes from behind: it is enough to look close.
_SNUG = wp.constant(0.01)
_SNUG_SLACK = wp.constant(0.025)
# A limb lies below the plane that touches it at a seed, but for dents this deep [m].
_DENT = wp.constant(0.01)
# How near another part of the body must be to matter [m].
_OTHER_REACH = wp.constant(0.05)
# Cloth on a limb that is not its own, stretched to this multiple [1] of its length at rest, lets go of it for a while.
_TORN = wp.constant(1.5)
_LET_GO = wp.constant(16)  # queries


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
    kept: wp.array(dtype=Any),
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
    direction: wp.array(dtype=Any),
    keepable: wp.array(dtype=Any),
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
        kept: What ``keep_contacts`` found: 2, 1 or 0.
        own_face, other_face: Where the walks on owned and on other parts ended, -1 for none; kept from query to query.
        face: Face of the contact plane, -1 for none.
        distance: Signed distance to the body [m]; of a vertex out of reach, a lower bound.
        pinched: 1 where a vertex is pinched, else 0.
        plane_point, plane_normal: Closest point of the contact plane [m] and smooth normal there.
        direction: Unit vector from the closest point to the outside.
        keepable: 1 where the contact may be kept for as long as the vertex hardly slides, 0 where not.
        floor: Distance that vertices keep [m], more than thickness and standoff where the body would poke through the
            triangles around them.
    """
    i = wp.tid()
    positions = x[i]
    gaps = clearance[i]
    distances = distance[i]
    pinches_here = pinched[i]
    points = plane_point[i]
    normals = plane_normal[i]
    outward = direction[i]
    plain = keepable[i]
    floors = floor[i]
    velocities = v[i]
    holds = kept[i]
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
        last = own_face[c]
        loose = wp.max(let_go[c] - 1, 0)
        base = cell_at(seeds.cells, motion, position) * seeds.regions
        if base != known:
            known = base
            present = int(0)
            for r in range(seeds.regions):
                present = present | (holds_now(seeds, seeds.grid[base + r]) << r)
        strange = present
        reached = int(0)  # regions that a walk comes to by itself, but for what faces the other way
        held = int(0)
        if (i & (turns - 1)) != turn:
            strange = present & ~(bit_of(surface, last) | bit_of(surface, other_face[c]))
            held = int(holds[k])
            if last >= 0:
                reached = surface.joined[surface.faces[last][3] >> 16]

        # The most promising seeds of limbs that are not followed.
        own_start = int(-1)
        other_start = int(-1)
        own_nearest = float(1.0)
        other_nearest = float(1.0)
        so_far = wp.where(last < 0, _FOLLOWED, wp.abs(distances[k]))
        slack = wp.where(so_far < _SNUG, _SNUG_SLACK, _SEED_SLACK)
        while strange != 0:
            r = int(wp.log2(float(strange & -strange)) + 0.5)
            strange = strange & (strange - 1)
            seed = seed_of(seeds.grid[base + r])
            from_seed = position - seeds.point[motion * seeds.count + seed]
            to_seed = wp.length(from_seed)
            normal = seeds.normal[motion * seeds.count + seed]
            height = wp.dot(from_seed, normal) - _DENT
            start = seeds.face[seed]
            if is_own(surface.faces[start], parts) == 1:
                alike = normal[0] * normals[k] + normal[1] * normals[lanes + k] + normal[2] * normals[2 * lanes + k]
                onward = ((reached >> r) & 1) == 1 and alike > 0.7
                if not onward and wp.max(to_seed - slack, height) < so_far and to_seed < own_nearest:
                    own_start = start
                    own_nearest = to_seed
            elif wp.max(to_seed - _SEED_SLACK, height) < _OTHER_REACH and to_seed < other_nearest:
                other_start = start
                other_nearest = to_seed
        if held > 0 and own_start < 0 and (other_start < 0 or loose > 0):
            any_near = wp.where(held > 1, 1, any_near)
            continue

        step = wp.vec3(velocities[k], velocities[lanes + k], velocities[2 * lanes + k]) * (dt[k] * steps)
        lowest = wp.where(steps > 0.0, wp.min(distances[k], 0.0), -1.0)
        own = Hit()
        other = Hit()
        other.face = -1
        if held > 0:
            own.face = last
            own.barycentric = barycentric[c]
            own.point = wp.vec3(points[k], points[lanes + k], points[2 * lanes + k])
            own.normal = wp.vec3(normals[k], normals[lanes + k], normals[2 * lanes + k])
            own.distance = distances[k]
        else:
            own = reached_in(surface, first, follow(surface, first, last, position, parts, 1), step, lowest)
            other = follow(surface, first, other_face[c], position, parts, 0)
        if own_start >= 0:
            found = walk(surface, first, own_start, position, parts, 1)
            own = nearer(own, reached_in(surface, first, found, step, lowest))
        if other_start >= 0 and loose == 0:
            found = walk(surface, first, other_start, position, parts, 0)
            other = nearer(other, reached_in(surface, first, found, step, lowest))
        if loose > 0:
            other.face = -1
        own_face[c] = own.face
        other_face[c] = other.face

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
        plain[k] = 0.0
        distances[k] = _FOLLOWED
        pinches_here[k] = pinch
        if hit.face >= 0:
            distances[k] = hit.distance
            way = wp.length(way_towards(surface, first, hit, step))
            away = position - hit.point
            above = wp.dot(away, hit.normal)
            out = way_out(hit, position)
            barycentric[c] = hit.barycentric
            for axis in range(3):
                points[axis * lanes + k] = hit.point[axis]
                normals[axis * lanes + k] = hit.normal[axis]
                outward[axis * lanes + k] = out[axis]
            leaning = wp.vec3(0.0, 0.0, 0.0)
            if hit.distance > TOUCHING and above < ALIGNED * hit.distance:
                # Beside a pointed feature: the smooth normal would claim contact where there is air.
                leaning = away / hit.distance - hit.normal
                above = hit.distance
            elif hit.face == own.face and other.face < 0 and loose == 0:
                plain[k] = 1.0
            lean[c] = leaning
            if hit.distance < reach + AHEAD * way:
                any_near = 1
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
    direction[i] = outward
    keepable[i] = plain


for _width in WIDTHS:
    _kinds = {"parameters": "scalars", "v": "vectors", "x": "vectors", "clearance": "scalars", "distance": "scalars"}
    _kinds |= {"pinched": "scalars", "floor": "scalars", "plane_point": "vectors", "plane_normal": "vectors"}
    _kinds |= {"kept": "scalars", "keepable": "scalars", "direction": "vectors"}
    declare(find_contacts, _width, **_kinds)
