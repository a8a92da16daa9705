"""Vertex-triangle and edge-edge pairs of a garment: their geometry, and which of them are followed.

Both kinds read alike: four vertices with weights that add up to zero, so that ``sum w_i x_i = distance * normal``; a
vertex has weight 1 and its triangle minus the barycentric coordinates, one edge ``1 - s, s`` and the other
``t - 1, -t``.
"""

from __future__ import annotations

from typing import Any

import warp as wp

from sim.kernels.lanes import LANE_OPTIONS, WIDTHS, declare
from sim.kernels.parameters import DT, THICKNESS
from sim.kernels.self_detection import SLACK, TRIANGLE_PAIRS, Patch

wp.set_module_options(LANE_OPTIONS)

FEATURE_PAIRS = wp.constant(1)
"""Place of the number of feature pairs among the counters."""
OFF = wp.constant(-1.0)
"""Gap of a pair that is switched off in a lane [m]."""

PATIENCE = wp.constant(12.0)
"""Searches in a row that find features at a crossing before their contact is let go, so that they can slide free."""

# How far beyond the rim of a triangle or the end of an edge a feature is followed already [m].
_RIM = wp.constant(0.002)
# Longest way that is foreseen [m], so that cloth that flies apart is not paired with everything.
_FARTHEST = wp.constant(0.03)
# Edges whose squared sine is below this are parallel: their crossing point is anywhere.
_PARALLEL = wp.constant(0.01)
# Layers whose normals differ by more (cosine) do not lie on each other: which is outside says nothing about the side.
_ALIKE = wp.constant(0.3)
# Nor does it where the outer layer is under the inner one by more than this, in thicknesses: that is another fold.
_UNDER = wp.constant(2.0)
_TINY = wp.constant(1.0e-20)


@wp.struct
class Pair:
    """A vertex and a triangle, or two edges."""

    i0: int
    i1: int
    i2: int
    i3: int
    edges: int  # 0: vertex i0, triangle i1 i2 i3; 1: edges i0 i1 and i2 i3


@wp.struct
class Frame:
    """How a pair lies: unit normal of the triangle, or across both edges, and the point where the two are nearest."""

    nx: float
    ny: float
    nz: float
    distance: float  # along the normal [m]
    first: float  # barycentric coordinate of the second corner; place along the first edge
    second: float  # barycentric coordinate of the third corner; place along the second edge
    inner: float  # least barycentric coordinate; least share of an edge up to the crossing; negative outside


@wp.func
def triangle_frame(ux: float, uy: float, uz: float, wx: float, wy: float, wz: float, dx: float, dy: float, dz: float):
    """Point d against the triangle 0, u, w."""
    nx = uy * wz - uz * wy
    ny = uz * wx - ux * wz
    nz = ux * wy - uy * wx
    over = 1.0 / wp.sqrt(nx * nx + ny * ny + nz * nz + _TINY)
    f = Frame()
    f.nx = nx * over
    f.ny = ny * over
    f.nz = nz * over
    f.distance = f.nx * dx + f.ny * dy + f.nz * dz
    f.first = (f.nx * (dy * wz - dz * wy) + f.ny * (dz * wx - dx * wz) + f.nz * (dx * wy - dy * wx)) * over
    f.second = (f.nx * (uy * dz - uz * dy) + f.ny * (uz * dx - ux * dz) + f.nz * (ux * dy - uy * dx)) * over
    f.inner = wp.min(wp.min(f.first, f.second), 1.0 - f.first - f.second)
    return f


