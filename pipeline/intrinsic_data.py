"""From simulated sequences to what the motion-invariant autoencoder sees."""

from __future__ import annotations

import numpy as np

from body.model import Body
from datasets.sequences import Sequence, motion_signature
from models.same_phi import IntrinsicFrames
from models.shape_descriptor import ShapeDescriptor, encode_all
from pipeline.sequence_data import canonical_frames, frame_numbers


def intrinsic_frames(
    sequences: list[Sequence], descriptor: ShapeDescriptor, window: int, body: Body
) -> IntrinsicFrames:
    """All frames as the motion-invariant autoencoder sees them: descriptor, motion signature, parameter set, clip."""
    clips = {name: number for number, name in enumerate(sorted({s.clip for s in sequences}))}
    return IntrinsicFrames(
        encode_all(descriptor, canonical_frames(sequences, body)),
        np.concatenate([motion_signature(s, window, body) for s in sequences]),
        frame_numbers(sequences, (s.phi for s in sequences)),
        frame_numbers(sequences, (clips[s.clip] for s in sequences)),
    )
