"""The motion that a user names in a word: a file, a clip of the run, or labels.

Each ``ValueError`` is one sentence that says what there is.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import torch

from formats.motion_file import read_motion
from motions.clip import Clip
from motions.clip_file import read_clips
from runtime.finished_run import FinishedRun
from runtime.motion_making import generated_clip
from runtime.wishes import labels

_FILES = (".bvh", ".npz", ".h5", ".hdf5")


def asked_motion(
    run: FinishedRun, what: str, clip: str | None = None, frames: int | None = None, seed: int = 0
) -> Clip:
    """The motion, of the run's own body and at its frame rate.

    Args:
        run: A finished run.
        what: A motion file; the name of a clip of the run, such as ``walk_003``; or a label, or several with commas
            between them, which a motion is invented from.
        clip: Which clip, of a file that holds several.
        frames: Length of an invented motion; that of the run's clips where None.
        seed: Another seed, another invented motion.

    Raises:
        ValueError: It is none of these; the known labels are listed.
        FileNotFoundError: It looks like a file, and there is none.
    """
    path = Path(what)
    if path.is_file() or path.suffix.lower() in _FILES:
        return read_motion(path, run.fps, run.body, clip)
    found = run_clip(run, what)
    if found is not None:
        return found
    wanted, known = labels([what]), list(run.generator.config.labels)
    unknown = [label for label in wanted if label not in known]
    if unknown:
        raise ValueError(
            f"motion {what!r}: {unknown[0]!r} is no file, no clip of {run.folder} and no label; "
            f"known labels: {', '.join(known)}"
        )
    name = "_".join(wanted) + f"_{seed:04d}"
    randomness = torch.Generator().manual_seed(seed)
    return generated_clip(
        run.generator, wanted, frames or run.segment, run.segment, run.fps, run.body, randomness, name
    )


def run_clip(run: FinishedRun, name: str) -> Clip | None:
    """The clip of a name among the motions of a run; None where there is none."""
    for path in sorted((run.folder / "motions").glob("batch_*.h5")):
        for clip in read_clips(path):
            if clip.name == name:
                return clip
    return None


def stretch(clip: Clip, first: int, frames: int | None) -> Clip:
    """``frames`` frames of a clip from ``first`` on, all that follow where None.

    Raises:
        ValueError: Fewer than two frames, or frames that the clip does not have.
    """
    last = clip.frames if frames is None else first + frames
    if not 0 <= first < last - 1 < clip.frames:
        raise ValueError(
            f"motion '{clip.name}': frames {first} to {last - 1} are asked for, at least two of its frames 0 to "
            f"{clip.frames - 1} are allowed"
        )
    part = slice(first, last)
    return replace(clip, pose=clip.pose[part], root=clip.root[part])
