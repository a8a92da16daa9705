"""Which triangles of a garment come near each other: boxes over a fixed tree, walked once for all worlds.

A node of the tree is entered, and a pair of triangles is kept, where that is due in any lane. Motion until the next
search is taken as linear: a box is kept for now and for the end of that time, and two boxes are apart where one axis
parts them at both times; so cloth that moves along together is not swept against itself.

A box is six vectors: low corner and negated high corner now, the same soon, and low and negated high corner of the box
of the unit normals. All of a parent's numbers are the least of its children's.
"""

from __future__ import annotations

from typing import Any

import warp as wp

from sim.kernels.lanes import LANE_OPTIONS, WIDTHS, declare
from sim.kernels.parameters import DT, THICKNESS

wp.set_module_options(LANE_OPTIONS)

SLACK = wp.constant(0.003)
"""Distance beyond the thickness within which features are followed [m]: what their motion may differ from a line."""

TRIANGLE_PAIRS = wp.constant(0)
"""Place of the number of triangle pairs among the counters; the other lists' numbers follow."""

_FAR = wp.constant(1.0e6)
_TINY = wp.constant(1.0e-20)


@wp.struct
class Patch:
    """A triangle of the garment, in the order of the tree."""

    corner: wp.vec3i
    opposite: wp.vec3i  # corner c: the far vertex of the neighbour at the edge from c to c + 1, -1 at a rim
    owned: int  # bit c: vertex c is this triangle's to test; bit 3 + c: so is the edge from c to c + 1
    piece: int  # connected piece of the garment
    layer: int  # 0 next to the body
    centre: wp.vec3  # at rest [m]
    radius: float  # of the circle around the centre through the farthest corner [m]


@wp.struct
class Node:
    """A node of the tree over the patches, in preorder."""

    first: int  # first patch of a leaf
    count: int  # number of patches of a leaf, 0 for an inner node
    escape: int  # next node outside of the subtree
    right: int  # second child; the first one is the next node
    piece: int  # connected piece, -1 for several
    centre: wp.vec3  # of its patches at rest [m]
    radius: float  # [m]


@wp.kernel
def box_triangles(
    interval: float,
    largest: float,
    patches: wp.array(dtype=Patch),
    parameters: wp.array(dtype=Any),
    x: wp.array(dtype=Any),
    v: wp.array(dtype=Any),
    boxes: wp.array(dtype=Any),
):
    """Boxes of the triangles now and after ``interval`` substeps at their velocities, six vectors a triangle.

    A triangle that is wider than ``largest`` [m], or not finite, belongs to a world that has diverged: its box is put
    far away, or it would be paired with everything in every world.
    """
    i = wp.tid()
    corner = patches[i].corner
    dt = parameters[DT]
    x0 = x[corner[0]]
    x1 = x[corner[1]]
    x2 = x[corner[2]]
    v0 = v[corner[0]]
    v1 = v[corner[1]]
    v2 = v[corner[2]]
    low = x0
    high = x0
    low_soon = x0
    high_soon = x0
    normal = x0
    lanes = len(dt)
    for axis in range(3):
        for k in range(lanes):
            j = axis * lanes + k
            time = dt[k] * interval
            least = wp.min(wp.min(x0[j], x1[j]), x2[j])
            most = wp.max(wp.max(x0[j], x1[j]), x2[j])
            y0 = x0[j] + v0[j] * time
            y1 = x1[j] + v1[j] * time
            y2 = x2[j] + v2[j] * time
            least_soon = wp.min(wp.min(y0, y1), y2)
            most_soon = wp.max(wp.max(y0, y1), y2)
            sane = most - least < largest
            calm = most_soon - least_soon < largest
            low[j] = wp.where(sane, least, _FAR)
            high[j] = wp.where(sane, -most, _FAR)
            low_soon[j] = wp.where(calm, least_soon, low[j])
            high_soon[j] = wp.where(calm, -most_soon, high[j])
    for k in range(lanes):
        y = lanes + k
        z = 2 * lanes + k
        ux = x1[k] - x0[k]
        uy = x1[y] - x0[y]
        uz = x1[z] - x0[z]
        wx = x2[k] - x0[k]
        wy = x2[y] - x0[y]
        wz = x2[z] - x0[z]
        nx = uy * wz - uz * wy
        ny = uz * wx - ux * wz
        nz = ux * wy - uy * wx
        over = 1.0 / wp.sqrt(nx * nx + ny * ny + nz * nz + _TINY)
        normal[k] = nx * over
        normal[y] = ny * over
        normal[z] = nz * over
    boxes[6 * i] = low
    boxes[6 * i + 1] = high
    boxes[6 * i + 2] = low_soon
    boxes[6 * i + 3] = high_soon
    boxes[6 * i + 4] = normal
    boxes[6 * i + 5] = -normal


