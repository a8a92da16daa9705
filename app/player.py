"""Playing: the frame that is shown moves on with the time, and begins again at the end."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable


class Player:
    """A thread that asks for the next frame, at the frame rate or as fast as frames are shown.

    Args:
        fps: Frame rate [Hz].
        advance: Shows the frame that is so many frames on.
        failed: Told of an error, which ends the playing alone.
    """

    def __init__(self, fps: float, advance: Callable[[int], None], failed: Callable[[Exception], None]) -> None:
        self.fps, self._advance, self._failed = fps, advance, failed
        self._going, self._stopped = threading.Event(), threading.Event()
        self._thread = threading.Thread(target=self._run, name="player", daemon=True)
        self._thread.start()

    @property
    def playing(self) -> bool:
        """Whether it plays."""
        return self._going.is_set()

    def play(self, on: bool) -> None:
        """Play, or pause."""
        if on:
            self._going.set()
        else:
            self._going.clear()

    def stop(self) -> None:
        """End the thread."""
        self._stopped.set()
        self._going.set()
        self._thread.join(timeout=5.0)

    def _run(self) -> None:
        while True:
            self._going.wait()
            if self._stopped.is_set():
                return
            begun, shown = time.monotonic(), 0
            while self._going.is_set() and not self._stopped.is_set():
                # Late frames are left out: the motion keeps its pace.
                due = int((time.monotonic() - begun) * self.fps)
                if due > shown:
                    try:
                        self._advance(due - shown)
                    except Exception as error:
                        self._going.clear()
                        self._failed(error)
                    shown = due
                time.sleep(max(0.0, begun + (shown + 1) / self.fps - time.monotonic()))
