"""Time integration of a substep: prediction, pins, velocities, and the change of the floating origin."""

from __future__ import annotations

import warp as wp

from sim.kernels.parameters import SubstepParameters

wp.set_module_options({"enable_backward": False})


@wp.kernel
def predict(
    inverse_mass: wp.array(dtype=float),
    parameters: wp.array(dtype=SubstepParameters),
    v: wp.array(dtype=wp.vec3),
    x: wp.array(dtype=wp.vec3),
    x_prev: wp.array(dtype=wp.vec3),
    x_pred: wp.array(dtype=wp.vec3),
):
    """Semi-implicit Euler; drag comes before gravity, or it would take away from the weight of cloth at rest."""
    i = wp.tid()
    p = parameters[0]
    start = x[i]
    x_prev[i] = start
    if inverse_mass[i] > 0.0:
        velocity = v[i] * p.velocity_decay
        velocity = velocity - wp.vec3(0.0, p.gravity_step, 0.0)
        v[i] = velocity
        end = start + velocity * p.dt
        x[i] = end
        x_pred[i] = end


@wp.kernel
def move_pins(
    fraction: float,
    pinned: wp.array(dtype=int),
    pin_from: wp.array(dtype=wp.vec3),
    pin_to: wp.array(dtype=wp.vec3),
    x: wp.array(dtype=wp.vec3),
):
    """Kinematic vertices on their way through the interval."""
    k = wp.tid()
    x[pinned[k]] = pin_from[k] * (1.0 - fraction) + pin_to[k] * fraction


@wp.kernel
def update_velocity(
    inverse_mass: wp.array(dtype=float),
    parameters: wp.array(dtype=SubstepParameters),
    x: wp.array(dtype=wp.vec3),
    x_prev: wp.array(dtype=wp.vec3),
    x_pred: wp.array(dtype=wp.vec3),
    v: wp.array(dtype=wp.vec3),
):
    """``v += (x - x_pred) / dt``: the difference of positions alone would lose the velocity in float32 rounding."""
    i = wp.tid()
    p = parameters[0]
    if inverse_mass[i] > 0.0:
        velocity = v[i] + (x[i] - x_pred[i]) / p.dt
        speed = wp.length(velocity)
        if speed > p.max_speed:
            velocity = velocity * (p.max_speed / speed)
        v[i] = velocity
    else:
        v[i] = (x[i] - x_prev[i]) / p.dt


@wp.kernel
def shift_origin(shift: wp.array(dtype=wp.vec3), x: wp.array(dtype=wp.vec3)):
    """Positions in the coordinates of a new origin; velocities are those of the world and stay."""
    i = wp.tid()
    x[i] = x[i] + shift[0]
