"""Sampled body shapes, and the motions of one body made by another.

In: numbers of shapes, a seed, how far they spread. Out: shape coefficients in standard deviations of ``body.model``,
and root translations [m]. All is a function of the arguments alone: asking for more shapes changes no earlier one.
"""

from __future__ import annotations

import hashlib
from typing import TYPE_CHECKING

import numpy as np
from scipy.special import ndtr, ndtri

if TYPE_CHECKING:
    from body.model import Body

SAMPLED = 5
"""Shape components that are sampled. The others move no vertex by more than 4 mm a standard deviation."""

LIMIT = 2.0
"""A coefficient is drawn from a normal distribution that is cut off at so many of its standard deviations."""

FARTHEST = 3.0
"""Largest coefficient of a shape, on either side [standard deviations]; farther out, bodies are no longer plausible."""

PELVIS = 0


def sampled_shape(own: np.ndarray, spread: float, seed: int, number: int) -> np.ndarray:
    """Coefficients of one of many shapes around a body's own.

    Few shapes have to cover five dimensions, so the numbers are not independent draws but points of an additive
    recurrence, which lie evenly however many there are (Roberts 2018, the golden ratio in more dimensions), begun at a
    place that the seed says. Each coordinate becomes a truncated normal deviate by its inverse distribution.

    Args:
        own: Coefficients of the run's own body [standard deviations], shape [<= 10].
        spread: Standard deviation of each sampled coefficient before it is cut off, in those of the population.
        seed: The run's seed.
        number: Number of the shape, from 1 on; 0 is the own shape itself.

    Returns:
        Shape [max(5, len(own))] float64, within ``FARTHEST``, rounded to 1e-4.
    """
    shape = np.zeros(max(SAMPLED, len(own)))
    shape[: len(own)] = own
    if number > 0:
        root = 1.0
        for _ in range(64):  # x^(d + 1) = x + 1
            root = (1.0 + root) ** (1.0 / (SAMPLED + 1))
        digest = hashlib.sha256(f"{seed}/body shapes".encode()).digest()
        start = np.random.default_rng(int.from_bytes(digest[:16], "little")).uniform(size=SAMPLED)
        even = (start + number * root ** -(1.0 + np.arange(SAMPLED))) % 1.0
        low, high = ndtr(-LIMIT), ndtr(LIMIT)
        shape[:SAMPLED] += spread * ndtri(low + even * (high - low))
    return np.round(np.clip(shape, -FARTHEST, FARTHEST), 4)


def scaled_root(root: np.ndarray, own: Body, other: Body) -> np.ndarray:
    """Root translations [T, 3] [m] of a motion that another body makes with the same joint rotations.

    Scaled by the height of the pelvis over the ground: longer legs take longer steps and go down farther to sit, so
    feet that stand on one body stand on the other.
    """
    return (np.asarray(root) * (other.joints[PELVIS, 1] / own.joints[PELVIS, 1])).astype(np.float32)
