"""Frames grouped by the parameter set that they were simulated with (Wang 2019, section 3.4).

In: descriptors, motion signatures, parameter set and clip of each frame. Out: batches whose frames share one phi.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, fields

import numpy as np

from models.motion_history import MotionHistory


@dataclass(frozen=True)
class IntrinsicFrames:
    """Frames as this network sees them, row by row.

    Attributes:
        descriptors: S, shape [N, C].
        signatures: M, shape [N, D]: an array, or rows that are made when they are asked for.
        phi: Number of the parameter set, shape [N].
        clip: Number of the clip, shape [N].
        parameters: Values of the parameter set on the scale that they are drawn on, shape [N, P]; P may be 0.
    """

    descriptors: np.ndarray
    signatures: np.ndarray | MotionHistory
    phi: np.ndarray
    clip: np.ndarray
    parameters: np.ndarray

    def __post_init__(self) -> None:
        count = len(self.descriptors)
        if self.descriptors.ndim != 2 or len(self.signatures.shape) != 2 or count == 0:
            raise ValueError("intrinsic frames: descriptors and signatures must be of shape [N, C] and [N, D], N > 0")
        for name in ("signatures", "phi", "clip", "parameters"):
            if len(getattr(self, name)) != count:
                raise ValueError(f"intrinsic frames: {count} descriptors, but {len(getattr(self, name))} {name}")

    def at(self, index: np.ndarray) -> IntrinsicFrames:
        """The frames of the given numbers."""
        return IntrinsicFrames(*(getattr(self, f.name).take(index, axis=0) for f in fields(self)))


class SamePhiBatches:
    """Batches whose frames all share one phi, with a partner of another clip for each frame.

    The published code of the paper groups by a slipped index and so mixes materials; this class exists to be tested.

    Args:
        phi: Number of the parameter set of each frame, shape [N].
        clip: Number of the clip of each frame, shape [N].
        batch: Largest batch, at least 4: a smaller one could leave a frame without a partner.
    """

    def __init__(self, phi: np.ndarray, clip: np.ndarray, batch: int) -> None:
        self.clip = np.asarray(clip)
        phi = np.asarray(phi)
        if phi.ndim != 1 or self.clip.shape != phi.shape:
            raise ValueError(f"phi and clip: expected equal shapes [N], got {phi.shape} and {self.clip.shape}")
        self.groups = [np.flatnonzero(phi == value) for value in np.unique(phi)]
        if batch < 4:
            raise ValueError(f"same-phi batches: batch must be at least 4, got {batch}")
        small = [group for group in self.groups if len(group) < 2]
        if small:
            raise ValueError(f"same-phi batches: phi {phi[small[0][0]]} has one frame only, at least 2 are needed")
        self.batch = batch

    def epoch(self, generator: np.random.Generator) -> Iterator[tuple[np.ndarray, np.ndarray]]:
        """Yield ``(frames [B], partners [B])``; every frame once an epoch, partners index the batch, not the data."""
        batches: list[np.ndarray] = []
        for group in self.groups:
            # Nearly equal parts, so that none is left with a single frame, whose variance would be zero.
            batches += np.array_split(generator.permutation(group), math.ceil(len(group) / self.batch))
        for number in generator.permutation(len(batches)):
            yield batches[number], self.partners(batches[number], generator)

    def partners(self, frames: np.ndarray, generator: np.random.Generator) -> np.ndarray:
        """A permutation of the batch that gives each frame one of another clip, as far as the clips allow."""
        shuffled = generator.permutation(len(frames))
        order = shuffled[np.argsort(self.clip[frames[shuffled]], kind="stable")]
        _, sizes = np.unique(self.clip[frames], return_counts=True)
        partners = np.empty(len(frames), dtype=np.int64)
        # Sorted by clip and rolled by the largest clip, no frame meets its own clip unless one has over half of all.
        partners[order] = np.roll(order, sizes.max() if len(sizes) > 1 else 1)
        return partners

    def halves(self, frames: np.ndarray, generator: np.random.Generator) -> np.ndarray:
        """0 or 1 for each frame of a batch, so that the two halves share no clip; a single clip is split at random."""
        clips = np.unique(self.clip[frames])
        if len(clips) == 1:
            half = np.arange(len(frames)) % 2
            return generator.permutation(half)
        first = generator.permutation(clips)[: len(clips) // 2]
        return np.isin(self.clip[frames], first).astype(np.int64)
