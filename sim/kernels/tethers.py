"""Long-range attachments (Kim, Chentanez & Mueller 2012): no vertex gets farther from its pin than the cloth is long.

A substep of Gauss-Seidel carries a load one row of triangles further, so that many rows hang lower than their material
lets them. A tether carries it at once. It is one-sided: it does nothing to cloth that is slack or bent.
"""

from __future__ import annotations

from typing import Any

import warp as wp

from sim.kernels.lanes import LANE_OPTIONS, WIDTHS, declare
from sim.kernels.parameters import TETHER_SLACK

wp.set_module_options(LANE_OPTIONS)


@wp.kernel
def solve_tethers(
    vertex: wp.array(dtype=int),
    anchor: wp.array(dtype=int),
    length: wp.array(dtype=float),
    parameters: wp.array(dtype=Any),
    x: wp.array(dtype=Any),
):
    """Pull each vertex back to within its tether's length [m], stretched as far as the material would be."""
    i = wp.tid()
    slack = parameters[TETHER_SLACK]
    position = x[vertex[i]]
    pin = x[anchor[i]]
    longest = length[i]
    lanes = len(slack)
    for k in range(lanes):
        y = lanes + k
        z = 2 * lanes + k
        dx = position[k] - pin[k]
        dy = position[y] - pin[y]
        dz = position[z] - pin[z]
        allowed = longest * slack[k]
        scale = wp.min(allowed / wp.sqrt(dx * dx + dy * dy + dz * dz + 1.0e-20), 1.0)
        position[k] = pin[k] + dx * scale
        position[y] = pin[y] + dy * scale
        position[z] = pin[z] + dz * scale
    x[vertex[i]] = position


for _width in WIDTHS:
    declare(solve_tethers, _width, parameters="scalars", x="vectors")
