"""The intrinsic parameters that a point of the latent space is of, or nearest to, for the sliders to show."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import torch

from models.pooled_latent import PooledNetwork
from runtime.intrinsic_space import LOGARITHMIC, IntrinsicSpace
from sim.parameters import parameter


@dataclass(frozen=True)
class Material:
    """Intrinsic parameters of a keyframe.

    Attributes:
        parameters: Those that the model was told.
        exact: Whether the keyframe's z is theirs; else they are the nearest ones.
    """

    parameters: Mapping[str, float]
    exact: bool


def nearest_parameters(space: IntrinsicSpace, latent: np.ndarray) -> dict[str, float]:
    """What the network reads from ``latent [Z]``, within the ranges; the base material where it reads nothing."""
    garment, network = space.garment, space.network
    read = np.array([garment.base_parameters.get(name, 0.0) for name in space.names])
    if isinstance(network, PooledNetwork):
        with torch.no_grad():
            scaled = network.read_parameters(torch.as_tensor(latent, dtype=torch.float32)[None])[0]
            read = (scaled * network.parameter_deviation + network.parameter_mean).double().numpy()
        read = np.array([np.exp(v) if name in LOGARITHMIC else v for name, v in zip(space.names, read, strict=True)])
    values = dict(zip(space.names, read.tolist(), strict=True))
    return {name: float(np.clip(values[name], *garment.ranges[name])) for name in space.tellable}


def check_trained(garment: str, ranges: Mapping[str, tuple[float, float]], values: Mapping[str, float]) -> None:
    """Raise ``ValueError`` for a parameter or a value that the garment's model was not trained on; says on what."""
    for name, value in values.items():
        if name not in ranges:
            raise ValueError(f"'{garment}' was trained on samples of {', '.join(ranges)}, not of {name}")
        low, high = ranges[name]
        if not low * (1 - 1e-6) <= value <= high * (1 + 1e-6):
            unit = parameter(name).unit
            raise ValueError(f"{name}: '{garment}' was trained on {low:g} to {high:g} {unit}, not on {value:g}")


def share_of(name: str, value: float, ends: tuple[float, float]) -> float:
    """Where a value is between the ends of its range, 0 to 1; by its logarithm where it spans decades."""
    low, high, value = (np.log(v) if name in LOGARITHMIC else v for v in (*ends, value))
    return float(np.clip((value - low) / (high - low), 0.0, 1.0))


def value_of(name: str, share: float, ends: tuple[float, float]) -> float:
    """The other way of :func:`share_of`."""
    if name in LOGARITHMIC:
        return float(np.clip(np.exp((1 - share) * np.log(ends[0]) + share * np.log(ends[1])), *ends))
    return float(np.clip((1 - share) * ends[0] + share * ends[1], *ends))
