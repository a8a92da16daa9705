"""The whole body on one spot: squats, bows, lunges, bends and twists, circles of hips and trunk, balance."""

from __future__ import annotations

import numpy as np

from motions.arms import ArmPose, arm_pose
from motions.stage import CALM_SECONDS, Stage
from motions.timing import keyed, oscillation, pulse, transition

BEGIN = CALM_SECONDS
AHEAD = arm_pose((0.18, -0.05, 1), (0.08, 0.05, 1))
BEFORE_HIPS = arm_pose((0.75, -0.75, -0.12), (-0.3, -0.55, 0.75), twist=-0.5, wrist=0.2)  # room for moving hips
ON_HIPS = arm_pose((0.75, -0.75, -0.12), (-0.42, -0.62, 0.62), twist=-0.5, wrist=0.2)


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
        for arm in stage.performance.arms:
            # Outside of the thighs, which come up between the arms.
            arm.spread += (0.25 if arms == "ahead" else 0.4) * low
            arm.swing += (0.0 if arms == "ahead" else 0.5) * low
    if arms == "ahead":
        for side in (0, 1):
            stage.arm_course(side, keys)
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
            back = stage.beside(behind, ahead=-0.24, outward=-0.08)
            stage.step(behind, start + 0.15, duration, back, 0.3 * stage.outward(behind), push=0.3, strike=0.5)
            leave = start + stage.seconds(0.9 + hold)
            stage.step(behind, leave, duration, stage.beside(behind), performance.feet[behind].yaw, push=0.6)
        else:
            for arm in (0, 1):
                performance.arms[arm].spread += 0.06 * down
    if style == "curtsy":
        stage.balance(0.35, 0.15)


def lunge(stage: Stage, way: str = "front") -> None:
    """Lunge with the legs in turn: "front", "side" or "back"; the hands come together."""
    period, performance, times = stage.seconds(2.0), stage.performance, stage.times
    far = 0.5 * (0.8 + 0.2 * stage.style.amplitude)
    keys: list[tuple[float, ArmPose]] = []
    clasped = arm_pose((0.5, -0.75, 0.45), (-0.45, 0.35, 0.85), twist=-0.4)
    for number, start in enumerate(stage.repeats(period)):
        leg = (stage.leading() + number) % 2
        plan = performance.feet[leg]
        ahead, outward = {"front": (far, 0.0), "side": (0.0, far), "back": (-far, 0.0)}[way]
        target = stage.beside(leg, ahead, outward)
        yaw = plan.yaw + (0.2 * stage.outward(leg) if way == "side" else 0.0)
        swing = stage.seconds(0.5)
        strike, leave = {"front": -0.12, "side": 0.0, "back": 0.65}[way], start + stage.seconds(1.2)
        stage.step(leg, start + 0.12, swing, target, yaw, push=0.3, strike=strike, height=0.1)
        stage.step(leg, leave, swing, plan.place, plan.yaw, push=0.65 if way == "back" else 0.35, height=0.1)
        deep = keyed(
            times,
            [
                (start + 0.1, 0.0),
                (start + stage.seconds(0.85), 1.0),
                (start + stage.seconds(1.05), 1.0),
                (start + stage.seconds(1.75), 0.0),
            ],
        )
        # The foot behind stands on its ball: with the heel down its ankle would bend too far.
        if way == "front":
            stage.raise_heel(1 - leg, 0.6 * deep)
        elif way == "back":
            landed = start + 0.12 + swing
            kept = transition(times, landed, landed + 0.11) - transition(times, leave - 0.3, leave)
            stage.raise_heel(leg, 0.65 * kept)
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
        for arm in (0, 1):
            stage.arm_course(arm, [(BEGIN + 0.55, BEFORE_HIPS)])
        performance.hang *= 0.2
    else:
        performance.spine.bend += 0.42 * (strength - 0.35 * (strength - along))
        performance.pelvis.bend += 0.15 * (strength + along)
        performance.spine.lean += 0.42 * across
        performance.place[:, 1] -= 0.03 * along
        performance.drop += 0.02 * strength
        for arm in performance.arms:
            arm.spread += 0.2 * strength


def bend(stage: Stage, way: str = "side") -> None:
    """Bend the trunk: "side" (one arm over the head), "toes" (touch the floor), "pick" something up, "back"."""
    performance, times = stage.performance, stage.times
    period = {"side": 2.0, "toes": 2.3, "pick": 2.4, "back": 2.2}[way]
    over = arm_pose((0.35, 1, 0.1), (-0.35, 1, 0.1))
    down = arm_pose((0.12, -1, 0.85), (0.0, -1, 0.85)) if way == "pick" else arm_pose((0.15, -1, 0.3), (0.02, -1, 0.35))
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
                    (middle, over if arm == raised else ON_HIPS),
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
            pose = ON_HIPS if way == "back" else down
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
        "hips": ON_HIPS,
    }[arms]
    for arm in (0, 1):
        stage.arm_course(arm, [(BEGIN + 0.6, pose)])
    performance.hang *= 0.2


def balance_on_one_leg(stage: Stage) -> None:
    """Stand on one leg with the other knee raised and the arms spread, swaying a little."""
    performance, times = stage.performance, stage.times
    leg = stage.leading()
    stage.step(
        leg,
        0.4,
        stage.duration + 2.0,
        performance.feet[leg].place,
        performance.feet[leg].yaw,
        height=0.38,
        reach=(0.0, 0.2),
        push=0.4,
        strike=0.4,
        point=0.2,
        rise=stage.seconds(0.6),
    )
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
