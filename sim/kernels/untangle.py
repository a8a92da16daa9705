"""Cloth that has passed through itself: counted, and drawn apart by shortening the contours of intersection.

Volino & Magnenat-Thalmann 2006 (Resolving surface collisions through intersection contour minimization): where an edge
with direction E pierces a triangle with normal N, the contour leaves the piercing point along the unit vectors R into
the faces at the edge. Moving the edge by d against the triangle moves the point by ``d - (N.d) / (N.E) E``, so that
``sum R - (sum R.E) / (N.E) N`` is the direction that shortens the contour fastest.
"""

from __future__ import annotations

from typing import Any

import warp as wp

from sim.kernels.lanes import LANE_OPTIONS, WIDTHS, declare
from sim.kernels.parameters import DT
from sim.kernels.self_detection import TRIANGLE_PAIRS, Patch

wp.set_module_options(LANE_OPTIONS)

CROSSINGS = wp.constant(2)
"""Place of the number of crossings among the counters."""

# Speed at which an edge is drawn out of a triangle [m/s].
_SPEED = wp.constant(6.0)
# The same between layers: their order tells how they come apart, and two strong hands that pull differently tear.
_LAYER_SPEED = wp.constant(1.0)
# Gradient below which the contour is nearly straight and its direction says little, 1.
_STRAIGHT = wp.constant(0.3)
_TINY = wp.constant(1.0e-20)


@wp.struct
class Crossing:
    """An edge i0 i1 that pierces a triangle i2 i3 i4 in some lane; the far vertices of its faces, -1 for none."""

    i0: int
    i1: int
    i2: int
    i3: int
    i4: int
    left: int
    right: int
    speed: float  # at which they are drawn apart [m/s]


@wp.struct
class Piercing:
    """Where the line of an edge meets a triangle."""

    along: float  # place along the edge
    first: float  # barycentric coordinate of the second corner
    second: float  # and of the third
    inner: float  # least of along, 1 - along and the barycentric coordinates; negative without a crossing
    nx: float  # unit normal of the triangle
    ny: float
    nz: float


@wp.func
def pierce(
    ux: float,
    uy: float,
    uz: float,
    wx: float,
    wy: float,
    wz: float,
    ex: float,
    ey: float,
    ez: float,
    dx: float,
    dy: float,
    dz: float,
):
    """Line d + t e against the triangle 0, u, w (Moeller & Trumbore 1997)."""
    nx = uy * wz - uz * wy
    ny = uz * wx - ux * wz
    nz = ux * wy - uy * wx
    slope = nx * ex + ny * ey + nz * ez
    over = 1.0 / wp.where(wp.abs(slope) > _TINY, slope, _TINY)
    qx = dy * ez - dz * ey
    qy = dz * ex - dx * ez
    qz = dx * ey - dy * ex
    p = Piercing()
    p.along = -(nx * dx + ny * dy + nz * dz) * over
    p.first = -(qx * wx + qy * wy + qz * wz) * over
    p.second = (qx * ux + qy * uy + qz * uz) * over
    rim = wp.min(wp.min(p.first, p.second), 1.0 - p.first - p.second)
    p.inner = wp.min(rim, wp.min(p.along, 1.0 - p.along))
    length = 1.0 / wp.sqrt(nx * nx + ny * ny + nz * nz + _TINY)
    p.nx = nx * length
    p.ny = ny * length
    p.nz = nz * length
    return p


