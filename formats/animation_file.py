"""Our own animation file (HDF5): everything of an ``Animation``, without loss. This module alone knows the layout.

Layout, version 1: attributes ``format``, ``version``, ``units``, ``name``, ``fps``, ``meshes`` (their number) and
``notes`` (JSON) on the file; ``meshes/<index>`` with attributes ``name``, ``material``, ``colour`` and the datasets
``faces`` [F, 3] int32, ``frames`` [T, V, 3] float32 (shuffled Zstandard, eight frames a chunk) and, where there are
any, ``uv`` [V, 2] float32; where the motion is known, ``clip`` with attributes ``name``, ``take``, ``label`` and
``source``, and the datasets ``pose`` [T, 24, 3] and ``root`` [T, 3].

A file is untrusted: its sizes are judged before anything is read, and it cannot make other files be read.
"""

from __future__ import annotations

import io
import json
import os
from pathlib import Path

import h5py
import hdf5plugin
import numpy as np

from formats.animation import MAX_POINTS, AnimatedMesh, Animation
from formats.body_notes import PELVIS_HEIGHT
from formats.target import refuse_existing, write_bytes
from motions.clip import Clip

FORMAT = "drapeline-animation"
VERSION = 1
UNITS = "frames: [m], y up; pose: axis-angle [rad], SMPL joint order; root: [m]; fps: [Hz]; colour: sRGB, 0 to 1"
FRAMES_PER_CHUNK = 8
MAX_MESHES = 64
LOWEST, HIGHEST = 0.2, 2.5
"""Of a pelvis above the ground [m]."""
LARGEST_CHUNK = 256 * 2**20
"""Bytes of a stored chunk, at most: what one read takes from memory, whatever the size of the dataset."""


def write_animation_file(path: str | os.PathLike, animation: Animation, force: bool = False) -> None:
    """Write an animation file, whole or not at all; errors as those of ``formats.target``."""
    refuse_existing(path, force)
    # In memory first: HDF5 cannot be relied on to clean up after a disk that is full.
    buffer = io.BytesIO()
    with h5py.File(buffer, "w") as file:
        file.attrs.update(format=FORMAT, version=VERSION, units=UNITS, name=animation.name, fps=animation.fps)
        file.attrs.update(meshes=len(animation.meshes), notes=json.dumps(dict(animation.notes)))
        for index, mesh in enumerate(animation.meshes):
            group = file.create_group(f"meshes/{index:02d}")
            group.attrs.update(name=mesh.name, material=mesh.material, colour=mesh.colour)
            for field in ("faces", "frames", "uv"):
                values = getattr(mesh, field)
                if values is not None:
                    chunk = (
                        (min(FRAMES_PER_CHUNK, len(values)), *values.shape[1:]) if field == "frames" else values.shape
                    )
                    group.create_dataset(field, data=values, chunks=chunk, **_STORAGE)
        if animation.clip is not None:
            group = file.create_group("clip")
            for field in ("name", "take", "label", "source"):
                group.attrs[field] = getattr(animation.clip, field)
            for field in ("pose", "root"):
                group.create_dataset(field, data=getattr(animation.clip, field), **_STORAGE)
    write_bytes(path, buffer.getbuffer(), force)


_STORAGE = dict(hdf5plugin.Blosc(cname="zstd", clevel=3, shuffle=hdf5plugin.Blosc.SHUFFLE))


def load_animation(path: str | os.PathLike) -> Animation:
    """Read an animation file.

    Raises:
        FileNotFoundError: No such file.
        ValueError: Not an animation file, another version, damaged, or larger than this program reads.
    """
    with _opened(path) as file:
        return _animation(file)


def load_clip(path: str | os.PathLike) -> tuple[Clip, float | None]:
    """The motion of an animation file, without its meshes, and how high its body's pelvis is at rest [m] where it says.

    ``ValueError`` where it has none, else as above.
    """
    with _opened(path) as file:
        if "clip" not in file:
            raise ValueError("the animation was saved without its motion")
        height = _notes(file).get(PELVIS_HEIGHT)
        if height is not None and not (isinstance(height, int | float) and LOWEST <= height <= HIGHEST):
            raise ValueError(
                f"its body's pelvis is {height!r} m above the ground, {LOWEST:g} to {HIGHEST:g} are allowed"
            )
        return _clip(file["clip"], _number(file, "fps")), height