@wp.func
def edge_frame(ux: float, uy: float, uz: float, wx: float, wy: float, wz: float, dx: float, dy: float, dz: float):
    """Edge d + s u against the edge t w."""
    nx = uy * wz - uz * wy
    ny = uz * wx - ux * wz
    nz = ux * wy - uy * wx
    area = nx * nx + ny * ny + nz * nz + _TINY
    over = 1.0 / wp.sqrt(area)
    uu = ux * ux + uy * uy + uz * uz
    ww = wx * wx + wy * wy + wz * wz
    uw = ux * wx + uy * wy + uz * wz
    ud = ux * dx + uy * dy + uz * dz
    wd = wx * dx + wy * dy + wz * dz
    f = Frame()
    f.nx = nx * over
    f.ny = ny * over
    f.nz = nz * over
    f.distance = f.nx * dx + f.ny * dy + f.nz * dz
    f.first = (uw * wd - ww * ud) / area
    f.second = (uu * wd - uw * ud) / area
    inner = wp.min(wp.min(f.first, 1.0 - f.first), wp.min(f.second, 1.0 - f.second))
    f.inner = wp.where(area > _PARALLEL * uu * ww, inner, -1.0e6)
    return f


@wp.func
def comes_near(f: Frame, sign: float, size: float, sx: float, sy: float, sz: float, thickness: float):
    """1 if a pair of ``size`` [m] that moves by s [m] within the interval may come to touch, else 0."""
    rise = f.nx * sx + f.ny * sy + f.nz * sz
    closing = wp.min(wp.max(-sign * rise, 0.0), _FARTHEST)
    sliding = wp.sqrt(wp.max(sx * sx + sy * sy + sz * sz - rise * rise, 0.0))
    beside = f.inner * size + _RIM + wp.min(sliding, _FARTHEST)
    return wp.where(sign * f.distance - closing < thickness + SLACK and beside > 0.0, 1, 0)


@wp.func
def apart_at_rest(rest: wp.array(dtype=wp.vec3), i: int, j: int, least: float):
    return wp.length_sq(rest[i] - rest[j]) > least * least


