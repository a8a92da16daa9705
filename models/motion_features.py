"""What a garment regressor is told about the body's motion, a row a frame.

In: poses, joints and frame rate of a motion with its lead-in. Out: features [F, D]. Two kinds:

- ``pose``: the 24 rotations in the 6-D form (Shi 2023), D = 144. The pelvis row is the rotation in the world.
- ``motion``: everything in the pelvis frame of its own frame: the other 23 joints [m], the direction of gravity, and
  linear [m/s] and angular velocity [rad/s] of the pelvis, D = 78. A pose alone hides how the body travels, which is
  what swings a skirt; and what the cloth does depends on where down is, not on where north is.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from body.model import Body
from datasets.sequences import Sequence
from geometry.rotations import axis_angle_to_6d, axis_angle_to_matrix, matrix_to_axis_angle

FEATURE_KINDS = {"pose": 144, "motion": 78}


@dataclass(frozen=True)
class MotionTrack:
    """A motion with the frames that lead into it.

    Attributes:
        pose: Axis-angle [rad], shape [L + T, 24, 3].
        joints: World joints [m], shape [L + T, 24, 3].
        lead: Number of frames L before the first wanted frame.
        fps: Frame rate [Hz].
    """

    pose: np.ndarray
    joints: np.ndarray
    lead: int
    fps: float

    def __post_init__(self) -> None:
        if self.pose.ndim != 3 or self.pose.shape[1:] != (24, 3) or self.pose.shape != self.joints.shape:
            raise ValueError(
                f"motion track: expected pose and joints of the same shape [F, 24, 3], "
                f"got {list(self.pose.shape)} and {list(self.joints.shape)}"
            )
        if not 0 <= self.lead < len(self.pose):
            raise ValueError(f"motion track: lead-in of {self.lead} frames in a track of {len(self.pose)}")
        if not self.fps > 0.0:
            raise ValueError(f"motion track: frame rate {self.fps} Hz must be positive")

    @classmethod
    def from_motion(
        cls,
        body: Body,
        pose: np.ndarray,
        root: np.ndarray,
        lead_pose: np.ndarray,
        lead_root: np.ndarray,
        fps: float,
    ) -> MotionTrack:
        """Track of a motion (pose [T, 24, 3] [rad], root [T, 3] [m]) and of the frames that lead into it ([L, ...])."""
        whole = np.concatenate([lead_pose, pose])
        return cls(whole, body.joint_positions(whole, np.concatenate([lead_root, root])), len(lead_pose), fps)

    @property
    def frames(self) -> int:
        """Number of wanted frames T."""
        return len(self.pose) - self.lead

    def pelvis_frames(self) -> tuple[np.ndarray, np.ndarray]:
        """Rotation [F, 3, 3] and position [F, 3] of the pelvis."""
        return axis_angle_to_matrix(self.pose[:, 0]), np.asarray(self.joints[:, 0], dtype=np.float64)

    def in_world(self, canonical: np.ndarray) -> np.ndarray:
        """World vertices [m], shape [T, V, 3] float32, of a garment's canonical ones in the wanted frames."""
        rotation, position = (part[self.lead :].astype(np.float32) for part in self.pelvis_frames())
        return np.matmul(canonical, np.swapaxes(rotation, 1, 2)) + position[:, None]


def sequence_track(sequence: Sequence) -> MotionTrack:
    """The sequence's motion with its lead-in."""
    pose = np.concatenate([sequence.lead_pose, sequence.pose])
    joints = np.concatenate([sequence.lead_joints, sequence.joints])
    return MotionTrack(pose, joints, len(sequence.lead_pose), sequence.fps)


def track_features(track: MotionTrack, kind: str) -> np.ndarray:
    """Features [L + T, D] float32 of a track; ``kind`` is a key of ``FEATURE_KINDS``."""
    if kind not in FEATURE_KINDS:
        raise ValueError(f"unknown motion features {kind!r}; known: {', '.join(FEATURE_KINDS)}")
    if kind == "pose":
        return axis_angle_to_6d(track.pose).reshape(len(track.pose), -1).astype(np.float32)
    rotation, position = track.pelvis_frames()
    local = np.einsum("tjc,tcd->tjd", track.joints[:, 1:] - position[:, None], rotation)
    gravity = -rotation[:, 1, :]  # R^T (0, -1, 0)
    velocity = np.einsum("tc,tcd->td", _backward_difference(position) * track.fps, rotation)
    turn = np.swapaxes(rotation[:-1], 1, 2) @ rotation[1:]
    angular = np.concatenate([np.zeros((1, 3)), matrix_to_axis_angle(turn)]) * track.fps
    return np.concatenate([local.reshape(len(local), -1), gravity, velocity, angular], axis=1).astype(np.float32)


def _backward_difference(values: np.ndarray) -> np.ndarray:
    """Difference to the frame before, zero at the first (the future is never looked at)."""
    return np.diff(values, axis=0, prepend=values[:1])
