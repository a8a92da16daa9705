"""Undo and redo, as buttons and as keys; the other keys of the app beside them."""

from __future__ import annotations

from typing import TYPE_CHECKING

import viser

from app.plain_text import plain

if TYPE_CHECKING:
    from app.window import Window

UNDO, REDO = "Undo", "Redo"

KEYS = """
| key | |
|---|---|
| Ctrl+Z | undo |
| Ctrl+Shift+Z, Ctrl+Y | redo |
| P | play, pause |
| I | insert a keyframe |
| Delete | delete the keyframe |
| C | show candidates |
| Ctrl+K | all of these, to be searched |
"""
"""What the keys do, for the user to read; on a Mac it is Command in place of Ctrl."""


class UndoControls:
    """Buttons in the present container, and keys.

    Args:
        window: What they control.
    """

    def __init__(self, window: Window) -> None:
        self.window, gui = window, window.server.gui
        buttons = gui.add_button_group(
            "Edits", (UNDO, REDO), hint="Ctrl+Z takes an edit back, Ctrl+Shift+Z makes it again"
        )
        self._told = gui.add_markdown("")
        buttons.on_click(window.guarded(lambda event: window.step_back(event.target.value == UNDO)))
        ctrl, icon = "cmd/ctrl", viser.Icon
        self._key("Undo", "Z", ctrl, icon.ARROW_BACK_UP, lambda: window.step_back(True))
        self._key("Redo", "Z", f"{ctrl}+shift", icon.ARROW_FORWARD_UP, lambda: window.step_back(False))
        self._key("Redo, too", "Y", ctrl, icon.ARROW_FORWARD_UP, lambda: window.step_back(False))
        self._key("Play or pause", "P", None, icon.PLAYER_PLAY, lambda: window.play(not window.player.playing))
        self._key("Insert keyframe", "I", None, icon.DIAMOND, lambda: window.keys.insert())
        self._key("Delete keyframe", "delete", None, icon.TRASH, lambda: window.keys.delete())
        self._key("Show candidates", "C", None, icon.SPARKLES, lambda: window.shapes.sample())

    def follow(self) -> None:
        """Say what can be undone and redone."""
        session = self.window.session
        told = [f"{what}: {plain(name)}" for what, name in ((UNDO, session.undoable), (REDO, session.redoable)) if name]
        self._told.content = " · ".join(told) or "No edits yet."

    def _key(self, label: str, key: str, modifier: str | None, icon: str, work: object) -> None:
        command = self.window.server.gui.add_command(label, hotkey=key, modifier=modifier, icon=icon)
        command.on_trigger(self.window.guarded(lambda _: work()))
