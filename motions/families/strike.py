"""Punching, kicking and throwing: wind up, strike, come back to a guard or to standing."""

from __future__ import annotations

import numpy as np

from motions.arms import ArmPose, arm_pose
from motions.stage import CALM_SECONDS, Stage
from motions.timing import keyed, pulse, transition

BEGIN = CALM_SECONDS
GUARD = arm_pose((0.42, -0.85, 0.35), (-0.3, 0.75, 0.6), twist=-0.4)


def punch(stage: Stage, way: str = "straight", arms: str = "both") -> None:
    """Punch from a guard: "straight", "hook" or "uppercut"; "both" arms in turn, or one ("left", "right")."""
    period, performance, times = stage.seconds(0.82), stage.performance, stage.times
    strike = {
        "straight": arm_pose((0.12, 0.02, 1), (-0.06, 0.06, 1), twist=-0.7),
        "hook": arm_pose((0.85, 0.05, 0.6), (-0.75, 0.1, 0.75), twist=-0.5),
        "uppercut": arm_pose((0.3, -0.35, 0.85), (-0.12, 0.9, 0.5), twist=0.8),
    }[way]
    wind = {
        "straight": GUARD,
        "hook": arm_pose((0.75, -0.6, 0.1), (0.0, 0.35, 0.9), twist=-0.4),
        "uppercut": arm_pose((0.42, -0.9, -0.15), (-0.05, 0.05, 1), twist=0.6),
    }[way]
    first = BEGIN + stage.seconds(0.4)
    leading = stage.leading(None if arms == "both" else arms)
    sequence = [leading, 1 - leading] if arms == "both" else [leading]
    keys: list[list[tuple[float, ArmPose]]] = [[(first, GUARD)], [(first, GUARD)]]
    performance.drop += 0.035 * transition(times, BEGIN, first)
    performance.spine.bend += 0.12 * transition(times, BEGIN, first)
    for number in range(int(stage.duration / period) + 2):
        arm = sequence[number % len(sequence)]
        start = first + number * period
        ready, hit, back = start + 0.32 * period, start + 0.62 * period, start + period
        keys[arm] += [(start + 0.02, GUARD), (ready, wind), (hit, strike), (back, GUARD)]
        thrust = keyed(times, [(start, 0.0), (ready, -0.3), (hit, 1.0), (back, 0.0)]) * stage.style.amplitude
        turn = -stage.outward(arm) * thrust
        performance.pelvis.turn += 0.16 * turn
        performance.spine.turn += 0.32 * turn
        performance.head.turn -= 0.42 * turn
        performance.place[:, 1] += 0.035 * thrust
    for arm in (0, 1):
        stage.arm_course(arm, keys[arm])
    performance.hang *= 0.2


def kick(stage: Stage, way: str = "front", side: str | None = None) -> None:
    """Kick with one leg, again and again: "front", "side", "back", or only raise the "knee"."""
    period, performance, times = stage.seconds(1.55), stage.performance, stage.times
    leg = stage.leading(side)
    out = stage.outward(leg)
    size = 0.7 + 0.3 * stage.style.amplitude
    height, reach, point = {
        "front": (0.56, (0.0, 0.72), 0.5),
        "side": (0.48, (out * 0.62, 0.0), 0.1),
        "back": (0.38, (0.0, -0.48), 0.9),
        "knee": (0.45, (0.0, 0.3), 0.6),
    }[way]
    duration = stage.seconds(0.9)
    for start in stage.repeats(period):
        lift = start + stage.seconds(0.42)
        stage.step(
            leg,
            lift,
            duration,
            performance.feet[leg].place,
            performance.feet[leg].yaw,
            height=height * size,
            reach=(reach[0] * size, reach[1] * size),
            push=0.5,
            strike=0.2,
            point=point,
            early=1.0,
        )
        over = pulse(times, start, stage.seconds(0.42), duration, stage.seconds(0.22))
        stage.shift_weight(1 - leg, 0.8 * over)
        high = pulse(times, lift, 0.5 * duration, 0.0, 0.5 * duration)
        performance.drop += 0.03 * over
        performance.pelvis.bend += {"front": -0.25, "back": 0.4, "knee": -0.12}.get(way, 0.0) * high
        performance.spine.bend += {"front": 0.15, "back": 0.25, "knee": 0.08}.get(way, 0.0) * high
        performance.pelvis.lean -= out * (0.28 if way == "side" else 0.0) * high
        performance.spine.lean -= out * (0.1 if way == "side" else 0.0) * high
        for arm in (0, 1):
            performance.arms[arm].spread += 0.3 * over
            performance.arms[arm].swing += (0.5 if arm != leg else -0.35) * high * (way != "side")
            performance.arms[arm].elbow += 0.35 * over
    performance.hang *= 0.5


