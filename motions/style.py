"""How somebody moves, apart from what is done: tempo, size of the movements, posture, mood."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Style:
    """The manner of one variant.

    Attributes:
        tempo: Speed of the movements relative to the family's own, 1 is neutral.
        amplitude: Size of the movements relative to the family's own, 1 is neutral.
        side: +1 begins with the left, -1 with the right.
        slouch: Forward bend of the trunk while standing [rad].
        nod: Forward bend of the head [rad].
        spread: Angle between a hanging upper arm and the trunk [rad]; the room that sleeves and skirts have.
        elbow: Flexion of a hanging arm's elbow [rad].
        stance: Distance of the feet relative to that of the zero pose.
        toe_out: Outward turn of the feet [rad].
        sway: Size of the pelvis' movements relative to the family's own.
        drop: Extra knee bend, as how far the pelvis is lowered [m].
        noise: Size of the small unsteadiness [rad].
    """

    tempo: float
    amplitude: float
    side: int
    slouch: float
    nod: float
    spread: float
    elbow: float
    stance: float
    toe_out: float
    sway: float
    drop: float
    noise: float


# Shifts of the neutral manner: tempo, amplitude and sway are factors, the others are added.
MOODS: dict[str, dict[str, float]] = {
    "neutral": {},
    "happy": {"tempo": 1.1, "amplitude": 1.15, "sway": 1.3, "slouch": -0.04, "nod": -0.06},
    "sad": {"tempo": 0.84, "amplitude": 0.75, "sway": 0.8, "slouch": 0.16, "nod": 0.3, "drop": 0.008},
    "angry": {"tempo": 1.12, "amplitude": 1.1, "slouch": 0.12, "nod": 0.1, "spread": 0.08, "elbow": 0.35},
    "proud": {"tempo": 0.95, "amplitude": 1.1, "slouch": -0.09, "nod": -0.12, "spread": 0.06},
    "tired": {"tempo": 0.8, "amplitude": 0.8, "sway": 1.2, "slouch": 0.22, "nod": 0.24, "drop": 0.018},
}


def draw_style(generator: np.random.Generator, mood: str) -> Style:
    """A manner drawn around a mood's mean; `ValueError` for an unknown mood."""
    if mood not in MOODS:
        raise ValueError(f"unknown mood {mood!r}; known are {', '.join(MOODS)}")
    shift = MOODS[mood]
    uniform = generator.uniform
    return Style(
        tempo=uniform(0.86, 1.14) * shift.get("tempo", 1.0),
        amplitude=uniform(0.85, 1.15) * shift.get("amplitude", 1.0),
        side=int(generator.integers(2)) * 2 - 1,
        slouch=uniform(-0.03, 0.07) + shift.get("slouch", 0.0),
        nod=uniform(-0.05, 0.08) + shift.get("nod", 0.0),
        spread=np.radians(uniform(15.0, 20.0)) + shift.get("spread", 0.0),
        elbow=np.radians(uniform(12.0, 22.0)) + shift.get("elbow", 0.0),
        stance=uniform(0.88, 1.05),
        toe_out=np.radians(uniform(4.0, 12.0)),
        sway=uniform(0.8, 1.2) * shift.get("sway", 1.0),
        drop=uniform(0.0, 0.008) + shift.get("drop", 0.0),
        noise=np.radians(uniform(0.6, 1.4)),
    )
