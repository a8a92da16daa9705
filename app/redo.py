"""Making the sequence again behind the user's back, after every edit."""

from __future__ import annotations

import threading
from collections.abc import Callable

from app.session import Session


class Redo:
    """A thread that makes stale frames; the newest edit goes first.

    Args:
        session: What is made.
        first: Says which frame is looked at: those behind it are made first.
        progress: Told the share of frames that are made.
        failed: Told of an error, which ends neither the thread nor the app.
    """

    def __init__(
        self,
        session: Session,
        first: Callable[[], int],
        progress: Callable[[float], None],
        failed: Callable[[Exception], None],
    ) -> None:
        self._session, self._first, self._progress, self._failed = session, first, progress, failed
        self._wanted, self._stopped = threading.Event(), threading.Event()
        self._thread = threading.Thread(target=self._run, name="redo", daemon=True)
        self._thread.start()

    def ask(self) -> None:
        """There is something to be made again."""
        self._wanted.set()

    def stop(self) -> None:
        """End the thread."""
        self._stopped.set()
        self._wanted.set()
        self._thread.join(timeout=5.0)

    def _run(self) -> None:
        while True:
            self._wanted.wait()
            self._wanted.clear()
            if self._stopped.is_set():
                return
            try:
                while not self._session.remake(self._first(), self._progress) and not self._stopped.is_set():
                    pass
            except Exception as error:
                self._failed(error)
