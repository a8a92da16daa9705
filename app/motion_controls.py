"""What the body does."""

from __future__ import annotations

from typing import TYPE_CHECKING

import viser

from app.motions import FRAMES, LONGEST, invented_motion, motion_of_file
from app.plain_text import plain
from app.uploads import read_upload

if TYPE_CHECKING:
    from app.window import Window


class MotionControls:
    """Controls of the motion, in the present container.

    Args:
        window: What they control.
    """

    def __init__(self, window: Window) -> None:
        self.window, gui, session = window, window.server.gui, window.session
        self._told = gui.add_markdown(self._described())
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
        self._plant = gui.add_button(
            "Plant the feet", icon=viser.Icon.SHOE, color="gray",
            hint="Feet that touch the ground neither slide, as recorded ones do, nor sink; invented motions have that",
        )  # fmt: skip
        self._label.on_update(window.guarded(self._labelled))
        self._make.on_click(window.guarded(self._labelled))
        self._upload.on_upload(window.guarded(self._uploaded))
        self._plant.on_click(window.guarded(self._planted))

    def follow(self) -> None:
        """Show which motion there is."""
        session = self.window.session
        if session.clip.label in session.labels and self._label.value != session.clip.label:
            self._label.value = session.clip.label
        self._told.content = self._described()

    def _labelled(self, event: viser.GuiEvent) -> None:
        label, frames, seed = self._label.value, int(self._frames.value), int(self._seed.value)
        with self.window.busy(event.client, "Motion", f"inventing {frames} frames of '{label}' ..."):
            try:
                clip = invented_motion(self.window.session.run, label, frames, seed)
                self.window.change(lambda: self.window.session.use_clip(clip))
            finally:
                self.follow()

    def _uploaded(self, event: viser.GuiEvent) -> None:
        file, name, session = event.target.value, self._clip.value.strip() or None, self.window.session
        with self.window.busy(event.client, "Motion", "reading the file ..."):
            clip = read_upload(file.name, file.content, lambda path: motion_of_file(session.run, path, name))
            self.window.change(lambda: session.use_clip(clip))
        self.follow()

    def _planted(self, event: viser.GuiEvent) -> None:
        with self.window.busy(event.client, "Motion", "planting the feet ..."):
            before, after = self.window.change(self.window.session.plant_feet)
        slid = f"They slid up to {100 * before:.0f} cm/s while they touched the ground, now {100 * after:.0f}."
        self.window.say(event.client, "Feet planted", slid, "green")

    def _described(self) -> str:
        clip = self.window.session.clip
        seconds = clip.frames / clip.fps
        return f"Now: **{plain(clip.name)}**, {clip.frames} frames, {seconds:.1f} s at {clip.fps:g} frames a second."
