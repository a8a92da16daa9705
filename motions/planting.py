"""Feet that slide are planted: a clean-up of motions that a network made, which knows the ground but roughly.

In: a motion with its root. Out: poses whose touching feet stay in place on the ground, and a root that is lowered where
the legs would not reach it. Trunk and arms are as they were, thighs and shanks turn as little as that takes.

While a foot touches the ground, the drift of its touching points and its turning are taken back, so that it rolls as
before but does not slide, and its lowest point is put on the ground; the foot goes to where it mostly was, and
between two contacts the correction passes smoothly from one to the next. A foot in the air is kept off the ground. The
legs follow by two-bone inverse kinematics in the plane that they bend in.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from scipy.ndimage import gaussian_filter1d, maximum_filter1d
from scipy.spatial.transform import Rotation

from body.model import Body
from body.skeleton import JOINT_INDEX
from geometry.rotations import matrix_to_axis_angle
from motions.figure import SIDES, SOFTEST_KNEE
from motions.quality import CONTACT_HEIGHT, sole_points
from motions.timing import rotation_about

FARTHEST = 0.12  # [m] that a foot is moved along the ground; more would be another motion
MOST_TURN = 0.15  # [rad] that a foot is turned; more is a pivot that is meant
NEAR_GROUND = 0.012  # [m] up to which the lowest point of a slow foot was meant to touch
FASTEST = 0.2  # [m/s] a foot near the ground that is faster is swung along it, lands or leaves
LIFT = 0.002  # [m] above the height of a contact, to which a swung foot is lifted
SHORTEST_FLIGHT = 2  # [frames] between two contacts; a foot that leaves the ground for less has not left it
SAMPLE = 32  # points of the sole that say how far it slid
SETTLING = 0.06  # [s] over which the pelvis is lowered
LEGS = tuple(tuple(JOINT_INDEX[f"{side}_{joint}"] for joint in ("hip", "knee", "ankle")) for side in SIDES)
ANKLES = tuple(leg[2] for leg in LEGS)


@dataclass(frozen=True)
class _Correction:
    """What becomes of a foot: its movement [T, 3] [m], its turn about the vertical [T] [rad], when it touches [T]."""

    move: np.ndarray
    turn: np.ndarray
    touching: np.ndarray


def plant_feet(pose: np.ndarray, root: np.ndarray, body: Body, fps: float) -> tuple[np.ndarray, np.ndarray]:
    """A motion without sliding feet and without feet in the ground.

    Args:
        pose: Axis-angle pose [rad], shape [T, 24, 3].
        root: Root translation [m], shape [T, 3]; the ground is y = 0.
        body: Body that moves.
        fps: Frame rate [Hz].

    Returns:
        Pose [rad], shape [T, 24, 3], and root [m], shape [T, 3], float32; a foot that never comes near the ground keeps
        its leg as it was.
    """
    planted, root = np.array(pose, dtype=np.float64), np.array(root, dtype=np.float64)
    if len(planted) < 2:
        return planted.astype(np.float32), root.astype(np.float32)
    rotation, joints = body.joint_frames(planted, root)
    corrections = [
        _correction(points, joints[:, ankle], rotation[:, ankle], fps)
        for points, ankle in zip(sole_points(pose, root, body), ANKLES, strict=True)
    ]
    targets = [joints[:, ankle] + c.move for ankle, c in zip(ANKLES, corrections, strict=True)]
    drop = _drop_to_reach(joints, targets, [c.touching for c in corrections], fps)
    root[:, 1] -= drop
    joints[..., 1] -= drop[:, None]
    for side, ankle, target, correction in zip(SIDES, ANKLES, targets, corrections, strict=True):
        if np.any(correction.move) or np.any(correction.turn) or np.any(drop):
            turned = rotation_about("y", correction.turn) @ rotation[:, ankle]
            _set_leg(planted, rotation, joints, side, target, turned)
    planted = planted.astype(np.float32)
    # What the legs could not do is left to the pelvis.
    lowest = np.minimum(*(points[..., 1].min(axis=1) for points in sole_points(planted, root, body)))
    root[:, 1] += np.maximum(0.0, -lowest)
    return planted, root.astype(np.float32)


def _correction(points: np.ndarray, ankle: np.ndarray, rotation: np.ndarray, fps: float) -> _Correction:
    """How a foot is set right, whose sole's points are [T, S, 3], whose ankle is [T, 3] and turned by [T, 3, 3]."""
    drift, height = _drift(points)
    low = np.maximum(height[1:], height[:-1]) < NEAR_GROUND
    speed = np.linalg.norm(np.column_stack([drift, np.diff(height)]), axis=1) * fps
    contacts = _stretches(low & (speed < FASTEST))
    touching = np.zeros(len(points), dtype=bool)
    for first, last in contacts:  # steps first .. last - 1, so frames first .. last
        touching[first : last + 1] = True
    move, turn = np.zeros((len(points), 3)), np.zeros(len(points))
    if contacts:
        frames = [np.arange(first, last + 1) for first, last in contacts]
        heading = np.unwrap(np.arctan2(rotation[:, 0, 2], rotation[:, 2, 2]))
        turns = [np.clip(heading[own].mean() - heading[own], -MOST_TURN, MOST_TURN)[:, None] for own in frames]
        turn = _smoothly_between(len(points), frames, turns)[:, 0]
        spun = ankle[:, None] + np.einsum("tij,tsj->tsi", rotation_about("y", turn), points - ankle[:, None])
        drift, _ = _drift(spun)
        back = []
        for first, last in contacts:
            slid = -np.concatenate([np.zeros((1, 2)), np.cumsum(drift[first:last], axis=0)])
            back.append(np.column_stack([slid - np.median(slid, axis=0), -height[first : last + 1]]))
        move = _smoothly_between(len(points), frames, back)[:, [0, 2, 1]]
        length = np.linalg.norm(move[:, [0, 2]], axis=1, keepdims=True)
        move[:, [0, 2]] *= np.minimum(1.0, FARTHEST / np.maximum(length, 1e-12))
    clear = np.maximum(move[:, 1], CONTACT_HEIGHT + LIFT - height)
    move[:, 1] = np.where(touching, move[:, 1], clear)
    return _Correction(move, turn, touching)


