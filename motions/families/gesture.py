"""Standing and moving the arms: waving, raising, clapping, stretching, pointing and other gestures.

Poses are written as directions (outward, up, ahead) of the upper arm and the forearm; see :mod:`motions.arms`.
"""

from __future__ import annotations

import numpy as np

from motions.arms import ArmPose, arm_pose
from motions.stage import CALM_SECONDS, Stage
from motions.timing import keyed, oscillation, pulse, transition

BEGIN = CALM_SECONDS


def _sides(stage: Stage, side: str) -> tuple[int, ...]:
    """Indices of the arms that "left", "right", "both" or "own" (the variant's side) mean."""
    return (0, 1) if side == "both" else (stage.leading(None if side == "own" else side),)


def _cycle(stage: Stage, side: int, keys: list[tuple[float, ArmPose]], period: float, offset: float = 0.0) -> None:
    """Repeat keyed poses (times relative to each repetition, at neutral tempo [s]) until the clip ends."""
    start = BEGIN + offset
    course = [
        (start + repeat + stage.seconds(time), pose)
        for repeat in (begin - BEGIN for begin in stage.repeats(stage.seconds(period), BEGIN))
        for time, pose in keys
    ]
    stage.arm_course(side, course)


def _counterbalance(stage: Stage, side: int, amount: float = 0.25) -> None:
    """Weight on the other leg and a little trunk bend away from one raised arm."""
    shift = transition(stage.times, BEGIN, BEGIN + 0.7) * stage.style.sway
    stage.shift_weight(1 - side, amount * shift)
    stage.performance.spine.lean -= stage.outward(side) * 0.05 * shift


def wave(stage: Stage, side: str = "own", size: str = "high") -> None:
    """Wave with one hand or both; "high" over the head, "low" beside the shoulder."""
    wide = 0.3 + 0.12 * stage.style.amplitude
    for arm in _sides(stage, side):
        lift = 0.85 if size == "high" else 0.05
        upper = (0.8, lift, 0.3)
        poses = [arm_pose(upper, (0.22 + offset, 1.0, 0.2), twist=-0.5) for offset in (wide, -wide)]
        half = stage.seconds(0.3)
        first = BEGIN + stage.seconds(0.55)
        times = [first + index * half for index in range(int(stage.duration / half) + 3)]
        delay = 0.1 * stage.seconds(1.0) * arm if side == "both" else 0.0
        stage.arm_course(arm, [(time + delay, poses[index % 2]) for index, time in enumerate(times)])
        if side != "both":
            _counterbalance(stage, arm)
            stage.performance.head.turn += stage.outward(arm) * 0.12 * transition(stage.times, BEGIN, BEGIN + 0.6)
    if side == "both":
        sway = oscillation(stage.times, stage.seconds(1.2), BEGIN + 0.3, ramp=0.8) * stage.style.sway
        stage.performance.spine.lean += 0.07 * sway
        stage.shift_weight(0, 0.22 * sway)


def raise_arms(stage: Stage, way: str = "side", side: str = "both", hold: float = 0.5) -> None:
    """Raise the arms over the head and lower them, sideways, in front, or to the horizontal ("forward", "cross")."""
    middle, top = {
        "side": (arm_pose((1, 0.0, 0.05), (1, 0.12, 0.15)), arm_pose((0.28, 1, 0.05), (0.12, 1, 0.1))),
        "front": (arm_pose((0.25, -0.1, 1), (0.15, 0.05, 1)), arm_pose((0.3, 1, 0.2), (0.15, 1, 0.15))),
        "forward": (arm_pose((0.25, -0.5, 0.8), (0.12, -0.35, 0.9)), arm_pose((0.16, 0.03, 1), (0.06, 0.1, 1))),
        "cross": (arm_pose((0.8, -0.6, 0.1), (0.8, -0.5, 0.2)), arm_pose((1, 0.05, -0.05), (1, 0.1, 0.1))),
    }[way]
    for arm in _sides(stage, side):
        keys = [(0.42, middle), (0.84, top), (0.84 + hold, top), (1.26 + hold, middle), (1.7 + hold, stage.relaxed)]
        _cycle(stage, arm, keys, 1.85 + hold)
        if side != "both":
            _counterbalance(stage, arm, 0.15)
    for start in stage.repeats(stage.seconds(1.85 + hold)):
        up = pulse(stage.times, start, stage.seconds(0.85), stage.seconds(hold), stage.seconds(0.85))
        stage.performance.spine.bend -= 0.1 * stage.style.amplitude * up
        stage.performance.head.bend -= 0.18 * up * (way in ("side", "front"))


