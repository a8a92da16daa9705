"""From batches of clips to labelled poses, and from the motion CVAE to motions that can be dressed."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
import torch

from body.model import Body
from geometry.rotations import axis_angle_to_6d, matrix_from_6d, matrix_to_axis_angle
from models.motion_features import MotionTrack
from models.motion_generator import MotionGenerator
from motions.clip import Clip
from motions.clip_file import read_clips
from motions.grounding import ground_motion
from motions.lead_in import lead_in
from motions.planting import plant_feet
from pipeline.stage import Job


def split_clips(job: Job, paths: Iterable[str]) -> tuple[list[Clip], list[Clip]]:
    """The clips to learn from and those that are held out; ``ValueError`` where a side has none."""
    excluded = set(job.spec["held_out_clips"])
    clips = [clip for path in paths for clip in read_clips(path)]
    sides = tuple([clip for clip in clips if (clip.name in excluded) == held_out] for held_out in (False, True))
    for side, name in zip(sides, ("left to train on", "held out"), strict=True):
        if not side:
            raise ValueError(f"motions: no clip is {name}")
    return sides


def labelled_motions(clips: Iterable[Clip]) -> tuple[np.ndarray, list[str], np.ndarray]:
    """Poses of clips in the 6-D form, shape [N, T, 24, 6], their labels and root translations [m], shape [N, T, 3]."""
    clips = list(clips)
    poses = np.stack([axis_angle_to_6d(c.pose) for c in clips]).astype(np.float32)
    return poses, [c.label for c in clips], np.stack([c.root for c in clips])


def generated_tracks(
    cvae: MotionGenerator,
    labels: list[str],
    frames: int,
    fps: float,
    lead: int,
    body: Body,
    generator: torch.Generator,
) -> list[MotionTrack]:
    """Motions sampled from the CVAE, on the ground with planted feet and led into, to be dressed; one a label given.

    The root is derived from the poses where the CVAE makes poses alone.
    """
    tracks = []
    poses, roots = cvae.sample_motions(labels, frames, generator)
    for number, pose6d in enumerate(poses):
        pose = matrix_to_axis_angle(matrix_from_6d(pose6d)).astype(np.float32)
        pose, root = plant_feet(pose, ground_motion(pose, body) if roots is None else roots[number], body, fps)
        clip = Clip(f"generated_{number:04d}", "generated", labels[number], pose, root, fps, "cvae")
        lead_pose, lead_root = lead_in(clip, body, lead)
        whole_pose, whole_root = np.concatenate([lead_pose, clip.pose]), np.concatenate([lead_root, clip.root])
        tracks.append(MotionTrack(whole_pose, body.joint_positions(whole_pose, whole_root), lead, fps))
    return tracks
