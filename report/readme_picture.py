"""The picture of the README's first screen, from a finished run: ``python -m report.readme_picture --results
results/default --out docs``.

In: the animations that stage ``render`` wrote. Out: ``picture.webp``, an animation that shows a simulated and a
generated sequence of each of the first two garments side by side, below 1.5 MB.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from PIL import Image, ImageSequence

from report.run_files import Picture, RunFiles
from report.sheets import side_by_side, write_animation

LARGEST = 1_500_000
"""Bytes of the picture, at most."""

QUALITIES = (75, 65, 55, 45, 35, 25)
GARMENTS = 2


def make_picture(results: str | Path, out: str | Path, width: int = 1200, frames: int = 60) -> Path:
    """Write ``out/picture.webp``; returns its path.

    Args:
        results: Folder of a finished run.
        out: Folder, made where it is missing.
        width: Width of the whole picture [px].
        frames: Frames at most.

    Raises:
        ValueError: The run has no animations, or the picture stays too large at the lowest quality.
    """
    pictures = [p for p in RunFiles(results).pictures() if p.kind in ("simulated", "generated") and p.animated]
    garments = list(dict.fromkeys(p.garment for p in pictures))[:GARMENTS]
    chosen = [
        next((p for p in pictures if p.garment == garment and p.kind == kind), None)
        for garment in garments
        for kind in ("simulated", "generated")
    ]
    chosen = [p for p in chosen if p is not None]
    if not chosen:
        raise ValueError(f"{results}: no animation in figures/; run the workflow to its end first")
    size = _panel(chosen, width)
    panels = [_frames(p.file, size, frames) for p in chosen]
    shortest = min(map(len, panels))
    joined = side_by_side([p[:shortest] for p in panels], [f"{p.garment}, {p.kind}" for p in chosen])
    path = Path(out) / "picture.webp"
    path.parent.mkdir(parents=True, exist_ok=True)
    for quality in QUALITIES:
        write_animation(path, joined, _frame_rate(chosen[0].file), quality)
        if path.stat().st_size < LARGEST:
            return path
    path.unlink()
    raise ValueError(f"{path}: larger than {LARGEST} bytes at quality {QUALITIES[-1]}; ask for fewer frames or pixels")


def _panel(chosen: Sequence[Picture], width: int) -> tuple[int, int]:
    first = chosen[0]
    return width // len(chosen), round(width / len(chosen) * first.height / first.width)


def _frames(path: Path, size: tuple[int, int], most: int) -> np.ndarray:
    """Frames of an animation, scaled to ``size`` = (width, height) [px], uint8 [T, H, W, 3]."""
    with Image.open(path) as image:
        found = []
        for frame in ImageSequence.Iterator(image):
            found.append(np.asarray(frame.convert("RGB").resize(size, Image.Resampling.LANCZOS)))
            if len(found) == most:
                break
    return np.stack(found)


def _frame_rate(path: Path) -> float:
    """Frame rate of an animation [Hz], from the mean duration of its frames."""
    with Image.open(path) as image:
        durations = []
        for frame in ImageSequence.Iterator(image):
            frame.load()
            durations.append(frame.info.get("duration", 33))
    return 1000.0 / max(float(np.mean(durations)), 1.0)


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(prog="python -m report.readme_picture", description=__doc__)
    parser.add_argument("--results", required=True, help="folder of a finished run")
    parser.add_argument("--out", default="docs", help="folder of the picture")
    options = parser.parse_args()
    try:
        path = make_picture(options.results, options.out)
    except ValueError as error:
        sys.exit(f"[readme_picture] error: {error}")
    print(f"{path}: {path.stat().st_size / 1e6:.2f} MB")


if __name__ == "__main__":
    main()
