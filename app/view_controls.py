"""What is seen: refinement, vertices inside the body, the body itself."""

from __future__ import annotations

from typing import TYPE_CHECKING

from app.undo_controls import KEYS

if TYPE_CHECKING:
    from app.window import Window


class ViewControls:
    """Controls of the view, in the present container.

    Args:
        window: What they control.
    """

    def __init__(self, window: Window) -> None:
        self.window, gui = window, window.server.gui
        self._refine = gui.add_checkbox(
            "Refinement", window.session.refine, hint="Take the garment out of the body wherever the network left it in"
        )
        self._highlight = gui.add_checkbox(
            "Highlight penetration", True, hint="Red: vertices inside the body. Amber: those that refinement took out"
        )
        self._told = gui.add_markdown("")
        self._body = gui.add_checkbox("Body", True)
        self._follow = gui.add_checkbox("Follow the body", True, hint="Keep it in view, however far it walks")
        self._refine.on_update(window.guarded(lambda _: self._refined()))
        self._highlight.on_update(window.guarded(lambda _: self._seen()))
        self._follow.on_update(window.guarded(lambda _: self._seen()))
        self._body.on_update(window.guarded(lambda _: window.scene.show_body(self._body.value)))
        with gui.add_folder("Mouse and keys", expand_by_default=False):
            gui.add_markdown("Drag to turn, scroll to come nearer, right-drag to move.")
            gui.add_markdown(KEYS)

    def say_inside(self, count: int) -> None:
        """How many vertices are or were inside the body in the frame that is shown."""
        taken_out = self.window.session.refine
        what = "vertex" if count == 1 else "vertices"
        told = f"{count} {what} taken out of the body" if taken_out else f"{count} {what} inside the body"
        if self._told.content != told:
            self._told.content = told

    def follow(self) -> None:
        """Show whether garments are refined."""
        if self._refine.value != self.window.session.refine:
            self._refine.value = self.window.session.refine

    def _refined(self) -> None:
        self.window.session.set_refine(self._refine.value)
        self.window.edited()

    def _seen(self) -> None:
        self.window.scene.highlight, self.window.scene.follow = self._highlight.value, self._follow.value
        self.window.show()
