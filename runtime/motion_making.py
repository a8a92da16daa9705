"""Motions to be dressed: invented from labels, at any length, or taken from a recording.

In: a motion generator and labels, or a clip. Out: clips on the ground with planted feet, and their tracks with the way
that leads into them from the bind pose, in which garments begin.

A generator makes motions of the length that it learned. Longer ones, and those of several labels, are made of as many
of them as it takes, each faded into the next (``motions.chain``).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import torch

from body.model import Body
from body.shapes import scaled_root
from geometry.rotations import matrix_from_6d, matrix_to_axis_angle
from models.motion_features import MotionTrack
from models.motion_generator import MotionGenerator
from motions.chain import chain, chained_length
from motions.clip import Clip
from motions.grounding import ground_motion
from motions.lead_in import lead_in
from motions.planting import plant_feet

OVERLAP = 0.4
"""Seconds in which a motion fades into the next."""

MOST_FRAMES = 100_000
"""Frames of a generated motion, at most: almost an hour."""


def generated_clip(
    generator: MotionGenerator,
    labels: Sequence[str],
    frames: int,
    segment: int,
    fps: float,
    body: Body,
    randomness: torch.Generator,
    name: str,
) -> Clip:
    """A motion of one label, or of several one after another, of any length.

    Args:
        generator: Makes the motions.
        labels: In their order; each gets an equal part of the time.
        frames: Wanted length T.
        segment: Frames of the motions that the generator learned from.
        fps: Frame rate [Hz].
        body: Body that moves.
        randomness: The same state gives the same motion.
        name: Of the clip.

    Raises:
        ValueError: An unknown label (lists the known), or fewer than two or too many frames.
    """
    if not 2 <= frames <= MOST_FRAMES:
        raise ValueError(f"a generated motion has 2 to {MOST_FRAMES} frames, asked for are {frames}")
    if not labels:
        raise ValueError("a generated motion needs a label")
    overlap = min(max(1, round(OVERLAP * fps)), (segment - 1) // 2)
    order, length = _order(labels, frames, segment, overlap)
    poses, roots = generator.sample_motions(order, length, randomness)
    motions = []
    for number, pose6d in enumerate(poses):
        pose = matrix_to_axis_angle(matrix_from_6d(pose6d)).astype(np.float32)
        motions.append((pose, ground_motion(pose, body) if roots is None else roots[number]))
    pose, root = chain(motions, overlap)
    pose, root = plant_feet(pose[:frames], root[:frames], body, fps)
    return Clip(name, "generated", "+".join(dict.fromkeys(labels)), pose, root, fps, "cvae")


def _order(labels: Sequence[str], frames: int, segment: int, overlap: int) -> tuple[list[str], int]:
    """Labels of the motions to be chained, and how long each is."""
    if len(labels) == 1 and frames <= segment:
        return list(labels), frames
    count = max(len(labels), math.ceil((frames - overlap) / (segment - overlap)))
    each = math.ceil(count / len(labels))
    order = [label for label in labels for _ in range(each)]
    # As short as reaches the end: equal parts, none longer than was learned.
    length = math.ceil((frames + (len(order) - 1) * overlap) / len(order))
    length = min(segment, max(length, 2 * overlap + 1))
    assert chained_length(len(order), length, overlap) >= frames or length == segment
    return order, length


def planted(clip: Clip, body: Body) -> Clip:
    """The clip with feet that neither slide nor sink into the ground (``motions.planting``), made by a body."""
    pose, root = plant_feet(clip.pose, clip.root, body, clip.fps)
    return replace(clip, pose=pose, root=root)


def clip_track(clip: Clip, body: Body, lead: int) -> MotionTrack:
    """A clip with the way from the bind pose into it, as regressors take it.

    Args:
        clip: The motion.
        body: Body that makes it.
        lead: Frames of the way.
    """
    lead_pose, lead_root = lead_in(clip, body, lead)
    return MotionTrack.from_motion(body, clip.pose, clip.root, lead_pose, lead_root, clip.fps)


def on_body(clip: Clip, own: Body, other: Body) -> Clip:
    """The motion that another body makes of a clip: the same rotations, steps as long as its legs."""
    root = scaled_root(clip.root, own, other)
    return Clip(clip.name, clip.take, clip.label, clip.pose, root, clip.fps, clip.source)
