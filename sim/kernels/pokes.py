"""Body that pokes through cloth between vertices that lie outside of it: seen by the bend of the body, and lifted.

A convex body lies below its tangent planes. Along an edge of the cloth, the tangent planes at the closest points of its
two ends meet somewhere; what is left there of the distance of the edge is a lower bound, exact over a sharp ridge and
half a sagitta too little over a round limb. Where it falls below a margin the ends are lifted, and keep the new
distance as their floor for a while.
"""

from __future__ import annotations

from typing import Any

import warp as wp

from sim.kernels.lanes import LANE_OPTIONS, WIDTHS, declare

wp.set_module_options(LANE_OPTIONS)

# Least that is left of the distance, as a share of the thickness.
_MARGIN = wp.constant(0.3)
# Floors are not raised above this [m].
_HIGHEST = wp.constant(0.015)
# Outward directions at the two ends that meet at more than this (cosine) face each other.
_FOLDED = wp.constant(-0.2)


@wp.kernel
def raise_floors(
    edges: wp.array(dtype=wp.vec2i),
    near: wp.array(dtype=int),
    inverse_mass: wp.array(dtype=float),
    clearance: wp.array(dtype=Any),
    distance: wp.array(dtype=Any),
    direction: wp.array(dtype=Any),
    x: wp.array(dtype=Any),
    thickness: wp.array(dtype=Any),
    floor: wp.array(dtype=Any),
):
    """Raise the floors of both ends of every edge that the body may poke through [m]."""
    e = wp.tid()
    i = edges[e][0]
    j = edges[e][1]
    if near[i] == 0 or near[j] == 0:
        return
    free_i = wp.where(inverse_mass[i] > 0.0, 1.0, 0.0)
    free_j = wp.where(inverse_mass[j] > 0.0, 1.0, 0.0)
    gap_i = clearance[i]
    gap_j = clearance[j]
    from_i = distance[i]
    from_j = distance[j]
    p = x[i]
    q = x[j]
    a = direction[i]
    b = direction[j]
    thick = thickness[0]
    floor_i = floor[i]
    floor_j = floor[j]
    lanes = len(thick)
    for k in range(lanes):
        y = lanes + k
        z = 2 * lanes + k
        ex = q[k] - p[k]
        ey = q[y] - p[y]
        ez = q[z] - p[z]
        # How far the edge comes down on the plane at i from there to j, and on that at j the other way.
        down = wp.min(a[k] * ex + a[y] * ey + a[z] * ez, -1.0e-6)
        up = wp.min(-(b[k] * ex + b[y] * ey + b[z] * ez), -1.0e-6)
        t = wp.clamp((from_j[k] + up - from_i[k]) / (down + up), 0.0, 1.0)
        s = 1.0 - t
        left = wp.max(from_i[k] + t * down, from_j[k] + s * up)
        facing = a[k] * b[k] + a[y] * b[y] + a[z] * b[z]
        # Where the surfaces face each other, in the crook of a knee, nothing pokes through: there is a fold.
        bent = facing > _FOLDED
        lift = wp.where(bent and wp.min(gap_i[k], gap_j[k]) > -1.0, wp.max(_MARGIN * thick[k] - left, 0.0), 0.0)
        over = lift / (s * s * free_i + t * t * free_j + 1.0e-6)
        floor_i[k] = wp.max(floor_i[k], wp.where(lift > 0.0, wp.min(from_i[k] + s * over, _HIGHEST), 0.0))
        floor_j[k] = wp.max(floor_j[k], wp.where(lift > 0.0, wp.min(from_j[k] + t * over, _HIGHEST), 0.0))
    wp.atomic_max(floor, i, floor_i)
    wp.atomic_max(floor, j, floor_j)


@wp.kernel
def lift_to_floors(
    near: wp.array(dtype=int),
    inverse_mass: wp.array(dtype=float),
    direction: wp.array(dtype=Any),
    floor: wp.array(dtype=Any),
    clearance: wp.array(dtype=Any),
    distance: wp.array(dtype=Any),
    x: wp.array(dtype=Any),
):
    """Move vertices away from their closest points out to their floors [m]; as in a query, velocities stay."""
    i = wp.tid()
    if near[i] == 0 or inverse_mass[i] == 0.0:
        return
    out = direction[i]
    floors = floor[i]
    gap = clearance[i]
    far = distance[i]
    position = x[i]
    lanes = len(floors)
    for k in range(lanes):
        y = lanes + k
        z = 2 * lanes + k
        lift = wp.where(gap[k] > -1.0, wp.max(floors[k] - far[k], 0.0), 0.0)
        position[k] = position[k] + out[k] * lift
        position[y] = position[y] + out[y] * lift
        position[z] = position[z] + out[z] * lift
        far[k] = far[k] + lift
        gap[k] = gap[k] + lift
    x[i] = position
    clearance[i] = gap
    distance[i] = far


for _width in WIDTHS:
    _kinds = {"clearance": "scalars", "distance": "scalars", "floor": "scalars", "direction": "vectors"}
    declare(raise_floors, _width, x="vectors", thickness="scalars", **_kinds)
    declare(lift_to_floors, _width, x="vectors", **_kinds)
