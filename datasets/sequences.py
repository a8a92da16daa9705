"""Simulated sequences as the models see them: split, canonical frame, motion signature.

In: shard paths and a split rule. Out: ``Sequence`` objects, and arrays in the *canonical frame* of the current frame,
which is the full pelvis frame: ``x_c = R_pelvis^T (x - pelvis)`` (Wang 2019, "character space of the current frame").
"""

from __future__ import annotations

import os
from collections.abc import Iterable
from collections.abc import Sequence as Many
from dataclasses import dataclass, field

import numpy as np

from body.model import Body
from datasets.shards import LONG, MATERIALS, MOTIONS, REPEATED, read_header, read_sequences
from datasets.splits import SplitRule
from geometry.rotations import axis_angle_to_matrix

_OWN_FIELDS = ("clip", "take", "label", "phi", "parameters", "vertices", "pose", "root", "joints")
_OWN_FIELDS += ("lead_pose", "lead_root", "lead_joints", "body_index")

ONE_BODY = (MATERIALS, MOTIONS, REPEATED, LONG)
"""Plans whose sequences are all on the run's own body: what a reader gets that does not ask for others."""


@dataclass(frozen=True)
class Sequence:
    """One simulated clip.

    Attributes:
        garment, clip, take, label, plan: Names; ``plan`` is ``materials``, ``motions`` or ``bodies``.
        phi: Number of the parameter set, 0 = base.
        split: One of ``datasets.splits.SPLITS``.
        fps: Frame rate [Hz].
        vertices: Garment in the world [m], shape [T, V, 3] float32.
        pose, root, joints: Axis-angle [rad] [T, 24, 3], root translation [m] [T, 3], joints [m] [T, 24, 3].
        lead_pose, lead_root, lead_joints: The motion before the first recorded frame, [L, ...].
        parameters: Intrinsic parameters by name, in the order of the shard.
        shape: Shape coefficients of its body [standard deviations], shape [<= 10]; missing ones are zero. Its body is
            ``Body.load(...).shaped(sequence.shape)``, its rest shape ``garments.grading.graded`` of the template.
        body_index: Number of the body shape, 0 = the run's own body.
    """

    garment: str
    clip: str
    take: str
    label: str
    plan: str
    phi: int
    split: str
    fps: float
    vertices: np.ndarray
    pose: np.ndarray
    root: np.ndarray
    joints: np.ndarray
    lead_pose: np.ndarray
    lead_root: np.ndarray
    lead_joints: np.ndarray
    parameters: dict[str, float]
    shape: np.ndarray = field(default_factory=lambda: np.zeros(0))
    body_index: int = 0

    @property
    def frames(self) -> int:
        """Number of recorded frames T."""
        return len(self.pose)

    @property
    def pelvis(self) -> tuple[np.ndarray, np.ndarray]:
        """Rotation [T, 3, 3] and position [T, 3] [m] of its own pelvis, whichever body has it."""
        return axis_angle_to_matrix(self.pose[:, 0]), np.asarray(self.joints[:, 0], dtype=np.float64)

    def canonical(self, world: np.ndarray) -> np.ndarray:
        """Vertices in the world [m], shape [T, V, 3], in the pelvis frame of each frame, float32."""
        rotation, position = self.pelvis
        made = np.empty(np.shape(world), dtype=np.float32)
        for some in _blocks(len(made)):
            made[some] = np.matmul(world[some] - position[some, None], rotation[some])
        return made

    def in_world(self, canonical: np.ndarray) -> np.ndarray:
        """Vertices in the pelvis frame of each frame [m], shape [T, V, 3], in the world, float32."""
        rotation, position = self.pelvis
        made = np.empty(np.shape(canonical), dtype=np.float32)
        for some in _blocks(len(made)):
            made[some] = np.matmul(canonical[some], np.swapaxes(rotation[some], 1, 2)) + position[some, None]
        return made


def load_sequences(
    paths: Iterable[str | os.PathLike],
    rule: SplitRule,
    splits: Many[str] | None = None,
    plans: Many[str] | None = None,
) -> list[Sequence]:
    """Sequences of the shards, in the order of the paths.

    Args:
        paths: Shards.
        rule: What is held out.
        splits: Splits that are wanted; all where None.
        plans: Plans that are wanted; where None those of ``ONE_BODY``, so that who knows of one body gets one body.
    """

    def wanted(phi: int, take_index: int, label: str, body_index: int) -> bool:
        return splits is None or rule.split(phi, take_index, label, body_index) in splits

    sequences = []
    for path in paths:
        header = read_header(path)
        if header.plan not in (ONE_BODY if plans is None else plans):
            continue
        for s in read_sequences(path, wanted):
            split = rule.split(s.phi, s.take_index, s.label, s.body_index)
            own = {name: getattr(s, name) for name in _OWN_FIELDS}
            shape = s.shape if len(s.shape) else header.body_shape
            shared = {"garment": header.garment, "plan": header.plan, "fps": header.fps, "shape": shape}
            sequences.append(Sequence(split=split, **shared, **own))
    return sequences


def to_canonical(points: np.ndarray, pose: np.ndarray, root: np.ndarray, body: Body) -> np.ndarray:
    """World points [T, N, 3] in the pelvis frame of their own frame, float32."""
    rotation, position = body.pelvis_frames(pose, root)
    return np.matmul(points - position[:, None], rotation).astype(np.float32)


def from_canonical(points: np.ndarray, pose: np.ndarray, root: np.ndarray, body: Body) -> np.ndarray:
    """Inverse of ``to_canonical``."""
    rotation, position = body.pelvis_frames(pose, root)
    return (np.matmul(points, np.swapaxes(rotation, 1, 2)) + position[:, None]).astype(np.float32)


def _blocks(frames: int) -> list[slice]:
    """Runs of frames whose vertices, in double precision, stay in a processor's cache: half the time of all at once."""
    return [slice(first, first + 32) for first in range(0, frames, 32)]


def motion_signature(sequence: Sequence, window: int, body: Body) -> np.ndarray:
    """Motion signature ``M_t`` of Wang 2019: joints of the current and the past ``window`` frames [m].

    All in the pelvis frame of the *current* frame, newest first. Before the first recorded frame the history runs into
    the lead-in; before that it stands still, as the body did.

    Returns:
        Shape [T, (window + 1) * 24 * 3] float32.
    """
    joints = np.concatenate([sequence.lead_joints, sequence.joints])
    lead, frames = len(sequence.lead_joints), sequence.frames
    rotation, position = body.pelvis_frames(sequence.pose, sequence.root)
    index = lead + np.arange(frames)[:, None] - np.arange(window + 1)[None, :]
    history = joints[np.maximum(index, 0)]
    local = np.einsum("twjc,tcd->twjd", history - position[:, None, None], rotation)
    return local.reshape(frames, -1).astype(np.float32)
