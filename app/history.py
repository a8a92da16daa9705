"""What can be taken back: states before each edit, and those that were taken back themselves."""

from __future__ import annotations

import time
from collections.abc import Callable, Hashable
from dataclasses import dataclass
from typing import Generic, TypeVar

MOST = 300
"""Edits that are remembered."""

PAUSE = 1.0
"""Seconds without a change after which a slider that moves on makes another edit of its own."""

S = TypeVar("S")


@dataclass(frozen=True, eq=False)
class Step(Generic[S]):
    """One edit.

    Attributes:
        name: What it was, in words.
        frame: Where it was; None where all frames were changed alike.
        state: What there was on its other side: before it where it can be undone, after it where it can be redone.
    """

    name: str
    frame: int | None
    state: S


class History(Generic[S]):
    """Undo and redo. States are never changed, and are as small as what differs between them.

    Args:
        most: Edits that are remembered.
        pause: See ``PAUSE`` [s].
        now: The time [s].
    """

    def __init__(self, most: int = MOST, pause: float = PAUSE, now: Callable[[], float] = time.monotonic) -> None:
        self._most, self._pause, self._now = most, pause, now
        self._before: list[Step[S]] = []
        self._after: list[Step[S]] = []
        self._held: Hashable = None
        self._last = 0.0

    @property
    def undoable(self) -> str | None:
        """Name of the edit that would be undone; None where there is none."""
        return self._before[-1].name if self._before else None

    @property
    def redoable(self) -> str | None:
        """Name of the edit that would be redone; None where there is none."""
        return self._after[-1].name if self._after else None

    def record(self, name: str, before: S, frame: int | None = None, held: Hashable = None) -> None:
        """An edit was made; what had been undone cannot be redone any more.

        Args:
            name: What it was, in words.
            before: The state before it.
            frame: Where it was; None where all frames were changed alike.
            held: What the user holds, such as a slider: moved without a pause, it makes one edit.
        """
        now = self._now()
        moved_on = held is not None and held == self._held and now - self._last < self._pause
        if not (moved_on and self._before):
            self._before = [*self._before[-self._most + 1 :], Step(name, frame, before)]
        self._after, self._held, self._last = [], held, now

    def undo(self, present: S) -> Step[S]:
        """Take the last edit back; ``ValueError`` where there is none."""
        return self._taken(self._before, self._after, present, "undo")

    def redo(self, present: S) -> Step[S]:
        """Make the edit again that was undone last; ``ValueError`` where there is none."""
        return self._taken(self._after, self._before, present, "redo")

    def _taken(self, here: list[Step[S]], there: list[Step[S]], present: S, what: str) -> Step[S]:
        if not here:
            raise ValueError(f"there is nothing to {what}")
        step = here.pop()
        there.append(Step(step.name, step.frame, present))
        self._held = None
        return step
