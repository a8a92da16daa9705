"""The constraints of a rest state on the device: triangles and hinges, sorted by colour, one a thread or in packs."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import warp as wp

from sim.colouring import Colouring, colour_constraints
from sim.kernels import bending, membrane, packed_bending, packed_membrane
from sim.kernels.packs import PACK, packed_float
from sim.rest_state import RestState


@dataclass(frozen=True)
class Coloured:
    """Constraints, or packs of them, on the device and the ``(first, count)`` of each colour among them."""

    ranges: tuple[tuple[int, int], ...]
    items: wp.array


def device_triangles(rest: RestState, device: str) -> Coloured:
    """Triangles, one a thread."""
    colouring = colour_constraints(rest.topology.faces, len(rest.vertices))
    return Coloured(
        colouring.ranges, wp.array(_triangles(rest)[colouring.order], dtype=membrane.Triangle, device=device)
    )


def triangle_packs(rest: RestState, device: str) -> Coloured:
    """Triangles in packs of one colour."""
    ranges, members = _packs(colour_constraints(rest.topology.faces, len(rest.vertices)))
    triangles = _triangles(rest)[members]
    packed = np.zeros(len(members), dtype=packed_membrane.Pack.numpy_dtype())
    for name in triangles.dtype.names:
        packed[name] = triangles[name]
    for corner in range(3):
        packed[f"m{corner}"] = rest.inverse_mass[triangles[f"i{corner}"]]
    return Coloured(ranges, wp.array(packed, dtype=packed_membrane.Pack, device=device))


def device_hinges(rest: RestState, device: str) -> Coloured:
    """Hinges, one a thread."""
    colouring = colour_constraints(rest.hinges, len(rest.vertices))
    packed = np.zeros(len(rest.hinges), dtype=bending.Hinge.numpy_dtype())
    packed["i0"], packed["i1"], packed["i2"], packed["i3"] = rest.hinges.T
    packed["weight"] = rest.hinge_weights
    packed["norm"] = (rest.hinge_weights**2 * rest.inverse_mass[rest.hinges]).sum(axis=1)
    packed["over_curvature"] = rest.hinge_curvature
    return Coloured(colouring.ranges, wp.array(packed[colouring.order], dtype=bending.Hinge, device=device))


def hinge_packs(rest: RestState, device: str) -> tuple[Coloured, wp.array]:
    """Hinges in packs of one colour, and ``over_curvature`` of each [m], see ``bending.Hinge``."""
    ranges, members = _packs(colour_constraints(rest.hinges, len(rest.vertices)))
    vertices, weights = rest.hinges[members], rest.hinge_weights[members]
    packed = np.zeros(len(members), dtype=packed_bending.HingePack.numpy_dtype())
    for corner in range(4):
        packed[f"i{corner}"] = vertices[..., corner]
        packed[f"m{corner}"] = weights[..., corner] * rest.inverse_mass[vertices[..., corner]]
        if corner:
            packed[f"w{corner}"] = weights[..., corner]
    over_curvature = wp.array(rest.hinge_curvature[members].astype(np.float32), dtype=packed_float, device=device)
    return Coloured(ranges, wp.array(packed, dtype=packed_bending.HingePack, device=device)), over_curvature


def _packs(colouring: Colouring) -> tuple[tuple[tuple[int, int], ...], np.ndarray]:
    """Ranges of packs by colour and the members of each, [P, 16]; a pack that is not full repeats the last one."""
    ranges, members = [], [np.zeros((0, PACK), dtype=np.int64)]
    for start, count in colouring.ranges:
        packs = -(-count // PACK)
        ranges.append((sum(map(len, members)), packs))
        places = start + np.minimum(np.arange(packs * PACK), count - 1)
        members.append(colouring.order[places].reshape(packs, PACK))
    return tuple(ranges), np.concatenate(members)


def _triangles(rest: RestState) -> np.ndarray:
    packed = np.zeros(len(rest.area), dtype=membrane.Triangle.numpy_dtype())
    packed["i0"], packed["i1"], packed["i2"] = rest.topology.faces.T
    packed["du1"], packed["dv1"] = rest.inverse[:, 0, 0], rest.inverse[:, 0, 1]
    packed["du2"], packed["dv2"] = rest.inverse[:, 1, 0], rest.inverse[:, 1, 1]
    packed["root_area"] = np.sqrt(rest.area)
    return packed