@wp.kernel
def find_vertex_triangles(
    threads: int,
    interval: float,
    rest_distance: float,
    patches: wp.array(dtype=Patch),
    rest: wp.array(dtype=wp.vec3),
    triangle_pairs: wp.array(dtype=wp.vec2i),
    released: wp.array(dtype=Any),
    tangled: wp.array(dtype=Any),
    parameters: wp.array(dtype=Any),
    normals: wp.array(dtype=Any),
    x: wp.array(dtype=Any),
    v: wp.array(dtype=Any),
    found: wp.array(dtype=int),
    pairs: wp.array(dtype=Pair),
    side: wp.array(dtype=Any),
    gap: wp.array(dtype=Any),
):
    """Vertices that are over a triangle and near it, or may be within the interval, in any lane.

    ``side`` is 1 or -1 where the vertex is over the triangle, along its normal or against it, and 0 where that is still
    open; 2 or -2 where the order of the layers gives it. ``gap`` is the distance that they have [m], at most the
    thickness; ``OFF`` where the cloth is released, or both features have belonged to crossings
    for ``PATIENCE`` searches and no order of layers says how these resolve.
    """
    dt = parameters[DT]
    thickness = parameters[THICKNESS]
    lanes = len(dt)
    for index in range(wp.tid(), wp.min(found[TRIANGLE_PAIRS], triangle_pairs.shape[0]), threads):
        for turn in range(2):
            a = patches[triangle_pairs[index][turn]]
            b = patches[triangle_pairs[index][1 - turn]]
            order = float(wp.clamp(a.layer - b.layer, -1, 1))
            i1 = b.corner[0]
            i2 = b.corner[1]
            i3 = b.corner[2]
            for c in range(3):
                i0 = a.corner[c]
                due = ((a.owned >> c) & 1) == 1
                if due and a.piece == b.piece:
                    due = (
                        apart_at_rest(rest, i0, i1, rest_distance)
                        and apart_at_rest(rest, i0, i2, rest_distance)
                        and apart_at_rest(rest, i0, i3, rest_distance)
                    )
                if due:
                    p = x[i0]
                    x1 = x[i1]
                    x2 = x[i2]
                    x3 = x[i3]
                    vp = v[i0]
                    v1 = v[i1]
                    v2 = v[i2]
                    v3 = v[i3]
                    m = normals[i0]
                    sides = dt
                    gaps = dt
                    hits = int(0)
                    for k in range(lanes):
                        y = lanes + k
                        z = 2 * lanes + k
                        ux = x2[k] - x1[k]
                        uy = x2[y] - x1[y]
                        uz = x2[z] - x1[z]
                        wx = x3[k] - x1[k]
                        wy = x3[y] - x1[y]
                        wz = x3[z] - x1[z]
                        f = triangle_frame(ux, uy, uz, wx, wy, wz, p[k] - x1[k], p[y] - x1[y], p[z] - x1[z])
                        third = 1.0 / 3.0
                        sx = (vp[k] - (v1[k] + v2[k] + v3[k]) * third) * dt[k] * interval
                        sy = (vp[y] - (v1[y] + v2[y] + v3[y]) * third) * dt[k] * interval
                        sz = (vp[z] - (v1[z] + v2[z] + v3[z]) * third) * dt[k] * interval
                        # Twice the area over the longest of two sides: a height of the triangle.
                        crossed = (uy * wz - uz * wy) * f.nx + (uz * wx - ux * wz) * f.ny + (ux * wy - uy * wx) * f.nz
                        height = crossed / wp.sqrt(wp.max(ux * ux + uy * uy + uz * uz, wx * wx + wy * wy + wz * wz))
                        given = wp.where(f.nx * m[k] + f.ny * m[y] + f.nz * m[z] > _ALIKE, order, 0.0)
                        given = wp.where(given * f.distance > -_UNDER * thickness[k], given, 0.0)
                        sign = wp.where(given != 0.0, given, wp.where(f.distance < 0.0, -1.0, 1.0))
                        hits += comes_near(f, sign, height, sx, sy, sz, thickness[k])
                        sides[k] = wp.where(given != 0.0, 2.0 * given, wp.where(f.inner >= 0.0, sign, 0.0))
                        gaps[k] = wp.min(thickness[k], sign * f.distance)
                    if hits > 0:
                        slot = wp.atomic_add(found, FEATURE_PAIRS, 1)
                        if slot < pairs.shape[0]:
                            r0 = released[i0]
                            r1 = released[i1]
                            r2 = released[i2]
                            r3 = released[i3]
                            t0 = tangled[i0]
                            t1 = tangled[i1]
                            t2 = tangled[i2]
                            t3 = tangled[i3]
                            for k in range(lanes):
                                loose = wp.max(wp.max(r0[k], r1[k]), wp.max(r2[k], r3[k]))
                                age = wp.min(t0[k], wp.max(wp.max(t1[k], t2[k]), t3[k]))
                                loose = wp.max(loose, wp.where(wp.abs(sides[k]) < 1.5 and age > PATIENCE, 1.0, 0.0))
                                gaps[k] = wp.where(loose > 0.0, OFF, gaps[k])
                            pair = Pair()
                            pair.i0 = i0
                            pair.i1 = i1
                            pair.i2 = i2
                            pair.i3 = i3
                            pair.edges = 0
                            pairs[slot] = pair
                            side[slot] = sides
                            gap[slot] = gaps


