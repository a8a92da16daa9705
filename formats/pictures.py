"""Animations as moving and still pictures: MP4 (H.264), GIF, and a PNG sheet of frames at equal distances of time.

They are drawn by ``report.render``: the body as a body, all other meshes as cloth in their colours.
"""

from __future__ import annotations

import io
import os
from collections.abc import Iterable, Iterator

import numpy as np
from PIL import Image

from formats.animation import Animation
from formats.target import new_file, refuse_existing, write_bytes
from report.camera import Framing, View
from report.sheets import PAPER, side_by_side
from report.video import encode_mp4

SIZE = (480, 640)
"""Width and height of a picture [px]."""

SHEET = (6, 2)
"""Columns and rows of a sheet, at most."""

FASTEST_GIF = 50.0
"""Frames a second that browsers show: they slow down what is faster."""

TRAVEL = 1.0
"""Way of the body over the ground [m] from which on the camera follows it."""


def drawn(
    animation: Animation, size: tuple[int, int] = SIZE, view: View | None = None, which: Iterable[int] | None = None
) -> Iterator[np.ndarray]:
    """Pictures of an animation, one after the other, uint8 [H, W, 3].

    Args:
        animation: What to draw.
        size: Width and height [px].
        view: Camera angles; by default a little from the front left, following a body that walks away.
        which: Frames to draw; all where None.
    """
    from report.render import SceneRenderer  # brings VTK, which takes seconds to load

    body = next((mesh for mesh in animation.meshes if mesh.name == "body"), None)
    cloth = [mesh for mesh in animation.meshes if mesh is not body]
    seen = np.concatenate([mesh.frames for mesh in (cloth or [body])], axis=1)
    if view is None:
        centre = seen[:, :, [0, 2]].mean(axis=1)
        view = View(follow=bool(np.ptp(centre, axis=0).max() > TRAVEL))
    framing = Framing.of(seen if body is None else body.frames, view, size, seen)
    # What is not there is a triangle without area in the middle of what is.
    nothing = (np.repeat(seen.mean(axis=1, keepdims=True), 3, axis=1), np.array([[0, 1, 2]]))
    body_vertices, body_faces = nothing if body is None else (body.frames, body.faces)
    vertices, faces, colours = *nothing, np.ones((3, 3))
    if cloth:
        starts = np.cumsum([0] + [mesh.frames.shape[1] for mesh in cloth])
        faces = np.concatenate([mesh.faces + start for mesh, start in zip(cloth, starts)])
        colours = np.concatenate([np.tile(mesh.colour, (mesh.frames.shape[1], 1)) for mesh in cloth])
        vertices = seen
    with SceneRenderer(faces, body_faces, size, colours) as scene:
        for frame in range(animation.frames) if which is None else which:
            yield scene.frame(vertices[frame], body_vertices[frame], framing, frame)


def write_mp4(path: str | os.PathLike, animation: Animation, force: bool = False) -> None:
    """Write a video; errors as those of ``formats.target``."""
    with new_file(path, force) as temporary:
        encode_mp4(temporary, drawn(animation), SIZE, animation.fps)


def write_gif(path: str | os.PathLike, animation: Animation, force: bool = False) -> None:
    """Write an endless GIF, of every second or third frame where it would be too fast for browsers."""
    refuse_existing(path, force)
    stride = int(np.ceil(animation.fps / FASTEST_GIF))
    which = range(0, animation.frames, stride)
    # Hundredths of a second, spread so that the length of the whole is right.
    times = np.round(np.arange(len(which) + 1) * 100.0 * stride / animation.fps).astype(int)
    images = (Image.fromarray(image).quantize(255, dither=Image.Dither.NONE) for image in drawn(animation, which=which))
    buffer = io.BytesIO()
    next(images).save(
        buffer, "GIF", save_all=True, append_images=images, duration=(10 * np.diff(times)).tolist(), loop=0, disposal=1
    )
    write_bytes(path, buffer.getbuffer(), force)


def write_sheet(path: str | os.PathLike, animation: Animation, force: bool = False) -> None:
    """Write a PNG sheet of frames, each under its time."""
    refuse_existing(path, force)
    buffer = io.BytesIO()
    Image.fromarray(sheet(animation)).save(buffer, "PNG", optimize=True)
    write_bytes(path, buffer.getbuffer(), force)


def sheet(animation: Animation, size: tuple[int, int] = (300, 400)) -> np.ndarray:
    """Frames at equal distances of time under their times, row by row, uint8 [H, W, 3]."""
    count = min(animation.frames, SHEET[0] * SHEET[1])
    columns = min(count, SHEET[0])
    which = np.linspace(0, animation.frames - 1, count).round().astype(int).tolist()
    images = list(drawn(animation, size, which=which))
    labels = [f"{frame / animation.fps:.2f} s" for frame in which]
    while len(images) % columns:
        images.append(np.full_like(images[0], PAPER))
        labels.append("")
    rows = [
        side_by_side([image[None] for image in images[k : k + columns]], labels[k : k + columns])[0]
        for k in range(0, len(images), columns)
    ]
    return np.concatenate(rows)
