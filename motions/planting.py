"""Feet that slide are planted: a clean-up of motions that a network made, which nobody told where the ground is.

In: a motion with its root. Out: poses whose touching feet stay in place; root, trunk, arms and the directions of the
feet are as they were, thighs and shanks turn as little as that takes.

While a foot touches the ground, the drift of its touching points is taken back, so that it rolls as before but does not
slide; the foot goes to the middle of where it was, and between two contacts the correction passes smoothly from one to
the next. A foot that is swung along the ground is lifted off it. The legs follow by two-bone inverse kinematics in the
plane that they bend in.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from scipy.spatial.transform import Rotation

from body.model import Body
from body.skeleton import JOINT_INDEX
from geometry.rotations import matrix_to_axis_angle
from motions.figure import SIDES, SOFTEST_KNEE
from motions.quality import CONTACT_HEIGHT, sole_points

FARTHEST = 0.12  # [m] that a foot is moved; more would be another motion
FASTEST = 1.0  # [m/s] a touching foot that is faster is swung along the ground, not slid
LIFT = 0.002  # [m] above the height of a contact, to which a swung foot is lifted
SHORTEST_FLIGHT = 2  # [frames] between two contacts; a foot that leaves the ground for less has not left it


def plant_feet(pose: np.ndarray, root: np.ndarray, body: Body, fps: float) -> np.ndarray:
    """Poses of a motion without sliding feet.

    Args:
        pose: Axis-angle pose [rad], shape [T, 24, 3].
        root: Root translation [m], shape [T, 3]; the ground is y = 0.
        body: Body that moves.
        fps: Frame rate [Hz].

    Returns:
        Pose [rad], shape [T, 24, 3] float32; a foot that never touches the ground keeps its leg as it was.
    """
    planted = np.array(pose, dtype=np.float64)
    if len(planted) < 2:
        return planted.astype(np.float32)
    rotation, joints = body.joint_frames(planted, np.asarray(root, dtype=np.float64))
    for side, points in zip(SIDES, sole_points(pose, root, body), strict=True):
        move = _correction(points, fps)
        if np.any(move):
            _move_foot(planted, rotation, joints, side, move)
    return planted.astype(np.float32)


def _correction(points: np.ndarray, fps: float) -> np.ndarray:
    """Movement [T, 3] [m] that takes back the drift of a touching foot; its sole's points are [T, S, 3]."""
    height = np.maximum(points[1:, :, 1], points[:-1, :, 1])
    step = np.diff(points[..., [0, 2]], axis=0)  # [T - 1, S, 2]
    speed = np.linalg.norm(step, axis=-1)
    lowest = height < np.maximum(height.min(axis=1, keepdims=True), 0.0) + CONTACT_HEIGHT
    # Of the lowest points those that move least: a foot that rolls does not slide.
    limit = np.nanpercentile(np.where(lowest, speed, np.nan), 25.0, axis=1, keepdims=True)
    still = lowest & (speed <= limit)
    drift = (step * still[..., None]).sum(1) / still.sum(1)[:, None]
    touching = (height < CONTACT_HEIGHT).any(axis=1) & (np.linalg.norm(drift, axis=1) * fps < FASTEST)
    contacts = _stretches(touching)
    flying = np.ones(len(points), dtype=bool)
    for first, last in contacts:
        flying[first : last + 1] = False
    move = np.zeros((len(points), 3))
    move[:, 1] = np.where(flying, np.maximum(0.0, CONTACT_HEIGHT + LIFT - points[..., 1].min(axis=1)), 0.0)
    if not contacts:
        return move
    known, values = [], []
    for first, last in contacts:  # steps first .. last - 1, so frames first .. last
        back = -np.concatenate([np.zeros((1, 2)), np.cumsum(drift[first:last], axis=0)])
        known.append(np.arange(first, last + 1))
        values.append(back - back.mean(axis=0))
    slid = _smoothly_between(len(points), known, values)
    length = np.linalg.norm(slid, axis=1, keepdims=True)
    move[:, [0, 2]] = slid * np.minimum(1.0, FARTHEST / np.maximum(length, 1e-12))
    return move


