"""From encoded sequences to what the motion-invariant autoencoder sees."""

from __future__ import annotations

import numpy as np

from datasets.codes import CodedSequence, file_digest, read_codes
from datasets.sequences import Sequence
from models.motion_features import sequence_track
from models.motion_history import MotionHistory
from models.motion_invariant import MotionInvariantConfig
from models.parameter_groups import GROUPS, scale_values, with_groups
from models.same_phi import IntrinsicFrames
from pipeline.sequence_data import frame_numbers
from pipeline.stage import Job
from sim.parameters import INTRINSIC_PARAMETERS

SHARED = {p.name for p in INTRINSIC_PARAMETERS if p.shared}
LOGARITHMIC = {p.name for p in INTRINSIC_PARAMETERS if p.logarithmic} | set(GROUPS)
"""Parameters, and groups of them, that are learned as their logarithm."""


def job_codes(
    job: Job,
    path: str,
    descriptor_path: str,
    splits: tuple[str, ...] | None = None,
    plans: tuple[str, ...] | None = None,
) -> list[CodedSequence]:
    """Sequences of the job's file of codes; ``ValueError`` when another descriptor made it or there is none."""
    return read_codes(path, job.spec["garment"], file_digest(descriptor_path), splits, plans)


def all_codes(sequences: list[CodedSequence]) -> np.ndarray:
    """Descriptors [N, C] of all frames."""
    return np.concatenate([s.codes for s in sequences])


def check_same_frames(coded: list[CodedSequence], simulated: list[Sequence]) -> None:
    """``ValueError`` unless both are the same sequences in the same order."""
    for a, b in zip(coded, simulated, strict=False):
        if (a.clip, a.phi, a.frames) != (b.clip, b.phi, b.frames):
            raise ValueError(
                f"{a.garment}: codes of set {a.phi} on {a.clip} stand where the shards have set {b.phi} on {b.clip}: "
                "encode the shapes again"
            )
    if len(coded) != len(simulated):
        raise ValueError(
            f"{simulated[0].garment}: {len(coded)} sequences are encoded, but the shards hold {len(simulated)}: "
            "encode the shapes again"
        )


def varied_parameters(sequences: list[CodedSequence]) -> tuple[str, ...]:
    """Parameters that differ between the sequences, and the groups that can be made of all parameters.

    Not those that sixteen sets have in common: these sets share their clips too, so the clip would give them away.
    """
    first = sequences[0].parameters
    own = [name for name in first if name not in SHARED]
    varied = [name for name in own if any(s.parameters[name] != first[name] for s in sequences)]
    groups = [name for name in with_groups(first) if name in GROUPS and set(GROUPS[name]) & set(varied)]
    return (*varied, *groups)


def intrinsic_frames(
    sequences: list[CodedSequence], codes: np.ndarray, config: MotionInvariantConfig, names: tuple[str, ...]
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
