"""Garment descriptors of all frames of a run, so that shards are encoded once and not by each training.

A file of codes holds, for every simulated sequence of one garment, the descriptor of each frame (Wang 2019, section
3.3) and its motion, parameters and split, but no vertices. Layout, version 1:

=============================  ==============================================================================
``/`` attributes               ``format``, ``version``, ``garment``, ``fps`` [Hz], ``descriptor`` (digest of the
                               model file that encoded)
``/parameter_names``           [K] strings
``/{clip,take,label,plan,split}``  [S] strings, one a sequence
``/{phi,frames,lead_frames}``  [S] int64
``/parameters``                [S, K] float64
``/codes``                     [N, C] float32; N = sum of ``frames``
``/pose``, ``root``, ``joints``      SMPL pose [rad] [N, 24, 3], root translation [m] [N, 3], joints [m] [N, 24, 3]
``/lead_pose``, ``lead_root``, ``lead_joints``  before the first frame; as many rows as the sum of ``lead_frames``
=============================  ==============================================================================
"""

from __future__ import annotations

import hashlib
import os
from collections.abc import Iterable
from collections.abc import Sequence as Many
from dataclasses import dataclass

import h5py
import hdf5plugin
import numpy as np

from datasets.atomic import atomic_path
from datasets.splits import SPLITS

FORMAT = "drapeline-codes"
VERSION = 1
_TEXTS = ("clip", "take", "label", "plan", "split")
_MOTION = {"pose": (24, 3), "root": (3,), "joints": (24, 3)}


@dataclass(frozen=True)
class CodedSequence:
    """One simulated clip with its garment as descriptors; all else as in ``datasets.sequences.Sequence``.

    Attributes:
        codes: Descriptors, shape [T, C] float32.
    """

    garment: str
    clip: str
    take: str
    label: str
    plan: str
    phi: int
    split: str
    fps: float
    codes: np.ndarray
    pose: np.ndarray
    root: np.ndarray
    joints: np.ndarray
    lead_pose: np.ndarray
    lead_root: np.ndarray
    lead_joints: np.ndarray
    parameters: dict[str, float]

    @property
    def frames(self) -> int:
        """Number of recorded frames T."""
        return len(self.pose)


