"""Batches of clips in one HDF5 file. This module alone knows the layout.

Layout (version 1): attributes ``format``, ``version``, ``units``, ``clips`` (their number) on the file; one group
``clips/<index>`` per clip in batch order, with attributes ``name``, ``take``, ``label``, ``fps``, ``source`` and the
datasets ``pose`` [T, 24, 3] and ``root`` [T, 3].
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import h5py
import numpy as np

from body.skeleton import JOINT_COUNT
from datasets.atomic import atomic_path
from motions.clip import Clip

FORMAT = "drapeline-motions"
VERSION = 1
UNITS = "pose: axis-angle [rad], SMPL joint order; root: [m], y up; fps: [Hz]"
MAX_FRAMES = 1_000_000  # of one clip; a larger number in a file is damage, not motion


def write_clips(path: str | Path, clips: Sequence[Clip]) -> None:
    """Write clips to one file, atomically: a reader sees the old file or the whole new one, never a part.

    Args:
        path: Target file (.h5).
        clips: Clips with unique names, in the order in which they are read back.

    Raises:
        ValueError: No clips, or two clips of one name.
    """
    names = [clip.name for clip in clips]
    if not names:
        raise ValueError(f"No clips to write to {path}; a motion file holds at least one")
    if len(set(names)) != len(names):
        twice = next(name for name in names if names.count(name) > 1)
        raise ValueError(f"Two clips are named '{twice}'; names must be unique in {path}")
    with atomic_path(path) as temporary, h5py.File(temporary, "w") as file:
        file.attrs["format"], file.attrs["version"], file.attrs["units"] = FORMAT, VERSION, UNITS
        file.attrs["clips"] = len(clips)
        for index, clip in enumerate(clips):
            group = file.create_group(f"clips/{index:05d}")
            for field in ("name", "take", "label", "fps", "source"):
                group.attrs[field] = getattr(clip, field)
            for field in ("pose", "root"):
                group.create_dataset(field, data=getattr(clip, field), compression="gzip", shuffle=True)


def read_clips(path: str | Path) -> list[Clip]:
    """Read all clips of a file, in the order in which they were written.

    Raises:
        FileNotFoundError: No such file.
        ValueError: Not an HDF5 file, another format or version, missing parts, damaged or invalid motion.
    """
    if not Path(path).is_file():
        raise FileNotFoundError(f"Motion file {path} does not exist")
    try:
        with h5py.File(path, "r") as file:
            _check_header(file, path)
            groups = file.get("clips")
            expected = int(file.attrs.get("clips", -1))
            if not isinstance(groups, h5py.Group) or len(groups) != expected:
                found = len(groups) if isinstance(groups, h5py.Group) else 0
                raise ValueError(f"Motion file {path} announces {expected} clips but holds {found}")
            return [_read_clip(groups[key], f"{path}, clip {key}") for key in sorted(groups)]
    except (OSError, KeyError, TypeError, RuntimeError) as error:
        raise ValueError(f"Motion file {path} is damaged or not an HDF5 file: {error}") from None


def _check_header(file: h5py.File, path: str | Path) -> None:
    found = file.attrs.get("format")
    if found != FORMAT:
        raise ValueError(f"{path} is not a motion file: its format is {found!r}, expected '{FORMAT}'")
    version = file.attrs.get("version")
    if version != VERSION:
        raise ValueError(f"Motion file {path} has version {version}, this program reads version {VERSION}")


def _read_clip(group: h5py.Group, where: str) -> Clip:
    for field, tail in (("pose", (JOINT_COUNT, 3)), ("root", (3,))):
        dataset = group.get(field)
        if not isinstance(dataset, h5py.Dataset) or dataset.shape[1:] != tail or dataset.dtype.kind != "f":
            raise ValueError(f"{where}: dataset '{field}' is missing or not floats of shape {['T', *tail]}")
        if dataset.shape[0] > MAX_FRAMES:
            raise ValueError(f"{where}: {dataset.shape[0]} frames, at most {MAX_FRAMES} are allowed")
    missing = [field for field in ("name", "take", "label", "fps", "source") if field not in group.attrs]
    if missing:
        raise ValueError(f"{where}: attribute '{missing[0]}' is missing")
    texts = {field: str(group.attrs[field]) for field in ("name", "take", "label", "source")}
    arrays = {field: np.asarray(group[field][()], dtype=np.float32) for field in ("pose", "root")}
    try:
        return Clip(fps=float(group.attrs["fps"]), **texts, **arrays)
    except ValueError as error:
        raise ValueError(f"{where}: {error}") from None