def clap(stage: Stage, height: str = "chest") -> None:
    """Clap the hands before the chest or over the head."""
    period = 0.46 if height == "chest" else 0.62
    if height == "chest":
        opened = arm_pose((0.55, -0.72, 0.5), (0.3, 0.3, 1.0), twist=-0.75)
        closed = arm_pose((0.38, -0.75, 0.6), (-0.52, 0.3, 0.8), twist=-0.75)
    else:
        opened = arm_pose((0.85, 0.75, 0.15), (0.45, 1.0, 0.2), twist=-0.4)
        closed = arm_pose((0.42, 1.0, 0.2), (-0.36, 1.0, 0.15), twist=-0.4)
    for arm in (0, 1):
        first, half = BEGIN + stage.seconds(0.5), stage.seconds(period / 2)
        keys = [(first + index * half, (opened, closed)[index % 2]) for index in range(int(stage.duration / half) + 3)]
        stage.arm_course(arm, keys)
    beat = oscillation(stage.times, stage.seconds(period * 2), BEGIN + 0.3)
    stage.performance.spine.lean += 0.035 * stage.style.sway * beat
    stage.performance.head.lean += 0.04 * stage.style.sway * beat
    stage.performance.drop += (
        0.006
        * (1.0 - oscillation(stage.times, stage.seconds(period), BEGIN + 0.3))
        * transition(stage.times, BEGIN, 0.6)
    )
    stage.shift_weight(0, 0.2 * beat * stage.style.sway)


def stretch(stage: Stage, way: str = "up") -> None:
    """Stretch both arms up and back ("up"), or up and over to one side ("side")."""
    reach = arm_pose((0.3, 1.0, 0.0), (0.02, 1.0, -0.08), twist=-0.3)
    chest = arm_pose((0.55, -0.45, 0.65), (-0.55, 0.35, 0.6))
    for arm in (0, 1):
        _cycle(stage, arm, [(0.5, chest), (1.15, reach), (1.9, reach), (2.7, stage.relaxed)], 3.0)
    trunk = stage.performance
    for number, start in enumerate(stage.repeats(stage.seconds(3.0))):
        up = pulse(
            stage.times, start + stage.seconds(0.35), stage.seconds(0.8), stage.seconds(0.65), stage.seconds(0.8)
        )
        if way == "up":
            trunk.spine.bend -= 0.24 * stage.style.amplitude * up
            trunk.head.bend -= 0.25 * up
        else:
            towards = stage.style.side * (-1) ** number
            trunk.spine.lean += 0.5 * towards * stage.style.amplitude * up
            trunk.pelvis.lean -= 0.05 * towards * up
            stage.shift_weight(1 if towards > 0 else 0, 0.5 * up)


_ONE_ARM: dict[str, tuple[list[tuple[float, ArmPose]], float, float]] = {
    # name: keys of the gesturing arm, period [s], turn of chest and head towards that side [rad]
    "point": (
        [
            (0.55, arm_pose((0.35, 0.12, 1), (0.2, 0.12, 1), wrist=-0.1)),
            (1.3, arm_pose((0.4, 0.15, 1), (0.3, 0.15, 1))),
        ],
        2.4,
        0.2,
    ),
    "salute": (
        [
            (0.55, arm_pose((0.9, 0.12, 0.35), (-0.62, 0.75, 0.25), twist=-0.6)),
            (1.4, arm_pose((0.9, 0.12, 0.35), (-0.62, 0.75, 0.25), twist=-0.6)),
        ],
        2.3,
        0.0,
    ),
    "beckon": (
        [(0.5, arm_pose((0.4, -0.3, 0.9), (0.2, 0.25, 1), twist=0.9))]
        + [
            (0.78 + 0.3 * i, arm_pose((0.4, -0.4, 0.8), (-0.1, 0.3 + 0.7 * ((i + 1) % 2), 0.6), twist=0.9))
            for i in range(4)
        ],
        2.6,
        0.1,
    ),
    "guide": (
        [
            (0.45, arm_pose((0.3, -0.75, 0.55), (-0.35, 0.1, 0.8), twist=0.6)),
            (1.0, arm_pose((0.9, -0.35, 0.4), (0.9, 0.05, 0.35), twist=1.0)),
            (1.7, arm_pose((0.92, -0.35, 0.3), (0.95, 0.05, 0.25), twist=1.0)),
        ],
        2.7,
        0.45,
    ),
    "call": (
        [
            (0.55, arm_pose((0.55, -0.1, 0.8), (-0.55, 0.85, -0.02), twist=-0.3)),
            (1.6, arm_pose((0.55, -0.05, 0.8), (-0.55, 0.85, -0.02), twist=-0.3)),
        ],
        2.6,
        0.25,
    ),
    "slash": (
        [
            (0.5, arm_pose((0.35, 0.9, -0.1), (0.1, 0.9, -0.6))),
            (0.85, arm_pose((0.1, -0.2, 1), (-0.35, -0.35, 0.9))),
            (1.15, arm_pose((0.0, -0.7, 0.6), (-0.5, -0.6, 0.6))),
        ],
        1.9,
        -0.35,
    ),
    "reach-up": (
        [(0.75, arm_pose((0.25, 1, 0.3), (0.12, 1, 0.2), wrist=-0.2)), (1.2, arm_pose((0.2, 1, 0.25), (0.1, 1, 0.15)))],
        2.2,
        -0.1,
    ),
}


