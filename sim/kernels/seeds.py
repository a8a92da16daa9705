"""Seeds of walks over the body: a coarse grid that knows, in every cell, a face of each region of the body near it.

A walk from face to face finds the closest point only of the limb that it walks on. Another limb that comes near is
noticed by the grid: points spread over the body plant themselves into the cells around them at every query, and a
garment vertex looks into its one cell. Cells repeat in space, further apart than any region of the body is long.

Entries are integers that sort by age, then by distance from the middle of the cell, so that planting is one atomic
minimum in any order and old entries need no clearing.
"""

from __future__ import annotations

import warp as wp

from sim.kernels.contact import blend
from sim.kernels.lanes import LANE_OPTIONS

wp.set_module_options(LANE_OPTIONS)

CELL = 0.05
"""Width of a cell [m]: whatever is within it of the vertex is seen in the cell of the vertex."""
SEED_BITS = 11
DISTANCE_BITS = 7
STAMPS = 2 ** (31 - SEED_BITS - DISTANCE_BITS) - 1
"""Queries until the grid has to be cleared: stamps count down from here to 1."""

_CELL = wp.constant(CELL)
_SEEDS = wp.constant(2**SEED_BITS)
_STAMP_SHIFT = wp.constant(SEED_BITS + DISTANCE_BITS)
_DISTANCES = wp.constant(2**DISTANCE_BITS)
_FINENESS = wp.constant(2**DISTANCE_BITS / (4.0 * CELL))


@wp.struct
class Seeds:
    """Points spread over the body, and the grid of cells they are planted in."""

    face: wp.array(dtype=int)  # that each seed lies on
    region: wp.array(dtype=int)  # of the body, that each seed lies in
    weight: wp.array(dtype=wp.vec3)  # where on the face
    point: wp.array(dtype=wp.vec3)  # where now, motion after motion
    normal: wp.array(dtype=wp.vec3)  # smooth, there
    grid: wp.array(dtype=int)  # entries, region within cell within motion
    count: int  # seeds of one motion
    regions: int
    cells: int  # along each axis, a power of two
    stamp: int  # of the entries that hold now


@wp.func
def cell_of(cells: int, motion: int, x: int, y: int, z: int):
    """Number of a cell, by its place in units of its width; places repeat."""
    last = cells - 1
    return ((motion * cells + (x & last)) * cells + (y & last)) * cells + (z & last)


@wp.func
def cell_at(cells: int, motion: int, p: wp.vec3):
    """Number of the cell that a point lies in."""
    return cell_of(cells, motion, int(wp.floor(p[0] / _CELL)), int(wp.floor(p[1] / _CELL)), int(wp.floor(p[2] / _CELL)))


@wp.func
def holds_now(seeds: Seeds, entry: int):
    """1 for an entry of the last planting, 0 for an older one."""
    return wp.where((entry >> _STAMP_SHIFT) == seeds.stamp, 1, 0)


@wp.func
def seed_of(entry: int):
    """The seed of an entry."""
    return entry & (_SEEDS - 1)


@wp.kernel
def plant_seeds(
    faces: wp.array(dtype=wp.vec4i),
    body_count: int,
    points: wp.array(dtype=wp.vec3),
    normals: wp.array(dtype=wp.vec3),
    seeds: Seeds,
):
    """Put every seed into its cell and the 26 around it, where none of its region is nearer to the middle."""
    i = wp.tid()
    motion = i // seeds.count
    seed = i - motion * seeds.count
    corner = faces[seeds.face[seed]]
    p = blend(points, motion * body_count, corner, seeds.weight[seed])
    seeds.point[i] = p
    seeds.normal[i] = wp.normalize(blend(normals, motion * body_count, corner, seeds.weight[seed]))
    region = seeds.region[seed]
    x = int(wp.floor(p[0] / _CELL))
    y = int(wp.floor(p[1] / _CELL))
    z = int(wp.floor(p[2] / _CELL))
    for dx in range(-1, 2):
        for dy in range(-1, 2):
            for dz in range(-1, 2):
                middle = wp.vec3(float(x + dx) + 0.5, float(y + dy) + 0.5, float(z + dz) + 0.5) * _CELL
                distance = wp.min(int(wp.length(p - middle) * _FINENESS), _DISTANCES - 1)
                cell = cell_of(seeds.cells, motion, x + dx, y + dy, z + dz)
                entry = (seeds.stamp * _DISTANCES + distance) * _SEEDS + seed
                wp.atomic_min(seeds.grid, cell * seeds.regions + region, entry)
