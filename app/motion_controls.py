"""Which garment is worn and what the body does."""

from __future__ import annotations

from typing import TYPE_CHECKING

import viser

from app.session import FRAMES, LONGEST
from app.uploads import read_upload

if TYPE_CHECKING:
    from app.window import Window


class MotionControls:
    """Controls of garment and motion, in the present container.

    Args:
        window: What they control.
    """

    def __init__(self, window: Window) -> None:
        self.window, gui, session = window, window.server.gui, window.session
        self._garment = gui.add_dropdown("Garment", session.garments, initial_value=session.garment)
        with gui.add_folder("Motion from a label"):
            label = session.clip.label if session.clip.label in session.labels else session.labels[0]
            self._label = gui.add_dropdown("Label", session.labels, initial_value=label)
            self._frames = gui.add_number(
                "Frames", session.frames, min=2, max=LONGEST, step=1,
                hint=f"{session.run.fps:g} frames are a second; {FRAMES} are enough to see it",
            )  # fmt: skip
            self._seed = gui.add_number("Seed", 0, min=0, max=2**31 - 1, step=1, hint="Another seed, another motion")
            self._make = gui.add_button("Make this motion", icon=viser.Icon.RUN)
        with gui.add_folder("Motion from a file"):
            gui.add_markdown("BVH, AMASS (`.npz`), or this program's own motions and animations (`.h5`).")
            self._clip = gui.add_text("Clip", "", hint="Its name, of a file that holds several; empty for the only one")
            self._upload = gui.add_upload_button(
                "Open a motion", icon=viser.Icon.UPLOAD, mime_type=".bvh,.npz,.h5,.hdf5"
            )
        self._told = gui.add_markdown(self._described())
        self._garment.on_update(window.guarded(self._dressed))
        self._label.on_update(window.guarded(self._labelled))
        self._make.on_click(window.guarded(self._labelled))
        self._upload.on_upload(window.guarded(self._uploaded))

    def _dressed(self, event: viser.GuiEvent) -> None:
        given_up = self.window.change(lambda: self.window.session.use_garment(self._garment.value))
        if given_up:
            listed = ", ".join(str(frame) for frame in given_up)
            self.window.say(
                event.client, "Another garment", f"Only materials go from garment to garment: given up at {listed}."
            )

    def _labelled(self, _: viser.GuiEvent) -> None:
        label, frames, seed = self._label.value, int(self._frames.value), int(self._seed.value)
        self.window.change(lambda: self.window.session.use_label(label, frames, seed))
        self._told.content = self._described()

    def _uploaded(self, event: viser.GuiEvent) -> None:
        file, name, session = event.target.value, self._clip.value.strip() or None, self.window.session
        self.window.change(
            lambda: read_upload(file.name, file.content, lambda path: session.use_motion_file(path, name))
        )
        self._told.content = self._described()

    def _described(self) -> str:
        clip = self.window.session.clip
        plain = "".join(letter if letter.isalnum() or letter in " .-+" else " " for letter in clip.name)
        return f"The body moves as in **{plain}**: {clip.frames} frames at {clip.fps:g} a second."
