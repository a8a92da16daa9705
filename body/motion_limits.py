"""How fast a human body can move: the limits that tell a motion from a teleport.

The figures are above anything that people do and far below a jump in a recording. Largest values over every clip of the
embedded generator (all labels) and 237 recordings with runs, dashes, punches, kicks and jumps, at 10 to 240 frames a
second: root 5.4 m/s, joints 13.7 m/s, local rotations 35 rad/s; change of velocity between neighbouring intervals 2.4
m/s for the root and 11.1 m/s for a joint. That change hardly depends on the frame rate (1.3 and 7.8 m/s at 30 Hz, 1.3
and 6.5 m/s at 240 Hz), and a jump by d metres makes it d times the frame rate: 0.5 m of a hand at 30 Hz are 15 m/s.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from scipy.spatial.transform import Rotation

from body.skeleton import JOINT_NAMES

MAX_ROOT_SPEED = 20.0
"""Of the root [m/s]; a sprinter stays below 13."""

MAX_JOINT_SPEED = 30.0
"""Of a joint in the world [m/s]; a pitcher's hand comes near it."""

MAX_TURN_SPEED = 60.0
"""Of a joint's local rotation [rad/s]."""

MAX_ROOT_JOLT = 5.0
"""Change of the root's velocity from one frame interval to the next [m/s]."""

MAX_JOINT_JOLT = 15.0
"""Change of a joint's velocity from one frame interval to the next [m/s]."""


def check_speeds(
    what: str, pose: np.ndarray, root: np.ndarray, fps: float, positions: np.ndarray | None = None, lead_in: int = 0
) -> None:
    """Refuse a motion that teleports.

    Args:
        what: How to name the motion in an error.
        pose: Axis-angle joint rotations [rad], shape [T, J, 3], finite.
        root: Root translations [m], shape [T, 3], finite.
        fps: Frames per second [Hz].
        positions: World positions of the joints [m], shape [T, J, 3]; without them only the root and the local
            rotations are checked.
        lead_in: Leading frames that do not count: frame 0 of an error is the first one after them.

    Raises:
        ValueError: The root or a joint is too fast, or jumps; the sentence names the joint, the frames and the limit.
    """
    if len(pose) < 2:
        return

    def place(frame: int) -> str:
        if frame < lead_in:
            return f"frames {frame} and {frame + 1} of the lead-in"
        return f"frames {frame - lead_in} and {frame - lead_in + 1} ({(frame - lead_in) / fps:.2f} s)"

    root = np.asarray(root, dtype=np.float64)
    _check_track(what, ["the root"], root[:, None], fps, MAX_ROOT_SPEED, MAX_ROOT_JOLT, place)
    turn = _turn_speeds(pose, fps)
    frame, joint = np.unravel_index(turn.argmax(), turn.shape)
    if turn[frame, joint] > MAX_TURN_SPEED:
        raise ValueError(
            f"{what}: {_name(joint)} turns by {turn[frame, joint] / fps:.1f} rad between {place(frame)}, that is "
            f"{turn[frame, joint]:.0f} rad/s, at most {MAX_TURN_SPEED:g} rad/s is allowed"
        )
    if positions is not None:
        names = [_name(joint) for joint in range(positions.shape[1])]
        positions = np.asarray(positions, dtype=np.float64)
        _check_track(what, names, positions, fps, MAX_JOINT_SPEED, MAX_JOINT_JOLT, place)


def _check_track(
    what: str,
    names: list[str],
    points: np.ndarray,
    fps: float,
    fastest: float,
    jolt: float,
    place: Callable[[int], str],
) -> None:
    """Named points [T, N, 3] [m] against a limit of speed and one of its change [m/s]."""
    velocity = np.diff(points, axis=0) * fps
    speed = np.linalg.norm(velocity, axis=-1)
    frame, point = np.unravel_index(speed.argmax(), speed.shape)
    if speed[frame, point] > fastest:
        raise ValueError(
            f"{what}: {names[point]} jumps {speed[frame, point] / fps:.2f} m between {place(frame)}, that is "
            f"{speed[frame, point]:.0f} m/s, at most {fastest:g} m/s is allowed"
        )
    if len(points) < 3:
        return
    change = np.linalg.norm(np.diff(velocity, axis=0), axis=-1)
    frame, point = np.unravel_index(change.argmax(), change.shape)
    if change[frame, point] > jolt:
        # Of the two intervals around the change, the faster one is where the jump is.
        jump = int(frame) + int(speed[frame + 1, point] > speed[frame, point])
        raise ValueError(
            f"{what}: {names[point]} jumps {speed[jump, point] / fps:.2f} m between {place(jump)}, where its "
            f"velocity changes by {change[frame, point]:.0f} m/s in a frame, at most {jolt:g} m/s is allowed"
        )


def _turn_speeds(pose: np.ndarray, fps: float) -> np.ndarray:
    """Speeds of the local rotations [rad/s], shape [T - 1, J]."""
    pose = np.asarray(pose, dtype=np.float64)
    joints = pose.shape[1]
    rotation = Rotation.from_rotvec(pose.reshape(-1, 3))
    return ((rotation[:-joints].inv() * rotation[joints:]).magnitude() * fps).reshape(-1, joints)


def _name(joint: int) -> str:
    return f"the joint {JOINT_NAMES[joint] if joint < len(JOINT_NAMES) else joint}"
