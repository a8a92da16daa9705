"""Jumping: up, ahead, turning, as a jack, over a rope, on one leg; ballistic flight between a crouch and a landing."""

from __future__ import annotations

import numpy as np

from motions.arms import ArmPose, arm_pose
from motions.stage import CALM_SECONDS, Stage
from motions.timing import through, transition

BEGIN = CALM_SECONDS
GRAVITY = 9.81  # [m/s^2]
AHEAD = arm_pose((0.18, -0.05, 1), (0.08, 0.05, 1))


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
                (start, 0.0, 0.0, 0.0),
                (start + dip, crouch, 0.0, 0.0),
                (take_off, -rise, -speed, GRAVITY),
                (land, -rise, speed, GRAVITY),
                (land + absorb, landing, 0.0, 0.0),
                (land + absorb + stand, 0.0, 0.0, 0.0),
            ],
        )
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
        x, z = stage.beside(side, ahead * (number + 1), wide)
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
        # In a low jump pointed toes would scrape over the ground.
        point = 0.25 * min(1.0, max(0.0, height - 0.08) / 0.08)
        stage.step(
            side, take_off, flight, place, yaw, height=height, push=0.55, strike=0.4, point=point, ballistic=True
        )


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
