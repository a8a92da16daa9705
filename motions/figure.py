"""Measurements of a body for the motion generator: bones, soles of the feet; inverse kinematics of a leg."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from body.model import Body
from body.skeleton import JOINT_COUNT, JOINT_INDEX
from motions.timing import rotation_about

SIDES = ("left", "right")
SOFTEST_KNEE = np.radians(5.0)  # a leg is never stretched further: straight knees snap, and nobody stands on them

REACH_SOFTNESS = 0.003  # [m] over which a leg approaches its reach


@dataclass(frozen=True)
class FootShape:
    """One foot in the zero pose, relative to its ankle joint [m], with the toes turned straight ahead.

    Attributes:
        ankle: World position of the ankle joint in the zero pose, shape [3].
        ball: Joint of the toes relative to the ankle, shape [3].
        heel: Point of the heel that touches the ground, relative to the ankle, shape [3].
        natural_yaw: How far the foot of the zero pose points to the left of straight ahead [rad].
    """

    ankle: np.ndarray
    ball: np.ndarray
    heel: np.ndarray
    natural_yaw: float


@dataclass(frozen=True)
class Figure:
    """A body as the motion generator sees it.

    Attributes:
        joints: Joint positions of the zero pose [m], shape [24, 3].
        feet: Left and right foot.
    """

    joints: np.ndarray
    feet: tuple[FootShape, FootShape]

    @classmethod
    def of(cls, body: Body) -> Figure:
        """Measure a body in its zero pose."""
        zero = np.zeros((1, JOINT_COUNT, 3))
        vertices = body.posed(zero, np.zeros((1, 3)))[0].astype(np.float64)
        joints = body.joint_frames(zero, np.zeros((1, 3)))[1][0]
        feet = tuple(_measure_foot(body, vertices, joints, side) for side in SIDES)
        return cls(joints=joints, feet=feet)

    def offset(self, joint: str) -> np.ndarray:
        """Zero-pose position of a joint relative to its parent in the skeleton [m], shape [3]."""
        index = JOINT_INDEX[joint]
        return self.joints[index] - self.joints[_PARENT_OF[joint]]

    @property
    def leg_length(self) -> float:
        """Thigh plus shank, mean of both sides [m]."""
        bones = [np.linalg.norm(self.offset(f"{side}_{part}")) for side in SIDES for part in ("knee", "ankle")]
        return float(sum(bones) / 2.0)


_PARENT_OF = {
    f"{side}_{part}": JOINT_INDEX[f"{side}_{parent}"]
    for side in SIDES
    for part, parent in (("knee", "hip"), ("ankle", "knee"), ("foot", "ankle"))
} | {"left_hip": 0, "right_hip": 0}


def _measure_foot(body: Body, vertices: np.ndarray, joints: np.ndarray, side: str) -> FootShape:
    ankle, ball = JOINT_INDEX[f"{side}_ankle"], JOINT_INDEX[f"{side}_foot"]
    foot = vertices[np.isin(body.part_of_vertex, [ankle, ball])]
    sole = foot[foot[:, 1] < foot[:, 1].min() + 0.015]
    to_ball = joints[ball] - joints[ankle]
    yaw = float(np.arctan2(to_ball[0], to_ball[2]))
    straighten = rotation_about("y", -yaw)
    heel = straighten @ (sole[sole[:, 2].argmin()] - joints[ankle])
    lowest = foot[:, 1].min() - joints[ankle, 1]
    return FootShape(
        ankle=joints[ankle],
        ball=straighten @ to_ball,
        heel=np.array([0.0, lowest, heel[2]]),
        natural_yaw=yaw,
    )


def farthest_reach(figure: Figure, side: str) -> float:
    """Distance from hip to ankle with the knee as straight as it gets [m]."""
    thigh, shank = figure.offset(f"{side}_knee"), figure.offset(f"{side}_ankle")
    return float(np.linalg.norm(thigh + rotation_about("x", SOFTEST_KNEE) @ shank))


def solve_leg(
    figure: Figure, side: str, hip: np.ndarray, ankle: np.ndarray, knee_yaw: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Two-bone inverse kinematics with a hinge knee.

    Args:
        figure: Measurements.
        side: "left" or "right".
        hip: Hip positions [m], shape [T, 3].
        ankle: Wanted ankle positions [m], shape [T, 3]; out of reach they are approached as far as possible.
        knee_yaw: Direction in which the knees point, to the left of +z [rad], shape [T].

    Returns:
        Global rotation of the hip joint, shape [T, 3, 3], and knee flexion [rad], shape [T]. The knee is at
        hip + R thigh and the ankle at knee + R Rx(flexion) shank.
    """
    thigh, shank = figure.offset(f"{side}_knee"), figure.offset(f"{side}_ankle")
    line = ankle - hip
    # Approaching the reach softly: at a hard limit the knee would stop dead.
    beyond = farthest_reach(figure, side) - np.linalg.norm(line, axis=-1)
    distance = farthest_reach(figure, side) - REACH_SOFTNESS * np.logaddexp(0.0, beyond / REACH_SOFTNESS)
    distance = np.maximum(distance, 0.25 * figure.leg_length)
    # |thigh + Rx(flexion) shank|^2 = distance^2, solved for the flexion: a cos + b sin = c.
    a = thigh[1] * shank[1] + thigh[2] * shank[2]
    b = thigh[2] * shank[1] - thigh[1] * shank[2]
    c = (distance**2 - thigh @ thigh - shank @ shank) / 2.0 - thigh[0] * shank[0]
    flexion = np.arctan2(b, a) + np.arccos(np.clip(c / np.hypot(a, b), -1.0, 1.0))
    local = thigh + np.einsum("tij,j->ti", rotation_about("x", flexion), shank)
    lateral = rotation_about("y", knee_yaw)[..., :, 0]
    hinge = np.broadcast_to(np.array([1.0, 0.0, 0.0]), local.shape)
    return _frame(line, lateral) @ _frame(local, hinge).transpose(0, 2, 1), flexion


def _frame(along: np.ndarray, beside: np.ndarray) -> np.ndarray:
    """Right-handed frames [T, 3, 3]: the first axis along one vector, the second in the half-plane of another."""
    first = along / np.linalg.norm(along, axis=-1, keepdims=True)
    second = beside - (beside * first).sum(-1, keepdims=True) * first
    second /= np.linalg.norm(second, axis=-1, keepdims=True)
    return np.stack([first, second, np.cross(first, second)], axis=-1)
