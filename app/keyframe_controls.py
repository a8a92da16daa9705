"""The list of keyframes, and how they are inserted, moved and deleted."""

from __future__ import annotations

from typing import TYPE_CHECKING

import viser

if TYPE_CHECKING:
    from app.window import Window

_SHOWN = 14
"""Keyframes that the list shows."""


class KeyframeControls:
    """Controls of keyframes, in the present container.

    Args:
        window: What they control.
    """

    def __init__(self, window: Window) -> None:
        self.window, gui = window, window.server.gui
        with gui.add_folder("Keyframes"):
            self._here = gui.add_markdown("")
            self._insert = gui.add_button(
                "Insert keyframe",
                icon=viser.Icon.DIAMOND,
                hint="Keep the shape of this frame as a keyframe, to edit it",
            )
            self._delete = gui.add_button("Delete keyframe", icon=viser.Icon.TRASH, color="gray", disabled=True)
            self._to = gui.add_number("Move to frame", 0, min=0, step=1, hint="Where the keyframe of this frame goes")
            self._move = gui.add_button("Move keyframe", icon=viser.Icon.ARROWS_HORIZONTAL, color="gray", disabled=True)
            self._list = gui.add_markdown("")
        self._insert.on_click(window.guarded(lambda _: self._inserted()))
        self._delete.on_click(window.guarded(lambda _: self._deleted()))
        self._move.on_click(window.guarded(lambda _: self._moved()))

    def at(self, frame: int) -> None:
        """What can be done at a frame."""
        key = self.window.session.keyframe(frame)
        self._insert.disabled, self._delete.disabled, self._move.disabled = key is not None, key is None, key is None
        told = f"keyframe: {_plain(key.origin)}" if key is not None else "no keyframe here"
        self._here.content = f"**Frame {frame}** · {told}"

    def list(self) -> None:
        """All keyframes."""
        keys = self.window.session.keyframes
        lines = [f"- frame **{key.frame}** · {_plain(key.origin)}" for key in keys[:_SHOWN]]
        if len(keys) > _SHOWN:
            lines.append(f"- and {len(keys) - _SHOWN} more")
        self._list.content = "\n".join(lines) or "*None yet: the garment is of its base material throughout.*"

    def _inserted(self) -> None:
        self.window.session.insert(self.window.frame)
        self.window.edited()

    def _deleted(self) -> None:
        self.window.session.delete(self.window.frame)
        self.window.edited()

    def _moved(self) -> None:
        key = self.window.session.move(self.window.frame, int(self._to.value))
        self.window.frame = key.frame
        self.window.edited()


def _plain(text: str) -> str:
    """A text, such as a file's name, without what Markdown would make of it."""
    return "".join(f"\\{letter}" if letter in "\\`*_{}[]()<>#+!|~" else letter for letter in text)
