"""Materials for ARCSim: the forces and energies of ours, computed another way."""

from __future__ import annotations

import numpy as np
import pytest

from sim.arcsim.material import BENDING_FACTOR, arcsim_material, arcsim_wind, stretching_rows
from sim.implicit.energies import bending_energy, deformation_coefficients, membrane_energy
from sim.parameters import base_parameters
from sim.rest_state import RestState

FRAMES, LEAD_IN = 10, 3


def test_membrane_carries_the_force_of_our_energy():
    """Forces by both laws for stretches along, across and at angles to the threads, and for shear."""
    stretch, shear = 900.0, 250.0
    rows = 2.0 * stretching_rows(stretch, shear)  # what the program makes of the file
    corners = np.array([[0.0, 0.0, 0.0], [0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]])  # v up, u along -x
    rest = RestState.from_mesh(corners[:, [0, 1, 2]], np.array([[0, 1, 2]]))
    bu, bv = (c[0] for c in deformation_coefficients(rest))
    parameters = base_parameters({"stretch": stretch, "shear": shear})

    def second_stress(gradient: np.ndarray) -> np.ndarray:
        """Ours: derivative of the energy an area by the Green strain, from the energy itself."""
        flat = np.stack([bu, bv])  # [2, 3]

        def energy(columns: np.ndarray) -> float:
            # Positions with these gradient columns: columns = X^T flat^T.
            positions = np.linalg.lstsq(flat, columns.T, rcond=None)[0]
            return membrane_energy(rest, positions, parameters) / rest.area[0]

        first = np.zeros((3, 2))
        for a in range(3):
            for b in range(2):
                step = np.zeros((3, 2))
                step[a, b] = 1e-6
                first[a, b] = (energy(gradient + step) - energy(gradient - step)) / 2e-6
        return np.linalg.lstsq(gradient, first, rcond=None)[0]

    for index, degrees in enumerate((0.0, 22.5, 45.0, 67.5, 90.0), start=1):
        turn = np.radians(degrees)
        axis = np.array([np.cos(turn), np.sin(turn)])
        for strain in (0.01, 0.05, 0.1, 1.0 / 6.0):
            flat = np.eye(2) + strain * np.outer(axis, axis)
            gradient = np.concatenate([flat, np.zeros((1, 2))])
            green = 0.5 * (flat.T @ flat - np.eye(2))
            share = min(strain * 6.0, 1.0)
            k = (1.0 - share) * rows[0] + share * rows[index]
            theirs = np.array(
                [
                    [k[0] * green[0, 0] + k[1] * green[1, 1], k[3] * green[0, 1]],
                    [k[3] * green[0, 1], k[1] * green[0, 0] + k[2] * green[1, 1]],
                ]
            )
            np.testing.assert_allclose(theirs, second_stress(gradient), atol=0.02 * np.abs(theirs).max())


def test_bending_stores_the_energy_of_our_hinge():
    angle, bend = 0.02, 3e-4
    flat = np.array([[0.0, 0, 0], [0.03, 0, 0], [0.012, 0.025, 0], [0.017, -0.02, 0]])
    rest = RestState.from_mesh(flat, np.array([[0, 1, 2], [1, 0, 3]]))
    folded = flat.copy()
    folded[2] = [0.012, 0.025 * np.cos(angle), 0.025 * np.sin(angle)]
    ours = bending_energy(rest, folded, base_parameters({"bend": bend}))
    k = arcsim_material(base_parameters({"bend": bend}))["bending"][0][0]
    theirs = k * 0.03**2 * angle**2 / (8.0 * rest.area.sum())
    assert theirs == pytest.approx(ours, rel=1e-3)
    assert k == BENDING_FACTOR * bend


def test_material_has_the_programs_shape_and_air_agrees_at_its_speed():
    parameters = base_parameters({"density": 0.3, "air_drag": 0.9, "drag_ratio": 0.2, "wind_speed": 3.0})
    content = arcsim_material(parameters | {"wind_heading": np.pi / 2})
    assert content["density"] == 0.3
    assert np.shape(content["stretching"]) == (6, 4) and np.shape(content["bending"]) == (3, 5)
    assert content["stretching"][0] == pytest.approx([500.0, 0.0, 500.0, 300.0])
    wind = arcsim_wind(parameters | {"wind_heading": np.pi / 2}, matched_speed=2.0)
    assert wind["velocity"] == pytest.approx([3.0, 0.0, 0.0])
    assert wind["density"] * 2.0**2 == pytest.approx(0.9 * 2.0)
    assert wind["drag"] == pytest.approx(0.18)
