"""Intrinsic parameters of a simulation: the three groups of Wang 2019 (section 4), their units and their sampling.

An intrinsic parameter is drawn once, fixed for a whole simulation and stored with it. This module is free of Warp, so
that configs can be checked and shards read without a simulator.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class IntrinsicParameter:
    """One number that shapes the motion of the cloth.

    Attributes:
        name: Key in configs and shards.
        group: ``simulator``, ``environment`` or ``material``.
        unit: SI unit, ``1`` for a ratio or a count.
        base: Value used where a garment's config names none.
        allowed: Physical limits (inclusive) for any value.
        logarithmic: Sampled log-uniformly, because its useful values span decades.
        integer: Rounded after sampling.
        shared: Drawn once for ``ENSEMBLE`` sets in a row: those that are simulated together must have it in common.
        meaning: One sentence.
    """

    name: str
    group: str
    unit: str
    base: float
    allowed: tuple[float, float]
    meaning: str
    logarithmic: bool = False
    integer: bool = False
    shared: bool = False


ENSEMBLE = 16
"""Parameter sets that are simulated together."""


INTRINSIC_PARAMETERS: tuple[IntrinsicParameter, ...] = (
    IntrinsicParameter(
        "substeps", "simulator", "1", 24, (1, 512), "Solver substeps a frame", integer=True, shared=True
    ),
    IntrinsicParameter("time_scale", "simulator", "1", 1.0, (0.1, 4.0), "Simulated seconds a second of the clip"),
    IntrinsicParameter(
        "thickness",
        "simulator",
        "m",
        0.003,
        (0.0005, 0.02),
        "Distance kept between cloth and body, and between layers of cloth",
    ),
    IntrinsicParameter(
        "compression", "simulator", "1", 0.5, (0.0, 1.0), "Stiffness against compression over that against stretch"
    ),
    IntrinsicParameter("gravity", "environment", "m/s^2", 9.81, (0.0, 30.0), "Downward acceleration"),
    IntrinsicParameter(
        "air_drag",
        "environment",
        "N s/m^3",
        0.7,
        (0.0, 20.0),
        "Drag force an area and a speed of cloth against the air, at right angles to the sheet",
        logarithmic=True,
    ),
    IntrinsicParameter(
        "drag_ratio", "environment", "1", 0.3, (0.0, 1.0), "Drag along the sheet over drag at right angles to it"
    ),
    IntrinsicParameter("wind_speed", "environment", "m/s", 0.0, (0.0, 30.0), "Speed of a steady horizontal wind"),
    IntrinsicParameter(
        "wind_heading", "environment", "rad", 0.0, (-np.pi, np.pi), "Where the wind blows to: 0 is +z, pi/2 is +x"
    ),
    IntrinsicParameter("density", "material", "kg/m^2", 0.2, (0.01, 2.0), "Mass an area of cloth", logarithmic=True),
    IntrinsicParameter(
        "stretch", "material", "N/m", 1000.0, (1.0, 1.0e6), "Membrane stiffness along warp and weft", logarithmic=True
    ),
    IntrinsicParameter(
        "shear", "material", "N/m", 300.0, (0.1, 1.0e6), "Membrane stiffness in shear", logarithmic=True
    ),
    IntrinsicParameter(
        "bend", "material", "N m", 5.0e-5, (1.0e-9, 1.0e-1), "Bending stiffness of the sheet", logarithmic=True
    ),
    IntrinsicParameter(
        "stretch_damping", "material", "s", 0.005, (0.0, 1.0), "Membrane damping as a fraction of stiffness"
    ),
    IntrinsicParameter(
        "bend_damping", "material", "s", 0.01, (0.0, 10.0), "Bending damping as a fraction of stiffness"
    ),
    IntrinsicParameter(
        "bend_yield",
        "material",
        "1/m",
        1.0e3,
        (1.0, 1.0e3),
        "Curvature beyond which a bend stays as a crease; 1000, a radius of 1 mm: never",
        logarithmic=True,
    ),
    IntrinsicParameter("friction", "material", "1", 0.4, (0.0, 2.0), "Coulomb friction between cloth and body"),
    IntrinsicParameter("self_friction", "material", "1", 0.3, (0.0, 2.0), "Coulomb friction between layers of cloth"),
)

PARAMETER_NAMES: tuple[str, ...] = tuple(p.name for p in INTRINSIC_PARAMETERS)
_BY_NAME = {p.name: p for p in INTRINSIC_PARAMETERS}


def parameter(name: str) -> IntrinsicParameter:
    """The parameter of that name; ``ValueError`` names the known ones."""
    if name not in _BY_NAME:
        raise ValueError(f"unknown intrinsic parameter {name!r}; known: {', '.join(PARAMETER_NAMES)}")
    return _BY_NAME[name]


def base_parameters(overrides: Mapping[str, float] | None = None) -> dict[str, float]:
    """Base value of every parameter, with a garment's own base values laid over them; checked."""
    values = {p.name: p.base for p in INTRINSIC_PARAMETERS} | dict(overrides or {})
    check_parameters(values)
    return values


def check_parameters(values: Mapping[str, float]) -> None:
    """Raise ``ValueError`` unless every parameter is there, finite and inside its physical limits."""
    for name in values:
        parameter(name)
    for p in INTRINSIC_PARAMETERS:
        if p.name not in values:
            raise ValueError(f"intrinsic parameter {p.name!r} is missing")
        value, (low, high) = values[p.name], p.allowed
        if not np.isfinite(value) or not low <= value <= high:
            raise ValueError(f"intrinsic parameter {p.name} = {value}: allowed are {low:g} to {high:g} {p.unit}")


def sample_parameters(
    base: Mapping[str, float], ranges: Mapping[str, tuple[float, float]], seed: int, garment: str, index: int
) -> dict[str, float]:
    """One parameter set, a function of seed, garment and index alone: more samples never change the earlier ones.

    Args:
        base: Value of every parameter, kept where ``ranges`` names none.
        ranges: Sampled interval by parameter name; log-uniform where the parameter says so and the lower end is
            positive.
        seed: The run's seed.
        garment: Name of the garment.
        index: Number of the set; 0 is the base set itself.
    """
    values = dict(base)
    if index > 0:
        for name, (low, high) in ranges.items():
            p = parameter(name)
            # One generator a parameter: adding a range leaves the draws of the others as they were.
            number = (index - 1) // ENSEMBLE if p.shared else index
            draw = _generator(seed, garment, number, name).uniform()
            if p.logarithmic and low > 0.0:
                value = float(np.exp(np.log(low) + draw * (np.log(high) - np.log(low))))
            else:
                value = float(low + draw * (high - low))
            values[name] = float(round(value)) if p.integer else value
    check_parameters(values)
    return values


def _generator(*key: object) -> np.random.Generator:
    digest = hashlib.sha256("/".join(map(str, key)).encode()).digest()
    return np.random.default_rng(int.from_bytes(digest[:16], "little"))