@wp.kernel
def find_edge_edges(
    threads: int,
    interval: float,
    rest_distance: float,
    patches: wp.array(dtype=Patch),
    rest: wp.array(dtype=wp.vec3),
    triangle_pairs: wp.array(dtype=wp.vec2i),
    released: wp.array(dtype=Any),
    tangled: wp.array(dtype=Any),
    parameters: wp.array(dtype=Any),
    normals: wp.array(dtype=Any),
    x: wp.array(dtype=Any),
    v: wp.array(dtype=Any),
    found: wp.array(dtype=int),
    pairs: wp.array(dtype=Pair),
    side: wp.array(dtype=Any),
    gap: wp.array(dtype=Any),
):
    """Edges that pass over each other nearby, or may within the interval, in any lane; sides and gaps as for vertices.

    The side of two edges is along the product of their directions, or against it.
    """
    dt = parameters[DT]
    thickness = parameters[THICKNESS]
    lanes = len(dt)
    for index in range(wp.tid(), wp.min(found[TRIANGLE_PAIRS], triangle_pairs.shape[0]), threads):
        a = patches[triangle_pairs[index][0]]
        b = patches[triangle_pairs[index][1]]
        order = float(wp.clamp(a.layer - b.layer, -1, 1))
        for ca in range(3):
            if ((a.owned >> (3 + ca)) & 1) == 1:
                i0 = a.corner[ca]
                i1 = a.corner[wp.where(ca == 2, 0, ca + 1)]
                for cb in range(3):
                    i2 = b.corner[cb]
                    i3 = b.corner[wp.where(cb == 2, 0, cb + 1)]
                    due = ((b.owned >> (3 + cb)) & 1) == 1
                    if due and a.piece == b.piece:
                        due = (
                            apart_at_rest(rest, i0, i2, rest_distance)
                            and apart_at_rest(rest, i0, i3, rest_distance)
                            and apart_at_rest(rest, i1, i2, rest_distance)
                            and apart_at_rest(rest, i1, i3, rest_distance)
                        )
                    if due:
                        x0 = x[i0]
                        x1 = x[i1]
                        x2 = x[i2]
                        x3 = x[i3]
                        v0 = v[i0]
                        v1 = v[i1]
                        v2 = v[i2]
                        v3 = v[i3]
                        m = normals[i0]
                        n = normals[i2]
                        sides = dt
                        gaps = dt
                        hits = int(0)
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
                            half = 0.5 * dt[k] * interval
                            sx = (v0[k] + v1[k] - v2[k] - v3[k]) * half
                            sy = (v0[y] + v1[y] - v2[y] - v3[y]) * half
                            sz = (v0[z] + v1[z] - v2[z] - v3[z]) * half
                            size = wp.sqrt(wp.max(ux * ux + uy * uy + uz * uz, wx * wx + wy * wy + wz * wz))
                            along_m = f.nx * m[k] + f.ny * m[y] + f.nz * m[z]
                            along_n = f.nx * n[k] + f.ny * n[y] + f.nz * n[z]
                            alike = wp.min(along_m * along_n, wp.abs(along_m + along_n) - 1.0) > 0.0
                            given = wp.where(alike, order * wp.where(along_m < 0.0, -1.0, 1.0), 0.0)
                            given = wp.where(given * f.distance > -_UNDER * thickness[k], given, 0.0)
                            sign = wp.where(given != 0.0, given, wp.where(f.distance < 0.0, -1.0, 1.0))
                            hits += comes_near(f, sign, size, sx, sy, sz, thickness[k])
                            sides[k] = wp.where(given != 0.0, 2.0 * given, wp.where(f.inner >= 0.0, sign, 0.0))
                            gaps[k] = wp.min(thickness[k], sign * f.distance)
                        if hits > 0:
                            slot = wp.atomic_add(found, FEATURE_PAIRS, 1)
                            if slot < pairs.shape[0]:
                                r0 = released[i0]
                                r1 = released[i1]
                                r2 = released[i2]
                                r3 = released[i3]
                                t0 = tangled[i0]
                                t1 = tangled[i1]
                                t2 = tangled[i2]
                                t3 = tangled[i3]
                                for k in range(lanes):
                                    loose = wp.max(wp.max(r0[k], r1[k]), wp.max(r2[k], r3[k]))
                                    age = wp.min(wp.max(t0[k], t1[k]), wp.max(t2[k], t3[k]))
                                    loose = wp.max(loose, wp.where(wp.abs(sides[k]) < 1.5 and age > PATIENCE, 1.0, 0.0))
                                    gaps[k] = wp.where(loose > 0.0, OFF, gaps[k])
                                pair = Pair()
                                pair.i0 = i0
                                pair.i1 = i1
                                pair.i2 = i2
                                pair.i3 = i3
                                pair.edges = 1
                                pairs[slot] = pair
                                side[slot] = sides
                                gap[slot] = gaps


for _width in WIDTHS:
    for _kernel in (find_vertex_triangles, find_edge_edges):
        _lanes = {"released": "scalars", "tangled": "scalars", "parameters": "scalars", "normals": "vectors"}
        declare(_kernel, _width, x="vectors", v="vectors", side="scalars", gap="scalars", **_lanes)