@wp.kernel
def find_crossings(
    threads: int,
    patches: wp.array(dtype=Patch),
    triangle_pairs: wp.array(dtype=wp.vec2i),
    boxes: wp.array(dtype=Any),
    x: wp.array(dtype=Any),
    found: wp.array(dtype=int),
    crossings: wp.array(dtype=Crossing),
    marked: wp.array(dtype=Any),
    total: wp.array(dtype=Any),
):
    """Edges that pierce a triangle in any lane; ``total[0]`` counts them in each, ``marked`` gets 1 at their vertices.

    More crossings than fit are counted and not stored.
    """
    scale = total[0]
    lanes = len(scale)
    for index in range(wp.tid(), wp.min(found[TRIANGLE_PAIRS], triangle_pairs.shape[0]), threads):
        i = triangle_pairs[index][0]
        j = triangle_pairs[index][1]
        a0 = boxes[6 * i]
        a1 = boxes[6 * i + 1]
        b0 = boxes[6 * j]
        b1 = boxes[6 * j + 1]
        meets = int(0)
        for k in range(lanes):
            y = lanes + k
            z = 2 * lanes + k
            gap_x = wp.max(a0[k] + b1[k], b0[k] + a1[k])
            gap_y = wp.max(a0[y] + b1[y], b0[y] + a1[y])
            gap_z = wp.max(a0[z] + b1[z], b0[z] + a1[z])
            meets += wp.where(wp.max(wp.max(gap_x, gap_y), gap_z) <= 0.0, 1, 0)
        if meets > 0:
            for turn in range(2):
                a = patches[wp.where(turn == 0, i, j)]
                b = patches[wp.where(turn == 0, j, i)]
                i2 = b.corner[0]
                i3 = b.corner[1]
                i4 = b.corner[2]
                for c in range(3):
                    i0 = a.corner[c]
                    i1 = a.corner[wp.where(c == 2, 0, c + 1)]
                    due = ((a.owned >> (3 + c)) & 1) == 1
                    due = due and i0 != i2 and i0 != i3 and i0 != i4 and i1 != i2 and i1 != i3 and i1 != i4
                    if due:
                        x0 = x[i0]
                        x1 = x[i1]
                        x2 = x[i2]
                        x3 = x[i3]
                        x4 = x[i4]
                        marks = scale
                        hits = int(0)
                        for k in range(lanes):
                            y = lanes + k
                            z = 2 * lanes + k
                            p = pierce(
                                x3[k] - x2[k],
                                x3[y] - x2[y],
                                x3[z] - x2[z],
                                x4[k] - x2[k],
                                x4[y] - x2[y],
                                x4[z] - x2[z],
                                x1[k] - x0[k],
                                x1[y] - x0[y],
                                x1[z] - x0[z],
                                x0[k] - x2[k],
                                x0[y] - x2[y],
                                x0[z] - x2[z],
                            )
                            marks[k] = wp.where(p.inner > 0.0, 1.0, 0.0)
                            hits += wp.where(p.inner > 0.0, 1, 0)
                        if hits > 0:
                            wp.atomic_add(total, 0, marks)
                            wp.atomic_max(marked, i0, marks)
                            wp.atomic_max(marked, i1, marks)
                            wp.atomic_max(marked, i2, marks)
                            wp.atomic_max(marked, i3, marks)
                            wp.atomic_max(marked, i4, marks)
                            slot = wp.atomic_add(found, CROSSINGS, 1)
                            if slot < crossings.shape[0]:
                                crossing = Crossing()
                                crossing.i0 = i0
                                crossing.i1 = i1
                                crossing.i2 = i2
                                crossing.i3 = i3
                                crossing.i4 = i4
                                crossing.left = a.corner[wp.where(c == 0, 2, c - 1)]
                                crossing.right = a.opposite[c]
                                crossing.speed = wp.where(a.layer == b.layer, _SPEED, _LAYER_SPEED)
                                crossings[slot] = crossing


@wp.kernel
def count_searches(marked: wp.array(dtype=Any), tangled: wp.array(dtype=Any)):
    """Number of searches in a row that found each vertex at a crossing; clears the marks."""
    i = wp.tid()
    mark = marked[i]
    age = tangled[i]
    for k in range(len(mark)):
        age[k] = (age[k] + 1.0) * mark[k]
        mark[k] = 0.0
    tangled[i] = age
    marked[i] = mark


@wp.struct
class Inward:
    """Unit vector of a contour into a face at an edge."""

    x: float
    y: float
    z: float
    spare: float  # a struct of more than 16 bytes keeps the loop vectorisable
    more: float


@wp.func
def contour(nx: float, ny: float, nz: float, ex: float, ey: float, ez: float, fx: float, fy: float, fz: float):
    """Along the plane with normal n and the face that holds the unit edge e and the far vertex f, towards f."""
    along = fx * ex + fy * ey + fz * ez
    gx = fx - along * ex
    gy = fy - along * ey
    gz = fz - along * ez
    # The normal of the face is e x g; the contour is at right angles to it and to n.
    mx = ey * gz - ez * gy
    my = ez * gx - ex * gz
    mz = ex * gy - ey * gx
    rx = ny * mz - nz * my
    ry = nz * mx - nx * mz
    rz = nx * my - ny * mx
    over = 1.0 / wp.sqrt(rx * rx + ry * ry + rz * rz + _TINY)
    over = wp.where(rx * gx + ry * gy + rz * gz < 0.0, -over, over)
    r = Inward()
    r.x = rx * over
    r.y = ry * over
    r.z = rz * over
    r.spare = 0.0
    r.more = 0.0
    return r


