"""Intrinsic parameters as an ARCSim material: what the same cloth is called there, and what has no name there.

*Membrane.* ARCSim's stretching is a Saint Venant-Kirchhoff energy whose stiffnesses depend on the strain; with the
Green strain ``G``, the second Piola-Kirchhoff stress is ``S_uu = k0 Guu + k1 Gvv``, ``S_vv = k1 Guu + k2 Gvv``,
``S_uv = k3 Guv``. The energy of Baraff & Witkin (``sim.implicit.energies``) has, with ``Guu = (|w_u|^2 - 1) / 2`` and
``Guv = w_u . w_v / 2``,

    S_uu = stretch (1 - 1 / |w_u|),  S_vv = stretch (1 - 1 / |w_v|),  S_uv = shear (w_u . w_v)

and so equals ARCSim's with ``k0 = 2 stretch / (|w_u| (1 + |w_u|))``, ``k1 = 0``, ``k2`` as k0 with ``|w_v|``, and
``k3 = 2 shear``. At small strain k0 = stretch. A row of the file holds [C11, C12, C22, C33] of *half* these values (the
program doubles them). Row 0 is for no strain, rows 1 to 5 for a principal stretch of 7/6 in the directions 0, 22.5 ...
90 degrees from weft to warp; the program interpolates. With the rows below both cloths carry the same force within 2%
up to that stretch (tested), where constant rows would be 26% too stiff.

*Bending.* An edge of length l with dihedral angle theta stores ``bend l^2 theta^2 / (2 (A0 + A1))`` here (Bergou 2006
without its factor 3, ``sim.rest_state``) and ``k l^2 theta^2 / (8 (A0 + A1))`` there: k = 4 bend, in every direction
and at every curvature.

*Damping.* One time constant there for stretching and bending; it is given ``bend_damping``, which shapes the motion of
folds, while membrane strain rates are damped by implicit Euler itself.

*Air.* Here drag is linear, ``air_drag v_n`` along the normal and ``drag_ratio air_drag v_t`` along the sheet. There the
tangential part is the same (``wind.drag``) but the normal part is ``wind.density |v_n| v_n``: both agree at one speed.

*Not carried over:* compression (ARCSim's fabrics resist compression as they resist stretch) and substeps.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from sim.parameters import check_parameters, parameter

ROW_STRETCH = 7.0 / 6.0
"""Principal stretch of rows 1 to 5 of the stretching table."""

DIRECTIONS = np.radians([0.0, 22.5, 45.0, 67.5, 90.0])
"""Angles of the principal direction against the weft for those rows [rad]."""

PROGRAM_FACTOR = 2.0
"""The program's stretching stiffness over the file's."""

BENDING_FACTOR = 4.0
"""ARCSim's bending stiffness over the parameter ``bend`` for the same energy of a hinge."""


def stretching_rows(stretch: float, shear: float) -> np.ndarray:
    """The six rows [C11, C12, C22, C33] [N/m] of an ARCSim material, as they stand in its file.

    Args:
        stretch: Membrane stiffness along warp and weft [N/m].
        shear: Membrane stiffness in shear [N/m].
    """
    squared = ROW_STRETCH**2
    # Stretches of the threads when the sheet is stretched in one direction and keeps its width across.
    along_u = np.sqrt(squared * np.cos(DIRECTIONS) ** 2 + np.sin(DIRECTIONS) ** 2)
    along_v = np.sqrt(squared * np.sin(DIRECTIONS) ** 2 + np.cos(DIRECTIONS) ** 2)
    along_u, along_v = np.concatenate([[1.0], along_u]), np.concatenate([[1.0], along_v])
    rows = np.zeros((6, 4))
    rows[:, 0] = 2.0 * stretch / (along_u * (1.0 + along_u))
    rows[:, 2] = 2.0 * stretch / (along_v * (1.0 + along_v))
    rows[:, 3] = 2.0 * shear
    return rows / PROGRAM_FACTOR


def arcsim_material(parameters: Mapping[str, float]) -> dict:
    """Content of a material file: ``density`` [kg/m^2], ``stretching`` [N/m], ``bending`` [N m]."""
    check_parameters(parameters)
    bending = np.full((3, 5), BENDING_FACTOR * parameters["bend"])
    return {
        "density": float(parameters["density"]),
        "stretching": stretching_rows(parameters["stretch"], parameters["shear"]).tolist(),
        "bending": bending.tolist(),
    }


def arcsim_wind(parameters: Mapping[str, float], matched_speed: float) -> dict:
    """The scene's ``wind``: its normal drag is that of the parameters at ``matched_speed`` [m/s] against the air."""
    if not matched_speed > 0.0:
        raise ValueError(f"arcsim: matched_speed = {matched_speed}: must be above 0 m/s")
    heading = parameters["wind_heading"]
    velocity = parameters["wind_speed"] * np.array([np.sin(heading), 0.0, np.cos(heading)])
    return {
        "density": float(parameters["air_drag"] / matched_speed),
        "velocity": velocity.tolist(),
        "drag": float(parameters["air_drag"] * parameters["drag_ratio"]),
    }


def never_yields(parameters: Mapping[str, float]) -> bool:
    """Whether ``bend_yield`` stands at its upper end, which means that no crease ever forms."""
    return parameters["bend_yield"] >= parameter("bend_yield").allowed[1]