@wp.kernel
def box_leaves(
    leaves: wp.array(dtype=int), tree: wp.array(dtype=Node), boxes: wp.array(dtype=Any), nodes: wp.array(dtype=Any)
):
    """Merge the boxes of the triangles of each leaf."""
    node = leaves[wp.tid()]
    start = tree[node].first
    for part in range(6):
        least = boxes[6 * start + part]
        for t in range(start + 1, start + tree[node].count):
            other = boxes[6 * t + part]
            for j in range(len(least)):
                least[j] = wp.min(least[j], other[j])
        nodes[6 * node + part] = least


@wp.kernel
def box_parents(first: int, inner: wp.array(dtype=int), tree: wp.array(dtype=Node), nodes: wp.array(dtype=Any)):
    """Merge the children of inner nodes whose children are done."""
    node = inner[first + wp.tid()]
    for part in range(6):
        least = nodes[6 * (node + 1) + part]
        other = nodes[6 * tree[node].right + part]
        for j in range(len(least)):
            least[j] = wp.min(least[j], other[j])
        nodes[6 * node + part] = least


@wp.func
def gap(low: float, high: float, low_soon: float, high_soon: float):
    """Gap between the low side of one box and the (negated) high side of another, now or soon."""
    return wp.min(low + high, low_soon + high_soon)


@wp.func
def least_product(a: float, a_high: float, b: float, b_high: float):
    """Least product of two intervals; the upper ends come negated."""
    return wp.min(wp.min(a * b, -a * b_high), wp.min(-a_high * b, a_high * b_high))


