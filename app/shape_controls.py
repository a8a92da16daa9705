"""The shape of the garment in a frame: candidates of the latent space, intrinsic parameters, or a mesh from a file."""

from __future__ import annotations

import threading
from typing import TYPE_CHECKING

import numpy as np
import viser

from app.materials import share_of, value_of
from app.scene import CANDIDATE_PLACES
from app.uploads import read_upload
from sim.parameters import parameter

if TYPE_CHECKING:
    from app.window import Window

CANDIDATES = len(CANDIDATE_PLACES)
"""Candidates that are shown at once."""

_STEPS = 100
"""Of a slider, from one end of what the model was trained on to the other."""

_WHOLE = str.maketrans({" ": "\u00a0", "/": "\u2215", "-": "\u2212", ".": "\u2024"})
"""Labels are broken after these letters; a number and its unit stay on one line with others that look like them."""

_GROUPS = {
    "material": "Intrinsic parameters: material",
    "environment": "Intrinsic parameters: surroundings",
    "simulator": "Intrinsic parameters: simulation",
}


class ShapeControls:
    """Controls of the shape, in the present container.

    Args:
        window: What they control.
    """

    def __init__(self, window: Window) -> None:
        self.window, self._gui = window, window.server.gui
        self._first, self._latents = 1, dict[str, np.ndarray]()
        self._sliders: dict[str, viser.GuiSliderHandle] = {}
        self._parts: list[viser.GuiFolderHandle] = []
        self._built_for: str | None = None
        self._editing = threading.Lock()
        gui = self._gui
        with gui.add_folder("Candidates"):
            gui.add_markdown("Garments drawn from what the model knows, beside the body. Click one to take it.")
            self._sample = gui.add_button(f"Show {CANDIDATES} candidates", icon=viser.Icon.SPARKLES, hint="Key C")
            self._take = gui.add_button_group("Take", ("-",), visible=False)
            self._away = gui.add_button("Send them away", color="gray", visible=False)
        self._holder = gui.add_folder(None)
        with gui.add_folder("Mesh", expand_by_default=False):
            gui.add_markdown(
                "The garment's own mesh, moved in another program: OBJ or PLY, in metres, y up, on the body as it "
                "stands in this frame. *Export* writes it."
            )
            self._upload = gui.add_upload_button(
                "Keyframe from OBJ or PLY", icon=viser.Icon.UPLOAD, mime_type=".obj,.ply"
            )
        self._sample.on_click(window.guarded(lambda _: self.sample()))
        self._take.on_click(window.guarded(lambda event: self._taken(event.target.value)))
        self._away.on_click(window.guarded(lambda _: self._sent_away()))
        self._upload.on_upload(window.guarded(self._uploaded))

    def build(self) -> None:
        """Sliders of the present garment."""
        session = self.window.session
        if self._built_for == session.garment:
            return
        self._built_for = session.garment
        self._rebuild(session.ranges)

    def at(self, frame: int, dragged: str | None = None) -> None:
        """The parameters of a frame; the slider of ``dragged`` stays where the user holds it."""
        ranges = self.window.session.ranges
        for name, value in self.window.session.parameters_at(frame).items():
            slider = self._sliders[name]
            if name != dragged:
                slider.value = round(_STEPS * share_of(name, value, ranges[name]))
            slider.label = self._label(name, value)
        shown = self.window.scene.candidates > 0
        self._take.visible = self._away.visible = shown

    def _rebuild(self, ranges: dict[str, tuple[float, float]]) -> None:
        for part in self._parts:
            part.remove()
        self._parts, self._sliders = [], {}
        with self._holder:
            for group, title in _GROUPS.items():
                names = [name for name in ranges if parameter(name).group == group]
                if not names:
                    continue
                folder = self._gui.add_folder(title, expand_by_default=group == "material")
                self._parts.append(folder)
                with folder:
                    for name in names:
                        self._sliders[name] = self._slider(name, ranges[name])

    def _slider(self, name: str, ends: tuple[float, float]) -> viser.GuiSliderHandle:
        told = parameter(name)
        slider = self._gui.add_slider(
            name, 0, _STEPS, 1, 0, marks=((0, _short(ends[0])), (_STEPS, _short(ends[1]))),
            hint=f"{told.meaning}. Trained between {ends[0]:.3g} and {ends[1]:.3g} {_unit(told.unit)}".rstrip() + ".",
        )  # fmt: skip
        slider.on_update(self.window.guarded(lambda _: self._slid(name)))
        return slider

    def _slid(self, name: str) -> None:
        window = self.window
        with self._editing:
            # While an edit was shown the user has dragged on: what counts is where the slider is now.
            share, ends = int(self._sliders[name].value), window.session.ranges[name]
            if share == round(_STEPS * share_of(name, window.session.parameters_at(window.frame)[name], ends)):
                return
            window.pause()
            window.session.insert_parameters(window.frame, {name: value_of(name, share / _STEPS, ends)})
            window.edited(dragged=name)

    def sample(self) -> None:
        """Show the next candidates at the frame that is shown."""
        window = self.window
        window.pause()
        seeds = range(self._first, self._first + CANDIDATES)
        self._first += CANDIDATES
        self._latents = dict(zip(map(str, seeds), window.session.candidates(seeds), strict=True))
        self._take.options = tuple(self._latents)
        window.scene.show_candidates(
            window.session.look_of(window.frame, np.stack(list(self._latents.values()))),
            tuple(self._latents),
            lambda name, event: window.guarded(lambda _: self._taken(name))(event),
        )
        self.at(window.frame)

    def _taken(self, name: str) -> None:
        window = self.window
        window.session.insert_latent(window.frame, self._latents[name], f"candidate {name}")
        window.edited()

    def _sent_away(self) -> None:
        self.window.scene.clear_candidates()
        self.at(self.window.frame)

    def _uploaded(self, event: viser.GuiEvent) -> None:
        window, file = self.window, event.target.value
        key = read_upload(file.name, file.content, lambda path: window.session.insert_mesh(window.frame, path))
        window.edited()
        window.say(event.client, "Keyframe set", f"frame {key.frame}: {key.origin}", "green")

    @staticmethod
    def _label(name: str, value: float) -> str:
        quantity = f"{_short(value)} {_unit(parameter(name).unit)}".rstrip()
        return f"{name.replace('_', ' ')} {quantity.translate(_WHOLE)}"


def _short(value: float) -> str:
    """Three digits, as short as they go."""
    return f"{float(f'{value:.3g}'):g}".replace("e-0", "e-")


def _unit(unit: str) -> str:
    return "" if unit == "1" else unit.replace("^2", "²").replace("^3", "³")
