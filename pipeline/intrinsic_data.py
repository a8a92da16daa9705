"""From simulated sequences to what the motion-invariant autoencoder sees."""

from __future__ import annotations

import numpy as np

from body.model import Body
from datasets.sequences import Sequence, to_canonical
from evaluation.recovery import GROUPS, scale_values, with_groups
from models.motion_features import sequence_track
from models.motion_history import MotionHistory
from models.motion_invariant import MotionInvariantConfig
from models.same_phi import IntrinsicFrames
from models.shape_descriptor import ShapeDescriptor, encode_all
from pipeline.sequence_data import frame_numbers
from sim.parameters import INTRINSIC_PARAMETERS

SHARED = {p.name for p in INTRINSIC_PARAMETERS if p.shared}
LOGARITHMIC = {p.name for p in INTRINSIC_PARAMETERS if p.logarithmic} | set(GROUPS)
"""Parameters, and groups of them, that are learned as their logarithm."""


def sequence_codes(sequences: list[Sequence], descriptor: ShapeDescriptor, body: Body) -> np.ndarray:
    """Descriptors [N, C] of all frames, sequence by sequence: canonical copies of all would fill the memory."""
    return np.concatenate([encode_all(descriptor, to_canonical(s.vertices, s.pose, s.root, body)) for s in sequences])


def varied_parameters(sequences: list[Sequence]) -> tuple[str, ...]:
    """Parameters that differ between the sequences, and the groups that can be made of all parameters.

    Not those that sixteen sets have in common: these sets share their clips too, so the clip would give them away.
    """
    first = sequences[0].parameters
    own = [name for name in first if name not in SHARED]
    varied = [name for name in own if any(s.parameters[name] != first[name] for s in sequences)]
    groups = [name for name in with_groups(first) if name in GROUPS and set(GROUPS[name]) & set(varied)]
    return (*varied, *groups)


def intrinsic_frames(
    sequences: list[Sequence], codes: np.ndarray, config: MotionInvariantConfig, names: tuple[str, ...]
) -> IntrinsicFrames:
    """All frames as a network of ``config`` sees them; ``names`` are the parameters that it may be told."""
    clips = {name: number for number, name in enumerate(sorted({s.clip for s in sequences}))}
    values = []
    for s in sequences:
        known = with_groups(s.parameters)
        values.append(scale_values({name: known[name] for name in names}, LOGARITHMIC))
    return IntrinsicFrames(
        codes,
        MotionHistory([sequence_track(s) for s in sequences], config.signature, config.window),
        frame_numbers(sequences, (s.phi for s in sequences)),
        frame_numbers(sequences, (clips[s.clip] for s in sequences)),
        np.repeat(np.stack(values).astype(np.float32), [s.frames for s in sequences], axis=0),
    )
