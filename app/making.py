"""Making the frames of one garment in one motion: at once the one that is looked at, all others a few at a time, so
that an edit in between never waits long. Frames are kept until an edit makes them stale.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Sequence
from concurrent.futures import ThreadPoolExecutor

import numpy as np
from scipy.ndimage import gaussian_filter

from app.frames import Frames, Look
from app.turns import Turns
from models.refinement import Refiner
from runtime.composing import Composer

BLOCK = 8
"""Frames that are decoded at once."""

WORKERS = 2
"""Threads that make frames again: most of the time is spent outside of Python's lock."""


STEADY = 0.2
"""Seconds over which the path of the body is smoothed."""


class Making:
    """The frames of a composer; any thread may ask.

    Attributes:
        refine: Whether garments are taken out of the body.
        path: Where the body is on the ground, without its sway, shape [T, 3] [m].

    Args:
        composer: Garment, motion, body and keyframes.
        refine: See there.
        turns: Of the session.
        refiners: Of the garment, one for each of ``WORKERS``; of whoever makes all frames.
    """

    def __init__(self, composer: Composer, refine: bool, turns: Turns, refiners: Sequence[Refiner]) -> None:
        self.refine = refine
        self._composer, self._turns, self._refiners = composer, turns, refiners
        self._frames = Frames(composer.frames)
        pelvis = (composer.body.joints[0] + composer.clip.root) * (1.0, 0.0, 1.0)
        self.path = gaussian_filter(pelvis, (STEADY * composer.clip.fps, 0.0), mode="nearest")

    @property
    def share(self) -> float:
        """Share of the frames that are as the keyframes say."""
        return self._frames.share

    @property
    def all_made(self) -> bool:
        """Whether all are."""
        return self._frames.all_made

    def edited(self) -> None:
        """All frames are stale."""
        self._frames.edited()

    def look(self, frame: int) -> Look:
        """A frame as it is now; made at once where it is stale."""
        version, kept = self._frames.kept(frame)
        if kept is not None:
            return kept
        with self._turns.work:
            return self._frames.keep(Look.of(frame, self._composer.frame(frame, self.refine)), version)

    def looks_of(self, frame: int, latents: Iterable[np.ndarray]) -> list[Look]:
        """What garments of each of ``latents [n, Z]`` look like in a frame."""
        with self._turns.work:
            return [Look.of(frame, self._composer.alone(z).frame(frame, self.refine)) for z in latents]

    def remake(self, first: int, progress: Callable[[float], None] | None = None) -> bool:
        """Make all stale frames, from ``first`` on and then those before it, on ``WORKERS`` threads.

        Args:
            first: Where to begin, such as the frame that is looked at.
            progress: Told the share of frames that are made; from any thread.

        Returns:
            Whether all are; False where an edit came in between.
        """
        with self._turns.making:
            with self._turns.work:
                version, stale, refine = self._frames.version, self._frames.stale(first), self.refine
                twins = [self._composer.twin(refiner) for refiner in self._refiners]
            if progress and not len(stale):
                progress(self._frames.share)  # somebody else made them
            blocks = deque(stale[start : start + BLOCK] for start in range(0, len(stale), BLOCK))

            def work(composer: Composer) -> None:
                while True:
                    try:
                        block = blocks.popleft()
                    except IndexError:
                        return
                    for frame, made in zip(block, composer.some_frames(block, refine), strict=True):
                        self._frames.keep(Look.of(int(frame), made), version)
                        self._turns.give_way()
                        if version != self._frames.version:
                            return
                    if progress:
                        progress(self._frames.share)

            with ThreadPoolExecutor(WORKERS) as pool:
                for done in [pool.submit(work, twin) for twin in twins]:
                    done.result()
            return version == self._frames.version and self._frames.all_made

    def stacked(self) -> tuple[np.ndarray, np.ndarray]:
        """Garments [T, V, 3] and bodies [T, B, 3] [m] of all frames, none of which may be stale."""
        return self._frames.stacked()
