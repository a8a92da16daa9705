"""A performance: everything that moves during a clip, as readable curves, and its solution as SMPL rotations.

A family of motions (``motions/families``) starts from the standing performance and changes curves. The solver here
then places the pelvis where both legs reach the ground, bends the legs by inverse kinematics so that planted feet
stay where they are, and distributes the trunk's bend over the spine.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import gaussian_filter1d, maximum_filter1d

from body.skeleton import JOINT_COUNT, JOINT_INDEX
from geometry.rotations import matrix_to_axis_angle
from motions.arms import ArmTrack
from motions.feet import FootPlan, FootTrack
from motions.figure import REACH_SOFTNESS, SIDES, Figure, farthest_reach, solve_leg
from motions.timing import rotation_about

SPINE_SHARES = (("spine1", 0.3), ("spine2", 0.35), ("spine3", 0.35))
SWING_ASKS = 0.05  # [m] of the pelvis' height that a swinging leg may ask for
HEAD_SHARES = (("neck", 0.45), ("head", 0.55))


@dataclass
class Trunk:
    """Rotation curves of a part of the trunk [rad], each shape [T]: bend ahead, turn to the left, lean to the left."""

    bend: np.ndarray
    turn: np.ndarray
    lean: np.ndarray

    @classmethod
    def straight(cls, frames: int) -> Trunk:
        return cls(np.zeros(frames), np.zeros(frames), np.zeros(frames))

    def rotation(self, share: float = 1.0) -> np.ndarray:
        """Rotations of a joint that takes a share of the curves, shape [T, 3, 3]."""
        turn, bend = rotation_about("y", share * self.turn), rotation_about("x", share * self.bend)
        return turn @ bend @ rotation_about("z", -share * self.lean)


@dataclass
class Performance:
    """All curves of a clip.

    Attributes:
        times: Times of the frames [s], shape [T].
        place: Pelvis position over the ground (x, z) [m], shape [T, 2].
        drop: How far the pelvis is below that of the zero pose [m], shape [T].
        pelvis: Rotation of the pelvis; its turn is the heading.
        spine, head: Bend, turn and lean relative to the pelvis and to the chest.
        feet: Step plans of the left and right foot.
        arms: Left and right arm, relative to the chest.
        knees_out: Additional outward turn of the knees [rad], shape [T].
        hang: How far the arms hang down when the trunk bends ahead (1) instead of staying fixed to the chest (0),
            shape [T].
    """

    times: np.ndarray
    place: np.ndarray
    drop: np.ndarray
    pelvis: Trunk
    spine: Trunk
    head: Trunk
    feet: tuple[FootPlan, FootPlan]
    arms: tuple[ArmTrack, ArmTrack]
    knees_out: np.ndarray
    hang: np.ndarray

    def support(self, tracks: tuple[FootTrack, FootTrack], seconds: float) -> np.ndarray:
        """Smoothed middle of the feet on the ground (x, z) [m], shape [T, 2]: where the weight goes."""
        planted = np.stack([track.planted for track in tracks], axis=1).astype(np.float64) + 1e-3
        ground = np.stack([track.ankle[:, [0, 2]] for track in tracks], axis=1)
        middle = (ground * planted[..., None]).sum(1) / planted.sum(1)[:, None]
        return gaussian_filter1d(middle, seconds / _step(self.times), axis=0, mode="nearest")


def _step(times: np.ndarray) -> float:
    return float(times[1] - times[0])


def solve(performance: Performance, figure: Figure) -> tuple[np.ndarray, np.ndarray]:
    """SMPL pose [rad], shape [T, 24, 3], and root [m], shape [T, 3], float32, of a performance."""
    frames = len(performance.times)
    local = np.tile(np.eye(3), (frames, JOINT_COUNT, 1, 1))
    tracks = tuple(plan.track(performance.times) for plan in performance.feet)
    pelvis_rotation = performance.pelvis.rotation()
    local[:, 0] = pelvis_rotation
    chest = pelvis_rotation
    for joint, share in SPINE_SHARES:
        local[:, JOINT_INDEX[joint]] = performance.spine.rotation(share)
        chest = chest @ local[:, JOINT_INDEX[joint]]
    for joint, share in HEAD_SHARES:
        local[:, JOINT_INDEX[joint]] = performance.head.rotation(share)

    pelvis = np.stack(
        [performance.place[:, 0], figure.joints[0, 1] - performance.drop, performance.place[:, 1]], axis=-1
    )
    pelvis[:, 1] -= _drop_to_reach(performance, figure, tracks, pelvis, pelvis_rotation)
    for side, name in enumerate(SIDES):
        _set_leg(local, performance, figure, tracks[side], side, name, pelvis, pelvis_rotation)
        _set_arm(local, performance, side, name, chest)
    return matrix_to_axis_angle(local).astype(np.float32), (pelvis - figure.joints[0]).astype(np.float32)


def _drop_to_reach(
    performance: Performance,
    figure: Figure,
    tracks: tuple[FootTrack, FootTrack],
    pelvis: np.ndarray,
    pelvis_rotation: np.ndarray,
) -> np.ndarray:
    """How much lower the pelvis must be for planted feet to be within reach [m], smooth in time, shape [T]."""
    needed = np.zeros(len(pelvis))
    for name, track in zip(SIDES, tracks):
        hip = pelvis + pelvis_rotation @ figure.offset(f"{name}_hip")
        aside = ((hip - track.ankle)[:, [0, 2]] ** 2).sum(-1)
        # A margin of the softness keeps the inverse kinematics of planted feet exact to a fraction of a millimetre.
        reach = farthest_reach(figure, name) - 2.5 * REACH_SOFTNESS
        tallest = np.sqrt(np.maximum(reach**2 - aside, 0.01))
        excess = hip[:, 1] - track.ankle[:, 1] - tallest
        # A swinging foot asks for a little only: a kick may stay out of reach, a landing foot should not.
        needed = np.maximum(needed, np.where(track.planted, excess, np.minimum(excess, SWING_ASKS)))
    if not needed.any():
        return needed
    # The maximum over a window keeps the smoothed curve above what is needed.
    window = 0.045 / _step(performance.times)
    wide = maximum_filter1d(needed, 2 * int(np.ceil(1.5 * window)) + 1, mode="nearest")
    return gaussian_filter1d(wide, window, mode="nearest", truncate=1.5)


def _set_leg(
    local: np.ndarray,
    performance: Performance,
    figure: Figure,
    track: FootTrack,
    side: int,
    name: str,
    pelvis: np.ndarray,
    pelvis_rotation: np.ndarray,
) -> None:
    outward = 1.0 if side == 0 else -1.0
    hip = pelvis + pelvis_rotation @ figure.offset(f"{name}_hip")
    # Knees point where the feet point, a little drawn to where the pelvis points.
    heading = performance.pelvis.turn
    knee_yaw = heading + 0.75 * (track.yaw - heading) + outward * performance.knees_out
    thigh, flexion = solve_leg(figure, name, hip, track.ankle, knee_yaw)
    shank = thigh @ rotation_about("x", flexion)
    local[:, JOINT_INDEX[f"{name}_hip"]] = pelvis_rotation.transpose(0, 2, 1) @ thigh
    local[:, JOINT_INDEX[f"{name}_knee"]] = rotation_about("x", flexion)
    local[:, JOINT_INDEX[f"{name}_ankle"]] = shank.transpose(0, 2, 1) @ track.rotation
    yaw = performance.feet[side].shape.natural_yaw
    toe = rotation_about("y", np.array(yaw)) @ rotation_about("x", -track.toe) @ rotation_about("y", np.array(-yaw))
    local[:, JOINT_INDEX[f"{name}_foot"]] = toe


def _set_arm(local: np.ndarray, performance: Performance, side: int, name: str, chest: np.ndarray) -> None:
    arm = performance.arms[side]
    # A hanging arm points down in the world, so the chest's forward pitch is taken back for it. Of a sideways lean only
    # the lower arm's: there it would press into the hip, while the upper one lies along the body.
    pitch = np.arctan2(-chest[:, 1, 2], chest[:, 1, 1])
    lowered = -np.arcsin(np.clip(chest[:, 1, 0], -1.0, 1.0)) * (1.0 if side == 0 else -1.0)
    aside = 0.5 * (lowered + np.sqrt(lowered**2 + 0.01) - 0.1)
    swing, spread = arm.swing + performance.hang * pitch, arm.spread + performance.hang * aside
    hanging = ArmTrack(arm.shoulder, arm.elbow, arm.twist, arm.wrist, swing, spread)
    joints = hanging.rotations(side)
    for joint, rotation in zip(("collar", "shoulder", "elbow", "wrist"), joints):
        local[:, JOINT_INDEX[f"{name}_{joint}"]] = rotation
