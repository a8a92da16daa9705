"""How the solver's state lies in memory, and how kernels are written so that one text serves one world or sixteen.

A *world* is one simulation of the garment; a solver holds W of them, one a SIMD *lane*. An array of vectors has one
``vector(3 W)`` a vertex: element k is x of lane k, W + k its y, 2 W + k its z; an array of scalars has ``vector(W)``.
With W = 1 this is plain ``vec3`` and ``float``.

Kernels take such arrays as ``Any`` and loop over the lanes. LLVM's loop vectoriser turns the loop into SIMD where

- whole vectors are loaded into locals before the loop and stored after it,
- the loop holds scalars alone: no ``vec3`` (its calling convention is in the way), no branch, no array access.

So measured, a triangle takes 1.7 ns a lane in sixteen lanes and 28 ns in one.
"""

from __future__ import annotations

import warp as wp

WIDTHS = (1, 16)
"""Numbers of lanes that the kernels are compiled for."""

LANE_OPTIONS = {
    "enable_backward": False,
    "max_unroll": 0,  # an unrolled loop is no loop to the vectoriser, and compiles ten times slower
    "cpu_compiler_flags": "-march=native -ffp-contract=fast -vectorize-loops -mprefer-vector-width=512"
    " -mllvm=-inline-threshold=9000",
}


def scalars(width: int) -> type:
    """Type of a scalar in every lane."""
    return wp.types.vector(length=width, dtype=wp.float32)


def vectors(width: int) -> type:
    """Type of a 3-D vector in every lane."""
    return wp.types.vector(length=3 * width, dtype=wp.float32)


def declare(kernel: wp.Kernel, width: int, **generic: str) -> None:
    """Instantiate a kernel; ``generic`` says of each of its ``Any`` arrays whether it holds scalars or vectors."""
    types = {"scalars": scalars(width), "vectors": vectors(width)}
    arrays = {name: wp.array(dtype=types[kind]) for name, kind in generic.items()}
    own = wp.Kernel(kernel.func, kernel.key, lane_module(width))
    _INSTANCES[kernel.key, kernel.module.name, width] = wp.overload(own, arrays)


def lane_module(width: int) -> wp.Module:
    """The module of the kernels for a number of lanes: one each, for a solver needs one, and starts sooner with it."""
    module = wp.get_module(f"sim.kernels.lanes_{width}")
    module.options.update(LANE_OPTIONS)
    return module


def instance(kernel: wp.Kernel, width: int) -> wp.Kernel:
    """The kernel for a number of lanes; a kernel that knows no lanes is its own."""
    return _INSTANCES.get((kernel.key, kernel.module.name, width), kernel)


def launch(kernel: wp.Kernel, width: int, size: int, inputs: list, outputs: list, device: str) -> None:
    """Launch a kernel for a number of lanes."""
    wp.launch(instance(kernel, width), size, inputs, outputs, device=device)


_INSTANCES: dict[tuple[str, str, int], wp.Kernel] = {}
