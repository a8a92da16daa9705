"""Feet that stay where they stand: a plan of steps, turned into ankle positions, foot rotations and toe flexion.

Between two steps a foot does not slide: it lies flat, or rolls about its heel (toes up, after landing) or about the
ball of the foot (heel up, before lifting). A step swings the ankle along a quintic that takes over the speed of the
roll and arrives at rest, with a bump (height, and reach for kicks) on top.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from motions.figure import FootShape
from motions.timing import minimum_jerk, rotation_about

LANDED_EARLY = (
    0.92  # part of a swing after which the foot only descends: touching the ground while still moving would be a skid
)
ROLL_IN_SECONDS = 0.11
ROLL_OUT_SECONDS = 0.32
ROLL_POWER = 1.8  # of the heel's rise over time: still accelerating when the foot leaves the ground


@dataclass(frozen=True)
class Step:
    """One swing of a foot.

    Attributes:
        lift, land: Times [s] at which the foot leaves and touches the ground.
        place: Ground position (x, z) of the ankle with the foot flat, after landing [m].
        yaw: Direction of the foot after landing, to the left of +z [rad].
        height: Extra height of the ankle in the middle of the swing [m].
        push: Pitch at lifting, heel up [rad]; the foot rolls over its ball before.
        strike: Pitch at landing [rad]: negative lands on the heel, positive on the ball.
        reach: Extra movement (to the foot's left, ahead) in the middle of the swing [m].
        point: Extra pitch in the middle of the swing, toes down [rad].
        early: Below 1 the bump comes early in the swing, above 1 late.
        ballistic: The height is a parabola: both feet fly with the body in a jump.
        rise: Time [s] in which the foot is lifted and kept up, for standing on the other leg; None for an ordinary
            swing.
    """

    lift: float
    land: float
    place: tuple[float, float]
    yaw: float
    height: float
    push: float = 0.0
    strike: float = 0.0
    reach: tuple[float, float] = (0.0, 0.0)
    point: float = 0.0
    early: float = 0.75
    ballistic: bool = False
    rise: float | None = None


@dataclass
class FootTrack:
    """A foot over time: ankle [T, 3] [m], global rotation [T, 3, 3], toes up [T] [rad], yaw [T] [rad], planted [T]."""

    ankle: np.ndarray
    rotation: np.ndarray
    toe: np.ndarray
    yaw: np.ndarray
    planted: np.ndarray


@dataclass
class FootPlan:
    """Where a foot stands first, and its steps in order of time.

    Attributes:
        shape: Measurements of the foot.
        place: First ground position (x, z) of the ankle [m].
        yaw: First direction, to the left of +z [rad].
        steps: Steps that do not overlap.
        heel: Extra rise of the heel while standing [rad], shape [T] of the frames; zero around steps.
    """

    shape: FootShape
    place: tuple[float, float]
    yaw: float
    steps: list[Step] = field(default_factory=list)
    heel: np.ndarray | None = None

    def standing_at(self) -> tuple[tuple[float, float], float]:
        """Place (x, z) [m] and yaw [rad] after the last step so far."""
        return (self.steps[-1].place, self.steps[-1].yaw) if self.steps else (self.place, self.yaw)

    def track(self, times: np.ndarray) -> FootTrack:
        """Evaluate the plan at times [s], shape [T]."""
        count = len(times)
        track = FootTrack(
            np.zeros((count, 3)), np.zeros((count, 3, 3)), np.zeros(count), np.zeros(count), np.ones(count, dtype=bool)
        )
        stance = _Stance(-np.inf, self.place, self.yaw, 0.0)
        for step in [*self.steps, None]:
            lift = step.lift if step else np.inf
            inside = (times >= stance.landed) & (times < lift)
            if inside.any():
                pitch = stance.pitch(times[inside], lift, step.push if step else 0.0)
                if self.heel is not None:
                    pitch += self.heel[inside]
                self._write(track, inside, self._rolled(stance, pitch), pitch, np.full(inside.sum(), stance.yaw))
            if step is None:
                break
            inside = (times >= step.lift) & (times < step.land)
            if inside.any():
                self._swing(track, inside, times[inside] - step.lift, stance, step)
            stance = _Stance(step.land, step.place, step.yaw, step.strike)
        return track

    def _write(self, track: FootTrack, rows: np.ndarray, ankle: np.ndarray, pitch: np.ndarray, yaw: np.ndarray) -> None:
        track.ankle[rows], track.yaw[rows] = ankle, yaw
        track.rotation[rows] = self._rotation(yaw, pitch)
        track.toe[rows] = np.maximum(pitch, 0.0)

    def _rotation(self, yaw: np.ndarray, pitch: np.ndarray) -> np.ndarray:
        """Rotation from the zero pose; the foot's own direction is undone first: yaw 0 points straight ahead."""
        return rotation_about("y", yaw) @ rotation_about("x", pitch) @ rotation_about("y", -self.shape.natural_yaw)

    def _rolled(self, stance: _Stance, pitch: np.ndarray) -> np.ndarray:
        """Ankle positions [T, 3] of a standing foot rolled about its ball (heel up) or its heel (toes up)."""
        pivot = np.where(pitch[:, None] > 0.0, self.shape.ball, self.shape.heel)
        rolled = pivot - np.einsum("tij,tj->ti", rotation_about("x", pitch), pivot)
        flat = np.array([stance.place[0], self.shape.ankle[1], stance.place[1]])
        return flat + rolled @ rotation_about("y", stance.yaw).T

    def _swing(self, track: FootTrack, rows: np.ndarray, elapsed: np.ndarray, stance: _Stance, step: Step) -> None:
        """Write the frames of a step, `elapsed` seconds after lifting, that follows a stance."""
        duration = step.land - step.lift
        # The state at lifting by a one-sided difference of the stance, which is exact enough and follows any roll.
        tick = 1e-4
        pitches = stance.pitch(step.lift - np.array([tick, 1e-9]), step.lift, step.push)
        ankles = self._rolled(stance, pitches)
        ankle_speed, pitch_speed = (ankles[1] - ankles[0]) / tick, (pitches[1:] - pitches[:1]) / tick
        end = self._rolled(_Stance(step.land, step.place, step.yaw, step.strike), np.array([step.strike]))[0]
        # A foot that is kept up is over its next place as soon as it is up; other feet arrive just before they land.
        settled = duration if step.rise is None else min(step.rise, duration)
        arrival = LANDED_EARLY * settled
        ankle = _take_over(elapsed / arrival, ankles[1], ankle_speed * arrival, end)
        ankle[:, 1] = _take_over(elapsed / settled, ankles[1], ankle_speed * settled, end)[:, 1]
        yaw = stance.yaw + (step.yaw - stance.yaw) * minimum_jerk(elapsed / arrival)
        bump, reach = _bump(elapsed, duration, step)
        extra = np.stack([step.reach[0] * reach, step.height * bump, step.reach[1] * reach], axis=-1)
        ankle += np.einsum("tij,tj->ti", rotation_about("y", yaw), extra)
        pitch = _take_over(elapsed / settled, pitches[1:], pitch_speed * settled, np.array([step.strike]))[:, 0]
        pitch += step.point * (bump if step.rise is None else reach)
        track.ankle[rows], track.yaw[rows], track.planted[rows] = ankle, yaw, False
        track.rotation[rows] = self._rotation(yaw, pitch)
        # Near the ground the toes stay level, whatever the pitch of the foot; in the air they are straight.
        s = elapsed / settled
        level = 1.0 - minimum_jerk((s - 0.15) / 0.45) + minimum_jerk((s - 0.6) / 0.4)
        track.toe[rows] = np.maximum(pitch, 0.0) * level


@dataclass(frozen=True)
class _Stance:
    """A foot on the ground: since when [s], where (x, z) [m], its yaw and its pitch at landing [rad]."""

    landed: float
    place: tuple[float, float]
    yaw: float
    strike: float

    def pitch(self, times: np.ndarray, lift: float, push: float) -> np.ndarray:
        """Pitch [rad], shape [T]: the strike fades after landing, the push grows before lifting."""
        duration = lift - self.landed
        roll_in = min(ROLL_IN_SECONDS, 0.3 * duration)
        roll_out = min(ROLL_OUT_SECONDS, 0.5 * duration, 0.8 * lift)  # a clip starts with calm feet
        pitch = np.zeros(len(times))
        if self.strike and np.isfinite(self.landed):
            pitch += self.strike * (1.0 - minimum_jerk((times - self.landed) / roll_in))
        if push and np.isfinite(lift):
            pitch += push * np.clip((times - (lift - roll_out)) / roll_out, 0.0, 1.0) ** ROLL_POWER
        return pitch


def _bump(elapsed: np.ndarray, duration: float, step: Step) -> tuple[np.ndarray, np.ndarray]:
    """Profiles of a swing's height and of its reach, 0 at both ends and 1 in the middle, each shape [T].

    The foot is off the ground before it reaches anywhere, and back over its place before it comes down.
    """
    if step.rise is not None:
        risen, left = elapsed / step.rise, (duration - elapsed) / step.rise
        height = minimum_jerk(risen) * minimum_jerk(left)
        return height, minimum_jerk((risen - 0.2) / 0.8) * minimum_jerk((left - 0.2) / 0.8)
    s = elapsed / duration
    warped = s**step.early
    height = 4.0 * s * (1.0 - s) if step.ballistic else (4.0 * warped * (1.0 - warped)) ** 1.75
    return height, minimum_jerk((s - 0.08) / 0.42) * minimum_jerk((0.92 - s) / 0.42)


def _take_over(s: np.ndarray, start: np.ndarray, speed: np.ndarray, end: np.ndarray) -> np.ndarray:
    """Quintic from `start` with `speed` (per unit of s) to `end` at rest, shape [T, 3]; constant after s = 1."""
    s = np.clip(s, 0.0, 1.0)[:, None]
    return start + (end - start) * minimum_jerk(s) + speed * (s - 6.0 * s**3 + 8.0 * s**4 - 3.0 * s**5)