def throw(stage: Stage, way: str = "over", side: str | None = None) -> None:
    """Throw with one arm and a step ahead of the other leg: "over" the shoulder or "under"."""
    period, performance, times = stage.seconds(2.1), stage.performance, stage.times
    arm = stage.leading(side)
    foot, out = 1 - arm, stage.outward(arm)
    if way == "over":
        back, release, through_pose = (
            arm_pose((0.9, 0.05, -0.45), (0.25, 0.9, -0.5), twist=-0.3),
            arm_pose((0.35, 0.45, 0.85), (0.05, 0.5, 0.9), twist=-0.3),
            arm_pose((0.0, -0.55, 0.85), (-0.35, -0.6, 0.75)),
        )
    else:
        back, release, through_pose = (
            arm_pose((0.35, -0.75, -0.75), (0.3, -0.75, -0.65)),
            arm_pose((0.2, -0.6, 0.8), (0.1, -0.4, 0.95)),
            arm_pose((0.2, 0.2, 1), (0.05, 0.55, 0.9)),
        )
    aim = arm_pose((0.3, -0.1, 0.95), (0.1, 0.1, 1))
    tucked = arm_pose((0.42, -0.85, 0.05), (0.1, -0.1, 1))
    thrown: list[tuple[float, ArmPose]] = []
    free: list[tuple[float, ArmPose]] = []
    home = performance.feet[foot].place
    for start in stage.repeats(period):
        t = [start + stage.seconds(value) for value in (0.0, 0.62, 0.98, 1.25, 1.9)]
        thrown += [
            (t[0] + 0.02, stage.relaxed),
            (t[1], back),
            (t[2], release),
            (t[3], through_pose),
            (t[4], stage.relaxed),
        ]
        free += [(t[0] + 0.02, stage.relaxed), (t[1], aim), (t[2] + 0.05, tucked), (t[4], stage.relaxed)]
        stage.step(
            foot,
            t[0] + stage.seconds(0.3),
            stage.seconds(0.42),
            (home[0], home[1] + 0.32),
            performance.feet[foot].yaw,
            push=0.3,
            strike=-0.15,
        )
        stage.step(foot, t[0] + stage.seconds(1.5), stage.seconds(0.42), home, performance.feet[foot].yaw, push=0.4)
        wound = keyed(times, [(t[0], 0.0), (t[1], -1.0), (t[2] + 0.06, 0.9), (t[4], 0.0)]) * stage.style.amplitude
        forward = keyed(times, [(t[0] + stage.seconds(0.3), 0.0), (t[2], 1.0), (t[2] + 0.15, 1.0), (t[4], 0.0)])
        performance.spine.turn += 0.4 * out * wound
        performance.pelvis.turn += 0.22 * out * wound
        performance.head.turn -= 0.5 * out * wound
        performance.place[:, 1] += 0.15 * forward - 0.05 * pulse(times, t[0], 0.35, 0.0, 0.35)
        performance.drop += 0.03 * forward
        performance.spine.bend += 0.2 * forward * np.clip(wound, 0.0, None) + 0.1 * np.clip(wound, -1.0, 0.0) * 0.5
    stage.arm_course(arm, thrown)
    stage.arm_course(foot, free)
    performance.hang *= 0.3
