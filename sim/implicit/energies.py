"""The two cloth energies in plain NumPy: the definition against which the implicit solver's force kernels are tested.

In: the rest state of a garment, world positions [V, 3] [m] and the intrinsic parameters. Out: joules.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from sim.rest_state import RestState


def deformation_coefficients(rest: RestState) -> tuple[np.ndarray, np.ndarray]:
    """Coefficients [1/m] with ``w_u = sum_i u[f, i] x_i`` and the same for ``w_v``, each of shape [F, 3]."""
    second_third = rest.inverse
    first = -second_third.sum(axis=1, keepdims=True)
    coefficients = np.concatenate([first, second_third], axis=1)
    return np.ascontiguousarray(coefficients[:, :, 0]), np.ascontiguousarray(coefficients[:, :, 1])


def membrane_energy(rest: RestState, positions: np.ndarray, parameters: Mapping[str, float]) -> float:
    """Membrane energy [J]: ``sum A/2 [k_stretch ((|w_u|-1)^2 + (|w_v|-1)^2) + k_shear (w_u . w_v)^2]``.

    Where a direction is compressed, its stretch stiffness is multiplied by the parameter ``compression``.
    """
    corners = positions[rest.topology.faces]
    w_u, w_v = (np.einsum("fi,fic->fc", c, corners) for c in deformation_coefficients(rest))
    energy = parameters["shear"] * (w_u * w_v).sum(1) ** 2
    for w in (w_u, w_v):
        strain = np.linalg.norm(w, axis=1) - 1.0
        stiffness = parameters["stretch"] * np.where(strain < 0.0, parameters["compression"], 1.0)
        energy = energy + stiffness * strain**2
    return float((0.5 * rest.area * energy).sum())


def bending_energy(rest: RestState, positions: np.ndarray, parameters: Mapping[str, float]) -> float:
    """Bending energy [J]: ``sum bend/2 |sum_i weight_i x_i|^2`` over the hinges; the cloth is flat at rest.

    A cylinder of curvature kappa stores ``bend kappa^2 / 2`` an area on an equilateral mesh.
    """
    curvature = np.einsum("hi,hic->hc", rest.hinge_weights, positions[rest.hinges])
    return float((0.5 * parameters["bend"] * (curvature**2).sum(1)).sum())
