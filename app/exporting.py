"""Taking what was made elsewhere: files in the folder of exports, none ever over another."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from formats.animation import Animation
from formats.save import check_target, save_animation

KINDS = ("glb", "usd", "mp4", "obj", "pc2", "h5")
"""Formats that the app offers."""

DOWNLOADED = 48 * 2**20
"""Bytes of a file that is offered to the browser as well, at most."""

_MOST = 10_000


def export(animation: Animation, folder: Path, kind: str) -> Path:
    """Write an animation under its own name, with a number where that is taken.

    Returns:
        The file, or the folder of a format that takes one.

    Raises:
        ValueError, OSError: It could not be written; nothing of it is left behind.
    """
    folder.mkdir(parents=True, exist_ok=True)
    for number in range(1, _MOST):
        name = animation.name if number == 1 else f"{animation.name[:54]}_{number}"
        path = folder / f"{name}.{kind}"
        try:
            check_target(path)
        except ValueError:
            if number + 1 == _MOST:
                raise
            continue
        return save_animation(path, replace(animation, name=name))
    raise ValueError(f"{folder} holds {_MOST} exports of that name; move them away")
