"""What an animation notes of the body in it, so that its garment can be understood and its motion taken elsewhere."""

from __future__ import annotations

from itertools import takewhile

import numpy as np

from body.model import Body
from body.shapes import FARTHEST, PELVIS
from formats.animation import Animation

PELVIS_HEIGHT = "pelvis_height"
"""How high above the ground the pelvis is at rest [m]: another body's steps are as much longer as its own is higher."""

MOST_SHAPE = 10
"""Shape coefficients of a body, at most."""


def body_notes(body: Body, shape: np.ndarray | None) -> dict[str, float]:
    """Notes of a body.

    Args:
        body: The body.
        shape: Its shape coefficients [standard deviations]; None where it is the run's own.
    """
    notes = {PELVIS_HEIGHT: float(body.joints[PELVIS, 1])}
    if shape is not None:
        notes |= {_shape_note(number): float(value) for number, value in enumerate(shape)}
    return notes


def noted_shape(animation: Animation) -> np.ndarray | None:
    """Shape coefficients of an animation's body [standard deviations]; None where none are noted: the run's own.

    Raises:
        ValueError: They are no numbers, or so large as no body is.
    """
    names = [_shape_note(number) for number in range(MOST_SHAPE)]
    noted = [animation.notes[name] for name in takewhile(animation.notes.__contains__, names)]
    for name, value in zip(names, noted, strict=False):
        if not isinstance(value, int | float) or not abs(value) <= FARTHEST:
            raise ValueError(
                f"animation '{animation.name}' notes {name} = {value!r}, allowed are {-FARTHEST:g} to {FARTHEST:g} "
                "standard deviations"
            )
    return np.array(noted, dtype=np.float64) if noted else None


def _shape_note(number: int) -> str:
    return f"shape_{number}"
