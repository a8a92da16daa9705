"""Per-substep constants of a parameter set, read from device memory so that a captured graph serves every set."""

from __future__ import annotations

import warp as wp


@wp.struct
class SubstepParameters:
    """Intrinsic parameters in the form that the kernels use; density is folded into the stiffnesses."""

    dt: float  # substep [s]
    velocity_decay: float  # factor on the velocity from air drag, 1
    gravity_step: float  # g dt [m/s]
    stretch_root: float  # sqrt(k_stretch dt^2 / density) [m]
    shear_root: float  # sqrt(k_shear dt^2 / density) [m]
    compression_root: float  # sqrt(compression), 1
    stretch_damping: float  # tau / dt, 1
    bend: float  # k_bend dt^2 / density [m^4]
    bend_damping: float  # tau / dt, 1
    friction: float  # 1
    thickness: float  # [m]
    max_speed: float  # [m/s]