def file_digest(path: str | os.PathLike) -> str:
    """SHA-256 of a file's content: by it codes name the descriptor that made them."""
    with open(path, "rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def write_codes(path: str | os.PathLike, descriptor: str, sequences: Iterable[CodedSequence]) -> None:
    """Write a file of codes, whole or not at all.

    Args:
        descriptor: ``file_digest`` of the model file that encoded.
        sequences: Of one garment and frame rate, all with the same parameters; taken one at a time.

    Raises:
        ValueError: No sequence, or sequences of different garments, frame rates or parameters.
    """
    known = list(sequences)
    if not known:
        raise ValueError("codes: there is no sequence to write")
    first = known[0]
    names = list(first.parameters)
    for s in known:
        if (s.garment, s.fps, list(s.parameters)) != (first.garment, first.fps, names):
            raise ValueError(
                f"codes: sequence {s.clip} of {s.garment} at {s.fps:g} Hz does not belong with {first.clip} of "
                f"{first.garment} at {first.fps:g} Hz, or has other parameters"
            )
    with atomic_path(path) as temporary, h5py.File(temporary, "w") as file:
        file.attrs.update(format=FORMAT, version=VERSION, garment=first.garment, fps=first.fps, descriptor=descriptor)
        text = h5py.string_dtype()
        file.create_dataset("parameter_names", data=names, dtype=text)
        for name in _TEXTS:
            file.create_dataset(name, data=[getattr(s, name) for s in known], dtype=text)
        file["phi"] = np.array([s.phi for s in known], dtype=np.int64)
        file["frames"] = np.array([s.frames for s in known], dtype=np.int64)
        file["lead_frames"] = np.array([len(s.lead_pose) for s in known], dtype=np.int64)
        file["parameters"] = np.array([list(s.parameters.values()) for s in known], dtype=np.float64)
        for name in ("codes", *_MOTION, *(f"lead_{name}" for name in _MOTION)):
            rows = np.concatenate([getattr(s, name) for s in known]).astype(np.float32)
            # Sets of parameters share their clips, so the motions say everything many times over.
            file.create_dataset(name, data=rows, **hdf5plugin.Blosc(cname="zstd", clevel=3))


def read_codes(
    path: str | os.PathLike,
    garment: str,
    descriptor: str,
    splits: Many[str] | None = None,
    plans: Many[str] | None = None,
) -> list[CodedSequence]:
    """Sequences of the asked splits and plans (default: all), in the order of the shards.

    Args:
        garment: Whose codes are wanted.
        descriptor: ``file_digest`` of the model file that must have made them.

    Raises:
        ValueError: A file that is damaged or of another version, garment or descriptor, or without such a sequence.
    """
    try:
        with h5py.File(path, "r") as file:
            found = {name: file.attrs.get(name) for name in ("format", "version", "garment", "descriptor")}
            if found["format"] != FORMAT or found["version"] != VERSION:
                raise ValueError(
                    f"format {found['format']!r}, version {found['version']}; this program reads {FORMAT!r}, "
                    f"version {VERSION}"
                )
            if found["garment"] != garment:
                raise ValueError(f"holds the codes of garment {found['garment']!r}, not of {garment!r}")
            if found["descriptor"] != descriptor:
                raise ValueError(
                    f"was encoded by descriptor {str(found['descriptor'])[:12]}, the one given is {descriptor[:12]}: "
                    "encode the shapes again"
                )
            sequences = _sequences(file)
    except OSError as error:
        raise ValueError(f"{path}: not a readable HDF5 file ({error})") from None
    except KeyError as error:
        raise ValueError(f"{path}: the file of codes lacks a part ({error.args[0]})") from None
    except (ValueError, TypeError, AttributeError, RuntimeError) as error:
        raise ValueError(f"{path}: {error}") from None
    chosen = [s for s in sequences if (not splits or s.split in splits) and (not plans or s.plan in plans)]
    if not chosen:
        wanted = f"splits {', '.join(splits or ('any',))} of plans {', '.join(plans or ('any',))}"
        raise ValueError(f"{garment}: no simulated sequence in {wanted}; were all of them dropped?")
    return chosen


def _sequences(file: h5py.File) -> list[CodedSequence]:
    garment, fps = str(file.attrs["garment"]), float(file.attrs["fps"])
    names = [name.decode() for name in file["parameter_names"][:]]
    texts = {name: [value.decode() for value in file[name][:]] for name in _TEXTS}
    phi, parameters = file["phi"][:], file["parameters"][:]
    frames, lead = file["frames"][:], file["lead_frames"][:]
    count = len(phi)
    if any(len(values) != count for values in (*texts.values(), frames, lead, parameters)):
        raise ValueError("its lists of sequences differ in length")
    if np.any(frames < 1) or np.any(lead < 0) or parameters.shape[1:] != (len(names),):
        raise ValueError("its numbers of frames or parameters are impossible")
    unknown = sorted(set(texts["split"]) - set(SPLITS))
    if unknown:
        raise ValueError(f"split {unknown[0]!r} is not one of {', '.join(SPLITS)}")
    shapes = {"codes": (frames, None)}
    shapes |= {name: (frames, row) for name, row in _MOTION.items()}
    shapes |= {f"lead_{name}": (lead, row) for name, row in _MOTION.items()}
    parts = {}
    for name, (lengths, row) in shapes.items():
        array = file[name][:]
        if len(array) != lengths.sum() or (array.ndim != 2 if row is None else array.shape[1:] != row):
            raise ValueError(f"{name} has shape {list(array.shape)}, which does not fit its {lengths.sum()} frames")
        if not np.isfinite(array).all():
            raise ValueError(f"{name} holds a number that is not finite")
        parts[name] = np.split(array, np.cumsum(lengths)[:-1])
    return [
        CodedSequence(
            garment=garment,
            fps=fps,
            phi=int(phi[i]),
            parameters=dict(zip(names, map(float, parameters[i]), strict=True)),
            **{name: values[i] for name, values in texts.items()},
            **{name: arrays[i] for name, arrays in parts.items()},
        )
        for i in range(count)
    ]