def one_arm(stage: Stage, gesture: str, side: str = "own") -> None:
    """A gesture of one arm, repeated: a key of ``_ONE_ARM``, such as "point" or "guide" (this way, please)."""
    keys, period, towards = _ONE_ARM[gesture]
    arm = _sides(stage, side)[0]
    _cycle(stage, arm, [*keys, (period - 0.25, stage.relaxed)], period)
    _counterbalance(stage, arm, 0.2)
    for start in stage.repeats(stage.seconds(period)):
        done = pulse(stage.times, start, stage.seconds(0.6), stage.seconds(period - 1.5), stage.seconds(0.7))
        turn = stage.outward(arm) * towards * done
        stage.performance.spine.turn += 0.6 * turn
        stage.performance.pelvis.turn += 0.15 * turn
        stage.performance.head.turn += 0.5 * turn
        if gesture == "slash":
            swing = pulse(
                stage.times, start + stage.seconds(0.5), stage.seconds(0.4), stage.seconds(0.2), stage.seconds(0.6)
            )
            stage.performance.spine.bend += 0.4 * stage.style.amplitude * swing
            stage.performance.drop += 0.05 * swing


_TWO_ARMS: dict[str, tuple[list[tuple[float, ArmPose]], float]] = {
    # name: keys of both arms, period [s]
    "push": (
        [
            (0.45, arm_pose((0.45, -0.8, -0.3), (0.0, 0.35, 1), twist=-0.4, wrist=-0.9)),
            (0.95, arm_pose((0.28, -0.08, 1), (0.1, 0.05, 1), wrist=-1.0)),
        ],
        1.5,
    ),
    "pull": (
        [(0.5, arm_pose((0.25, 0.0, 1), (0.1, 0.05, 1))), (1.05, arm_pose((0.55, -0.65, -0.45), (0.05, 0.05, 1)))],
        1.5,
    ),
    "shrug": (
        [
            (0.5, arm_pose((0.42, -0.8, 0.1), (0.75, 0.25, 0.6), twist=1.1)),
            (1.1, arm_pose((0.42, -0.8, 0.1), (0.75, 0.3, 0.6), twist=1.1)),
        ],
        2.0,
    ),
    "cheer": (
        [(0.45, arm_pose((0.6, -0.7, 0.3), (0.15, 0.9, 0.4))), (0.8, arm_pose((0.5, 1, 0.15), (0.3, 1, 0.1)))],
        0.95,
    ),
    "open-arms": (
        [
            (0.5, arm_pose((0.45, -0.5, 0.75), (-0.35, 0.1, 0.9))),
            (1.15, arm_pose((1, -0.1, 0.0), (0.9, 0.15, 0.35), twist=0.8)),
        ],
        2.0,
    ),
    "breathe": (
        [
            (1.0, arm_pose((0.7, -0.55, 0.35), (0.1, 0.3, 0.85), twist=0.5)),
            (1.5, arm_pose((0.75, -0.4, 0.35), (0.05, 0.35, 0.85), twist=-0.3)),
        ],
        2.6,
    ),
}