def _drift(points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Steps [T - 1, 2] [m] that a foot slides along the ground, and height [T] [m] of its lowest point."""
    lowest = points[..., 1].min(axis=1)
    above = points[..., 1] - lowest[:, None]
    height = np.maximum(above[1:], above[:-1])
    low = height < np.maximum(height.min(axis=1, keepdims=True), CONTACT_HEIGHT)
    low |= height == height.min(axis=1, keepdims=True)
    # The step that a quarter of the lowest points share best, as ``quality.sliding_speed`` asks: a foot that rolls or
    # bends its toes does not slide, as long as a part of it rests. A sample of these points tells as much as all do.
    spread = np.linspace(0.0, 1.0, SAMPLE, endpoint=False)
    ranks = (spread * low.sum(axis=1, keepdims=True)).astype(int)
    chosen = np.take_along_axis(np.argsort(~low, axis=1, kind="stable"), ranks, axis=1)  # [T - 1, SAMPLE]
    frame = np.arange(len(chosen))[:, None]
    ground = points[..., [0, 2]]
    step = ground[frame + 1, chosen] - ground[frame, chosen]
    x, z = step[..., 0], step[..., 1]
    apart = np.square(x[:, :, None] - x[:, None]) + np.square(z[:, :, None] - z[:, None])
    quarter = SAMPLE // 4 - 1
    together = np.partition(apart, quarter, axis=2)[..., quarter]
    return step[frame[:, 0], together.argmin(axis=1)], lowest


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
    """Values [T, n] of all frames: as given in the contacts, eased from one to the next, held at both ends."""
    move = np.zeros((frames, values[0].shape[1]))
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


def _drop_to_reach(joints: np.ndarray, targets: list[np.ndarray], touching: list[np.ndarray], fps: float) -> np.ndarray:
    """How much lower the pelvis must be for the touching feet's targets [T, 3] to be in reach [m], smooth, [T]."""
    needed = np.zeros(len(joints))
    for (hip, knee, ankle), target, own in zip(LEGS, targets, touching, strict=True):
        a, b = (np.linalg.norm(joints[:, i] - joints[:, j], axis=1) for i, j in ((knee, hip), (ankle, knee)))
        now = np.linalg.norm(joints[:, ankle] - joints[:, hip], axis=1)
        aside = np.square((target - joints[:, hip])[:, [0, 2]]).sum(1)
        tallest = np.sqrt(np.maximum(np.square(_longest(a, b, now)) - aside, 0.01))
        needed = np.maximum(needed, np.where(own, joints[:, hip, 1] - target[:, 1] - tallest, 0.0))
    if not needed.any():
        return needed
    # The maximum over a window keeps the smoothed curve above what is needed.
    sigma = SETTLING * fps
    wide = maximum_filter1d(needed, 2 * int(np.ceil(1.5 * sigma)) + 1, mode="nearest")
    return gaussian_filter1d(wide, sigma, mode="nearest", truncate=1.5)


def _longest(a: np.ndarray, b: np.ndarray, now: np.ndarray) -> np.ndarray:
    """Length to which a leg of thigh ``a`` and shank ``b`` may be stretched: nearly straight, or what it is now."""
    return np.maximum(np.sqrt(a**2 + b**2 + 2.0 * a * b * np.cos(SOFTEST_KNEE)), now)


def _set_leg(
    pose: np.ndarray, rotation: np.ndarray, joints: np.ndarray, side: str, target: np.ndarray, foot: np.ndarray
) -> None:
    """Turn thigh, shank and ankle in ``pose [T, 24, 3]``: the ankle to ``target [T, 3]``, turned by ``foot [T, 3, 3]``.

    ``rotation [T, 24, 3, 3]`` and ``joints [T, 24, 3]`` are those of the world before.
    """
    hip, knee, ankle = LEGS[SIDES.index(side)]
    thigh, shank = joints[:, knee] - joints[:, hip], joints[:, ankle] - joints[:, knee]
    a, b = np.linalg.norm(thigh, axis=1), np.linalg.norm(shank, axis=1)
    # The knee opens or closes until the ankle is as far from the hip as its target.
    wanted = np.linalg.norm(target - joints[:, hip], axis=1)
    wanted = np.clip(wanted, 0.3 * (a + b), _longest(a, b, np.linalg.norm(thigh + shank, axis=1)))
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
    pose[:, ankle] = matrix_to_axis_angle(shank_world.transpose(0, 2, 1) @ foot)


def _shortest(start: np.ndarray, end: np.ndarray) -> np.ndarray:
    """Rotations [T, 3, 3] that turn the directions ``start [T, 3]`` into ``end [T, 3]`` the shortest way."""
    start = start / np.linalg.norm(start, axis=1, keepdims=True)
    end = end / np.linalg.norm(end, axis=1, keepdims=True)
    axis = np.cross(start, end)
    sine = np.linalg.norm(axis, axis=1, keepdims=True)
    angle = np.arctan2(sine, (start * end).sum(1, keepdims=True))
    return Rotation.from_rotvec(angle * axis / np.maximum(sine, 1e-12)).as_matrix()
