"""The constraints of a rest state on the device: triangles and hinges, sorted by colour."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import warp as wp

from sim.colouring import colour_constraints
from sim.kernels import bending, membrane, packed_membrane
from sim.rest_state import RestState


@dataclass(frozen=True)
class Coloured:
    """Constraints on the device and the ``(first, count)`` of each colour among them."""

    ranges: tuple[tuple[int, int], ...]
    items: wp.array


def device_triangles(rest: RestState, device: str) -> Coloured:
    """Triangles, one a thread."""
    colouring = colour_constraints(rest.topology.faces, len(rest.vertices))
    return Coloured(
        colouring.ranges, wp.array(_triangles(rest)[colouring.order], dtype=membrane.Triangle, device=device)
    )


def device_packs(rest: RestState, device: str) -> Coloured:
    """Triangles in packs of one colour; the last pack of a colour is filled up by repeating a triangle."""
    colouring = colour_constraints(rest.topology.faces, len(rest.vertices))
    ranges, members = [], []
    for start, count in colouring.ranges:
        packs = -(-count // packed_membrane.PACK)
        ranges.append((sum(map(len, members)), packs))
        padded = np.full(packs * packed_membrane.PACK, start + count - 1)
        padded[:count] = np.arange(start, start + count)
        members.append(colouring.order[padded].reshape(packs, packed_membrane.PACK))
    lanes = np.concatenate(members)
    triangles = _triangles(rest)[lanes]
    packed = np.zeros(len(lanes), dtype=packed_membrane.Pack.numpy_dtype())
    for name in triangles.dtype.names:
        packed[name] = triangles[name]
    for corner in range(3):
        packed[f"m{corner}"] = rest.inverse_mass[triangles[f"i{corner}"]]
    return Coloured(tuple(ranges), wp.array(packed, dtype=packed_membrane.Pack, device=device))


def device_hinges(rest: RestState, device: str) -> Coloured:
    """Hinges, one a thread."""
    colouring = colour_constraints(rest.hinges, len(rest.vertices))
    packed = np.zeros(len(rest.hinges), dtype=bending.Hinge.numpy_dtype())
    packed["i0"], packed["i1"], packed["i2"], packed["i3"] = rest.hinges.T
    packed["weight"] = rest.hinge_weights
    packed["norm"] = (rest.hinge_weights**2 * rest.inverse_mass[rest.hinges]).sum(axis=1)
    packed["over_curvature"] = rest.hinge_curvature
    return Coloured(colouring.ranges, wp.array(packed[colouring.order], dtype=bending.Hinge, device=device))


def _triangles(rest: RestState) -> np.ndarray:
    packed = np.zeros(len(rest.area), dtype=membrane.Triangle.numpy_dtype())
    packed["i0"], packed["i1"], packed["i2"] = rest.topology.faces.T
    packed["du1"], packed["dv1"] = rest.inverse[:, 0, 0], rest.inverse[:, 0, 1]
    packed["du2"], packed["dv2"] = rest.inverse[:, 1, 0], rest.inverse[:, 1, 1]
    packed["root_area"] = np.sqrt(rest.area)
    return packed
