"""Stage ``evaluate_composition``: is an animation made of keyframes the simulated one? (Wang 2019, Fig. 13) And what do
shapes tell of their material?

In: the shape descriptor and the autoencoder in use, the codes, the long simulations that are tested on alone, and all
shards of a garment. Out: the garment's rows of the tables ``composition`` (errors between keyframes, beside
interpolation that knows nothing of the motion) and ``inference`` (R^2, coverage and width of the intervals of each
parameter, from one frame and from more).

The paper composes 96 frames. The long simulations give as many, in the base material; the clips of unseen materials
are as long as the run's clips are.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from functools import cache

import numpy as np

from body.model import Body
from datasets.sequences import Sequence, load_sequences
from datasets.shards import LONG, MATERIALS
from datasets.splits import TRAIN, UNSEEN_BOTH, UNSEEN_PARAMETERS, SplitRule
from evaluation.collisions import KnownGarment
from evaluation.composition import (
    CANONICAL,
    DESCRIPTORS,
    DETAILED,
    INTRINSIC,
    WORLD,
    Between,
    ComposedSequence,
    composition_rows,
    linear,
)
from evaluation.table import Row, merge_tables, write_table
from geometry.proximity import SurfaceQuery
from models.intrinsic_fitting import decode_frames, encode_frames, load_motion_invariant
from models.motion_features import MotionTrack, sequence_track
from models.motion_history import MotionHistory
from models.motion_invariant import MotionInvariantNetwork
from models.same_phi import IntrinsicFrames
from models.shape_descriptor import ShapeDescriptor, decode_all, encode_all, load_shape_descriptor
from pipeline.intrinsic_data import job_codes
from pipeline.parameter_reading import fitted_reader, sequence_evidence
from pipeline.sequence_data import job_body
from pipeline.stage import Job, run_stage
from runtime.keyframes import HOLD, Interpolation, Keyframe

FRAMES = 96
"""Frames of a composed sequence (Wang 2019, Fig. 13)."""
MOST = 16
"""Sequences of a split that are composed, spread evenly."""
TOLD_FROM = (1, 16, 64)
"""Frames that parameters are estimated from; a clip that is shorter gives all that it has."""


def main(job: Job) -> None:
    """Compose and compare; estimate and check."""
    descriptor_path, codes_path, network_path, long_path, *shards = job.inputs
    descriptor, network = load_shape_descriptor(descriptor_path), load_motion_invariant(network_path)
    body, garment = job_body(job), job.spec["garment"]
    rule = SplitRule(**job.spec["splits"])
    rows: list[Row] = []
    for split, sequences in {
        "long": load_sequences([long_path], rule, None, (LONG,)),
        UNSEEN_BOTH: load_sequences(shards, rule, (UNSEEN_BOTH,), (MATERIALS,)),
    }.items():
        if sequences:
            rows += composition_rows(_composed(sequences, descriptor, network, body), split)
    if not rows:
        raise ValueError(f"{garment}: no held-out simulation to compose; were all of them dropped?")
    write_table(job.outputs[0], merge_tables([rows], garment=garment))
    write_table(job.outputs[1], merge_tables([_inference(job, codes_path, descriptor_path, network)], garment=garment))


def _composed(
    sequences: list[Sequence], descriptor: ShapeDescriptor, network: MotionInvariantNetwork, body: Body
) -> Iterator[ComposedSequence]:
    """Evenly spread sequences, each with the ways to fill it between keyframes."""
    query = SurfaceQuery(body.faces, len(body.vertices))
    for index in np.unique(np.linspace(0, len(sequences) - 1, min(MOST, len(sequences))).astype(int)):
        yield _ways(sequences[index], descriptor, network, body, query)


def _ways(
    sequence: Sequence, descriptor: ShapeDescriptor, network: MotionInvariantNetwork, body: Body, query: SurfaceQuery
) -> ComposedSequence:
    whole = sequence_track(sequence)
    frames = min(FRAMES, sequence.frames)
    # The middle of a long motion: what came before is its history.
    first = (sequence.frames - frames) // 2
    end = whole.lead + first + frames
    track = MotionTrack(whole.pose[:end], whole.joints[:end], whole.lead + first, whole.fps)
    part = slice(first, first + frames)
    world = sequence.vertices[part]
    rotation, position = (x[track.lead :].astype(np.float32) for x in track.pelvis_frames())

    def to_canonical(points: np.ndarray) -> np.ndarray:
        return np.matmul(points - position[:, None], rotation)

    truth = to_canonical(world)
    signatures = MotionHistory([track], network.config.signature, network.config.window)[:]
    codes = encode_all(descriptor, truth)
    nothing = np.zeros(frames, dtype=np.int64)
    untold = np.zeros((frames, len(network.parameter_mean)), dtype=np.float32)
    latents = encode_frames(network, IntrinsicFrames(codes, signatures, nothing, nothing, untold))
    own = decode_all(descriptor, decode_frames(network, latents, signatures))

    def intrinsic(hold: float) -> Between:
        def fill(keys: np.ndarray) -> np.ndarray:
            details = [truth[k] - own[k] if hold else None for k in keys]
            keyframes = [Keyframe(int(k), latents[k], d) for k, d in zip(keys, details, strict=True)]
            between = Interpolation(keyframes, hold * sequence.fps)
            made = decode_all(descriptor, decode_frames(network, between.latents(np.arange(frames)), signatures))
            for number in range(frames):
                detail = between.detail(number)
                if detail is not None:
                    made[number] += detail
            return made

        return fill

    @cache
    def simulated(frame: int) -> KnownGarment:
        number = first + frame
        under = body.posed(sequence.pose[number : number + 1], sequence.root[number : number + 1])[0]
        return KnownGarment(world[frame], query.at(under))

    def inside(canonical: np.ndarray, frame: int) -> int:
        made = canonical @ rotation[frame].T + position[frame]
        return int((simulated(frame).distances(made) < 0.0).sum())

    methods: dict[str, Between] = {
        INTRINSIC: intrinsic(0.0),
        DETAILED: intrinsic(HOLD),
        DESCRIPTORS: lambda keys: decode_all(descriptor, linear(codes, keys)),
        CANONICAL: lambda keys: linear(truth, keys),
        WORLD: lambda keys: to_canonical(linear(world, keys)),
    }
    return ComposedSequence(truth, methods, inside)


def _inference(job: Job, codes_path: str, descriptor_path: str, network: MotionInvariantNetwork) -> Iterable[Row]:
    splits = (TRAIN, UNSEEN_PARAMETERS, UNSEEN_BOTH)
    sequences = job_codes(job, codes_path, descriptor_path, splits, (MATERIALS,))
    of_split = {split: [s for s in sequences if s.split == split] for split in splits}
    reader = fitted_reader(network, of_split[TRAIN], of_split[UNSEEN_PARAMETERS])
    rows: list[Row] = []
    for split in splits[1:]:
        tests = sequence_evidence(network, of_split[split]) if of_split[split] else []
        for frames in TOLD_FROM if tests else ():
            rows += merge_tables([reader.checked(tests, frames)], split=split)
    return rows


if __name__ == "__main__":
    run_stage(main)
