"""Layer files: garments as displacements of the body's vertices, and all of a run's as the arrays that networks take.

One HDF5 file a type of clothing (``LayerFile``): attributes ``format``, ``version``, ``type``, ``body_name``,
``body_digest``; ``covered`` [C] int32; a row a frame of ``displacements`` [N, C, 3] float16 [m] (a tenth of a metre is
kept to 0.05 mm), ``pose`` [N, 24, 3] [rad], ``root`` [N, 3] [m], ``shape`` [N, 10] [standard deviations], and of
``body_index``, ``sequence`` [N] int32 with the names in ``splits``, ``clips`` [number of sequences].
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import h5py
import numpy as np

from datasets.atomic import atomic_path

FORMAT = "drapeline-layer"
VERSION = 1

_ARRAYS = {"displacements": 3, "pose": 3, "root": 2, "shape": 2, "body_index": 1, "sequence": 1}


@dataclass(frozen=True)
class LayerFile:
    """Frames of one type of clothing; shapes as in the module's table.

    Attributes:
        type: Name of the type.
        body_name, body_digest: The body.
        covered: Body vertices that this type covers, ascending, shape [C].
        displacements: Of the covered vertices in the unposed space [m], shape [N, C, 3].
        pose, root: Pose [rad] and root translation [m] of each frame.
        shape: Shape coefficients of each frame's body [standard deviations], shape [N, 10].
        body_index: Number of each frame's body, shape [N].
        sequence: Number of each frame's sequence, shape [N].
        splits: Split of each sequence.
        clips: Clip of each sequence.
    """

    type: str
    body_name: str
    body_digest: str
    covered: np.ndarray
    displacements: np.ndarray
    pose: np.ndarray
    root: np.ndarray
    shape: np.ndarray
    body_index: np.ndarray
    sequence: np.ndarray
    splits: tuple[str, ...]
    clips: tuple[str, ...]

    def __post_init__(self) -> None:
        count = len(self.displacements)
        if self.displacements.shape[1:] != (len(self.covered), 3):
            raise ValueError(
                f"layer '{self.type}': expected displacements [N, {len(self.covered)}, 3], "
                f"got {list(self.displacements.shape)}"
            )
        for name, dimensions in _ARRAYS.items():
            array = getattr(self, name)
            if array.ndim != dimensions or len(array) != count:
                raise ValueError(f"layer '{self.type}': {name} of shape {list(array.shape)} for {count} frames")
        if count and not np.isfinite(self.displacements).all():
            raise ValueError(f"layer '{self.type}': displacements are not finite")
        if count and not 0 <= self.sequence.min() <= self.sequence.max() < len(self.splits) == len(self.clips):
            raise ValueError(f"layer '{self.type}': frames of sequences without a name")


def write_layer(path: str | os.PathLike, layer: LayerFile) -> None:
    """Write a layer file, whole or not at all."""
    with atomic_path(path) as partial, h5py.File(partial, "w") as file:
        file.attrs.update(format=FORMAT, version=VERSION, type=layer.type)
        file.attrs.update(body_name=layer.body_name, body_digest=layer.body_digest)
        file["covered"] = layer.covered.astype(np.int32)
        for name in _ARRAYS:
            array = np.asarray(getattr(layer, name))
            kind = {"displacements": np.float16, "body_index": np.int32, "sequence": np.int32}.get(name, np.float32)
            file.create_dataset(name, data=array.astype(kind))
        for name in ("splits", "clips"):
            file.create_dataset(name, data=list(getattr(layer, name)), dtype=h5py.string_dtype())


def read_layer(path: str | os.PathLike) -> LayerFile:
    """Read a layer file.

    Raises:
        FileNotFoundError: There is none.
        ValueError: It is no layer file of this version, or damaged; the sentence names it.
    """
    if not Path(path).is_file():
        raise FileNotFoundError(f"layer file {path} does not exist")
    try:
        with h5py.File(path, "r") as file:
            if file.attrs.get("format") != FORMAT or file.attrs.get("version") != VERSION:
                raise ValueError(f"it is not a {FORMAT} file of version {VERSION}")
            arrays = {name: file[name][()] for name in ("covered", *_ARRAYS)}
            texts = {name: tuple(text.decode() for text in file[name][()]) for name in ("splits", "clips")}
            names = {name: str(file.attrs[name]) for name in ("type", "body_name", "body_digest")}
            return LayerFile(**names, **arrays, **texts)
    except (OSError, KeyError, TypeError, ValueError) as error:
        raise ValueError(f"layer file {path} cannot be read: {error}") from None


@dataclass(frozen=True)
class LayerExamples:
    """Frames of several types on the same vertices.

    Attributes:
        types: Names of the types, in the numbering of ``type_index``.
        body_name, body_digest: The body.
        vertices: Body vertices that any type covers, ascending, shape [A].
        covered: Which of them each type covers, shape [number of types, A].
        displacements: [m], zero where the type covers nothing, shape [N, A, 3] float32.
        type_index, body_index: Of each frame, shape [N].
        sequence: Number of each frame's sequence, one numbering for all types, shape [N].
        pose, root, shape: As in ``LayerFile``.
        split: Split of each frame, shape [N].
        clip: Clip of each frame, shape [N].
    """

    types: tuple[str, ...]
    body_name: str
    body_digest: str
    vertices: np.ndarray
    covered: np.ndarray
    displacements: np.ndarray
    type_index: np.ndarray
    body_index: np.ndarray
    sequence: np.ndarray
    pose: np.ndarray
    root: np.ndarray
    shape: np.ndarray
    split: np.ndarray
    clip: np.ndarray

    def chosen(self, rows: np.ndarray) -> LayerExamples:
        """Some of the frames: numbers or a mask."""
        own = ("displacements", "type_index", "body_index", "sequence", "pose", "root", "shape", "split", "clip")
        return LayerExamples(
            **{name: getattr(self, name) for name in ("types", "body_name", "body_digest", "vertices", "covered")},
            **{name: getattr(self, name)[rows] for name in own},
        )

    def __len__(self) -> int:
        return len(self.displacements)


def joined_layers(files: Sequence[LayerFile]) -> LayerExamples:
    """All types of a run on the vertices that any of them covers.

    Raises:
        ValueError: No frames, one type twice, or layers of different bodies.
    """
    if not files or not sum(len(f.displacements) for f in files):
        raise ValueError("layers: there is no frame to learn from; were all simulations dropped?")
    types = tuple(f.type for f in files)
    if len(set(types)) < len(types):
        raise ValueError(f"layers: each type may be given once, got {', '.join(types)}")
    stranger = next((f for f in files if f.body_digest != files[0].body_digest), None)
    if stranger is not None:
        raise ValueError(f"layers: '{stranger.type}' is on another body than '{types[0]}'")
    vertices = np.unique(np.concatenate([f.covered for f in files]))
    counts = [len(f.displacements) for f in files]
    displacements = np.zeros((sum(counts), len(vertices), 3), dtype=np.float32)
    covered = np.zeros((len(files), len(vertices)), dtype=bool)
    splits, clips, sequence, start, before = [], [], [], 0, 0
    for number, one in enumerate(files):
        place = np.searchsorted(vertices, one.covered)
        covered[number, place] = True
        displacements[start : start + counts[number], place] = one.displacements
        start += counts[number]
        splits.append(np.asarray(one.splits, dtype=object)[one.sequence])
        clips.append(np.asarray(one.clips, dtype=object)[one.sequence])
        sequence.append(one.sequence + before)
        before += len(one.splits)
    joined = {name: np.concatenate([getattr(f, name) for f in files]) for name in ("pose", "root", "shape")}
    return LayerExamples(
        types=types,
        body_name=files[0].body_name,
        body_digest=files[0].body_digest,
        vertices=vertices,
        covered=covered,
        displacements=displacements,
        type_index=np.repeat(np.arange(len(files)), counts),
        body_index=np.concatenate([f.body_index for f in files]),
        sequence=np.concatenate(sequence),
        split=np.concatenate(splits),
        clip=np.concatenate(clips),
        **joined,
    )
