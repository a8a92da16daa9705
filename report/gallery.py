"""The pictures of one garment: drawn, put together, written beside a list that says what each one shows.

In: garment and body vertices [m] with names. Out: a folder of stills (WebP) and videos (MP4) and ``figures.json``,
which the page reads. Names are stable: the kind of the picture and a running number.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from datasets.atomic import write_text
from report.camera import Framing, View
from report.render import ERROR_STOPS, Colour, render_frame, render_sequence
from report.sheets import contact_sheet, side_by_side, with_legend, write_image
from report.video import write_video

FAR = 0.8
"""A body that travels farther [m] is followed by the camera."""

NARROWEST = 96
"""Width of a picture [px] below which a legend does not fit."""

COLUMNS_SCALE = 0.72
"""Size of a picture that stands beside others, against one that stands alone."""


@dataclass(frozen=True)
class Dressed:
    """A garment on a moving body.

    Attributes:
        garment: Garment vertices [m], shape [T, V, 3].
        body: Body vertices [m], shape [T, B, 3].
        clip, label: What the body does.
    """

    garment: np.ndarray
    body: np.ndarray
    clip: str
    label: str

    def view(self, azimuth: float = 28.0) -> View:
        """A camera a little from the left, which follows a body that travels."""
        path = self.body.mean(axis=1)
        return View(azimuth=azimuth, follow=bool(np.ptp(path[:, [0, 2]], axis=0).max() > FAR))

    def cut(self, frames: int) -> Dressed:
        """The first frames."""
        return Dressed(self.garment[:frames], self.body[:frames], self.clip, self.label)


class Gallery:
    """Draws into a folder.

    Args:
        folder: An existing folder.
        garment: Name of the garment.
        colour: Its colour.
        garment_faces, body_faces: Triangles.
        size: Width and height of a picture that stands alone [px].
        fps: Frame rate of the videos [Hz].
    """

    def __init__(
        self,
        folder: Path,
        garment: str,
        colour: Colour,
        garment_faces: np.ndarray,
        body_faces: np.ndarray,
        size: tuple[int, int],
        fps: float,
    ) -> None:
        self.folder, self.garment, self.size, self.fps = folder, garment, size, fps
        self.faces = {"garment_faces": garment_faces, "body_faces": body_faces}
        self.colour = colour
        self.entries: list[dict[str, Any]] = []

    def hero(self, garment: np.ndarray, body: np.ndarray) -> None:
        """A still of the template on its body, in the bind pose."""
        image = render_frame(garment, body=body, size=self.size, colour=self.colour, view=View(28.0), **self.faces)
        self._image(
            "hero", image, f"{self.garment}, as built", f"{len(garment):,} vertices, on the bind pose.", "A template"
        )

    def animation(self, kind: str, dressed: Dressed, title: str, caption: str, **numbers: Any) -> None:
        """One dressed body in motion."""
        frames = self._draw(dressed, self.size)
        self._animation(kind, frames, title, caption, dressed, numbers)

    def contact(self, rows: Sequence[tuple[str, Dressed]], columns: int, caption: str) -> None:
        """A sheet: a sequence a row, evenly spread frames as columns; all rows must be equally long."""
        size = self._small(0.5)
        images, times = [], np.linspace(0, len(rows[0][1].garment) - 1, columns).round().astype(int)
        for _, dressed in rows:
            view = dressed.view()
            # Each frame is framed by the whole sequence, as in its animation.
            framing = Framing.of(dressed.body, view, size, dressed.garment)
            part = Framing(framing.direction, framing.distance, framing.targets[times], framing.field)
            images.append(
                render_sequence(
                    dressed.garment[times], body=dressed.body[times], size=size, colour=self.colour, framing=part,
                    **self.faces,
                )
            )  # fmt: skip
        labels = [f"{1000 * t / self.fps:.0f} ms" for t in times]
        sheet = contact_sheet(images, [name for name, _ in rows], labels)
        self._image("contact", sheet, f"{self.garment}: sequences of the data set", caption, "A sheet of frames")

    def materials(self, sets: Sequence[tuple[str, Dressed]], frame: int, caption: str, **numbers: Any) -> None:
        """The same clip under several parameter sets, side by side: a still of one frame and an animation."""
        size = self._small()
        framing = _common([d for _, d in sets], size)
        drawn = [self._draw(d, size, framing) for _, d in sets]
        frames = side_by_side(drawn, [name for name, _ in sets])
        first = sets[0][1]
        title = f"{self.garment}, {first.label}: {len(sets)} materials"
        self._animation("materials", frames, title, caption, first, numbers)
        self._image("material", frames[frame], title, f"{caption} Frame {frame}.", "Materials side by side", first)

    def error(
        self, truth: Dressed, predicted: np.ndarray, largest: float, caption: str, still: int, **numbers: Any
    ) -> None:
        """Truth, prediction and the prediction coloured by its error, side by side; animated, and one still."""
        size = self._small()
        framing = Framing.of(truth.body, truth.view(), size, truth.garment)
        guess = Dressed(predicted, truth.body, truth.clip, truth.label)
        distance = np.linalg.norm(predicted - truth.garment, axis=2)
        coloured = self._draw(guess, size, framing, distance, largest)
        coloured = with_legend(coloured, ERROR_STOPS, 1e3 * largest, "mm", "error")
        frames = side_by_side(
            [self._draw(truth, size, framing), self._draw(guess, size, framing), coloured],
            ["simulated", "predicted", "error"],
        )
        title = f"{self.garment}, {truth.label}"
        self._animation("error", frames, title, caption, truth, numbers)
        self._image("error_still", frames[still], title, caption, "Truth, prediction, error", truth, numbers)

    def refined(self, before: Dressed, after: np.ndarray, frame: int, caption: str, **numbers: Any) -> None:
        """A frame before and after refinement, what was inside the body before in a strong colour."""
        size = self._small(0.9)
        framing = Framing.of(before.body, before.view(), size, before.garment)
        framing = Framing(framing.direction, framing.distance, framing.targets[frame : frame + 1], framing.field)
        moved = np.linalg.norm(after - before.garment, axis=2)
        one = slice(frame, frame + 1)
        largest = round_scale(float(moved[one].max()))
        still = {"body": before.body[one], "size": size, "framing": framing, **self.faces}
        images = [
            render_sequence(before.garment[one], colour=self.colour, **still),
            render_sequence(after[one], colour=self.colour, **still),
            with_legend(
                render_sequence(after[one], colour=self.colour, error=moved[one], largest_error=largest, **still),
                ERROR_STOPS,
                1e3 * largest,
                "mm",
                "moved",
            ),
        ]
        image = side_by_side(images, ["predicted", "refined", "moved by"])[0]
        self._image("refined", image, f"{self.garment}, {before.label}", caption, "Refinement", before, numbers)

    def still(self, garment: np.ndarray, body: np.ndarray, **drawing: Any) -> np.ndarray:
        """One small picture for a sheet, uint8 [H, W, 3]; ``drawing`` as in ``report.render.render_frame``."""
        size = self._small(0.5)
        return render_frame(garment, body=body, size=size, colour=self.colour, **drawing, **self.faces)

    def sheet(
        self,
        kind: str,
        rows: Sequence[Sequence[np.ndarray]],
        row_labels: Sequence[str],
        column_labels: Sequence[str],
        caption: str,
        alt: str,
        **numbers: Any,
    ) -> None:
        """Rows of stills, labelled."""
        sheet = contact_sheet(rows, row_labels, column_labels)
        self._image(kind, sheet, self.garment, caption, alt, numbers=numbers)

    def write(self, **more: Any) -> None:
        """Write the list of the pictures."""
        listing = {"garment": self.garment, "fps": self.fps, **more, "figures": self.entries}
        write_text(self.folder / "figures.json", json.dumps(listing, indent=1))

    def _draw(
        self,
        dressed: Dressed,
        size: tuple[int, int],
        framing: Framing | None = None,
        error: np.ndarray | None = None,
        largest: float = 0.05,
    ) -> np.ndarray:
        framing = framing or Framing.of(dressed.body, dressed.view(), size, dressed.garment)
        return render_sequence(
            dressed.garment, body=dressed.body, size=size, colour=self.colour, framing=framing, error=error,
            largest_error=largest, **self.faces,
        )  # fmt: skip

    def _small(self, scale: float = COLUMNS_SCALE) -> tuple[int, int]:
        """Size of a picture among others; never so narrow that the legend of an error has no room."""
        scale = max(scale, NARROWEST / self.size[0])
        return round(self.size[0] * scale), round(self.size[1] * scale)

    def _image(
        self,
        kind: str,
        image: np.ndarray,
        title: str,
        caption: str,
        alt: str,
        dressed: Dressed | None = None,
        numbers: dict[str, Any] | None = None,
    ) -> None:
        name = self._name(kind)
        write_image(self.folder / name, image)
        self._list(name, kind, image.shape, title, caption, alt, dressed, numbers, animated=False)

    def _animation(
        self, kind: str, frames: np.ndarray, title: str, caption: str, dressed: Dressed, numbers: dict[str, Any]
    ) -> None:
        frames = frames[:, : 2 * (frames.shape[1] // 2), : 2 * (frames.shape[2] // 2)]  # as video has to be
        name = self._name(kind, ".mp4")
        poster = f"{Path(name).stem}_poster.webp"
        write_video(self.folder / name, frames, self.fps)
        write_image(self.folder / poster, frames[0])
        self._list(name, kind, frames.shape[1:], title, caption, "Video", dressed, numbers, animated=True)
        self.entries[-1]["poster"] = poster

    def _name(self, kind: str, suffix: str = ".webp") -> str:
        return f"{kind}_{sum(e['kind'] == kind for e in self.entries):02d}{suffix}"

    def _list(
        self,
        name: str,
        kind: str,
        shape: Sequence[int],
        title: str,
        caption: str,
        alt: str,
        dressed: Dressed | None,
        numbers: dict[str, Any] | None,
        animated: bool,
    ) -> None:
        what = f" of the motion {dressed.label}" if dressed else ""
        self.entries.append(
            {
                "file": name,
                "kind": kind,
                "title": title,
                "caption": caption,
                "alt": f"{alt}: {self.garment} on a body{what}",
                "width": int(shape[1]),
                "height": int(shape[0]),
                "animated": animated,
                "label": dressed.label if dressed else "",
                "clip": dressed.clip if dressed else "",
                "numbers": {k: float(f"{v:.6g}") if isinstance(v, float) else v for k, v in (numbers or {}).items()},
            }
        )


def round_scale(value: float) -> float:
    """The next of 1, 2, 5, 10 ... millimetres [m], as the end of a colour bar."""
    steps = (1e-3 * factor * 10**k for k in range(4) for factor in (1, 2, 5))
    return next((step for step in steps if step >= value), 5.0)


def _common(several: Sequence[Dressed], size: tuple[int, int]) -> Framing:
    """One camera for several garments on the same motion: the farthest one."""
    framings = [Framing.of(d.body, d.view(), size, d.garment) for d in several]
    return max(framings, key=lambda f: f.distance)
