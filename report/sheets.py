"""Pictures put together: labelled sheets, the legend of an error map, animated WebP.

In: images, uint8 [H, W, 3], or sequences of them, [T, H, W, 3]. Out: images of the same kind, or a file.
"""

from __future__ import annotations

import os
from collections.abc import Sequence

import numpy as np
from PIL import Image, ImageDraw, ImageFont

from datasets.atomic import atomic_path

PAPER = (244, 242, 240)
INK = (52, 48, 46)
GAP = 6


def side_by_side(sequences: Sequence[np.ndarray], labels: Sequence[str] | None = None) -> np.ndarray:
    """Join sequences [T, H, W, 3] of equal size left to right, each under its label -> [T, H', W', 3]."""
    shapes = {s.shape for s in sequences}
    if len(shapes) != 1 or len(next(iter(shapes))) != 4:
        raise ValueError(f"side_by_side: expected sequences of one shape [T, H, W, 3], got {sorted(shapes)}")
    frames, height, width, _ = sequences[0].shape
    head = caption_height(width) if labels is not None else 0
    strip = _blank(head, len(sequences) * (width + GAP) - GAP)
    if labels is not None:
        for k, label in enumerate(labels):
            _write(strip, label, k * (width + GAP), width, head)
    result = np.empty((frames, head + height, strip.shape[1], 3), dtype=np.uint8)
    result[:] = PAPER
    result[:, :head] = strip
    for k, sequence in enumerate(sequences):
        left = k * (width + GAP)
        result[:, head:, left : left + width] = sequence
    return result


def contact_sheet(
    rows: Sequence[Sequence[np.ndarray]],
    row_labels: Sequence[str] | None = None,
    column_labels: Sequence[str] | None = None,
) -> np.ndarray:
    """A grid of images of equal size with labels on the left and on top, uint8 [H', W', 3].

    Args:
        rows: Rows of images [H, W, 3]; all rows equally long.
        row_labels: One text a row, written upwards along its left edge.
        column_labels: One text a column.
    """
    if not rows or len({len(row) for row in rows}) != 1 or len({image.shape for row in rows for image in row}) != 1:
        raise ValueError("contact_sheet: expected rows of equal length with images of one size")
    height, width, _ = rows[0][0].shape
    head = caption_height(width) if column_labels is not None else 0
    side = caption_height(width) if row_labels is not None else 0
    sheet = _blank(head + len(rows) * (height + GAP) - GAP, side + len(rows[0]) * (width + GAP) - GAP)
    for i, row in enumerate(rows):
        top = head + i * (height + GAP)
        for j, image in enumerate(row):
            left = side + j * (width + GAP)
            sheet[top : top + height, left : left + width] = image
        if row_labels is not None:
            upright = _blank(side, height)
            _write(upright, row_labels[i], 0, height, side, size=_text_size(width))
            sheet[top : top + height, :side] = np.rot90(upright)
    if column_labels is not None:
        for j, label in enumerate(column_labels):
            _write(sheet, label, side + j * (width + GAP), width, head)
    return sheet


def with_legend(image: np.ndarray, colours: np.ndarray, largest: float, unit: str, title: str) -> np.ndarray:
    """Draw a colour bar from 0 to ``largest`` into the lower left corner of an image or a sequence.

    Args:
        image: [H, W, 3] or [T, H, W, 3].
        colours: The colour stops, RGB in 0..1, evenly spaced, shape [S, 3].
        largest: Value at the end of the bar; larger values share its colour.
        unit: Unit of the values, as printed.
        title: What the colours mean.
    """
    height, width = image.shape[-3:-1]
    size = _text_size(width)
    bar, margin = (max(60, width // 3), max(6, size // 2)), max(8, width // 40)
    place = np.linspace(0, 1, bar[0])
    stops = np.linspace(0, 1, len(colours))
    ramp = np.stack([np.interp(place, stops, colours[:, k]) for k in range(3)], axis=1)
    result = image.copy()
    bottom = height - margin - int(1.5 * size)
    result[..., bottom - bar[1] : bottom, margin : margin + bar[0], :] = (255 * ramp).astype(np.uint8)
    # Texts are drawn once and laid over all frames.
    layer = Image.new("L", (width, height), 0)
    draw, font = ImageDraw.Draw(layer), ImageFont.load_default(size)
    draw.text((margin, bottom - bar[1] - 3), title, font=font, fill=255, anchor="ld")
    for share in (0.0, 0.5, 1.0):
        text = f"{largest * share:g}" + (f" {unit}" if share == 1.0 else "")
        draw.text((margin + share * bar[0], bottom + 3), text, font=font, fill=255, anchor="la" if share == 0 else "ma")
    cover = np.asarray(layer)[..., None] / 255.0
    rows = slice(bottom - bar[1] - 2 * size, height)
    mixed = result[..., rows, :, :] * (1 - cover[rows]) + np.array(INK) * cover[rows]
    result[..., rows, :, :] = mixed.astype(np.uint8)
    return result


def write_animation(path: str | os.PathLike, frames: np.ndarray, fps: float, quality: int = 70) -> None:
    """Write a looping animated WebP of ``frames [T, H, W, 3]``, atomically."""
    _check_frames(frames)
    if not fps > 0:
        raise ValueError(f"write_animation: frame rate {fps} Hz must be positive")
    # Whole milliseconds, spread so that the length of the clip is right.
    times = np.round(np.arange(len(frames) + 1) * 1000.0 / fps).astype(int)
    images = [Image.fromarray(frame) for frame in frames]
    with atomic_path(path) as temporary:
        images[0].save(
            temporary,
            format="WEBP",
            save_all=True,
            append_images=images[1:],
            duration=np.diff(times).tolist(),
            loop=0,
            quality=quality,
            method=2,
            minimize_size=False,
        )


def write_image(path: str | os.PathLike, image: np.ndarray, quality: int = 85) -> None:
    """Write one image [H, W, 3], atomically; the suffix names the format (.png, .webp, .jpg)."""
    _check_frames(image[None])
    with atomic_path(path) as temporary:
        Image.fromarray(image).save(temporary, quality=quality)


def caption_height(width: int) -> int:
    """Height of a caption over a picture of this width [px]."""
    return int(1.9 * _text_size(width))


def _text_size(width: int) -> int:
    return int(np.clip(width / 24, 11, 22))


def _blank(height: int, width: int) -> np.ndarray:
    return np.full((height, width, 3), PAPER, dtype=np.uint8)


def _write(sheet: np.ndarray, text: str, left: int, width: int, height: int, size: int | None = None) -> None:
    """Write a text centred in a box at the top of ``sheet``, smaller if it would not fit."""
    if height == 0:
        return
    size = size or _text_size(width)
    while size > 7 and ImageFont.load_default(size).getlength(text) > width:
        size -= 1
    box = Image.new("RGB", (width, height), PAPER)
    ImageDraw.Draw(box).text((width / 2, height / 2), text, font=ImageFont.load_default(size), fill=INK, anchor="mm")
    sheet[:height, left : left + width] = np.asarray(box)


def _check_frames(frames: np.ndarray) -> None:
    if frames.ndim != 4 or frames.shape[-1] != 3 or frames.dtype != np.uint8 or len(frames) == 0:
        raise ValueError(f"expected images uint8 [T, H, W, 3], got {frames.dtype} {list(frames.shape)}")
