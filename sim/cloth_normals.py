"""Normals of the cloth in every lane, triangle by triangle and colour by colour."""

from __future__ import annotations

import warp as wp

from sim.constraints import Coloured
from sim.kernels import normals as kernels
from sim.kernels.lanes import launch


def find_normals(
    triangles: Coloured, parameters: wp.array, x: wp.array, normals: wp.array, width: int, device: str
) -> None:
    """Area-weighted unit normals of the vertices, shape [V], of positions ``x`` [m], shape [V], in W lanes."""
    launch(kernels.clear_normals, width, len(x), [x], [normals], device)
    for first, count in triangles.ranges:
        launch(kernels.add_normals, width, count, [first, triangles.items, parameters, x], [normals], device)
    launch(kernels.scale_normals, width, len(x), [parameters], [normals], device)
