"""Moving from place to place: walking, running, marching, sneaking, sidestepping, turning.

Feet are placed where the pelvis will be in the middle of their stance, so that any path (ahead, back, sideways,
curved) and any change of speed gives steps that fit. Sources of the numbers: Winter 1991 (gait phases, joint
excursions), Novacheck 1998 (running).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from motions.arms import ArmTrack, arm_pose
from motions.feet import Step
from motions.stage import CALM_SECONDS, Stage
from motions.timing import blend_rotations, minimum_jerk, transition


@dataclass(frozen=True)
class Gait:
    """A manner of walking; angles in radians.

    Attributes:
        speed: Travelling speed [m/s].
        cycle: Duration of two steps [s].
        duty: Part of the cycle that a foot is on the ground; below 0.5 there is a flight between steps.
        heading: Direction of travel relative to where the body faces, to the left [rad].
        turning: Change of direction [rad/s], to the left.
        height: Height of the ankle in the swing [m].
        reach: Extra movement of the swinging foot ahead, in the middle of the swing [m].
        push, strike: Foot pitch at lifting and landing [rad].
        width: Distance of the feet relative to standing.
        ahead: Part of the stance before the pelvis passes the foot.
        drop: Extra knee bend [m].
        bob: Vertical movement of the pelvis, lowest in the middle of the stance [m].
        arm_swing: Amplitude of the arms [rad].
        elbow: Elbow flexion [rad].
        lean: Forward bend of the trunk [rad].
        pelvis_turn: Amplitude of the pelvis' rotation with the steps [rad].
        early: See :class:`motions.feet.Step`.
    """

    speed: float
    cycle: float
    duty: float = 0.6
    heading: float = 0.0
    turning: float = 0.0
    height: float = 0.07
    reach: float = 0.0
    push: float = 0.65
    strike: float = -0.3
    width: float = 0.75
    ahead: float = 0.43
    drop: float = 0.0
    bob: float = 0.0
    arm_swing: float = 0.38
    elbow: float = 0.3
    lean: float = 0.03
    pelvis_turn: float = 0.1
    early: float = 0.75


GAITS: dict[str, Gait] = {
    "walk": Gait(speed=1.0, cycle=1.06),
    "walk-slow": Gait(speed=0.65, cycle=1.35, duty=0.64, height=0.065, push=0.5, strike=-0.2, arm_swing=0.22),
    "walk-fast": Gait(speed=1.4, cycle=0.9, duty=0.56, height=0.08, arm_swing=0.55, elbow=0.6, lean=0.07),
    "walk-back": Gait(
        speed=0.75, cycle=1.12, duty=0.62, heading=np.pi, push=0.15, strike=0.3, height=0.07, arm_swing=0.15, ahead=0.5
    ),
    "walk-in-place": Gait(speed=0.0, cycle=1.0, height=0.13, push=0.6, strike=0.2, arm_swing=0.3, ahead=0.5),
    "walk-curve": Gait(speed=1.0, cycle=1.1, turning=0.75),
    "tiptoe": Gait(speed=0.6, cycle=0.95, duty=0.62, height=0.095, push=0.75, strike=0.55, arm_swing=0.1, drop=-0.01),
    "stride": Gait(speed=1.2, cycle=1.2, duty=0.57, height=0.09, arm_swing=0.5, drop=0.02, pelvis_turn=0.16),
    "stomp": Gait(speed=0.75, cycle=1.1, duty=0.58, height=0.24, reach=0.1, push=0.4, strike=0.0, drop=0.02, bob=0.02),
    "run": Gait(
        speed=2.5,
        cycle=0.74,
        duty=0.36,
        height=0.25,
        push=0.85,
        strike=-0.08,
        width=0.45,
        drop=0.05,
        bob=0.035,
        arm_swing=0.6,
        elbow=1.5,
        lean=0.14,
        pelvis_turn=0.16,
        early=0.6,
        ahead=0.33,
    ),
    "jog": Gait(
        speed=1.9,
        cycle=0.76,
        duty=0.42,
        height=0.19,
        push=0.7,
        strike=-0.05,
        width=0.55,
        drop=0.04,
        bob=0.03,
        arm_swing=0.42,
        elbow=1.45,
        lean=0.09,
        pelvis_turn=0.12,
        early=0.65,
        ahead=0.37,
    ),
    "run-in-place": Gait(
        speed=0.0,
        cycle=0.7,
        duty=0.42,
        height=0.24,
        push=0.8,
        strike=0.3,
        width=0.7,
        drop=0.035,
        bob=0.025,
        arm_swing=0.4,
        elbow=1.5,
        lean=0.04,
        early=0.8,
        ahead=0.5,
    ),
    "march": Gait(
        speed=0.7,
        cycle=1.06,
        duty=0.56,
        height=0.36,
        reach=0.22,
        push=0.45,
        strike=0.1,
        arm_swing=0.65,
        elbow=0.35,
        lean=-0.02,
        drop=0.005,
        pelvis_turn=0.05,
        early=1.0,
        ahead=0.5,
    ),
    "march-in-place": Gait(
        speed=0.0,
        cycle=1.02,
        duty=0.56,
        height=0.36,
        reach=0.3,
        push=0.45,
        strike=0.15,
        arm_swing=0.6,
        elbow=0.9,
        lean=-0.02,
        drop=0.005,
        pelvis_turn=0.05,
        early=1.0,
        ahead=0.5,
    ),
    "sneak": Gait(
        speed=0.5,
        cycle=1.7,
        duty=0.62,
        height=0.17,
        reach=0.05,
        push=0.45,
        strike=0.3,
        drop=0.13,
        arm_swing=0.18,
        elbow=1.25,
        lean=0.38,
        pelvis_turn=0.12,
        ahead=0.5,
        early=0.9,
    ),
    "turn": Gait(
        speed=0.0,
        cycle=1.02,
        duty=0.6,
        turning=1.25,
        height=0.06,
        push=0.4,
        strike=0.0,
        arm_swing=0.14,
        ahead=0.5,
        width=0.95,
    ),
    "spin": Gait(
        speed=0.0,
        cycle=0.72,
        duty=0.56,
        turning=2.9,
        height=0.085,
        push=0.45,
        strike=0.25,
        arm_swing=0.05,
        ahead=0.5,
        width=0.9,
    ),
    "sidestep": Gait(
        speed=0.42,
        cycle=0.98,
        duty=0.58,
        heading=np.pi / 2,
        height=0.06,
        push=0.3,
        strike=0.15,
        arm_swing=0.06,
        width=1.25,
        pelvis_turn=0.0,
        ahead=0.5,
        drop=0.02,
    ),
    "shuffle": Gait(
        speed=0.9,
        cycle=0.66,
        duty=0.54,
        heading=np.pi / 2,
        height=0.065,
        push=0.3,
        strike=0.2,
        arm_swing=0.05,
        width=1.7,
        pelvis_turn=0.0,
        ahead=0.5,
        drop=0.1,
        elbow=1.3,
        lean=0.22,
    ),
}


def travel(stage: Stage, gait: str, direction: str | None = None, hands: str = "swing") -> None:
    """Walk, run or step with one of the gaits.

    Args:
        stage: The stage.
        gait: Key of ``GAITS``.
        direction: "left" or "right" for gaits that turn or go sideways; None keeps the gait's own (left is positive).
        hands: "swing", "ahead" (stretched, sleepwalking), "guard" (held before the chest).
    """
    manner, style, times, performance = GAITS[gait], stage.style, stage.times, stage.performance
    sign = -1.0 if direction == "right" else 1.0
    cycle = manner.cycle / style.tempo
    speed = manner.speed * style.tempo * (0.5 + 0.5 * style.amplitude)
    swing = (1.0 - manner.duty) * cycle
    begin = CALM_SECONDS + 0.1
    # Going sideways, the foot on that side goes first: the other one would cross over.
    leading = stage.leading(direction) if direction else stage.leading()
    ramp = min(0.9 * cycle, 0.8)

    fine = np.arange(0.0, stage.duration + 2.0 * cycle + 0.01, 1.0 / 240.0)
    strength = transition(fine, begin, begin + ramp)
    wander = 0.0 if manner.turning or abs(manner.heading) > 0.1 else stage.generator.uniform(-0.12, 0.12)
    yaw = np.cumsum((manner.turning * style.tempo * sign + wander) * strength) / 240.0
    course = yaw + manner.heading * sign
    path = np.cumsum(speed * strength[:, None] * np.stack([np.sin(course), np.cos(course)], axis=-1), axis=0) / 240.0

    def position(at: np.ndarray | float) -> np.ndarray:
        return np.stack([np.interp(at, fine, path[:, 0]), np.interp(at, fine, path[:, 1])], axis=-1)

    for side in range(2):
        plan = performance.feet[side]
        first = begin + (0.0 if side == leading else 0.5 * cycle)
        for lift in np.arange(first, stage.duration, cycle):
            land = lift + swing
            passing = land + manner.ahead * (cycle - swing)
            turned = float(np.interp(passing, fine, yaw))
            # The first steps narrow the stance gradually.
            width = 1.0 + (manner.width - 1.0) * float(minimum_jerk((land - begin) / cycle))
            aside = plan.place[0] * width
            place = position(passing) + np.array([np.cos(turned), -np.sin(turned)]) * aside
            place += np.array([np.sin(turned), np.cos(turned)]) * plan.place[1]
            begun = 0.5 + 0.5 * float(minimum_jerk((lift - begin) / cycle)) if lift < begin + cycle else 1.0
            plan.steps.append(
                Step(
                    lift=lift,
                    land=land,
                    place=(float(place[0]), float(place[1])),
                    yaw=turned + plan.yaw * 0.7,
                    height=manner.height * (0.6 + 0.4 * style.amplitude) * (0.6 + 0.4 * begun),
                    push=manner.push * begun * min(style.amplitude, 1.1),
                    strike=manner.strike * begun,
                    reach=(0.0, manner.reach * style.amplitude * begun),
                    early=manner.early,
                )
            )

    performance.place += position(times)
    performance.pelvis.turn += np.interp(times, fine, yaw)
    stage.balance(share=0.5 if manner.duty > 0.5 else 0.25)
    _follow_steps(stage, manner, begin + (0.0 if leading == 0 else 0.5 * cycle) + swing, cycle, begin, ramp)
    _carry_arms(stage, manner, hands, begin, ramp)
    if manner.turning:
        # Eyes and chest go ahead of the feet into the turn.
        eager = sign * transition(times, begin, begin + ramp) * min(manner.turning, 1.5)
        performance.spine.turn += 0.16 * eager
        performance.head.turn += 0.2 * eager


def _follow_steps(stage: Stage, manner: Gait, landed: float, cycle: float, begin: float, ramp: float) -> None:
    """Rotation and bob of pelvis, trunk and arms; `landed` is a time at which the left foot lands [s]."""
    style, times, performance = stage.style, stage.times, stage.performance
    strength = transition(times, begin, begin + ramp)
    phase = 2.0 * np.pi * (times - landed) / cycle
    forward = -1.0 if abs(manner.heading) > 2.0 else 1.0
    turn = forward * manner.pelvis_turn * style.sway * strength * np.cos(phase)
    performance.pelvis.turn -= turn
    performance.spine.turn += 2.0 * turn
    performance.head.turn -= 0.9 * turn
    hips = 0.06 * style.sway * strength * np.sin(phase)
    performance.pelvis.lean -= hips
    performance.spine.lean += 1.25 * hips
    # Twice a cycle the body is lowest: while walking by the reach of the legs alone, while running in the middle of
    # each stance.
    middle = 2.0 * np.pi * manner.duty * 0.5
    performance.drop += strength * (manner.drop + manner.bob * np.cos(2.0 * (phase - middle)))
    performance.pelvis.bend += 0.35 * manner.lean * strength
    performance.spine.bend += strength * (0.65 * manner.lean + 0.02 * np.cos(2.0 * phase))
    performance.head.bend -= strength * (0.7 * manner.lean + 0.015 * np.cos(2.0 * phase - 0.6))
    for side in range(2):
        opposite = -stage.outward(side) * forward * np.cos(phase - 0.15)
        amplitude = manner.arm_swing * style.amplitude * strength
        # Bent far over, the hands are held ahead of the rising knees.
        held = 0.8 * max(0.0, manner.lean - 0.2) * strength
        performance.arms[side].swing += amplitude * (opposite + 0.12) + held
        performance.arms[side].spread += 0.06 * strength * np.abs(manner.arm_swing) * (1.0 + opposite)
        performance.arms[side].elbow += strength * (
            max(0.0, manner.elbow - 0.3) + 0.45 * manner.arm_swing * (0.6 + opposite)
        )
    performance.hang[:] = 0.85 - 0.45 * strength * (manner.elbow > 1.0)


def _carry_arms(stage: Stage, manner: Gait, hands: str, begin: float, ramp: float) -> None:
    """Poses of the arms that are not the swing of hanging ones."""
    if hands == "swing":
        return
    pose = {
        "ahead": arm_pose((0.12, 0.02, 1.0), (-0.05, 0.08, 1.0), twist=-0.2, wrist=0.35),
        "guard": arm_pose((0.5, -0.8, 0.35), (-0.35, 0.55, 0.75), twist=-0.3),
    }[hands]
    for side in range(2):
        arm: ArmTrack = stage.performance.arms[side]
        arm.shoulder = blend_rotations(stage.times, [(begin, stage.relaxed.shoulder), (begin + 0.6, pose.shoulder)])
        share = transition(stage.times, begin, begin + 0.6)
        for name in ("elbow", "twist", "wrist"):
            base = getattr(stage.relaxed, name)
            setattr(arm, name, base + share * (getattr(pose, name) - base))
        arm.swing *= 1.0 - 0.75 * share
