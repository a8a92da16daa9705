"""The whole body on one spot: squats, bows, jumps, kicks, punches, throws, lunges, bends and twists."""

from __future__ import annotations

import numpy as np

from motions.arms import ArmPose, arm_pose
from motions.stage import CALM_SECONDS, Stage
from motions.timing import keyed, oscillation, pulse, through, transition

BEGIN = CALM_SECONDS
GRAVITY = 9.81  # [m/s^2]
AHEAD = arm_pose((0.18, -0.05, 1), (0.08, 0.05, 1))
GUARD = arm_pose((0.42, -0.85, 0.35), (-0.3, 0.75, 0.6), twist=-0.4)


def _place_of(stage: Stage, side: int, ahead: float = 0.0, outward: float = 0.0) -> tuple[float, float]:
    """Ground position of a foot, moved from where the plan begins [m]."""
    x, z = stage.performance.feet[side].place
    return x + stage.outward(side) * outward, z + ahead


def _hips_back(stage: Stage, depth: np.ndarray) -> None:
    """Lower the pelvis by a depth [m]: it goes back and tilts, the trunk leans over the feet."""
    performance = stage.performance
    performance.drop += depth
    performance.place[:, 1] -= 0.28 * depth
    performance.pelvis.bend += 0.75 * depth
    performance.spine.bend += 0.55 * depth
    performance.head.bend -= 0.75 * depth


def squat(stage: Stage, depth: float = 0.36, arms: str = "ahead", period: float = 1.9, hold: float = 0.15) -> None:
    """Squat down and rise, arms stretched ahead or hanging."""
    depth *= 0.75 + 0.25 * stage.style.amplitude
    down, up = stage.seconds(0.43 * (period - hold)), stage.seconds(0.5 * (period - hold))
    keys: list[tuple[float, ArmPose]] = []
    for start in stage.repeats(stage.seconds(period)):
        low = pulse(stage.times, start, down, stage.seconds(hold), up)
        _hips_back(stage, depth * low)
        stage.performance.knees_out += 0.35 * low
        keys += [
            (start + 0.03, stage.relaxed),
            (start + down, AHEAD),
            (start + down + stage.seconds(hold) + up, stage.relaxed),
        ]
    if arms == "ahead":
        for arm in (0, 1):
            stage.arm_course(arm, keys)
            stage.performance.arms[arm].spread += 0.05
        stage.performance.hang[:] = 0.7


def bow(stage: Stage, angle: float = 1.0, hold: float = 0.35, style: str = "straight") -> None:
    """Bow ahead: "straight" arms along the body, or a "curtsy" with one foot behind."""
    period = 1.7 + hold
    performance = stage.performance
    performance.hang[:] = 0.55
    behind = stage.leading()
    for start in stage.repeats(stage.seconds(period)):
        down = pulse(stage.times, start, stage.seconds(0.75), stage.seconds(hold), stage.seconds(0.75))
        bend = angle * stage.style.amplitude * down
        performance.pelvis.bend += 0.42 * bend
        performance.spine.bend += 0.58 * bend
        performance.head.bend += 0.2 * bend
        performance.place[:, 1] -= 0.07 * bend
        if style == "curtsy":
            performance.drop += 0.11 * down
            performance.knees_out += 0.25 * down
            for arm in (0, 1):
                performance.arms[arm].spread += 0.35 * down
            duration = stage.seconds(0.45)
            back = _place_of(stage, behind, ahead=-0.24, outward=-0.08)
            stage.step(behind, start + 0.02, duration, back, 0.3 * stage.outward(behind), push=0.3, strike=0.5)
            leave = start + stage.seconds(0.9 + hold)
            stage.step(behind, leave, duration, _place_of(stage, behind), performance.feet[behind].yaw, push=0.6)
        else:
            for arm in (0, 1):
                performance.arms[arm].spread += 0.06 * down
    if style == "curtsy":
        stage.balance(0.35, 0.15)


