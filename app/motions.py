"""Motions that a session takes: invented from a label, or of a file; none longer than can be worked on."""

from __future__ import annotations

from pathlib import Path

from formats.motion_file import read_motion
from motions.clip import Clip
from runtime.asked_motion import asked_motion
from runtime.finished_run import FinishedRun

FRAMES = 240
"""Length of a generated motion, at first."""

LONGEST = 3000
"""Frames of a motion, at most: a hundred seconds at 30 frames a second."""


def invented_motion(run: FinishedRun, label: str, frames: int, seed: int) -> Clip:
    """A motion made of a label; ``ValueError`` lists the known labels and says how long it may be."""
    known = run.generator.config.labels
    if label not in known:
        raise ValueError(f"label {label!r} is unknown; known labels: {', '.join(known)}")
    if not 2 <= frames <= LONGEST:
        raise ValueError(f"a motion of {frames} frames: allowed are 2 to {LONGEST}")
    return asked_motion(run, label, None, frames, seed)


def motion_of_file(run: FinishedRun, path: Path, name: str | None = None) -> Clip:
    """The motion of a file: BVH, AMASS or our own.

    Args:
        run: Says the frame rate and the body.
        path: The file.
        name: Which clip, of a file that holds several.

    Raises:
        ValueError: No motion, or none of that name, or too long; one sentence.
    """
    return checked_length(read_motion(path, run.fps, run.body, name))


def checked_length(clip: Clip) -> Clip:
    """The clip; ``ValueError`` where it is too long or too short."""
    if not 2 <= clip.frames <= LONGEST:
        raise ValueError(f"motion '{clip.name}' has {clip.frames} frames, allowed are 2 to {LONGEST}")
    return clip
