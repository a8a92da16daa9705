"""Contact of a garment with itself: feature pairs are kept apart, with Coulomb friction.

A pair keeps the side on which it was found. Where the vertex is over the inside of the triangle (the edges pass over
each other), the distance on that side may not fall below ``gap``: the thickness, or less where the pair was nearer
when it was found, growing at ``_OPENING`` until it has the thickness, so that nothing pops. A pair that is farther
apart than the thickness has passed around or through: it takes the side that it is on, unless the order of the layers
gives it.

On a CPU the pairs are solved one after the other (Gauss-Seidel). On a GPU they are solved at once, in two passes: the
first counts the active pairs of each vertex, the second divides every correction by the count of the pair's busiest
vertex and adds it to ``delta``. One factor a pair, not a vertex: so momentum is kept there as well.
"""

from __future__ import annotations

from typing import Any

import warp as wp

from sim.kernels.lanes import LANE_OPTIONS, WIDTHS, declare
from sim.kernels.parameters import DT, SELF_FRICTION, THICKNESS
from sim.kernels.self_features import FEATURE_PAIRS, OFF, Pair, edge_frame, triangle_frame

wp.set_module_options(LANE_OPTIONS)

ONE_BY_ONE = wp.constant(0)
COUNT = wp.constant(1)
ADD_UP = wp.constant(2)

# Speed at which layers that were found too near are parted [m/s].
_OPENING = wp.constant(0.1)
_TINY = wp.constant(1.0e-20)


