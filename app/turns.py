"""Whose turn it is on one session: a thread edits, and the threads that make frames behind it give way."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager


class Turns:
    """The order of the threads of one session.

    Attributes:
        work: Held by whoever changes what is made, or makes a frame with what makes it.
        making: Held while all frames are made.
    """

    def __init__(self) -> None:
        self.work, self.making = threading.RLock(), threading.Lock()
        self._calm = threading.Event()
        self._calm.set()

    @contextmanager
    def edit(self) -> Iterator[None]:
        """Hold ``work``, and have the two cores to oneself: who makes frames stops after the one at hand."""
        with self.work:
            self._calm.clear()
            try:
                yield
            finally:
                self._calm.set()

    def give_way(self) -> None:
        """Wait while somebody edits; called between two frames, without ``work``."""
        self._calm.wait()