def hop(
    stage: Stage,
    height: float = 0.2,
    ahead: float = 0.0,
    turn: float = 0.0,
    spread: float = 0.0,
    arms: str = "swing",
    crouch: float = 0.22,
    pause: float = 0.25,
    legs: str = "both",
) -> None:
    """Jump with both legs (or one), again and again.

    Args:
        height: Height of the flight [m].
        ahead: Distance [m], turn: rotation [rad] to the style's side, of each jump.
        spread: Distance by which the feet land wider, every other jump [m] (jumping jack).
        arms: "swing" up with the jump, "jack" (over the head with spread feet), "rope" (turning a rope), "rest".
        crouch: Depth of the crouch before and after [m].
        pause: Time standing between two jumps [s].
        legs: "both" or "one".
    """
    style, performance, times = stage.style, stage.performance, stage.times
    height = height * (0.7 + 0.3 * style.amplitude)
    rise = 0.06  # the body leaves the ground on its toes
    speed = np.sqrt(2.0 * GRAVITY * height)
    flight = 2.0 * speed / GRAVITY
    dip, push, absorb, stand = (stage.seconds(t) for t in (0.3, 0.24, 0.2, 0.35))
    period = dip + push + flight + absorb + stand + stage.seconds(pause)
    landing = 0.7 * crouch
    keys: list[list[tuple[float, ArmPose]]] = [[], []]
    for number, start in enumerate(stage.repeats(period)):
        take_off, land = start + dip + push, start + dip + push + flight
        drop = through(
            times,
            [
                (start, 0.0, 0.0, 0.0), (start + dip, crouch, 0.0, 0.0), (take_off, -rise, -speed, GRAVITY),
                (land, -rise, speed, GRAVITY), (land + absorb, landing, 0.0, 0.0), (land + absorb + stand, 0.0, 0.0, 0.0),
            ],
        )  # fmt: skip
        bent = np.clip(drop, 0.0, None)
        performance.drop += drop
        performance.place[:, 1] += ahead * transition(times, start + 0.6 * dip, land + 0.1) - 0.25 * bent
        performance.pelvis.bend += 1.0 * bent
        performance.spine.bend += 1.0 * bent
        performance.head.bend -= 1.2 * bent
        performance.pelvis.turn += turn * style.side * transition(times, take_off - 0.12, land + 0.08)
        _fly(stage, number, take_off, flight, height, ahead, turn * style.side, spread, legs)
        for arm in (0, 1):
            keys[arm] += _jump_arms(stage, arms, number, start, dip, take_off, land, absorb)
    for arm in (0, 1):
        if arms in ("swing", "jack"):
            stage.arm_course(arm, keys[arm])
        elif arms == "rope":
            stage.arm_course(arm, [(BEGIN + 0.35, arm_pose((0.5, -0.85, -0.1), (0.55, -0.15, 0.8), twist=0.3))])
            turning = 2.0 * np.pi * (times - BEGIN) / period
            performance.arms[arm].elbow += 0.25 * np.sin(turning) * transition(times, BEGIN, 0.5)
            performance.arms[arm].swing += 0.12 * np.cos(turning) * transition(times, BEGIN, 0.5)
    performance.hang *= 0.4
    if legs == "one":
        stage.shift_weight(stage.leading(), 0.75 * transition(times, 0.0, 0.35))


def _fly(
    stage: Stage,
    number: int,
    take_off: float,
    flight: float,
    height: float,
    ahead: float,
    turn: float,
    spread: float,
    legs: str,
) -> None:
    """Steps of both feet of one jump."""
    wide = spread if number % 2 == 0 else 0.0
    heading = turn * (number + 1)
    for side in (0, 1):
        x, z = _place_of(stage, side, ahead * (number + 1), wide)
        # Feet turn about the point under the pelvis.
        middle = stage.performance.place[0, 1]
        cosine, sine = np.cos(heading), np.sin(heading)
        place = (cosine * x + sine * (z - middle), -sine * x + cosine * (z - middle) + middle)
        yaw = stage.performance.feet[side].yaw + heading
        if legs == "one" and side != stage.leading():
            if number == 0:
                # The other leg is lifted before the first hop and stays up beyond the end of the clip.
                stage.step(
                    side, 0.12, stage.duration + 2.0, (x, z), yaw, height=0.3, reach=(0.0, -0.08), point=0.5, rise=0.4
                )
            continue
        stage.step(side, take_off, flight, place, yaw, height=height, push=0.55, strike=0.4, point=0.25, ballistic=True)