@wp.kernel
def solve_self_contact(
    mode: int,
    threads: int,
    found: wp.array(dtype=int),
    pairs: wp.array(dtype=Pair),
    inverse_mass: wp.array(dtype=float),
    parameters: wp.array(dtype=Any),
    x_prev: wp.array(dtype=Any),
    side: wp.array(dtype=Any),
    gap: wp.array(dtype=Any),
    x: wp.array(dtype=Any),
    active: wp.array(dtype=Any),
    delta: wp.array(dtype=Any),
):
    """Part the pairs; friction takes away their sliding within the substep, at most ``mu`` times the depth."""
    thickness = parameters[THICKNESS]
    friction = parameters[SELF_FRICTION]
    dt = parameters[DT]
    lanes = len(dt)
    opening = float(_OPENING)
    if mode == ADD_UP:
        opening = 0.0
    for index in range(wp.tid(), wp.min(found[FEATURE_PAIRS], pairs.shape[0]), threads):
        pair = pairs[index]
        x0 = x[pair.i0]
        x1 = x[pair.i1]
        x2 = x[pair.i2]
        x3 = x[pair.i3]
        normal = x0
        depth = dt
        inner = dt
        w1 = dt
        w2 = dt
        w3 = dt
        if pair.edges == 0:
            for k in range(lanes):
                y = lanes + k
                z = 2 * lanes + k
                ux = x2[k] - x1[k]
                uy = x2[y] - x1[y]
                uz = x2[z] - x1[z]
                wx = x3[k] - x1[k]
                wy = x3[y] - x1[y]
                wz = x3[z] - x1[z]
                f = triangle_frame(ux, uy, uz, wx, wy, wz, x0[k] - x1[k], x0[y] - x1[y], x0[z] - x1[z])
                normal[k] = f.nx
                normal[y] = f.ny
                normal[z] = f.nz
                depth[k] = f.distance
                inner[k] = f.inner
                w1[k] = f.first + f.second - 1.0
                w2[k] = -f.first
                w3[k] = -f.second
        else:
            for k in range(lanes):
                y = lanes + k
                z = 2 * lanes + k
                ux = x1[k] - x0[k]
                uy = x1[y] - x0[y]
                uz = x1[z] - x0[z]
                wx = x3[k] - x2[k]
                wy = x3[y] - x2[y]
                wz = x3[z] - x2[z]
                f = edge_frame(ux, uy, uz, wx, wy, wz, x0[k] - x2[k], x0[y] - x2[y], x0[z] - x2[z])
                normal[k] = f.nx
                normal[y] = f.ny
                normal[z] = f.nz
                depth[k] = f.distance
                inner[k] = f.inner
                w1[k] = f.first
                w2[k] = f.second - 1.0
                w3[k] = -f.second
        sides = side[index]
        gaps = gap[index]
        hits = int(0)
        for k in range(lanes):
            distance = depth[k]
            old = sides[k]
            sign = wp.where(distance < 0.0, -1.0, 1.0)
            keeps = wp.where(old == 0.0, inner[k] < 0.0, sign * distance < thickness[k] or wp.abs(old) > 1.5)
            new = wp.where(keeps, old, sign)
            least = wp.where(new == old, gaps[k] + opening * dt[k], sign * distance)
            # Beside the triangle, the side that the layers give is only a wish: what comes over it begins where it is.
            beside = wp.abs(old) > 1.5 and inner[k] < 0.0
            least = wp.where(beside, wp.clamp(old, -1.0, 1.0) * distance, least)
            least = wp.where(gaps[k] == OFF, OFF, wp.min(least, thickness[k]))
            sides[k] = new
            gaps[k] = least
            unit = wp.clamp(new, -1.0, 1.0)
            missing = wp.where(inner[k] >= 0.0 and new != 0.0, wp.max(least - unit * distance, 0.0), 0.0)
            depth[k] = missing * unit
            hits += wp.where(missing > 0.0, 1, 0)
        if mode != ADD_UP:
            side[index] = sides
            gap[index] = gaps
        if hits > 0:
            if mode == COUNT:
                for k in range(lanes):
                    inner[k] = wp.where(depth[k] != 0.0, 1.0, 0.0)
                wp.atomic_add(active, pair.i0, inner)
                wp.atomic_add(active, pair.i1, inner)
                wp.atomic_add(active, pair.i2, inner)
                wp.atomic_add(active, pair.i3, inner)
            else:
                m0 = inverse_mass[pair.i0]
                m1 = inverse_mass[pair.i1]
                m2 = inverse_mass[pair.i2]
                m3 = inverse_mass[pair.i3]
                y0 = x_prev[pair.i0]
                y1 = x_prev[pair.i1]
                y2 = x_prev[pair.i2]
                y3 = x_prev[pair.i3]
                for k in range(lanes):
                    y = lanes + k
                    z = 2 * lanes + k
                    b1 = w1[k]
                    b2 = w2[k]
                    b3 = w3[k]
                    b0 = -b1 - b2 - b3
                    push = depth[k]
                    weight = b0 * b0 * m0 + b1 * b1 * m1 + b2 * b2 * m2 + b3 * b3 * m3
                    weight = wp.where(push != 0.0 and weight > 0.0, 1.0 / wp.max(weight, _TINY), 0.0)
                    nx = normal[k]
                    ny = normal[y]
                    nz = normal[z]
                    # Sliding against each other since the start of the substep.
                    sx = b0 * (x0[k] - y0[k]) + b1 * (x1[k] - y1[k]) + b2 * (x2[k] - y2[k]) + b3 * (x3[k] - y3[k])
                    sy = b0 * (x0[y] - y0[y]) + b1 * (x1[y] - y1[y]) + b2 * (x2[y] - y2[y]) + b3 * (x3[y] - y3[y])
                    sz = b0 * (x0[z] - y0[z]) + b1 * (x1[z] - y1[z]) + b2 * (x2[z] - y2[z]) + b3 * (x3[z] - y3[z])
                    rise = sx * nx + sy * ny + sz * nz
                    sx -= rise * nx
                    sy -= rise * ny
                    sz -= rise * nz
                    length = wp.sqrt(sx * sx + sy * sy + sz * sz + _TINY)
                    held = wp.min(friction[k] * wp.abs(push) / length, 1.0)
                    sx = (push * nx - held * sx) * weight
                    sy = (push * ny - held * sy) * weight
                    sz = (push * nz - held * sz) * weight
                    x0[k] = x0[k] + b0 * m0 * sx
                    x0[y] = x0[y] + b0 * m0 * sy
                    x0[z] = x0[z] + b0 * m0 * sz
                    x1[k] = x1[k] + b1 * m1 * sx
                    x1[y] = x1[y] + b1 * m1 * sy
                    x1[z] = x1[z] + b1 * m1 * sz
                    x2[k] = x2[k] + b2 * m2 * sx
                    x2[y] = x2[y] + b2 * m2 * sy
                    x2[z] = x2[z] + b2 * m2 * sz
                    x3[k] = x3[k] + b3 * m3 * sx
                    x3[y] = x3[y] + b3 * m3 * sy
                    x3[z] = x3[z] + b3 * m3 * sz
                if mode == ONE_BY_ONE:
                    x[pair.i0] = x0
                    x[pair.i1] = x1
                    x[pair.i2] = x2
                    x[pair.i3] = x3
                else:
                    c0 = active[pair.i0]
                    c1 = active[pair.i1]
                    c2 = active[pair.i2]
                    c3 = active[pair.i3]
                    x0 = x0 - x[pair.i0]
                    x1 = x1 - x[pair.i1]
                    x2 = x2 - x[pair.i2]
                    x3 = x3 - x[pair.i3]
                    for k in range(lanes):
                        share = 1.0 / wp.max(wp.max(wp.max(c0[k], c1[k]), wp.max(c2[k], c3[k])), 1.0)
                        for axis in range(3):
                            j = axis * lanes + k
                            x0[j] = x0[j] * share
                            x1[j] = x1[j] * share
                            x2[j] = x2[j] * share
                            x3[j] = x3[j] * share
                    wp.atomic_add(delta, pair.i0, x0)
                    wp.atomic_add(delta, pair.i1, x1)
                    wp.atomic_add(delta, pair.i2, x2)
                    wp.atomic_add(delta, pair.i3, x3)


@wp.kernel
def apply_corrections(x: wp.array(dtype=Any), active: wp.array(dtype=Any), delta: wp.array(dtype=Any)):
    """Move the vertices by what was added up, and begin anew."""
    i = wp.tid()
    step = delta[i]
    x[i] = x[i] + step
    delta[i] = step - step
    count = active[i]
    active[i] = count - count


for _width in WIDTHS:
    _lanes = {"parameters": "scalars", "x_prev": "vectors", "side": "scalars", "gap": "scalars"}
    declare(solve_self_contact, _width, x="vectors", active="scalars", delta="vectors", **_lanes)
    declare(apply_corrections, _width, x="vectors", active="scalars", delta="vectors")
