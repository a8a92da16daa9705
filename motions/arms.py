"""Arm poses by where the upper arm and the forearm point, and their course over a clip.

Everything is written for the left arm in the frame of the chest (x outward, y up, z ahead); the right arm is its
mirror image.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from motions.timing import blend_rotations, keyed, rotation_about

MIRROR = np.diag([-1.0, 1.0, 1.0])


@dataclass(frozen=True)
class ArmPose:
    """One pose of an arm.

    Attributes:
        shoulder: Rotation of the upper arm relative to the chest, from the zero pose (arm sideways, palm down), shape
            [3, 3].
        elbow: Flexion [rad].
        twist: Rotation of the forearm about its axis [rad]; positive turns the palm of a hanging arm to the back.
        wrist: Flexion of the hand towards the palm [rad].
    """

    shoulder: np.ndarray
    elbow: float
    twist: float = 0.0
    wrist: float = 0.0


def arm_pose(
    upper: Sequence[float],
    fore: Sequence[float],
    twist: float = 0.0,
    wrist: float = 0.0,
    hint: Sequence[float] = (0, 0, 1),
) -> ArmPose:
    """Arm pose from two directions (outward, up, ahead).

    Args:
        upper: Where the upper arm points, from shoulder to elbow.
        fore: Where the forearm points, from elbow to wrist.
        twist, wrist: See :class:`ArmPose`; [rad].
        hint: Direction towards which the elbow would bend when both directions are the same.
    """
    along = np.asarray(upper, dtype=np.float64) / np.linalg.norm(upper)
    towards = np.asarray(fore, dtype=np.float64) / np.linalg.norm(fore)
    elbow = float(np.arccos(np.clip(along @ towards, -1.0, 1.0)))
    # In the zero pose the left elbow bends ahead, about -y; a nearly straight arm takes its hinge from the hint
    # instead.
    bending = towards - (towards @ along) * along
    fallback = np.asarray(hint, dtype=np.float64) - (np.asarray(hint) @ along) * along
    bending = bending + max(0.0, 0.25 - np.linalg.norm(bending)) * fallback
    bending /= np.linalg.norm(bending)
    shoulder = np.stack([along, np.cross(bending, along), bending], axis=-1)
    return ArmPose(shoulder, elbow, twist, wrist)


@dataclass
class ArmTrack:
    """An arm over the frames of a clip.

    Attributes:
        shoulder: Rotation relative to the chest, left-arm convention, shape [T, 3, 3].
        elbow, twist, wrist: See :class:`ArmPose`; [rad], shape [T].
        swing: Additional movement ahead about the chest's lateral axis [rad], shape [T].
        spread: Additional movement away from the body [rad], shape [T].
    """

    shoulder: np.ndarray
    elbow: np.ndarray
    twist: np.ndarray
    wrist: np.ndarray
    swing: np.ndarray
    spread: np.ndarray

    @classmethod
    def held(cls, pose: ArmPose, frames: int) -> ArmTrack:
        """The same pose in every frame."""
        flat = [np.full(frames, value) for value in (pose.elbow, pose.twist, pose.wrist)]
        return cls(np.tile(pose.shoulder, (frames, 1, 1)), *flat, np.zeros(frames), np.zeros(frames))

    def follow(self, times: np.ndarray, keys: Sequence[tuple[float, ArmPose]]) -> None:
        """Replace the course by keyed poses with minimum-jerk timing between them; keys are (time [s], pose)."""
        self.shoulder = blend_rotations(times, [(time, pose.shoulder) for time, pose in keys])
        for name in ("elbow", "twist", "wrist"):
            setattr(self, name, keyed(times, [(time, getattr(pose, name)) for time, pose in keys]))

    def rotations(self, side: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
        """Collar, shoulder, elbow and wrist of the left (0) or right (1) arm.

        Returns:
            Local rotations of the four joints, each [T, 3, 3]; the collar and the shoulder lie on the chest.
        """
        upper = rotation_about("x", -self.swing) @ rotation_about("z", self.spread) @ self.shoulder
        direction = upper[..., :, 0]
        # The shoulder girdle takes part: it rises with a raised arm and comes forward with a reaching one.
        lifted = np.clip((direction[:, 1] + 0.7) / 1.7, 0.0, 1.0) ** 1.5
        collar = rotation_about("z", np.radians(22.0) * lifted) @ rotation_about(
            "y", -np.radians(8.0) * direction[:, 2]
        )
        shoulder = collar.transpose(0, 2, 1) @ upper
        # Half of the forearm's twist is given to the wrist: a single joint would wring the skin like a towel.
        half = rotation_about("x", -0.5 * self.twist)
        elbow = rotation_about("y", -self.elbow) @ half
        wrist = half @ rotation_about("z", -self.wrist)
        joints = (collar, shoulder, elbow, wrist)
        return joints if side == 0 else tuple(MIRROR @ joint @ MIRROR for joint in joints)
