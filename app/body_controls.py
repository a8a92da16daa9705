"""The shape of the body, where the run's models know more than one."""

from __future__ import annotations

import threading
from typing import TYPE_CHECKING

import viser

from app.body_shape import measures
from app.plain_text import plain

if TYPE_CHECKING:
    from app.window import Window

_NAMES = ("taller, broader", "taller, hips", "hips", "shoulders", "slimmer")
"""What more of each shape component is, in a word or two; ``_TELL`` tells more."""

_TELL = (
    "All of the body larger: 6 cm of height a step",
    "Taller, narrower at the shoulders and wider at the hips",
    "Wider at the hips, narrower at the chest",
    "Broader shoulders, narrower waist",
    "Slimmer at waist, hips and chest",
)

_EXPLAINED = "In standard deviations of the population, as far as the models were trained. The garment is cut to fit."

_STEP = 0.1
"""Of a slider [standard deviations]."""


class BodyControls:
    """Controls of the body's shape, in the present container.

    Attributes:
        sliders: One for each coefficient; none where the models know one body alone.
        explained: What they are, or why there are none.

    Args:
        window: What they control.
    """

    def __init__(self, window: Window) -> None:
        self.window, gui, shapes = window, window.server.gui, window.session.shapes
        self._editing = threading.Lock()
        self.sliders: list[viser.GuiSliderHandle] = []
        self._measured: object = None
        with gui.add_folder("Body shape"):
            self.explained = gui.add_markdown(plain(shapes.told) if shapes.told else _EXPLAINED)
            for number, (low, high) in enumerate(shapes.ends):
                slider = gui.add_slider(
                    f"{number + 1} {_NAMES[number]}", low, high, _STEP, float(shapes.own[number]),
                    hint=f"{_TELL[number]}. Number {number + 1} of `--shape`.",
                )  # fmt: skip
                slider.on_update(window.guarded(lambda _: self._slid()))
                self.sliders.append(slider)
            self._told = gui.add_markdown("")
            if shapes.ends:
                own = gui.add_button("The run's own body", icon=viser.Icon.USER, color="gray")
                own.on_click(window.guarded(lambda _: self._reset()))

    def follow(self, dragged: bool = False) -> None:
        """Show the body that there is; sliders stay where the user holds one."""
        session = self.window.session
        if self._measured is session.body:
            return
        self._measured = session.body
        for slider, value in zip(self.sliders, session.shape.tolist(), strict=False):
            if not dragged and abs(slider.value - value) > 1e-6:
                slider.value = value
        found = measures(session.body)
        girths = ", ".join(f"{name} {100 * size:.0f}" for name, size in found.items() if name != "height")
        self._told.content = f"**{found['height']:.2f} m** tall; {girths} cm around"

    def _slid(self) -> None:
        window = self.window
        with self._editing:
            # While a body was shown the user has dragged on: what counts is where the sliders are now.
            wanted = [float(slider.value) for slider in self.sliders]
            if wanted == window.session.shape[: len(wanted)].tolist():
                return
            self._use(wanted, True)

    def _reset(self) -> None:
        self._use(self.window.session.shapes.own[: len(self.sliders)].tolist(), False)

    def _use(self, wanted: list[float], dragged: bool) -> None:
        window = self.window
        window.pause()
        window.change(lambda: window.session.use_shape(wanted), body_dragged=dragged)