@wp.kernel
def draw_apart(
    threads: int,
    found: wp.array(dtype=int),
    crossings: wp.array(dtype=Crossing),
    inverse_mass: wp.array(dtype=float),
    released: wp.array(dtype=Any),
    parameters: wp.array(dtype=Any),
    x: wp.array(dtype=Any),
    x_pred: wp.array(dtype=Any),
):
    """Move edges that still pierce their triangle, and the triangle against them, along the contour's gradient.

    Positions and predictions move together, so that velocities stay as they are.
    """
    dt = parameters[DT]
    lanes = len(dt)
    for index in range(wp.tid(), wp.min(found[CROSSINGS], crossings.shape[0]), threads):
        c = crossings[index]
        x0 = x[c.i0]
        x1 = x[c.i1]
        x2 = x[c.i2]
        x3 = x[c.i3]
        x4 = x[c.i4]
        left = x[c.left]
        right = x[wp.max(c.right, 0)]
        two_sided = wp.where(c.right >= 0, 1.0, 0.0)
        m0 = inverse_mass[c.i0]
        m1 = inverse_mass[c.i1]
        m2 = inverse_mass[c.i2]
        m3 = inverse_mass[c.i3]
        m4 = inverse_mass[c.i4]
        r0 = released[c.i0]
        r2 = released[c.i2]
        for k in range(lanes):
            y = lanes + k
            z = 2 * lanes + k
            ex = x1[k] - x0[k]
            ey = x1[y] - x0[y]
            ez = x1[z] - x0[z]
            p = pierce(
                x3[k] - x2[k],
                x3[y] - x2[y],
                x3[z] - x2[z],
                x4[k] - x2[k],
                x4[y] - x2[y],
                x4[z] - x2[z],
                ex,
                ey,
                ez,
                x0[k] - x2[k],
                x0[y] - x2[y],
                x0[z] - x2[z],
            )
            over = 1.0 / wp.sqrt(ex * ex + ey * ey + ez * ez + _TINY)
            ex *= over
            ey *= over
            ez *= over
            a = contour(p.nx, p.ny, p.nz, ex, ey, ez, left[k] - x0[k], left[y] - x0[y], left[z] - x0[z])
            b = contour(p.nx, p.ny, p.nz, ex, ey, ez, right[k] - x0[k], right[y] - x0[y], right[z] - x0[z])
            gx = a.x + two_sided * b.x
            gy = a.y + two_sided * b.y
            gz = a.z + two_sided * b.z
            slope = p.nx * ex + p.ny * ey + p.nz * ez
            slope = wp.where(slope < 0.0, wp.min(slope, -0.1), wp.max(slope, 0.1))
            tilt = (gx * ex + gy * ey + gz * ez) / slope
            gx -= tilt * p.nx
            gy -= tilt * p.ny
            gz -= tilt * p.nz
            b1 = p.along
            b0 = 1.0 - b1
            b3 = p.first
            b4 = p.second
            b2 = 1.0 - b3 - b4
            weight = b0 * b0 * m0 + b1 * b1 * m1 + b2 * b2 * m2 + b3 * b3 * m3 + b4 * b4 * m4
            step = c.speed * dt[k] / wp.sqrt(gx * gx + gy * gy + gz * gz + _STRAIGHT * _STRAIGHT)
            step = wp.where(p.inner > 0.0 and wp.max(r0[k], r2[k]) == 0.0, step / wp.max(weight, _TINY), 0.0)
            step = wp.where(weight > 0.0, step, 0.0)
            gx *= step
            gy *= step
            gz *= step
            x0[k] = x0[k] + b0 * m0 * gx
            x0[y] = x0[y] + b0 * m0 * gy
            x0[z] = x0[z] + b0 * m0 * gz
            x1[k] = x1[k] + b1 * m1 * gx
            x1[y] = x1[y] + b1 * m1 * gy
            x1[z] = x1[z] + b1 * m1 * gz
            x2[k] = x2[k] - b2 * m2 * gx
            x2[y] = x2[y] - b2 * m2 * gy
            x2[z] = x2[z] - b2 * m2 * gz
            x3[k] = x3[k] - b3 * m3 * gx
            x3[y] = x3[y] - b3 * m3 * gy
            x3[z] = x3[z] - b3 * m3 * gz
            x4[k] = x4[k] - b4 * m4 * gx
            x4[y] = x4[y] - b4 * m4 * gy
            x4[z] = x4[z] - b4 * m4 * gz
        x_pred[c.i0] = x_pred[c.i0] + (x0 - x[c.i0])
        x_pred[c.i1] = x_pred[c.i1] + (x1 - x[c.i1])
        x_pred[c.i2] = x_pred[c.i2] + (x2 - x[c.i2])
        x_pred[c.i3] = x_pred[c.i3] + (x3 - x[c.i3])
        x_pred[c.i4] = x_pred[c.i4] + (x4 - x[c.i4])
        x[c.i0] = x0
        x[c.i1] = x1
        x[c.i2] = x2
        x[c.i3] = x3
        x[c.i4] = x4


for _width in WIDTHS:
    declare(find_crossings, _width, boxes="vectors", x="vectors", marked="scalars", total="scalars")
    declare(count_searches, _width, marked="scalars", tangled="scalars")
    declare(draw_apart, _width, released="scalars", parameters="scalars", x="vectors", x_pred="vectors")
