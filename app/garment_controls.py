"""Which garment is worn."""

from __future__ import annotations

from typing import TYPE_CHECKING

import viser

if TYPE_CHECKING:
    from app.window import Window


class GarmentControls:
    """The choice of a garment, in the present container.

    Args:
        window: What it controls.
    """

    def __init__(self, window: Window) -> None:
        self.window, session = window, window.session
        self._garment = window.server.gui.add_dropdown("Garment", session.garments, initial_value=session.garment)
        self._garment.on_update(window.guarded(self._dressed))

    def follow(self) -> None:
        """Show which is worn."""
        if self._garment.value != self.window.session.garment:
            self._garment.value = self.window.session.garment

    def _dressed(self, event: viser.GuiEvent) -> None:
        try:
            given_up = self.window.change(lambda: self.window.session.use_garment(self._garment.value))
        finally:
            self.follow()
        if given_up:
            listed = ", ".join(str(frame) for frame in given_up)
            self.window.say(
                event.client,
                "Another garment",
                f"Only materials go along: keyframes at {listed} were given up. Undo brings them back.",
            )
