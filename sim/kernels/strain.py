"""Edge strains of every lane at the end of a frame: the longest, and a histogram for percentiles over a whole clip."""

from __future__ import annotations

from typing import Any

import warp as wp

from sim.kernels.lanes import LANE_OPTIONS, WIDTHS, declare

wp.set_module_options(LANE_OPTIONS)

EDGES_A_THREAD = 64
BINS = 4096
BIN_WIDTH = 2.5e-4
"""Width of a bin of the histogram of |strain|, 1; the last bin takes everything beyond."""

_EDGES = wp.constant(EDGES_A_THREAD)
_BINS = wp.constant(BINS)
_OVER_BIN = wp.constant(1.0 / BIN_WIDTH)
# Stands for infinity and for what is no number.
_ABSURD = wp.constant(1.0e18)


@wp.kernel
def measure_strain(
    edges: wp.array(dtype=wp.vec2i),
    over_length: wp.array(dtype=float),
    counting: int,
    x: wp.array(dtype=Any),
    worst: wp.array(dtype=Any),
    histogram: wp.array(dtype=int),
):
    """Largest length over rest length of 64 edges a thread; where ``counting``, their |strain| in the histogram."""
    thread = wp.tid()
    longest = worst[thread]
    ratios = worst[thread]
    lanes = len(longest)
    for k in range(lanes):
        longest[k] = 0.0
    for e in range(thread * _EDGES, wp.min((thread + 1) * _EDGES, edges.shape[0])):
        a = x[edges[e][0]]
        b = x[edges[e][1]]
        over = over_length[e]
        for k in range(lanes):
            dx = b[k] - a[k]
            dy = b[lanes + k] - a[lanes + k]
            dz = b[2 * lanes + k] - a[2 * lanes + k]
            ratio = wp.sqrt(dx * dx + dy * dy + dz * dz) * over
            ratio = wp.where(ratio < _ABSURD, ratio, _ABSURD)
            ratios[k] = ratio
            longest[k] = wp.max(longest[k], ratio)
        if counting == 1:
            for k in range(lanes):
                bin = int(wp.min(wp.abs(ratios[k] - 1.0) * _OVER_BIN, float(_BINS - 1)))
                wp.atomic_add(histogram, k * _BINS + bin, 1)
    worst[thread] = longest


for _width in WIDTHS:
    declare(measure_strain, _width, x="vectors", worst="scalars")
