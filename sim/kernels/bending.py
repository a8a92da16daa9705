"""Bending constraint of one hinge: isometric quadratic energy (Bergou et al. 2006), solved by XPBD.

Energy ``k/2 |C|^2`` with the vector constraint ``C = sum_i weight_i x_i``; its three components have the same gradient,
so that one scalar solve moves the hinge.
"""

from __future__ import annotations

import warp as wp

from sim.kernels.parameters import SubstepParameters

wp.set_module_options({"enable_backward": False})


@wp.struct
class Hinge:
    """Vertices (0, 1 on the edge, 2, 3 opposite), weights [1/m] and their norm under the inverse masses [1/m^4]."""

    i0: int
    i1: int
    i2: int
    i3: int
    weight: wp.vec4
    norm: float


@wp.func
def combine(h: Hinge, values: wp.array(dtype=wp.vec3)):
    return (
        values[h.i0] * h.weight[0]
        + values[h.i1] * h.weight[1]
        + values[h.i2] * h.weight[2]
        + values[h.i3] * h.weight[3]
    )


@wp.func
def spread(h: Hinge, push: wp.vec3, inverse_mass: wp.array(dtype=float), values: wp.array(dtype=wp.vec3)):
    values[h.i0] = values[h.i0] + push * (h.weight[0] * inverse_mass[h.i0])
    values[h.i1] = values[h.i1] + push * (h.weight[1] * inverse_mass[h.i1])
    values[h.i2] = values[h.i2] + push * (h.weight[2] * inverse_mass[h.i2])
    values[h.i3] = values[h.i3] + push * (h.weight[3] * inverse_mass[h.i3])


@wp.kernel
def solve_bending(
    first: int,
    hinges: wp.array(dtype=Hinge),
    inverse_mass: wp.array(dtype=float),
    parameters: wp.array(dtype=SubstepParameters),
    x: wp.array(dtype=wp.vec3),
):
    """One XPBD step of the hinges of a colour; updates ``x`` [m]."""
    h = hinges[first + wp.tid()]
    stiffness = parameters[0].bend
    spread(h, combine(h, x) * (-stiffness / (1.0 + stiffness * h.norm)), inverse_mass, x)


@wp.kernel
def damp_bending(
    first: int,
    span: float,
    hinges: wp.array(dtype=Hinge),
    inverse_mass: wp.array(dtype=float),
    parameters: wp.array(dtype=SubstepParameters),
    v: wp.array(dtype=wp.vec3),
):
    """Stiffness-proportional damping of a colour over ``span`` substeps, implicit in each hinge; moves ``v`` [m/s]."""
    h = hinges[first + wp.tid()]
    p = parameters[0]
    stiffness = p.bend * p.bend_damping * span
    spread(h, combine(h, v) * (-stiffness / (1.0 + stiffness * h.norm)), inverse_mass, v)