def _jump_arms(
    stage: Stage, arms: str, number: int, start: float, dip: float, take_off: float, land: float, absorb: float
) -> list[tuple[float, ArmPose]]:
    if arms == "jack":
        top, rest = arm_pose((0.45, 1, 0.1), (0.2, 1, 0.15)), arm_pose((0.4, -1, 0), (0.35, -1, 0.15))
        side = arm_pose((1, -0.1, 0.05), (1, 0.0, 0.15))
        target = top if number % 2 == 0 else rest
        return [
            (take_off - 0.04, rest if number % 2 == 0 else top),
            (0.5 * (take_off + land) + 0.03, side),
            (land + 0.08, target),
        ]
    back = arm_pose((0.35, -0.8, -0.6), (0.3, -0.9, -0.35))
    up = arm_pose((0.35, 0.75, 0.65), (0.15, 0.9, 0.5))
    return [
        (start + dip, back),
        (take_off + 0.06, up),
        (land, AHEAD),
        (land + absorb + stage.seconds(0.35), stage.relaxed),
    ]


def punch(stage: Stage, way: str = "straight", arms: str = "both") -> None:
    """Punch from a guard: "straight", "hook" or "uppercut"; with "both" arms in turn, or the "left" or "right" one only."""
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
        "front": (0.62, (0.0, 0.55), 0.5),
        "side": (0.5, (out * 0.5, 0.0), 0.1),
        "back": (0.38, (0.0, -0.48), 0.9),
        "knee": (0.45, (0.0, 0.3), 0.6),
    }[way]
    duration = stage.seconds(0.9)
    for start in stage.repeats(period):
        lift = start + stage.seconds(0.42)
        stage.step(
            leg, lift, duration, performance.feet[leg].place, performance.feet[leg].yaw, height=height * size,
            reach=(reach[0] * size, reach[1] * size), push=0.5, strike=0.2, point=point, early=1.0,
        )  # fmt: skip
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
        stage.step(foot, t[0] + stage.seconds(0.3), stage.seconds(0.42), (home[0], home[1] + 0.32), performance.feet[foot].yaw,
                   push=0.3, strike=-0.15)  # fmt: skip
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


def lunge(stage: Stage, way: str = "front") -> None:
    """Lunge with the legs in turn: "front", "side" or "back"; hands come together or to the hips."""
    period, performance, times = stage.seconds(2.0), stage.performance, stage.times
    far = 0.5 * (0.8 + 0.2 * stage.style.amplitude)
    keys: list[tuple[float, ArmPose]] = []
    clasped = arm_pose((0.5, -0.75, 0.45), (-0.45, 0.35, 0.85), twist=-0.4)
    for number, start in enumerate(stage.repeats(period)):
        leg = (stage.leading() + number) % 2
        plan = performance.feet[leg]
        ahead, outward = {"front": (far, 0.0), "side": (0.0, far), "back": (-far, 0.0)}[way]
        target = _place_of(stage, leg, ahead, outward)
        yaw = plan.yaw + (0.2 * stage.outward(leg) if way == "side" else 0.0)
        swing = stage.seconds(0.5)
        heel = {"front": -0.12, "side": 0.0, "back": 0.65}[way]
        stage.step(leg, start + 0.12, swing, target, yaw, push=0.3, strike=0.65 if way == "back" else heel, height=0.1)
        stage.step(leg, start + stage.seconds(1.2), swing, plan.place, plan.yaw, push=0.35, height=0.1)
        deep = keyed(
            times,
            [
                (start + 0.1, 0.0),
                (start + stage.seconds(0.85), 1.0),
                (start + stage.seconds(1.05), 1.0),
                (start + stage.seconds(1.75), 0.0),
            ],
        )
        performance.drop += 0.24 * deep
        performance.place[:, 1] += {"front": 0.45, "side": -0.12, "back": -0.55}[way] * far * deep
        performance.place[:, 0] += stage.outward(leg) * (0.6 * far * deep if way == "side" else 0.0)
        performance.spine.bend += (0.35 if way == "side" else 0.06) * deep
        performance.pelvis.bend += (0.25 if way == "side" else 0.08) * deep
        performance.head.bend -= (0.4 if way == "side" else 0.05) * deep
        keys += [
            (start + 0.05, stage.relaxed),
            (start + stage.seconds(0.8), clasped),
            (start + stage.seconds(1.1), clasped),
            (start + stage.seconds(1.85), stage.relaxed),
        ]
    for arm in (0, 1):
        stage.arm_course(arm, keys)
    performance.hang *= 0.4


