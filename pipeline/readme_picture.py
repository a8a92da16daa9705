"""The picture of the README's first screen, from a finished run.

    python -m pipeline.readme_picture --run results/default --out docs

Above: a motion that was not trained on, in the run's first two garments, each as simulated and as the network makes it
of the motion alone. Below: the same motion in the first of them, simulated in fabrics from soft to stiff. Out:
``picture.webp``, a looping animation of at most 400 kB. Takes a minute or two; what is there is written over.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import numpy as np

from datasets.sequences import Sequence
from datasets.shards import MOTIONS
from datasets.splits import SplitRule
from formats.animation import Animation
from motions.clip import Clip
from pipeline.command import run_command
from pipeline.plan import shard_names
from pipeline.render import Data
from pipeline.spec import render_spec
from report.camera import Framing, View
from report.render import render_sequence, worn_colours
from report.sheets import PAPER, side_by_side, write_animation
from runtime.dressing import Wearing, dress, simulate
from runtime.finished_run import FinishedRun, LearnedGarment
from sim.fabrics import base_values
from sim.parameters import base_parameters

LARGEST = 400_000
"""Bytes of the picture, at most."""

QUALITIES = (80, 70, 62, 55, 48, 41, 34, 27, 20)
GARMENTS = 2
FABRICS = ("silk", "cotton", "twill", "leather")
"""From soft to stiff: 3.5, 15, 29 and 142 uN m."""

STRIDE = 2
"""Every second frame is shown: half the bytes, and smooth enough."""

CYCLE = (0.6, 1.6)
"""Length of what is shown [s]: the part of the clip that comes nearest to its own beginning."""

UPPER, LOWER = 4 / 3, 0.86
"""Height over width of the panels above, of whole bodies, and below, of the garment."""


def make_picture(run: FinishedRun, out: Path, label: str = "walk", width: int = 960) -> Path:
    """Write ``out/picture.webp``; returns its path.

    Args:
        run: A finished run.
        out: Folder, made where it is missing.
        label: Motion that is shown, the first held-out clip of it.
        width: Of the whole picture [px].

    Raises:
        ValueError: The run has no held-out clip of the label, a fabric does not hold, or the picture stays too large.
    """
    names = list(run.config["garments"])[:GARMENTS]
    panels = [draw for name in names for draw in _truth_and_network(run, name, label, width // (2 * len(names)))]
    upper = side_by_side([frames for _, frames in panels], [words for words, _ in panels])
    lower = _fabrics(run, names[0], label, width // len(FABRICS))
    frames = np.concatenate([upper, _as_wide(lower, upper.shape[2])], axis=1)
    out.mkdir(parents=True, exist_ok=True)
    path = out / "picture.webp"
    for quality in QUALITIES:
        write_animation(path, frames, run.fps / STRIDE, quality)
        if path.stat().st_size <= LARGEST:
            return path
    path.unlink()
    raise ValueError(f"{path}: larger than {LARGEST} bytes at quality {QUALITIES[-1]}; ask for fewer pixels")


def held_out(run: FinishedRun, name: str, label: str) -> Sequence:
    """The first simulated clip of a label that nothing was trained on, in the base material."""
    spec = json.loads(render_spec(run.config, name))
    paths = [run.folder / "shards" / name / f"{shard}.h5" for shard in shard_names(run.config, (MOTIONS,))]
    for path in paths:
        if not path.is_file():
            raise ValueError(f"{path} is missing: {run.folder} is not finished; `snakemake all` makes what lacks")
    data = Data([str(path) for path in paths], SplitRule(**spec["splits"]))
    rows = [row for row in data.rows if row["label"] == label and row["clip"] in spec["held_out_clips"]]
    if not rows:
        known = sorted({str(row["label"]) for row in data.rows if row["clip"] in spec["held_out_clips"]})
        raise ValueError(f"label {label!r}: no held-out clip was simulated; there are some of {', '.join(known)}")
    return data.read(rows[:1])[0]


def cycle(pose: np.ndarray, fps: float) -> slice:
    """The frames of a motion, every ``STRIDE``-th, after which it is nearest to where they began.

    Args:
        pose: Joint rotations [rad], shape [T, 24, 3]; the first joint, which heads elsewhere, is left out.
        fps: Frame rate [Hz].
    """
    shortest, longest = (round(seconds * fps / STRIDE) * STRIDE for seconds in CYCLE)
    # The way on from both ends counts too, or a step would be joined to its mirror image half a cycle later.
    joints = np.concatenate([pose[:-1, 1:], np.diff(pose[:, 1:], axis=0) * fps / 10.0], axis=1)
    found = [
        (float(np.square(joints[start] - joints[start + length]).sum()), start, length)
        for length in range(shortest, min(longest, len(joints) - 1) + 1, STRIDE)
        for start in range(len(joints) - length)
    ]
    if not found:
        return slice(0, len(pose), STRIDE)
    _, start, length = min(found)
    return slice(start, start + length, STRIDE)


def _truth_and_network(run: FinishedRun, name: str, label: str, width: int) -> list[tuple[str, np.ndarray]]:
    """A clip simulated and predicted, each with its words, drawn alike."""
    garment, truth = run.garment(name), held_out(run, name, label)
    learned = dress(_clip(truth), Wearing(garment)).animation
    body = next(mesh.frames for mesh in learned.meshes if mesh.name == "body")
    size = (width, round(UPPER * width))
    framing, some = Framing.of(body, View(28.0, follow=True, margin=0.03), size, truth.vertices), _cycle(truth)
    return [
        (f"{name}, simulated", _drawn(garment, truth.vertices, body, framing, size, some)),
        (f"{name}, learned", _drawn(garment, _cloth(learned), body, framing, size, some)),
    ]


def _fabrics(run: FinishedRun, name: str, label: str, width: int) -> np.ndarray:
    """A clip in each of ``FABRICS``, near enough to see folds."""
    garment, truth = run.garment(name), held_out(run, name, label)
    settings = run.config["garments"][name]
    shown = []
    for fabric in FABRICS:
        parameters = base_parameters(base_values(settings | {"fabric": fabric}))
        shown.append(simulate(_clip(truth), Wearing(garment, parameters)).animation)
    body = next(mesh.frames for mesh in shown[0].meshes if mesh.name == "body")
    size = (width, round(LOWER * width))
    everything = np.concatenate([_cloth(one) for one in shown], axis=1)
    framing = Framing.of(everything, View(28.0, follow=True, margin=0.02), size)
    drawn = [_drawn(garment, _cloth(one), body, framing, size, _cycle(truth)) for one in shown]
    return side_by_side(drawn, FABRICS)


def _drawn(
    garment: LearnedGarment,
    cloth: np.ndarray,
    body: np.ndarray,
    framing: Framing,
    size: tuple[int, int],
    some: slice,
) -> np.ndarray:
    """The frames ``some``, under a camera of all frames."""
    template = garment.template
    framing = Framing(framing.direction, framing.distance, framing.targets[some], framing.field)
    colours = worn_colours(template.worn_as, template.layer)
    body_faces = garment.run.body.faces
    return render_sequence(cloth[some], template.faces, body[some], body_faces, size, colours, framing=framing)


def _cycle(sequence: Sequence) -> slice:
    return cycle(sequence.pose, sequence.fps)


def _cloth(animation: Animation) -> np.ndarray:
    return next(mesh.frames for mesh in animation.meshes if mesh.name != "body")


def _clip(sequence: Sequence) -> Clip:
    return Clip(sequence.clip, sequence.take, sequence.label, sequence.pose, sequence.root, sequence.fps, "shard")


def _as_wide(frames: np.ndarray, width: int) -> np.ndarray:
    """Frames [T, H, W, 3] cut or filled to a width."""
    missing = max(0, width - frames.shape[2])
    filled = np.full((*frames.shape[:2], missing, 3), PAPER, dtype=np.uint8)
    return np.concatenate([frames, filled], axis=2)[:, :, :width]


def define(parser: argparse.ArgumentParser) -> None:
    """Options of the command."""
    parser.add_argument("--run", default="results/default", help="folder of a finished run (%(default)s)")
    parser.add_argument("--out", default="docs", help="folder of the picture (%(default)s)")
    parser.add_argument("--label", default="walk", help="motion that is shown (%(default)s)")


def picture(options: argparse.Namespace) -> None:
    """Draw and write."""
    path = make_picture(FinishedRun.open(options.run), Path(options.out), options.label)
    print(f"[readme_picture] {path}: {path.stat().st_size / 1e3:.0f} kB")


def main(given: list[str] | None = None) -> None:
    """Command line."""
    run_command("readme_picture", __doc__, define, picture, given)


if __name__ == "__main__":
    main()