def _stretches(touching: np.ndarray) -> list[tuple[int, int]]:
    """First and past-the-last step of each contact; contacts that a short flight parts are one."""
    edges = np.flatnonzero(np.diff(np.concatenate([[0], touching.astype(int), [0]])))
    found: list[tuple[int, int]] = []
    for first, last in zip(edges[::2].tolist(), edges[1::2].tolist(), strict=True):
        if found and first - found[-1][1] < SHORTEST_FLIGHT:
            found[-1] = (found[-1][0], last)
        else:
            found.append((first, last))
    return found


def _smoothly_between(frames: int, known: list[np.ndarray], values: list[np.ndarray]) -> np.ndarray:
    """Values [T, 2] of all frames: as given in the contacts, eased from one to the next, held at both ends."""
    move = np.zeros((frames, 2))
    for where, value in zip(known, values, strict=True):
        move[where] = value
    move[: known[0][0]] = values[0][0]
    move[known[-1][-1] :] = values[-1][-1]
    for (before, after), (start, end) in zip(pairwise(known), pairwise(values), strict=True):
        gap = np.arange(before[-1] + 1, after[0])
        passed = (gap - before[-1]) / (after[0] - before[-1])
        ease = (passed**2 * (3.0 - 2.0 * passed))[:, None]
        move[gap] = (1.0 - ease) * start[-1] + ease * end[0]
    return move


def _move_foot(pose: np.ndarray, rotation: np.ndarray, joints: np.ndarray, side: str, move: np.ndarray) -> None:
    """Turn thigh, shank and ankle in ``pose [T, 24, 3]`` so that the foot moves by ``move [T, 3]``, direction kept.

    ``rotation [T, 24, 3, 3]`` and ``joints [T, 24, 3]`` are those of the world before.
    """
    hip, knee, ankle = (JOINT_INDEX[f"{side}_{name}"] for name in ("hip", "knee", "ankle"))
    target = joints[:, ankle] + move
    thigh, shank = joints[:, knee] - joints[:, hip], joints[:, ankle] - joints[:, knee]
    a, b = np.linalg.norm(thigh, axis=1), np.linalg.norm(shank, axis=1)
    # The knee opens or closes until the ankle is as far from the hip as its target, at most nearly straight.
    wanted = np.linalg.norm(target - joints[:, hip], axis=1)
    straightest = np.sqrt(a**2 + b**2 + 2.0 * a * b * np.cos(SOFTEST_KNEE))
    wanted = np.clip(wanted, 0.3 * (a + b), np.maximum(straightest, np.linalg.norm(thigh + shank, axis=1)))
    inside = np.arccos(np.clip((a**2 + b**2 - wanted**2) / (2.0 * a * b), -1.0, 1.0))
    now = np.arccos(np.clip(-(thigh * shank).sum(1) / (a * b), -1.0, 1.0))
    axis = np.cross(-thigh, shank)
    length = np.linalg.norm(axis, axis=1, keepdims=True)
    hinge = -rotation[:, hip, :, 0]  # a straight leg bends about the x axis of its thigh
    axis = np.where(length > 0.02 * (a * b)[:, None], axis / np.maximum(length, 1e-12), hinge)
    bend = Rotation.from_rotvec((inside - now)[:, None] * axis).as_matrix()
    reached = thigh + np.einsum("tij,tj->ti", bend, shank)
    turn = _shortest(reached, target - joints[:, hip])
    thigh_world = turn @ rotation[:, hip]
    shank_world = turn @ bend @ rotation[:, knee]
    pose[:, hip] = matrix_to_axis_angle(rotation[:, 0].transpose(0, 2, 1) @ thigh_world)
    pose[:, knee] = matrix_to_axis_angle(thigh_world.transpose(0, 2, 1) @ shank_world)
    pose[:, ankle] = matrix_to_axis_angle(shank_world.transpose(0, 2, 1) @ rotation[:, ankle])


def _shortest(start: np.ndarray, end: np.ndarray) -> np.ndarray:
    """Rotations [T, 3, 3] that turn the directions ``start [T, 3]`` into ``end [T, 3]`` the shortest way."""
    start = start / np.linalg.norm(start, axis=1, keepdims=True)
    end = end / np.linalg.norm(end, axis=1, keepdims=True)
    axis = np.cross(start, end)
    sine = np.linalg.norm(axis, axis=1, keepdims=True)
    angle = np.arctan2(sine, (start * end).sum(1, keepdims=True))
    return Rotation.from_rotvec(angle * axis / np.maximum(sine, 1e-12)).as_matrix()