def trunk_circle(stage: Stage, part: str = "hips") -> None:
    """Circle the hips over standing feet, the trunk upright; or circle the bent trunk over standing hips."""
    period, performance, times = stage.seconds(1.5 if part == "hips" else 2.6), stage.performance, stage.times
    side = stage.style.side
    strength = transition(times, BEGIN, BEGIN + 0.7) * stage.style.amplitude
    angle = 2.0 * np.pi * (times - BEGIN) / period
    across, along = side * np.sin(angle) * strength, np.cos(angle) * strength
    if part == "hips":
        performance.place += np.stack([0.085 * across, 0.065 * along], axis=-1)
        performance.pelvis.bend -= 0.16 * along
        performance.pelvis.lean -= 0.16 * across
        performance.spine.bend += 0.24 * along
        performance.spine.lean += 0.22 * across
        hips = arm_pose((0.75, -0.75, -0.12), (-0.3, -0.55, 0.75), twist=-0.5, wrist=0.2)
        for arm in (0, 1):
            stage.arm_course(arm, [(BEGIN + 0.55, hips)])
        performance.hang *= 0.2
    else:
        performance.spine.bend += 0.42 * (strength - 0.35 * (strength - along))
        performance.pelvis.bend += 0.15 * (strength + along)
        performance.spine.lean += 0.42 * across
        performance.place[:, 1] -= 0.03 * along
        performance.drop += 0.02 * strength


def bend(stage: Stage, way: str = "side") -> None:
    """Bend the trunk: "side" with one arm over the head, "toes" (touch the floor), "pick" something up from a squat, "back"."""
    performance, times = stage.performance, stage.times
    period = {"side": 2.0, "toes": 2.3, "pick": 2.4, "back": 2.2}[way]
    over = arm_pose((0.35, 1, 0.1), (-0.35, 1, 0.1))
    hip = arm_pose((0.75, -0.75, -0.12), (-0.3, -0.55, 0.75), twist=-0.5, wrist=0.2)
    down = arm_pose((0.15, -1, 0.3), (0.02, -1, 0.35))
    keys: list[list[tuple[float, ArmPose]]] = [[], []]
    for number, start in enumerate(stage.repeats(stage.seconds(period))):
        low = pulse(
            times, start, stage.seconds(0.42 * period), stage.seconds(0.1 * period), stage.seconds(0.42 * period)
        )
        side = stage.style.side * (-1) ** number
        amount = stage.style.amplitude * low
        middle, end = start + stage.seconds(0.45 * period), start + stage.seconds(period) - 0.05
        if way == "side":
            performance.spine.lean += 0.55 * side * amount
            performance.pelvis.lean += 0.1 * side * amount
            performance.place[:, 0] -= 0.05 * side * amount
            raised = 1 if side > 0 else 0
            for arm in (0, 1):
                keys[arm] += [
                    (start + 0.02, stage.relaxed),
                    (middle, over if arm == raised else hip),
                    (end, stage.relaxed),
                ]
            continue
        depth, pelvis, spine = {"toes": (0.05, 0.85, 1.0), "pick": (0.3, 0.55, 0.75), "back": (0.03, -0.12, -0.5)}[way]
        performance.drop += depth * low
        performance.pelvis.bend += pelvis * min(1.0, stage.style.amplitude) * low
        performance.spine.bend += spine * min(1.05, stage.style.amplitude) * low
        performance.head.bend += {"toes": 0.15, "pick": -0.1, "back": -0.3}[way] * low
        performance.place[:, 1] += {"toes": -0.12, "pick": -0.12, "back": 0.08}[way] * low
        performance.knees_out += (0.2 if way == "pick" else 0.0) * low
        for arm in (0, 1):
            pose = hip if way == "back" else down
            keys[arm] += [(start + 0.02, stage.relaxed), (middle, pose), (end, stage.relaxed)]
    for arm in (0, 1):
        stage.arm_course(arm, keys[arm])
    performance.hang[:] = 0.9 if way in ("toes", "pick") else 0.2