def two_arms(stage: Stage, gesture: str) -> None:
    """A gesture of both arms, repeated: a key of ``_TWO_ARMS``, such as "push" or "cheer"."""
    keys, period = _TWO_ARMS[gesture]
    closing = [] if gesture in ("push", "pull", "cheer") else [(period - 0.2, stage.relaxed)]
    for arm in (0, 1):
        _cycle(stage, arm, [*keys, *closing], period)
    trunk = stage.performance
    trunk.hang *= 0.5
    for start in stage.repeats(stage.seconds(period)):
        peak = pulse(
            stage.times, start + stage.seconds(0.35), stage.seconds(0.55), 0.02, stage.seconds(max(0.4, period - 0.95))
        )
        peak = peak * stage.style.amplitude
        bend = {"push": 0.16, "pull": -0.12, "shrug": -0.03, "cheer": -0.12, "open-arms": -0.14, "breathe": -0.12}[
            gesture
        ]
        trunk.spine.bend += bend * peak
        trunk.head.bend += {"cheer": -0.2, "breathe": -0.12}.get(gesture, -0.5 * bend) * peak
        trunk.drop += {"push": 0.035, "pull": 0.04, "cheer": 0.0}.get(gesture, 0.0) * peak
        trunk.place[:, 1] += {"push": 0.03, "pull": -0.03}.get(gesture, 0.0) * peak
        if gesture == "cheer":
            trunk.drop += 0.03 * pulse(stage.times, start, stage.seconds(0.35), 0.01, stage.seconds(0.35))
        if gesture == "shrug":
            trunk.head.lean += 0.18 * stage.style.side * peak


def circle_arms(stage: Stage, direction: int = 1, alternate: bool = False) -> None:
    """Swing straight arms in full circles, ahead first (+1) or back first (-1); like swimming when they alternate."""
    period = stage.seconds(1.5)
    for arm in (0, 1):
        phase = 0.5 * period * (arm != stage.leading()) * alternate
        ring = [(0.25, -1, 0.1), (0.25, 0.0, 1.0), (0.3, 1, 0.05), (0.75, 0.05, -0.65)][::direction]
        ring = ring[-1:] + ring[:-1] if direction < 0 else ring
        poses = [arm_pose(at, (at[0] * 0.8, at[1], at[2] + 0.12), hint=(0, 0.3, 1)) for at in ring]
        start = BEGIN + stage.seconds(0.1) + phase
        keys = [(start + index * period / 4, poses[index % 4]) for index in range(int(stage.duration / period + 2) * 4)]
        stage.arm_course(arm, keys)
        smooth_circle(stage, arm, start, period, direction)
    rock = oscillation(stage.times, period, BEGIN + 0.1)
    stage.performance.spine.turn += (0.2 if alternate else 0.0) * rock * stage.style.side
    stage.performance.spine.bend += (0.0 if alternate else 0.06) * rock
    stage.performance.drop += 0.012 * (1.0 + rock) * transition(stage.times, BEGIN, 0.8)


def smooth_circle(stage: Stage, arm: int, start: float, period: float, direction: int) -> None:
    """Swing a hanging arm through full circles about the shoulder, without a stop."""
    track = stage.performance.arms[arm]
    stage.arm_course(arm, [(start + 0.3, arm_pose((0.3, -1, 0.02), (0.28, -1, 0.12)))])
    elapsed = np.maximum(stage.times - start, 0.0)
    ramp = 0.5 * period
    angle = np.where(elapsed < ramp, 0.5 * elapsed**2 / ramp, elapsed - 0.5 * ramp)
    track.swing += direction * 2.0 * np.pi * angle / period


def look_around(stage: Stage) -> None:
    """Look to one side, to the other, up and down; the trunk follows."""
    side, second = stage.style.side, stage.seconds(1.0)
    turn = keyed(
        stage.times,
        [
            (BEGIN + time * second, value * side)
            for time, value in ((0, 0), (0.7, 0.75), (1.1, 0.75), (2.0, -0.75), (2.4, -0.75), (3.2, 0))
        ],
    )
    trunk = stage.performance
    trunk.head.turn += turn * stage.style.amplitude
    trunk.spine.turn += 0.4 * turn
    trunk.pelvis.turn += 0.1 * turn
    trunk.head.bend += 0.15 * oscillation(stage.times, stage.seconds(2.3), BEGIN + 0.2)
    stage.shift_weight(0, 0.35 * turn)
    for arm in (0, 1):
        trunk.arms[arm].swing -= 0.12 * stage.outward(arm) * turn
