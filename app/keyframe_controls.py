"""Keyframes: inserted and deleted at the frame that is seen; the list of all, and how they are moved.

The list has a container of its own below all that makes keyframes: it grows with the first touch of a slider, which
must not move away under the user's hand.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import viser

from app.plain_text import plain

if TYPE_CHECKING:
    from app.window import Window

_SHOWN = 14
"""Keyframes that the list shows."""

_NONE = "None yet: the garment is of its base material throughout."


class KeyframeControls:
    """Controls of the keyframe at the frame that is seen, in the present container.

    Args:
        window: What they control.
    """

    def __init__(self, window: Window) -> None:
        self.window, gui = window, window.server.gui
        with gui.add_folder("Keyframe"):
            self._here = gui.add_markdown("")
            self._insert = gui.add_button(
                "Insert keyframe",
                icon=viser.Icon.DIAMOND,
                hint="Keep the shape of this frame, to edit it or to come back to it (key I)",
            )
            self._delete = gui.add_button(
                "Delete keyframe", icon=viser.Icon.TRASH, color="gray", disabled=True, hint="Key Delete"
            )
            gui.add_markdown("Every change of the shape makes a keyframe at the frame that you see.")
        self._insert.on_click(window.guarded(lambda _: self.insert()))
        self._delete.on_click(window.guarded(lambda _: self.delete()))

    def at(self, frame: int) -> None:
        """What can be done at a frame."""
        key = self.window.session.keyframe(frame)
        self._insert.disabled, self._delete.disabled = key is not None, key is None
        told = f"keyframe: {plain(key.origin)}" if key is not None else "no keyframe here"
        self._here.content = f"**Frame {frame}** · {told}"

    def insert(self) -> None:
        """Insert a keyframe at the frame that is shown."""
        self.window.pause()
        self.window.session.insert(self.window.frame)
        self.window.edited()

    def delete(self) -> None:
        """Delete the keyframe of the frame that is shown; ``ValueError`` where there is none."""
        self.window.pause()
        self.window.session.delete(self.window.frame)
        self.window.edited()


class KeyframeList:
    """All keyframes, in the present container.

    Args:
        window: What they control.
    """

    def __init__(self, window: Window) -> None:
        self.window, gui = window, window.server.gui
        with gui.add_folder("All keyframes"):
            self._list = gui.add_markdown("")
            self._to = gui.add_number("To frame", 0, min=0, step=1, hint="Where the keyframe of this frame goes")
            self._move = gui.add_button(
                "Move this keyframe", icon=viser.Icon.ARROWS_HORIZONTAL, color="gray", disabled=True
            )
        self._move.on_click(window.guarded(lambda _: self._moved()))

    def at(self, frame: int) -> None:
        """What can be done at a frame."""
        self._move.disabled = self.window.session.keyframe(frame) is None

    def follow(self) -> None:
        """List them."""
        keys = self.window.session.keyframes
        lines = [f"- frame **{key.frame}** · {plain(key.origin)}" for key in keys[:_SHOWN]]
        if len(keys) > _SHOWN:
            lines.append(f"- and {len(keys) - _SHOWN} more")
        self._list.content = "\n".join(lines) or _NONE

    def _moved(self) -> None:
        self.window.pause()
        key = self.window.session.move(self.window.frame, int(self._to.value))
        self.window.frame = key.frame
        self.window.edited()
        self.window.timeline.at(key.frame)