def twist(stage: Stage, arms: str = "loose") -> None:
    """Turn the trunk from side to side: arms "loose" (flung outward), "spread" (horizontal) or at the "hips"."""
    period, performance, times = stage.seconds(1.5), stage.performance, stage.times
    turn = oscillation(times, period, BEGIN, ramp=0.6) * stage.style.side * stage.style.amplitude
    performance.pelvis.turn += 0.24 * turn
    performance.spine.turn += 0.6 * turn
    performance.head.turn -= 0.15 * turn
    performance.drop += 0.012 * np.abs(turn)
    stage.shift_weight(0, 0.25 * turn)
    if arms == "loose":
        late = oscillation(times, period, BEGIN, phase=-0.7, ramp=0.6) * stage.style.side * stage.style.amplitude
        for arm in (0, 1):
            performance.arms[arm].spread += 0.3 * transition(times, BEGIN, 0.9) + 0.1 * np.abs(late)
            performance.arms[arm].swing -= 0.35 * stage.outward(arm) * late
            performance.arms[arm].elbow += 0.3 * transition(times, BEGIN, 0.9)
        return
    pose = {
        "spread": arm_pose((1, 0.05, 0.0), (1, 0.08, 0.12)),
        "hips": arm_pose((0.75, -0.75, -0.12), (-0.3, -0.55, 0.75), twist=-0.5, wrist=0.2),
    }[arms]
    for arm in (0, 1):
        stage.arm_course(arm, [(BEGIN + 0.6, pose)])
    performance.hang *= 0.2


def balance_on_one_leg(stage: Stage) -> None:
    """Stand on one leg with the other knee raised and the arms spread, swaying a little."""
    performance, times = stage.performance, stage.times
    leg = stage.leading()
    stage.step(
        leg, 0.4, stage.duration + 2.0, performance.feet[leg].place, performance.feet[leg].yaw,
        height=0.38, reach=(0.0, 0.2), push=0.3, point=0.5, rise=stage.seconds(0.6),
    )  # fmt: skip
    up = transition(times, 0.1, 0.6)
    stage.shift_weight(1 - leg, 0.9 * up)
    spread = arm_pose((1, -0.02, 0.1), (1, 0.1, 0.2))
    for arm in (0, 1):
        stage.arm_course(arm, [(BEGIN + 0.8, spread)])
    wobble = oscillation(times, stage.seconds(1.3), 0.6, ramp=0.8) * stage.style.sway
    performance.spine.lean += 0.07 * wobble
    performance.pelvis.lean -= 0.05 * wobble
    for arm in (0, 1):
        performance.arms[arm].spread -= 0.12 * stage.outward(arm) * wobble
    performance.hang *= 0.3
