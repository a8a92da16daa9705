"""Dances: swaying, side steps, twisting, disco, a box step, robot, cha-cha, waves of the arms; all on a beat."""

from __future__ import annotations

import itertools

import numpy as np

from motions.arms import ArmPose, arm_pose
from motions.stage import CALM_SECONDS, Stage
from motions.timing import oscillation, transition

BEGIN = CALM_SECONDS


def _beat(stage: Stage, neutral: float = 0.52) -> float:
    """Duration of a beat at the variant's tempo [s]."""
    return stage.seconds(neutral)


def _bounce(stage: Stage, beat: float, depth: float) -> None:
    """Bend the knees on every beat."""
    wave = 0.5 * (1.0 - np.cos(2.0 * np.pi * (stage.times - BEGIN) / beat))
    stage.performance.drop += depth * (0.35 + wave) * transition(stage.times, BEGIN, BEGIN + 0.6)


def _groove(stage: Stage, period: float, hips: float, chest: float, phase: float = 0.0) -> np.ndarray:
    """Hips swing to the sides, the chest answers against them a little later; returns the swing of the hips, -1..1."""
    swing = oscillation(stage.times, period, BEGIN, phase, ramp=0.7) * stage.style.sway
    late = oscillation(stage.times, period, BEGIN, phase - 0.6, ramp=0.7) * stage.style.sway
    performance = stage.performance
    stage.shift_weight(0, 0.42 * hips * swing)
    performance.pelvis.lean -= 0.12 * hips * swing
    performance.spine.lean += 0.12 * hips * swing - 0.14 * chest * late
    performance.spine.turn += 0.18 * chest * late
    performance.pelvis.turn -= 0.12 * chest * swing
    performance.head.lean += 0.12 * chest * late
    performance.head.turn -= 0.1 * chest * late
    return swing


def _arms_on_beats(stage: Stage, beat: float, patterns: tuple[list[ArmPose], list[ArmPose]]) -> None:
    """Move each arm to the next pose of its pattern on every beat, starting over at the end."""
    for arm, poses in enumerate(patterns):
        count = int(stage.duration / beat) + 3
        stage.arm_course(arm, [(BEGIN + (index + 1) * beat, poses[index % len(poses)]) for index in range(count)])
    stage.performance.hang *= 0.3


def _leading_first(stage: Stage, first: list[ArmPose], second: list[ArmPose]) -> tuple[list[ArmPose], list[ArmPose]]:
    return (first, second) if stage.leading() == 0 else (second, first)


def sway(stage: Stage, arms: str = "low") -> None:
    """Sway from foot to foot; arms swing "low" before the body or float "high" over the head."""
    beat = _beat(stage, 0.62)
    swing = _groove(stage, 2.0 * beat, 1.0, 1.0)
    _bounce(stage, beat, 0.018)
    performance = stage.performance
    if arms == "low":
        bent = arm_pose((0.45, -0.85, 0.15), (0.1, -0.2, 1.0), twist=-0.2)
        for arm in (0, 1):
            stage.arm_course(arm, [(BEGIN + 0.6, bent)])
            performance.arms[arm].swing += 0.3 * stage.outward(arm) * swing * stage.style.amplitude
            performance.arms[arm].spread += 0.12 * stage.outward(arm) * swing + 0.1
            performance.arms[arm].elbow += 0.2 * stage.outward(arm) * swing
    else:
        high = arm_pose((0.45, 1.0, 0.15), (0.1, 1.0, 0.2))
        for arm in (0, 1):
            stage.arm_course(arm, [(BEGIN + 0.4, arm_pose((1, 0.0, 0.2), (0.9, 0.4, 0.2))), (BEGIN + 0.85, high)])
            performance.arms[arm].spread -= 0.28 * stage.outward(arm) * swing * stage.style.amplitude
    performance.hang *= 0.2


