"""Curves over time that the motion families are written in: eased keys, bumps, oscillations with an envelope, slow
noise.

All times are seconds of the clip; all functions take and return arrays.
"""

from __future__ import annotations

import itertools
from collections.abc import Sequence

import numpy as np
from scipy.interpolate import BPoly
from scipy.spatial.transform import Rotation


def minimum_jerk(progress: np.ndarray | float) -> np.ndarray:
    """Minimum-jerk transition from 0 to 1, at rest at both ends (Flash & Hogan 1985); clipped to 0..1."""
    s = np.clip(progress, 0.0, 1.0)
    return s**3 * (10.0 - 15.0 * s + 6.0 * s**2)


def transition(times: np.ndarray, start: float, end: float) -> np.ndarray:
    """Minimum-jerk step from 0 before `start` to 1 after `end` [s]."""
    return minimum_jerk((times - start) / (end - start))


def pulse(times: np.ndarray, start: float, rise: float, hold: float, fall: float) -> np.ndarray:
    """From 0 to 1 within `rise`, held for `hold`, back to 0 within `fall` [s]."""
    down = start + rise + hold
    return transition(times, start, start + rise) - transition(times, down, down + fall)


def keyed(times: np.ndarray, keys: Sequence[tuple[float, float]]) -> np.ndarray:
    """Minimum-jerk course through keys (time [s], value) of increasing time, constant outside."""
    value = np.full(len(times), float(keys[0][1]))
    for (start, before), (end, after) in itertools.pairwise(keys):
        value += (after - before) * transition(times, start, end)
    return value


def through(times: np.ndarray, knots: Sequence[tuple[float, float, float, float]]) -> np.ndarray:
    """Piecewise quintic through (time, value, velocity, acceleration) knots, constant outside: for ballistic motion."""
    polynomial = BPoly.from_derivatives([knot[0] for knot in knots], [list(knot[1:]) for knot in knots])
    return polynomial(np.clip(times, knots[0][0], knots[-1][0]))


def oscillation(
    times: np.ndarray, period: float, start: float, phase: float = 0.0, ramp: float = 0.5, sharpness: float = 0.0
) -> np.ndarray:
    """Sine of the time since `start` with an eased-in amplitude.

    Args:
        times: Times [s], shape [T].
        period: Duration of a cycle [s].
        start: Time [s] at which the amplitude begins to grow.
        phase: Phase at `start` [rad].
        ramp: Time over which the amplitude grows to one [s].
        sharpness: 0 is a sine; towards 1 the ends of the movement are held longer and the way between them is faster.
    """
    wave = np.sin(2.0 * np.pi * (times - start) / period + phase)
    if sharpness > 0.0:
        wave = np.tanh(wave * 2.5 * sharpness) / np.tanh(2.5 * sharpness)
    return wave * transition(times, start, start + ramp)


def slow_noise(times: np.ndarray, generator: np.random.Generator, channels: int) -> np.ndarray:
    """Smooth noise of unit size that starts at zero with zero velocity, shape [T, channels].

    A sum of three sines between 0.15 and 0.9 Hz: the unsteadiness of a standing person.
    """
    frequency = generator.uniform([0.15, 0.3, 0.55], [0.3, 0.55, 0.9], size=(channels, 3))
    phase = generator.uniform(0.0, 2.0 * np.pi, size=(channels, 3))
    weight = np.array([0.6, 0.45, 0.25])
    wave = np.sin(2.0 * np.pi * frequency * times[:, None, None] + phase) - np.sin(phase)
    return (wave * weight).sum(-1) * transition(times, -0.2, 1.0)[:, None] * minimum_jerk(times / 0.4)[:, None]


def blend_rotations(times: np.ndarray, keys: Sequence[tuple[float, np.ndarray]]) -> np.ndarray:
    """Rotations through keys on the shortest way with minimum-jerk timing, constant outside, shape [T, 3, 3].

    Args:
        times: Times [s], shape [T].
        keys: (time [s], rotation [3, 3]) pairs, increasing in time.
    """
    rotation = Rotation.from_matrix(np.repeat(keys[0][1][None], len(times), axis=0))
    for (start, before), (end, after) in itertools.pairwise(keys):
        step = (Rotation.from_matrix(before).inv() * Rotation.from_matrix(after)).as_rotvec()
        rotation = rotation * Rotation.from_rotvec(transition(times, start, end)[:, None] * step)
    return rotation.as_matrix()


def rotation_about(axis: str, angle: np.ndarray) -> np.ndarray:
    """Rotation matrices about "x", "y" or "z" by angles [rad], shape [..., 3, 3]."""
    angle = np.asarray(angle, dtype=np.float64)
    cosine, sine = np.cos(angle), np.sin(angle)
    matrix = np.zeros((*angle.shape, 3, 3))
    i, j, k = {"x": (0, 1, 2), "y": (1, 2, 0), "z": (2, 0, 1)}[axis]
    matrix[..., i, i] = 1.0
    matrix[..., j, j], matrix[..., k, k] = cosine, cosine
    matrix[..., j, k], matrix[..., k, j] = -sine, sine
    return matrix
