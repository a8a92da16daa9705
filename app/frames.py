"""Frames that were made, kept until an edit makes them stale."""

from __future__ import annotations

import threading
from dataclasses import dataclass

import numpy as np

from runtime.composing import ComposedFrame


@dataclass(frozen=True, eq=False)
class Look:
    """One frame as it is seen.

    Attributes:
        frame: Its number.
        garment: Vertices in the world [m], shape [V, 3].
        body: The same of the body, shape [B, 3].
        inside: Numbers of the garment's vertices that are inside the body, or were before they were taken out.
    """

    frame: int
    garment: np.ndarray
    body: np.ndarray
    inside: np.ndarray

    @classmethod
    def of(cls, frame: int, made: ComposedFrame) -> Look:
        """The look of a composed frame."""
        return cls(frame, made.vertices, made.body, np.flatnonzero(made.inside))


class Frames:
    """The frames of one motion in one garment; any thread may ask.

    Attributes:
        version: Grows with every edit: what was made for another is not kept.

    Args:
        count: Number of frames T.
    """

    def __init__(self, count: int) -> None:
        self.version = 0
        self._lock = threading.Lock()
        self._looks: list[Look | None] = [None] * count
        self._fresh = np.zeros(count, dtype=bool)

    @property
    def share(self) -> float:
        """Share of the frames that are as the last edit left them."""
        return float(self._fresh.mean())

    @property
    def all_made(self) -> bool:
        """Whether none is stale."""
        return bool(self._fresh.all())

    def stale(self, first: int) -> np.ndarray:
        """Numbers of the stale frames, from ``first`` on and then those before it."""
        numbers = np.flatnonzero(~self._fresh)
        return np.roll(numbers, -np.searchsorted(numbers, first))

    def kept(self, frame: int) -> tuple[int, Look | None]:
        """The version, and the frame unless it is stale."""
        with self._lock:
            return self.version, self._looks[frame] if self._fresh[frame] else None

    def keep(self, look: Look, version: int) -> Look:
        """Keep a frame that was made for a version, unless an edit came in between."""
        with self._lock:
            if version == self.version:
                self._looks[look.frame], self._fresh[look.frame] = look, True
        return look

    def edited(self) -> None:
        """All are stale."""
        with self._lock:
            self.version += 1
            self._fresh[:] = False

    def stacked(self) -> tuple[np.ndarray, np.ndarray]:
        """Garments [T, V, 3] and bodies [T, B, 3] [m] of all frames, none of which may be stale."""
        with self._lock:
            assert self._fresh.all(), "a frame is stale"
            return np.stack([look.garment for look in self._looks]), np.stack([look.body for look in self._looks])