def side_steps(stage: Stage, steps: int = 1, arms: str = "swing", kick: bool = False) -> None:
    """Step to the side and touch, then back: one or two steps each way; arms "swing" or "clap", feet may kick."""
    beat = _beat(stage)
    performance, times = stage.performance, stage.times
    width = 0.27 * (0.75 + 0.25 * stage.style.amplitude)
    feet, home = performance.feet, [performance.feet[side].place for side in (0, 1)]
    offset, first = 0.0, stage.leading()
    count = int(stage.duration / beat) + 2
    centre = [(0.0, 0.0)]
    for index in range(count):
        bar, within = divmod(index, 2 * steps)
        going = first if bar % 2 == 0 else 1 - first
        foot = going if within % 2 == 0 else 1 - going
        touch = within == 2 * steps - 1
        if within % 2 == 0:
            offset += stage.outward(going) * width
        start = BEGIN + 0.08 + index * beat
        place = (home[foot][0] + offset, home[foot][1] + (0.04 if touch else 0.0))
        stage.step(
            foot,
            start,
            0.7 * beat,
            place,
            feet[foot].yaw,
            height=0.07,
            push=0.4,
            strike=0.35 if touch else 0.1,
            reach=(0.0, 0.3) if kick and touch else (0.0, 0.0),
        )
        centre.append((start + 0.9 * beat, offset))
    for (_, before), (moment, after) in itertools.pairwise(centre):
        performance.place[:, 0] += (after - before) * transition(times, moment - 0.95 * beat, moment + 0.1 * beat)
    stage.balance(0.35, 0.14)
    _bounce(stage, beat, 0.03)
    period = 4.0 * steps * beat
    _groove(stage, 2.0 * beat, 0.0, 0.7 * stage.outward(first))
    if arms == "swing":
        bent = arm_pose((0.42, -0.88, 0.1), (0.05, 0.05, 1.0), twist=-0.3)
        for arm in (0, 1):
            stage.arm_course(arm, [(BEGIN + 0.6, bent)])
            pump = oscillation(times, 2.0 * beat, BEGIN, np.pi * arm, ramp=0.6)
            performance.arms[arm].swing += 0.5 * stage.style.amplitude * pump
            performance.arms[arm].spread += 0.1
    else:
        opened, closed = (
            arm_pose((0.75, -0.5, 0.5), (0.45, 0.35, 0.9), twist=-0.6),
            arm_pose((0.38, -0.6, 0.75), (-0.5, 0.3, 0.8), twist=-0.6),
        )
        _arms_on_beats(stage, beat, ([opened, closed], [opened, closed]))
    performance.head.turn += 0.15 * oscillation(times, period, BEGIN) * stage.outward(first)
    performance.hang *= 0.3


def twist_dance(stage: Stage) -> None:
    """The twist: hips and bent arms turn against each other, knees deep, weight from foot to foot."""
    period = _beat(stage, 0.6)
    turn = oscillation(stage.times, period, BEGIN, ramp=0.7, sharpness=0.3) * stage.style.amplitude
    slow = oscillation(stage.times, 5.0 * period, BEGIN, ramp=0.9) * stage.style.sway
    performance = stage.performance
    performance.pelvis.turn += 0.34 * turn
    performance.spine.turn -= 0.62 * turn
    performance.head.turn += 0.25 * turn
    performance.drop += transition(stage.times, BEGIN, 0.8) * (0.09 + 0.03 * slow)
    performance.spine.bend += 0.14 * transition(stage.times, BEGIN, 0.8)
    stage.shift_weight(0, 0.4 * slow)
    bent = arm_pose((0.55, -0.8, 0.12), (0.05, 0.05, 1.0), twist=-0.2)
    for arm in (0, 1):
        stage.arm_course(arm, [(BEGIN + 0.5, bent)])
        performance.arms[arm].swing += 0.35 * stage.outward(arm) * turn
    performance.hang *= 0.2


def disco(stage: Stage) -> None:
    """Point up and out, then down across, on the beat; hips to the side of the arm."""
    beat = _beat(stage, 0.56)
    up = arm_pose((0.75, 0.85, 0.2), (0.6, 1.0, 0.2))
    down = arm_pose((0.25, -0.7, 0.65), (-0.3, -0.55, 0.75))
    rest = arm_pose((0.75, -0.75, -0.12), (-0.3, -0.55, 0.75), twist=-0.5, wrist=0.2)
    _arms_on_beats(stage, beat, _leading_first(stage, [up, down], [rest]))
    _groove(stage, 2.0 * beat, 1.3, 0.8, phase=0.0 if stage.leading() == 0 else np.pi)
    _bounce(stage, beat, 0.025)
    reach = oscillation(stage.times, 2.0 * beat, BEGIN + 0.1, ramp=0.6) * stage.outward(stage.leading())
    stage.performance.spine.turn += 0.2 * reach
    stage.performance.head.turn += 0.2 * reach


def box_step(stage: Stage) -> None:
    """A waltz box: ahead, side, together, back, side, together; arms as if holding a partner."""
    beat = _beat(stage, 0.58)
    performance, times = stage.performance, stage.times
    first = stage.leading()
    out = stage.outward(first)
    size = 0.3 * (0.75 + 0.25 * stage.style.amplitude)
    home = [performance.feet[side].place for side in (0, 1)]
    corners = [(0.0, size), (-out * size, size), (-out * size, size), (-out * size, 0.0), (0.0, 0.0), (0.0, 0.0)]
    order = [first, 1 - first, first, 1 - first, first, 1 - first]
    before = (0.0, 0.0)
    for index in range(int(stage.duration / beat) + 2):
        foot, corner = order[index % 6], corners[index % 6]
        start = BEGIN + 0.08 + index * beat
        place = (home[foot][0] + corner[0], home[foot][1] + corner[1])
        stage.step(foot, start, 0.72 * beat, place, performance.feet[foot].yaw, height=0.05, push=0.45, strike=0.1)
        share = transition(times, start, start + beat)[:, None]
        performance.place += share * (np.array(corner) - before)
        before = corner
    stage.balance(0.45, 0.16)
    rise = oscillation(times, 3.0 * beat, BEGIN, phase=-0.5 * np.pi, ramp=0.8)
    performance.drop += 0.015 * (1.0 - rise) * transition(times, BEGIN, 0.8)
    performance.spine.lean += 0.08 * oscillation(times, 6.0 * beat, BEGIN) * stage.style.sway
    performance.pelvis.turn += 0.2 * oscillation(times, 6.0 * beat, BEGIN) * stage.style.sway
    frame = arm_pose((0.85, 0.0, 0.5), (0.25, 0.45, 0.85), twist=-0.4)
    around = arm_pose((0.75, -0.1, 0.65), (-0.45, 0.1, 0.9), twist=-0.3)
    for arm, pose in enumerate(_leading_first(stage, [frame], [around])):
        stage.arm_course(arm, [(BEGIN + 0.7, pose[0])])
    performance.hang *= 0.2