@wp.kernel
def find_triangle_pairs(
    rest_distance: float,
    flat_distance: float,
    leaves: wp.array(dtype=int),
    tree: wp.array(dtype=Node),
    patches: wp.array(dtype=Patch),
    parameters: wp.array(dtype=Any),
    nodes: wp.array(dtype=Any),
    boxes: wp.array(dtype=Any),
    found: wp.array(dtype=int),
    pairs: wp.array(dtype=wp.vec2i),
):
    """Pairs of triangles whose boxes come within the thickness and slack in any lane; ``found`` counts them.

    A leaf meets itself and the leaves after it. Left out are triangles of one piece that are nearer than about
    ``rest_distance`` [m] at rest, and whole nodes nearer than ``flat_distance`` whose normals all lie within a right
    angle of each other: cloth that close cannot have turned back on itself (Volino & Magnenat-Thalmann 1994). More
    pairs than fit are counted and not stored.
    """
    own = leaves[wp.tid()]
    thickness = parameters[THICKNESS]
    lanes = len(thickness)
    a0 = nodes[6 * own]
    a1 = nodes[6 * own + 1]
    a2 = nodes[6 * own + 2]
    a3 = nodes[6 * own + 3]
    a4 = nodes[6 * own + 4]
    a5 = nodes[6 * own + 5]
    mine = tree[own]
    node = own
    while node < tree.shape[0]:
        b0 = nodes[6 * node]
        b1 = nodes[6 * node + 1]
        b2 = nodes[6 * node + 2]
        b3 = nodes[6 * node + 3]
        meets = thickness
        hits = int(0)
        for k in range(lanes):
            y = lanes + k
            z = 2 * lanes + k
            gap_x = wp.max(gap(a0[k], b1[k], a2[k], b3[k]), gap(b0[k], a1[k], b2[k], a3[k]))
            gap_y = wp.max(gap(a0[y], b1[y], a2[y], b3[y]), gap(b0[y], a1[y], b2[y], a3[y]))
            gap_z = wp.max(gap(a0[z], b1[z], a2[z], b3[z]), gap(b0[z], a1[z], b2[z], a3[z]))
            near = wp.where(wp.max(wp.max(gap_x, gap_y), gap_z) < thickness[k] + SLACK, 1.0, 0.0)
            meets[k] = near
            hits += int(near)
        other = tree[node]
        if hits > 0 and other.piece == mine.piece and other.piece >= 0:
            if wp.length(other.centre - mine.centre) + wp.where(other.count > 0, 0.0, other.radius) < flat_distance:
                b4 = nodes[6 * node + 4]
                b5 = nodes[6 * node + 5]
                bent = int(0)
                for k in range(lanes):
                    y = lanes + k
                    z = 2 * lanes + k
                    cosine = least_product(a4[k], a5[k], b4[k], b5[k])
                    cosine += least_product(a4[y], a5[y], b4[y], b5[y])
                    cosine += least_product(a4[z], a5[z], b4[z], b5[z])
                    near = wp.where(cosine < 0.0, meets[k], 0.0)
                    meets[k] = near
                    bent += int(near)
                hits = bent
        if hits == 0:
            node = other.escape
        else:
            for i in range(mine.first, wp.where(other.count > 0, mine.first + mine.count, 0)):
                p = patches[i]
                c0 = boxes[6 * i]
                c1 = boxes[6 * i + 1]
                c2 = boxes[6 * i + 2]
                c3 = boxes[6 * i + 3]
                for t in range(wp.max(other.first, i + 1), other.first + other.count):
                    q = patches[t]
                    joined = wp.length(p.centre - q.centre) + wp.max(p.radius, q.radius) < rest_distance
                    if p.piece != q.piece or not joined:
                        d0 = boxes[6 * t]
                        d1 = boxes[6 * t + 1]
                        d2 = boxes[6 * t + 2]
                        d3 = boxes[6 * t + 3]
                        touches = int(0)
                        for k in range(lanes):
                            y = lanes + k
                            z = 2 * lanes + k
                            gap_x = wp.max(gap(c0[k], d1[k], c2[k], d3[k]), gap(d0[k], c1[k], d2[k], c3[k]))
                            gap_y = wp.max(gap(c0[y], d1[y], c2[y], d3[y]), gap(d0[y], c1[y], d2[y], c3[y]))
                            gap_z = wp.max(gap(c0[z], d1[z], c2[z], d3[z]), gap(d0[z], c1[z], d2[z], c3[z]))
                            near = wp.where(wp.max(wp.max(gap_x, gap_y), gap_z) < thickness[k] + SLACK, meets[k], 0.0)
                            touches += int(near)
                        if touches > 0:
                            slot = wp.atomic_add(found, TRIANGLE_PAIRS, 1)
                            if slot < pairs.shape[0]:
                                pairs[slot] = wp.vec2i(i, t)
            node = node + 1


for _width in WIDTHS:
    declare(box_triangles, _width, parameters="scalars", x="vectors", v="vectors", boxes="vectors")
    declare(box_leaves, _width, boxes="vectors", nodes="vectors")
    declare(box_parents, _width, nodes="vectors")
    declare(find_triangle_pairs, _width, parameters="scalars", nodes="vectors", boxes="vectors")
