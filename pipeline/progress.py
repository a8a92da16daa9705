"""Progress of long jobs: a line every few seconds with the count, the rate and the time left.

Lines, not a bar that redraws itself: two jobs share one terminal, and the same text must read well in a log.
"""

from __future__ import annotations

import sys
import time
from typing import TextIO


class Progress:
    """Counts work and prints ``[job] 120/960 frames, 212/s, 4 s left`` at most every ``interval`` seconds."""

    def __init__(self, job: str, total: int, unit: str, interval: float = 5.0, stream: TextIO | None = None):
        self.job, self.total, self.unit, self.interval = job, total, unit, interval
        self.stream = stream or sys.stderr
        self.done = 0
        self._start = self._last = time.monotonic()
        self._note = ""

    def __call__(self, steps: int = 1, note: str = "") -> None:
        """Add finished work; ``note`` is a short text, such as the current loss."""
        self.done += steps
        self._note = note or self._note
        now = time.monotonic()
        if now - self._last >= self.interval:
            self._last = now
            self._print(now)

    def finish(self) -> None:
        """Print the final line."""
        self._print(time.monotonic())

    def _print(self, now: float) -> None:
        elapsed = max(now - self._start, 1e-9)
        rate = self.done / elapsed
        left = (self.total - self.done) / rate if rate > 0 else float("inf")
        state = f"{_duration(elapsed)}" if self.done >= self.total else f"{_duration(left)} left"
        note = f", {self._note}" if self._note else ""
        line = f"[{self.job}] {self.done}/{self.total} {self.unit}, {rate:.3g}/s, {state}{note}"
        print(line, file=self.stream, flush=True)


def _duration(seconds: float) -> str:
    if seconds == float("inf"):
        return "unknown"
    minutes, rest = divmod(round(seconds), 60)
    return f"{minutes} min {rest:02d} s" if minutes else f"{rest} s"
