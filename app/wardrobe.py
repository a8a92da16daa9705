"""The garments of a run as a session wears them: loaded when first worn, then kept."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from models.refinement import Refiner
from motions.clip import Clip
from runtime.composing import Composer
from runtime.finished_run import FinishedRun
from runtime.intrinsic_space import IntrinsicSpace


@dataclass(frozen=True)
class _Kept:
    space: IntrinsicSpace
    own: Refiner
    others: tuple[Refiner, ...]


class Wardrobe:
    """Models and refiners of a run's garments.

    Args:
        run: The finished run.
        workers: Threads that make frames beside the one that holds a composer.
    """

    def __init__(self, run: FinishedRun, workers: int) -> None:
        self._run, self._workers = run, workers
        self._kept: dict[str, _Kept] = {}

    def load(self, garment: str) -> None:
        """Load what a garment needs, unless it is there; ``ValueError`` where it is unknown or lacks a model."""
        if garment in self._kept:
            return
        learned = self._run.garment(garment)
        own, *others = (learned.refiner(self._run.body) for _ in range(1 + self._workers))
        self._kept[garment] = _Kept(IntrinsicSpace(learned), own, tuple(others))

    def composer(self, garment: str, clip: Clip, shape: np.ndarray | None) -> Composer:
        """A composer of a loaded garment, without keyframes; those of one garment are for one thread at a time.

        Args:
            garment: Its name.
            clip: Motion of the run's own body.
            shape: Shape coefficients of the body that wears it; the run's own where None.
        """
        kept = self._kept[garment]
        return Composer(kept.space, clip, shape, refiner=kept.own)

    def refiners(self, garment: str) -> Sequence[Refiner]:
        """One for each of the other threads."""
        return self._kept[garment].others
