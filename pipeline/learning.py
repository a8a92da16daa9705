"""From shards and clips to the arrays that training and evaluation stages take."""

from __future__ import annotations

import re
import time
from collections.abc import Callable, Iterable, Mapping
from dataclasses import fields
from pathlib import Path
from typing import Any

import numpy as np
import torch

from body.model import Body
from datasets.sequences import Sequence, from_canonical, load_sequences, motion_signature, to_canonical
from datasets.splits import SplitRule
from evaluation.baselines import motion_track
from geometry.rotations import axis_angle_to_6d, matrix_from_6d, matrix_to_axis_angle
from models.garment_fitting import GarmentExample
from models.garment_regressor import Regressor
from models.motion_cvae import MotionCVAE
from models.motion_features import MotionTrack
from models.same_phi import IntrinsicFrames
from models.shape_descriptor import ShapeDescriptor, encode_all
from models.training import TrainingSettings
from motions.clip import Clip
from motions.clip_file import read_clips
from motions.grounding import ground_motion
from motions.lead_in import lead_in
from pipeline.stage import Job


def job_body(job: Job) -> Body:
    """The run's body."""
    settings = job.spec["body"]
    return Body.load(settings["resolution"]).shaped(settings["shape"])


def job_sequences(
    job: Job, paths: Iterable[str], splits: tuple[str, ...] | None = None, plans: tuple[str, ...] | None = None
) -> list[Sequence]:
    """Sequences of the shards among the job's inputs; ``ValueError`` when a split that is asked for is empty."""
    sequences = load_sequences(paths, SplitRule(**job.spec["splits"]), splits, plans)
    if not sequences:
        wanted = f"splits {', '.join(splits or ('any',))} of plans {', '.join(plans or ('any',))}"
        raise ValueError(f"{job.spec['garment']}: no simulated sequence in {wanted}; were all of them dropped?")
    return sequences


def values_of(kind: type, values: Mapping[str, Any]) -> dict[str, Any]:
    """Those of a config section's values that a settings dataclass has fields for, lists as tuples."""
    names = {f.name for f in fields(kind)} - {"training"}
    return {k: tuple(v) if isinstance(v, list) else v for k, v in values.items() if k in names}


def settings_of(kind: type, values: Mapping[str, Any], **more: Any) -> Any:
    """A settings dataclass from a config section, with further fields that the section does not hold."""
    return kind(**values_of(kind, values), **more)


def training_settings(job: Job, model: Mapping[str, Any]) -> TrainingSettings:
    """How the config's ``training`` section trains on this job's device and threads."""
    return TrainingSettings(**model["training"], seed=job.spec["seed"], device=job.device, threads=job.threads)


def canonical_frames(sequences: Iterable[Sequence], body: Body) -> np.ndarray:
    """All garment frames in their canonical frame [m], shape [N, V, 3]."""
    return np.concatenate([to_canonical(s.vertices, s.pose, s.root, body) for s in sequences])


def motion_signatures(sequences: Iterable[Sequence], window: int, body: Body) -> np.ndarray:
    """Motion signatures of all frames [m], shape [N, (window + 1) * 72]."""
    return np.concatenate([motion_signature(s, window, body) for s in sequences])


def frame_numbers(sequences: list[Sequence], values: Iterable[int]) -> np.ndarray:
    """One integer a sequence, repeated for each of its frames, shape [N]."""
    return np.repeat(np.fromiter(values, dtype=np.int64), [s.frames for s in sequences])


def garment_examples(sequences: Iterable[Sequence]) -> list[GarmentExample]:
    """Motions with their simulated garment."""
    return [GarmentExample.from_world(motion_track(s), s.vertices) for s in sequences]


def labelled_poses(job: Job, paths: Iterable[str], held_out: bool) -> tuple[np.ndarray, list[str]]:
    """Poses of the clips of one side of the split in the 6-D form, shape [N, T, 24, 6], and their labels."""
    excluded = set(job.spec["held_out_clips"])
    clips = [clip for path in paths for clip in read_clips(path) if (clip.name in excluded) == held_out]
    if not clips:
        raise ValueError(f"motions: no clip is {'held out' if held_out else 'left to train on'}")
    return np.stack([axis_angle_to_6d(c.pose) for c in clips]).astype(np.float32), [c.label for c in clips]


def work_dir(losses: str) -> Path:
    """Folder of a training: where its losses go, its checkpoint lies beside."""
    return Path(losses).parent


class TrainingProgress:
    """Prints the training loop's lines with the name of the job and the time that is left."""

    def __init__(self, job: str):
        self._job = job
        self._start: tuple[float, int] | None = None

    def __call__(self, line: str) -> None:
        left = ""
        match = re.search(r"epoch (\d+)/(\d+)", line)
        if match:
            epoch, epochs = map(int, match.groups())
            now = time.monotonic()
            if self._start is None:
                self._start = (now, epoch)
            elif epoch > self._start[1]:
                rate = (epoch - self._start[1]) / max(now - self._start[0], 1e-9)
                left = f", {rate:.3g} epochs/s, {(epochs - epoch) / rate:.0f} s left"
        print(f"[{self._job}] {line}{left}", flush=True)


def generated_tracks(
    cvae: MotionCVAE,
    labels: list[str],
    frames: int,
    fps: float,
    lead: int,
    body: Body,
    generator: torch.Generator,
) -> list[MotionTrack]:
    """Motions sampled from the CVAE, put on the ground and led into, ready to be dressed; one a label given."""
    tracks = []
    for number, pose6d in enumerate(cvae.sample(labels, frames, generator)):
        pose = matrix_to_axis_angle(matrix_from_6d(pose6d)).astype(np.float32)
        clip = Clip(
            f"generated_{number:04d}", "generated", labels[number], pose, ground_motion(pose, body), fps, "cvae"
        )
        lead_pose, lead_root = lead_in(clip, body, lead)
        whole_pose, whole_root = np.concatenate([lead_pose, clip.pose]), np.concatenate([lead_root, clip.root])
        tracks.append(MotionTrack(whole_pose, body.joint_positions(whole_pose, whole_root), lead, fps))
    return tracks


def regressor_predictor(regressor: Regressor, body: Body) -> Callable[[Sequence], np.ndarray]:
    """A regressor as the evaluation takes it: from a sequence's motion to world vertices [m], [T, V, 3]."""

    def predict(sequence: Sequence) -> np.ndarray:
        return from_canonical(regressor.dress(motion_track(sequence)), sequence.pose, sequence.root, body)

    return predict


def intrinsic_frames(
    sequences: list[Sequence], descriptor: ShapeDescriptor, window: int, body: Body
) -> IntrinsicFrames:
    """All frames as the motion-invariant autoencoder sees them: descriptor, motion signature, parameter set, clip."""
    clips = {name: number for number, name in enumerate(sorted({s.clip for s in sequences}))}
    return IntrinsicFrames(
        encode_all(descriptor, canonical_frames(sequences, body)),
        motion_signatures(sequences, window, body),
        frame_numbers(sequences, (s.phi for s in sequences)),
        frame_numbers(sequences, (clips[s.clip] for s in sequences)),
    )
