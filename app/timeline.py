"""The timeline: play, pause, scrub, and how much of the sequence is as the keyframes say."""

from __future__ import annotations

import threading
import time
from typing import TYPE_CHECKING

import viser

if TYPE_CHECKING:
    from app.window import Window

_EVERY = 0.05
"""Seconds between two steps of the progress bar."""


_KEY = "◆"
"""Marks a keyframe."""


_STEPS = ("|<", "<", ">", ">|", f"< {_KEY}", f"{_KEY} >")


class Timeline:
    """Controls of the timeline, in the present container.

    Args:
        window: What they control.
    """

    def __init__(self, window: Window) -> None:
        self.window, self._gui = window, window.server.gui
        self._told, self._marked = 0.0, None
        self._building, self._scrubbing = threading.Lock(), threading.Lock()
        with self._gui.add_folder("Timeline"):
            self._holder = self._gui.add_folder(None)
            self._steps = self._gui.add_button_group("Step", _STEPS)
            self._play = self._gui.add_button("Play", icon=viser.Icon.PLAYER_PLAY, hint="Play, or pause")
            self._bar = self._gui.add_progress_bar(0.0, animated=True)
            self._state = self._gui.add_markdown("")
        self._slider: viser.GuiSliderHandle | None = None
        self.marks()
        self._play.on_click(window.guarded(lambda _: window.play(not window.player.playing)))
        self._steps.on_click(window.guarded(lambda event: self._step(event.target.value)))

    def marks(self) -> None:
        """The slider of the present motion, with a mark at each keyframe."""
        session = self.window.session
        wanted = (session.frames, tuple(key.frame for key in session.keyframes))
        with self._building:
            if wanted == self._marked:
                return
            old, self._marked = self._slider, wanted
            last = session.frames - 1
            marks = {0: "0", last: str(last)} | dict.fromkeys(wanted[1], _KEY)
            with self._holder:
                self._slider = self._gui.add_slider(
                    "Frame", 0, last, 1, self.window.frame, marks=tuple(sorted(marks.items())),
                    hint=f"Drag to scrub; {_KEY} are keyframes",
                )  # fmt: skip
            self._slider.on_update(self.window.guarded(lambda _: self._scrubbed()))
            if old is not None:
                old.remove()

    def at(self, frame: int) -> None:
        """The frame that is shown."""
        with self._building:
            if self._slider is not None and frame <= self._slider.max:
                self._slider.value = frame

    def playing(self, on: bool) -> None:
        """Whether it plays."""
        self._play.label = "Pause" if on else "Play"
        self._play.icon = viser.Icon.PLAYER_PAUSE if on else viser.Icon.PLAYER_PLAY

    def progress(self, share: float) -> None:
        """How much of the sequence is made again."""
        done = share >= 1.0
        if not done and time.monotonic() - self._told < _EVERY:
            return
        self._told = time.monotonic()
        self._bar.value, self._bar.animated = 100.0 * share, not done
        session = self.window.session
        self._state.content = (
            f"{session.frames} frames, {session.frames / session.clip.fps:.1f} s" if done else "making the sequence ..."
        )

    def _scrubbed(self) -> None:
        window = self.window
        with self._scrubbing:
            # While frames were shown the user has dragged on: what counts is where the slider is now.
            while (frame := int(self._slider.value)) != window.frame:
                window.pause()
                window.scrub(frame)

    def _step(self, which: str) -> None:
        window = self.window
        here, last = window.frame, window.session.frames - 1
        keys = [key.frame for key in window.session.keyframes]
        to = {
            "|<": 0,
            "<": max(0, here - 1),
            ">": min(last, here + 1),
            ">|": last,
            "< ◆": max((key for key in keys if key < here), default=here),
            "◆ >": min((key for key in keys if key > here), default=here),
        }[which]
        window.pause()
        window.go(to)
