"""Loops: motions whose last frame is their first one, wherever they have walked to meanwhile.

In: clips. Out: how far the ends of a clip are apart, the stretch of it that comes nearest to a loop, and clips that
are loops exactly. Two frames are compared in the *heading frame*, over the place where the body stands and faced the
way that it faces: a walk that loops ends elsewhere and perhaps turned.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from body.model import Body
from motions.chain import chain
from motions.clip import Clip
from motions.planting import plant_feet
from motions.timing import rotation_about

TOLERANCE = 0.02
"""Distance of a joint in the first frame from its place in the last [m], up to which a motion loops."""


@dataclass(frozen=True)
class LoopStretch:
    """Frames ``first`` to ``last`` of a clip, and the distance ``gap`` of their ends [m]."""

    first: int
    last: int
    gap: float


def heading_joints(clip: Clip, body: Body) -> np.ndarray:
    """Joints [T, 24, 3] [m] of each frame, the pelvis over the origin and faced to +z; heights stay."""
    joints = body.joint_positions(clip.pose, clip.root).astype(np.float64)
    ground = joints[:, :1] * np.array([1.0, 0.0, 1.0])
    turn = np.stack([rotation_about("y", -angle) for angle in headings(clip.pose[:, 0])])
    return np.einsum("tcd,tjd->tjc", turn, joints - ground)


def headings(pelvis: np.ndarray) -> np.ndarray:
    """Angle about the vertical [rad], from +z towards +x, that the front of each pelvis rotation [T, 3] points to."""
    front = Rotation.from_rotvec(np.asarray(pelvis, dtype=np.float64)).apply([0.0, 0.0, 1.0])
    return np.arctan2(front[:, 0], front[:, 2])


def loop_gap(clip: Clip, body: Body) -> float:
    """Largest distance of a joint in the last frame from its place in the first [m], in the heading frame."""
    joints = heading_joints(clip, body)
    return float(np.linalg.norm(joints[-1] - joints[0], axis=1).max())


def best_loop(clip: Clip, body: Body, shortest: int) -> LoopStretch | None:
    """The stretch of at least ``shortest`` frames whose ends are nearest; None where the clip is shorter."""
    joints = heading_joints(clip, body)
    frames = len(joints)
    best: LoopStretch | None = None
    for first in range(frames - shortest + 1):
        gaps = np.linalg.norm(joints[first + shortest - 1 :] - joints[first], axis=2).max(axis=1)
        nearest = int(gaps.argmin())
        # A longer loop is better unless it is worse by more than a millimetre: it holds more of the motion.
        if best is None or gaps[nearest] < best.gap - 1e-3:
            best = LoopStretch(first, first + shortest - 1 + nearest, float(gaps[nearest]))
    return best


def closed(clip: Clip, overlap: int, body: Body) -> Clip:
    """A loop made of a clip that is none: its end fades into its own beginning.

    The clip is laid behind itself, turned and moved to where it arrives, and one round is taken out of the middle. A
    fade makes feet slide, so they are planted (``motions.planting``).

    Args:
        clip: Of more than two overlaps.
        overlap: Frames of the fade, by which the loop is shorter than the clip.
        body: Body that moves.

    Raises:
        ValueError: The clip is too short.
    """
    if clip.frames <= 2 * overlap + 1:
        raise ValueError(
            f"motion '{clip.name}' has {clip.frames} frames; to be closed over {overlap} it needs {2 * overlap + 2}"
        )
    period = clip.frames - overlap
    pose, root = plant_feet(*chain([(clip.pose, clip.root)] * 3, overlap), body, clip.fps)
    round_ = slice(period, 2 * period + 1)
    return exact_loop(replace(clip, pose=pose[round_], root=root[round_]))


def exact_loop(clip: Clip) -> Clip:
    """The same clip with a last frame that is its first one exactly, but for heading and place.

    What the ends lack is spread over all frames: the joints turn the rest of the way, the pelvis rises or sinks. Where
    the ends also agree in place and heading, up to ``TOLERANCE``, the body returns there exactly.
    """
    pose, root = clip.pose.astype(np.float64), clip.root.astype(np.float64)
    frames = len(pose)
    share = np.linspace(0.0, 1.0, frames)
    turned = float(_wrapped(np.diff(headings(pose[[0, -1], 0]))[0]))
    moved = root[-1] - root[0]
    stays = np.hypot(moved[0], moved[2]) < TOLERANCE and abs(turned) < TOLERANCE
    turned = 0.0 if stays else turned
    target = pose[0].copy()
    target[0] = (Rotation.from_matrix(rotation_about("y", turned)) * Rotation.from_rotvec(pose[0, 0])).as_rotvec()
    last = Rotation.from_rotvec(pose[-1])
    lacking = (last.inv() * Rotation.from_rotvec(target)).as_rotvec()
    ways = (share[:, None, None] * lacking).reshape(-1, 3)
    pose = (Rotation.from_rotvec(pose.reshape(-1, 3)) * Rotation.from_rotvec(ways)).as_rotvec().reshape(pose.shape)
    gap = np.array([moved[0] if stays else 0.0, moved[1], moved[2] if stays else 0.0])
    root = root - share[:, None] * gap
    pose[-1], root[-1, 1] = target, root[0, 1]
    pose[0] = clip.pose[0]
    if stays:
        pose[-1], root[-1] = pose[0], root[0]
    return replace(clip, pose=pose.astype(np.float32), root=root.astype(np.float32))


def rounds_before(clip: Clip, frames: int, body: Body) -> tuple[np.ndarray, np.ndarray]:
    """What a loop did before its first frame: at least ``frames`` frames of earlier rounds.

    Returns:
        Pose [L, 24, 3] [rad] and root [L, 3] [m]; a whole number of rounds, the last of which ends where the clip
        begins.
    """
    period = clip.frames - 1
    rounds = -(-frames // period)
    turned = float(np.diff(headings(clip.pose[[0, -1], 0]))[0])
    back = Rotation.from_matrix(rotation_about("y", -turned))
    pelvis = body.joints[0].astype(np.float64)
    pose, root = clip.pose[:-1].astype(np.float64), clip.root[:-1].astype(np.float64)
    # A round back maps the place of the last frame to that of the first.
    places = root + pelvis
    end, start = clip.root[-1] + pelvis, clip.root[0] + pelvis
    poses, roots = [], []
    for _ in range(rounds):
        pose = pose.copy()
        pose[:, 0] = (back * Rotation.from_rotvec(pose[:, 0])).as_rotvec()
        places = back.apply(places - end) + start
        poses.insert(0, pose)
        roots.insert(0, places - pelvis)
    return np.concatenate(poses).astype(np.float32), np.concatenate(roots).astype(np.float32)


def _wrapped(angle: float) -> float:
    return (angle + np.pi) % (2.0 * np.pi) - np.pi
