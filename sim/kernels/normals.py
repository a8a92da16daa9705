"""Area-weighted unit normals of the garment's vertices, from its triangles colour by colour.

Two vectors are read and written a triangle and corner; to go round each vertex instead reads four times as many.
"""

from __future__ import annotations

from typing import Any

import warp as wp

from sim.kernels.lanes import LANE_OPTIONS, WIDTHS, declare
from sim.kernels.membrane import Triangle

wp.set_module_options(LANE_OPTIONS)


@wp.kernel
def clear_normals(x: wp.array(dtype=Any), normals: wp.array(dtype=Any)):
    """Zero, to begin with."""
    i = wp.tid()
    normals[i] = x[i] - x[i]


@wp.kernel
def add_normals(
    first: int,
    triangles: wp.array(dtype=Triangle),
    parameters: wp.array(dtype=Any),
    x: wp.array(dtype=Any),
    normals: wp.array(dtype=Any),
):
    """Add twice the area vector of each triangle of a colour to its vertices [m^2].

    ``parameters`` tell how many lanes there are: ``len(x0) // 3`` is no constant to the compiler.
    """
    t = triangles[first + wp.tid()]
    x0 = x[t.i0]
    x1 = x[t.i1]
    x2 = x[t.i2]
    n0 = normals[t.i0]
    n1 = normals[t.i1]
    n2 = normals[t.i2]
    lanes = len(parameters[0])
    for k in range(lanes):
        y = lanes + k
        z = 2 * lanes + k
        ax = x1[k] - x0[k]
        ay = x1[y] - x0[y]
        az = x1[z] - x0[z]
        bx = x2[k] - x0[k]
        by = x2[y] - x0[y]
        bz = x2[z] - x0[z]
        cx = ay * bz - az * by
        cy = az * bx - ax * bz
        cz = ax * by - ay * bx
        n0[k] = n0[k] + cx
        n0[y] = n0[y] + cy
        n0[z] = n0[z] + cz
        n1[k] = n1[k] + cx
        n1[y] = n1[y] + cy
        n1[z] = n1[z] + cz
        n2[k] = n2[k] + cx
        n2[y] = n2[y] + cy
        n2[z] = n2[z] + cz
    normals[t.i0] = n0
    normals[t.i1] = n1
    normals[t.i2] = n2


@wp.kernel
def scale_normals(parameters: wp.array(dtype=Any), normals: wp.array(dtype=Any)):
    """Make them unit vectors."""
    i = wp.tid()
    n = normals[i]
    lanes = len(parameters[0])
    for k in range(lanes):
        y = lanes + k
        z = 2 * lanes + k
        over = 1.0 / wp.sqrt(n[k] * n[k] + n[y] * n[y] + n[z] * n[z] + 1.0e-20)
        n[k] = n[k] * over
        n[y] = n[y] * over
        n[z] = n[z] * over
    normals[i] = n


for _width in WIDTHS:
    declare(clear_normals, _width, x="vectors", normals="vectors")
    declare(add_normals, _width, parameters="scalars", x="vectors", normals="vectors")
    declare(scale_normals, _width, parameters="scalars", normals="vectors")