def robot(stage: Stage) -> None:
    """Jerky right-angled poses, held between the beats."""
    beat = _beat(stage, 0.6)
    up = arm_pose((1.0, 0.0, 0.1), (0.1, 1.0, 0.1))
    down = arm_pose((1.0, 0.0, 0.1), (0.1, -0.95, 0.25))
    ahead = arm_pose((0.4, -0.9, 0.1), (0.1, 0.05, 1.0))
    # Each pose is reached in the first half of its beat and held in the second.
    for arm, poses in enumerate(_leading_first(stage, [up, ahead, down, ahead], [down, ahead, up, ahead])):
        keys = []
        for index in range(int(stage.duration / beat) + 2):
            pose = poses[index % 4]
            start = BEGIN + 0.15 + index * beat
            keys += [(start + 0.62 * beat, pose), (start + 0.98 * beat, pose)]
        stage.arm_course(arm, keys)
    turn = oscillation(stage.times, 4.0 * beat, BEGIN, ramp=0.6, sharpness=0.7) * stage.style.side
    performance = stage.performance
    performance.spine.turn += 0.32 * turn
    performance.head.turn += 0.3 * turn
    performance.spine.bend += 0.1 * oscillation(stage.times, 2.0 * beat, BEGIN, ramp=0.6, sharpness=0.7)
    stage.shift_weight(0, 0.3 * turn)
    performance.hang *= 0.0


def cha_cha(stage: Stage) -> None:
    """Rock step ahead and back with quick steps in place, lively hips."""
    beat = _beat(stage, 0.5)
    performance, times = stage.performance, stage.times
    first = stage.leading()
    home = [performance.feet[side].place for side in (0, 1)]
    size = 0.24 * (0.75 + 0.25 * stage.style.amplitude)
    # Beat, foot, how far ahead: rock, replace, then three quick steps; the second half goes back with the other foot.
    pattern = [
        (0, first, 1),
        (1, 1 - first, 0),
        (2, first, 0),
        (2.5, 1 - first, 0),
        (3, first, 0),
        (4, 1 - first, -1),
        (5, first, 0),
        (6, 1 - first, 0),
        (6.5, first, 0),
        (7, 1 - first, 0),
    ]
    for bar in range(int(stage.duration / (8.0 * beat)) + 1):
        for at, foot, ahead in pattern:
            start = BEGIN + 0.08 + (8.0 * bar + at) * beat
            place = (home[foot][0], home[foot][1] + ahead * size)
            duration = 0.4 * beat if at % 1 or at in (2, 3, 6, 7) else 0.6 * beat
            stage.step(foot, start, duration, place, performance.feet[foot].yaw, height=0.05, push=0.35, strike=0.1)
    performance.place[:, 1] += 0.5 * size * oscillation(times, 8.0 * beat, BEGIN, ramp=0.6)
    stage.balance(0.45, 0.1)
    _groove(stage, 2.0 * beat, 0.4, 1.2)
    _bounce(stage, beat, 0.012)
    bent = arm_pose((0.6, -0.75, 0.2), (0.1, 0.15, 1.0), twist=-0.2)
    for arm in (0, 1):
        stage.arm_course(arm, [(BEGIN + 0.5, bent)])
        performance.arms[arm].swing += 0.3 * oscillation(times, 2.0 * beat, BEGIN, np.pi * arm, ramp=0.6)
    performance.hang *= 0.2


def arm_wave(stage: Stage) -> None:
    """A wave that runs from one hand through the body to the other."""
    period = stage.seconds(1.5)
    performance, times = stage.performance, stage.times
    spread = arm_pose((1.0, 0.05, 0.1), (1.0, 0.0, 0.2))
    first = stage.leading()
    for arm in (0, 1):
        stage.arm_course(arm, [(BEGIN + 0.6, spread)])
        delay = 0.0 if arm == first else 2.4
        performance.arms[arm].spread += 0.35 * oscillation(times, period, BEGIN + 0.3, -delay - 0.8, ramp=0.7)
        performance.arms[arm].elbow += (
            0.35 * (1.0 + oscillation(times, period, BEGIN + 0.3, -delay, ramp=0.7)) * transition(times, 0.2, 0.9)
        )
        performance.arms[arm].wrist += 0.5 * oscillation(times, period, BEGIN + 0.3, -delay + 0.9, ramp=0.7)
    _groove(stage, period, 0.8, 1.1)
    _bounce(stage, period / 2.0, 0.02)
    performance.hang *= 0.2