class _opened:
    """An animation file for reading; whatever is wrong with it ends as a ``ValueError`` that names it."""

    def __init__(self, path: str | os.PathLike) -> None:
        self.path = Path(path)
        if not self.path.is_file():
            raise FileNotFoundError(f"{path}: no such file")

    def __enter__(self) -> h5py.File:
        try:
            self.file = h5py.File(self.path, "r")
        except OSError as error:
            raise ValueError(f"{self.path}: not a readable HDF5 file ({error})") from None
        try:
            found, version = self.file.attrs.get("format"), self.file.attrs.get("version")
            if not isinstance(found, str) or found != FORMAT:
                raise ValueError(f"{self.path}: is no animation file, its format is {str(found)[:40]!r}")
            if version != VERSION:
                raise ValueError(f"{self.path}: version {version}, this program reads version {VERSION}")
        except BaseException:
            self.file.close()
            raise
        return self.file

    def __exit__(self, kind: type | None, error: BaseException | None, _: object) -> None:
        self.file.close()
        if isinstance(error, KeyError):
            raise ValueError(f"{self.path}: the file lacks a part ({error.args[0]})") from None
        if isinstance(error, OSError | ValueError | TypeError | AttributeError | RuntimeError | RecursionError):
            raise ValueError(f"{self.path}: {error}") from None


def _animation(file: h5py.File) -> Animation:
    fps, count = _number(file, "fps"), _number(file, "meshes")
    if not 1 <= count <= MAX_MESHES:
        raise ValueError(f"{count:g} meshes, allowed are 1 to {MAX_MESHES}")
    groups = [file[f"meshes/{index:02d}"] for index in range(int(count))]
    points = 0
    for group in groups:
        shape = _dataset(group, "frames", (None, None, 3), "f").shape
        points += shape[0] * shape[1]
    if points > MAX_POINTS:
        raise ValueError(f"{points} vertices over all frames, at most {MAX_POINTS} are read")
    clip = _clip(file["clip"], fps) if "clip" in file else None
    return Animation(tuple(_mesh(group) for group in groups), fps, _text(file, "name"), clip, _notes(file))


def _mesh(group: h5py.Group) -> AnimatedMesh:
    frames = _dataset(group, "frames", (None, None, 3), "f")
    faces = _dataset(group, "faces", (None, 3), "iu")
    uv = _dataset(group, "uv", (frames.shape[1], 2), "f")[()] if "uv" in group else None
    colour = np.asarray(group.attrs["colour"])
    if colour.shape != (3,) or colour.dtype.kind != "f":
        raise ValueError("a colour must be three numbers")
    return AnimatedMesh(
        _text(group, "name"), faces[()], frames[()], tuple(colour.tolist()), _text(group, "material"), uv
    )


def _clip(group: h5py.Group, fps: float) -> Clip:
    texts = {field: _text(group, field) for field in ("name", "take", "label", "source")}
    pose = _dataset(group, "pose", (None, 24, 3), "f")
    root = _dataset(group, "root", (pose.shape[0], 3), "f")
    return Clip(pose=pose[()], root=root[()], fps=fps, **texts)


def _dataset(group: h5py.Group, name: str, shape: tuple[int | None, ...], kinds: str) -> h5py.Dataset:
    """A dataset that is what it should be, judged before it is read."""
    if not isinstance(group, h5py.Group) or not isinstance(group.get(name, getlink=True), h5py.HardLink):
        raise ValueError(f"'{name}' is missing")
    found = group[name]
    if not isinstance(found, h5py.Dataset) or found.dtype.kind not in kinds or found.dtype.itemsize > 8:
        raise ValueError(f"'{name}' must be an array of {'whole ' if kinds == 'iu' else ''}numbers")
    if found.is_virtual or found.external:
        raise ValueError(f"'{name}' refers to another file")
    if len(found.shape) != len(shape) or any(w is not None and w != g for w, g in zip(shape, found.shape)):
        raise ValueError(
            f"'{name}' has shape {list(found.shape)}, expected {['any' if w is None else w for w in shape]}"
        )
    if found.size > 3 * MAX_POINTS or (found.chunks and np.prod(found.chunks) * found.dtype.itemsize > LARGEST_CHUNK):
        raise ValueError(f"'{name}' is larger than this program reads")
    return found


def _text(group: h5py.Group, name: str) -> str:
    value = group.attrs[name]
    if not isinstance(value, str) or len(value) > 1000:
        raise ValueError(f"'{name}' must be a text")
    return value


def _number(group: h5py.Group, name: str) -> float:
    value = np.asarray(group.attrs[name])
    if value.shape != () or value.dtype.kind not in "iuf":
        raise ValueError(f"'{name}' must be a number")
    return float(value)


def _notes(file: h5py.File) -> dict[str, str | float]:
    text = file.attrs["notes"]
    notes = json.loads(text) if isinstance(text, str) else None
    if not isinstance(notes, dict):
        raise ValueError("'notes' must be a JSON object")
    return notes
