"""Contacts that still hold: vertices that hardly slid over the body since their closest point was searched for.

Cloth mostly rides on the body. The point of the body that was closest to a vertex is carried along (``carry_planes``);
while the vertex stays above it, a new search would find it again, to a fraction of the way that it slid. This pass over
all lanes side by side is ten times faster than a search.
"""

from __future__ import annotations

from typing import Any

import warp as wp

from sim.kernels.contact import FAR
from sim.kernels.lanes import LANE_OPTIONS, WIDTHS, declare
from sim.kernels.parameters import DT, THICKNESS

wp.set_module_options(LANE_OPTIONS)

AHEAD = wp.constant(1.5)
"""Contact is kept within the reach and this much [1] of the way that body and vertex went relative to each other."""

# A vertex may be this far [m] beside the line that leads out from the carried point, and this much [1] of its distance.
_SLIDE = wp.constant(0.0004)
_ASIDE = wp.constant(0.15)
# Deeper than this share of the distance to keep, moving a vertex out may bring it under another face.
_SHALLOW = wp.constant(0.25)
# What is left of a raised floor after a query [1].
_FORGET = wp.constant(0.95)


@wp.kernel
def keep_contacts(
    reach: float,
    steps: float,
    inverse_mass: wp.array(dtype=float),
    standoff: wp.array(dtype=float),
    parameters: wp.array(dtype=Any),
    v: wp.array(dtype=Any),
    keepable: wp.array(dtype=Any),
    plane_travel: wp.array(dtype=Any),
    plane_turn: wp.array(dtype=Any),
    x: wp.array(dtype=Any),
    plane_point: wp.array(dtype=Any),
    plane_normal: wp.array(dtype=Any),
    direction: wp.array(dtype=Any),
    clearance: wp.array(dtype=Any),
    distance: wp.array(dtype=Any),
    pinched: wp.array(dtype=Any),
    floor: wp.array(dtype=Any),
    kept: wp.array(dtype=Any),
):
    """End an interval where contacts still hold: move shallow vertices out, set the planes for the next interval.

    Args:
        reach: Distance up to which a vertex at rest is in contact [m].
        steps: Substeps since the last query.
        keepable: 1 where the last search found a plain contact, 0 where it has to be repeated.
        kept: Becomes 2 where a contact holds and is near, 1 where it holds, 0 where it has to be searched for.

    The other arguments are those of ``query.find_contacts``.
    """
    i = wp.tid()
    thickness = parameters[THICKNESS]
    dt = parameters[DT]
    free = wp.where(inverse_mass[i] > 0.0, 1.0, 0.0)
    stand = standoff[i]
    velocity = v[i]
    plain = keepable[i]
    travel = plane_travel[i]
    turn = plane_turn[i]
    position = x[i]
    point = plane_point[i]
    normal = plane_normal[i]
    out = direction[i]
    gap = clearance[i]
    far = distance[i]
    pinch = pinched[i]
    floors = floor[i]
    state = kept[i]
    lanes = len(thickness)
    for k in range(lanes):
        y = lanes + k
        z = 2 * lanes + k
        keep = thickness[k] + stand
        keep = keep + wp.max(floors[k] - keep, 0.0) * _FORGET
        floors[k] = keep
        nx = normal[k] + turn[k]
        ny = normal[y] + turn[y]
        nz = normal[z] + turn[z]
        over = 1.0 / wp.sqrt(nx * nx + ny * ny + nz * nz + 1.0e-20)
        nx = nx * over
        ny = ny * over
        nz = nz * over
        px = point[k] + travel[k]
        py = point[y] + travel[y]
        pz = point[z] + travel[z]
        rx = position[k] - px
        ry = position[y] - py
        rz = position[z] - pz
        # The way out turns with the smooth normal, which it differs from on a coarse body.
        ox = out[k] + turn[k]
        oy = out[y] + turn[y]
        oz = out[z] + turn[z]
        over = 1.0 / wp.sqrt(ox * ox + oy * oy + oz * oz + 1.0e-20)
        ox = ox * over
        oy = oy * over
        oz = oz * over
        height = rx * ox + ry * oy + rz * oz
        beside = rx * rx + ry * ry + rz * rz - height * height
        allowed = _SLIDE + _ASIDE * wp.abs(height)
        moved = wp.max(0.999 * keep - height, 0.0) * free
        hold = wp.where(plain[k] > 0.0 and beside < allowed * allowed and moved < _SHALLOW * keep, 1.0, 0.0)
        moved = wp.where(moved > 0.0, keep - height, 0.0) * hold
        position[k] = position[k] + ox * moved
        position[y] = position[y] + oy * moved
        position[z] = position[z] + oz * moved
        above = (rx + ox * moved) * nx + (ry + oy * moved) * ny + (rz + oz * moved) * nz
        height = height + moved
        wx = travel[k] - velocity[k] * dt[k] * steps
        wy = travel[y] - velocity[y] * dt[k] * steps
        wz = travel[z] - velocity[z] * dt[k] * steps
        way = wp.sqrt(wx * wx + wy * wy + wz * wz)
        near = wp.where(height < reach + AHEAD * way, 1.0, 0.0)
        state[k] = hold * (1.0 + near)
        gap[k] = wp.where(hold > 0.0, wp.where(near > 0.0, wp.min(keep, above), FAR), gap[k])
        far[k] = wp.where(hold > 0.0, height, far[k])
        pinch[k] = wp.where(hold > 0.0, 0.0, pinch[k])
        point[k] = wp.where(hold > 0.0, px, point[k])
        point[y] = wp.where(hold > 0.0, py, point[y])
        point[z] = wp.where(hold > 0.0, pz, point[z])
        normal[k] = wp.where(hold > 0.0, nx, normal[k])
        normal[y] = wp.where(hold > 0.0, ny, normal[y])
        normal[z] = wp.where(hold > 0.0, nz, normal[z])
        out[k] = wp.where(hold > 0.0, ox, out[k])
        out[y] = wp.where(hold > 0.0, oy, out[y])
        out[z] = wp.where(hold > 0.0, oz, out[z])
    x[i] = position
    plane_point[i] = point
    plane_normal[i] = normal
    direction[i] = out
    clearance[i] = gap
    distance[i] = far
    pinched[i] = pinch
    floor[i] = floors
    kept[i] = state


for _width in WIDTHS:
    _kinds = dict.fromkeys(("v", "plane_travel", "plane_turn", "x", "plane_point", "plane_normal"), "vectors")
    _kinds |= dict.fromkeys(("parameters", "keepable", "clearance", "distance", "pinched", "floor", "kept"), "scalars")
    declare(keep_contacts, _width, direction="vectors", **_kinds)
