"""What a user asks for in words, checked: materials as ``name=value``, body shapes as numbers.

Each ``ValueError`` is one sentence that says what is allowed.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from body.shapes import FARTHEST
from runtime.finished_run import LearnedGarment
from sim.parameters import check_parameters, parameter


def material(garment: LearnedGarment, wishes: Sequence[str], learned: bool) -> dict[str, float] | None:
    """The base material with single parameters changed.

    Args:
        garment: Garment of a finished run.
        wishes: Texts such as ``bend=2e-5``, in SI units.
        learned: Whether a network will dress it: that knows the sampled parameters alone, between the ends of their
            ranges. The simulator takes every parameter within its physical limits.

    Returns:
        Every intrinsic parameter; None where nothing is asked for.

    Raises:
        ValueError: No ``name=value``, an unknown parameter, or a value outside of what is allowed.
    """
    if not wishes:
        return None
    values, ranges = dict(garment.base_parameters), garment.ranges
    for wish in wishes:
        name, equals, text = wish.partition("=")
        try:
            value = float(text)
        except ValueError:
            equals = ""
            value = 0.0
        if not equals:
            raise ValueError(f"--set {wish!r}: expected name=value, such as bend=2e-5")
        known = parameter(name)
        if learned and name not in ranges:
            raise ValueError(
                f"--set {wish!r}: '{garment.name}' was trained on samples of {', '.join(ranges) or 'no parameter'}; "
                "the simulator (pipeline.dress --solver xpbd) takes every parameter"
            )
        if learned and not ranges[name][0] <= value <= ranges[name][1]:
            low, high = ranges[name]
            raise ValueError(
                f"--set {wish!r}: '{garment.name}' was trained on {low:g} to {high:g} {known.unit}; "
                f"the simulator (pipeline.dress --solver xpbd) takes {known.allowed[0]:g} to {known.allowed[1]:g}"
            )
        values[name] = value
    check_parameters(values)
    return values


def body_shape(wish: Sequence[float] | None) -> np.ndarray | None:
    """Shape coefficients [standard deviations], at most 10 and each at most 3 away from the mean; None where not asked.

    Raises:
        ValueError: Too many, or one that is too far out.
    """
    if wish is None:
        return None
    shape = np.asarray(wish, dtype=np.float64)
    if not 1 <= len(shape) <= 10 or not np.isfinite(shape).all() or np.abs(shape).max() > FARTHEST:
        raise ValueError(
            f"--shape {' '.join(f'{s:g}' for s in shape)}: allowed are 1 to 10 numbers from {-FARTHEST:g} to "
            f"{FARTHEST:g} standard deviations"
        )
    return shape


def labels(texts: Sequence[str]) -> list[str]:
    """Labels, given apart or with commas between them."""
    found = [part.strip() for text in texts for part in text.split(",") if part.strip()]
    if not found:
        raise ValueError("--label: at least one label is needed")
    return found
