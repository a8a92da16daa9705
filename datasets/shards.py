"""HDF5 shards: the one module that knows their layout, writes them and reads them.

A shard holds the simulated sequences of one garment for a fixed slice of the data plan. Layout, version 1:

=================================  ==========================================================================
``/`` attributes                   ``format``, ``version``, ``garment``, ``plan``, ``solver_version``, ``seed``,
                                   ``fps`` [Hz], ``spec`` (canonical JSON of all that determined the shard)
``/garment/vertices``              template on the bind-pose body [m], [V, 3] float32
``/garment/faces``, ``pinned``     [F, 3] and [P] int32
``/body`` attributes               ``name``, ``digest``; ``/body/faces`` [Fb, 3] int32, ``/body/shape`` [10] float64
``/parameters/{names,units,groups}``  intrinsic parameters, [K] strings
``/sequences/0000``                one simulation: attributes ``clip``, ``take``, ``take_index``, ``label``, ``phi``
                                   (number of the parameter set, 0 = base), ``body_index`` (number of the body
                                   shape, 0 = ``/body/shape``), ``shape`` (its coefficients [standard
                                   deviations], [<= 10] float64; empty: ``/body/shape``) and every quality
                                   figure of the simulation under ``quality_`` and its name (strain, depth and
                                   vertices inside, pinched vertices and frames, crossing pairs ...:
                                   ``sim.result``)
``.../vertices``                   garment in the world [m], [T, V, 3] float32
``.../pose``, ``root``, ``joints`` SMPL pose [rad] [T, 24, 3], root translation [m] [T, 3], joints [m] [T, 24, 3]
``.../lead_{pose,root,joints}``    the motion before the first recorded frame, [L, ...]
``.../parameters``                 values in the order of ``/parameters/names``, [K] float64
``/dropped`` attribute ``records`` JSON list of the simulations that were given up: clip, phi, body_index, reason ...
=================================  ==========================================================================
"""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field

import h5py
import hdf5plugin
import numpy as np

from datasets.atomic import atomic_path

FORMAT = "drapeline-shard"
VERSION = 1
MATERIALS = "materials"
"""Plan of many sampled parameter sets, each on the same few clips (Wang 2019)."""
MOTIONS = "motions"
"""Plan of the base parameters on every clip (Shi 2023)."""
BODIES = "bodies"
"""Plan of sampled body shapes, each in a garment graded to it, base parameters, on clips of all the run."""
REPEATED = "repeated"
"""Plan of test clips simulated once more, from a start that differs a little: what no regressor can know."""
LONG = "long"
"""Plan of a few long motions, base parameters, to be tested on alone."""
WARDROBE = "wardrobe"
"""Plan of a garment of many: some clips in its base parameters, others in a sampled material each."""
SHAPE_COMPONENTS = 10
"""Most shape coefficients of a body."""
FRAMES_PER_CHUNK = 8
"""Serves single frames and windows alike: a chunk is what one read decompresses."""

_ARRAYS = ("vertices", "pose", "root", "joints", "lead_pose", "lead_root", "lead_joints")


@dataclass(frozen=True)
class ShardHeader:
    """What all sequences of a shard share; see the module's table for shapes and units."""

    garment: str
    plan: str
    solver_version: str
    seed: int
    fps: float
    spec: str
    template_vertices: np.ndarray
    template_faces: np.ndarray
    pinned: np.ndarray
    body_name: str
    body_digest: str
    body_faces: np.ndarray
    body_shape: np.ndarray
    parameter_names: tuple[str, ...]
    parameter_units: tuple[str, ...]
    parameter_groups: tuple[str, ...]


@dataclass(frozen=True)
class SimulatedSequence:
    """One recorded simulation; arrays as in the module's table."""

    clip: str
    take: str
    take_index: int
    label: str
    phi: int
    parameters: dict[str, float]
    vertices: np.ndarray
    pose: np.ndarray
    root: np.ndarray
    joints: np.ndarray
    lead_pose: np.ndarray
    lead_root: np.ndarray
    lead_joints: np.ndarray
    quality: dict[str, float] = field(default_factory=dict)
    shape: np.ndarray = field(default_factory=lambda: np.zeros(0))
    body_index: int = 0


@dataclass(frozen=True)
class DroppedSimulation:
    """A simulation that no retry could bring inside the quality bounds."""

    clip: str
    label: str
    phi: int
    reason: str
    attempts: int
    body_index: int = 0


class ShardWriter:
    """Writes a shard atomically: until the ``with`` block ends well, nothing stands under the final name."""

    def __init__(self, path: str | os.PathLike, header: ShardHeader):
        self._context = atomic_path(path)
        self._header = header
        self._dropped: list[DroppedSimulation] = []
        self._count = 0

    def __enter__(self) -> ShardWriter:
        self._file = h5py.File(self._context.__enter__(), "w")
        self._write_header()
        return self

    def __exit__(self, kind, error, trace) -> None:
        if error is None:
            self._file.create_group("dropped").attrs["records"] = json.dumps([vars(d) for d in self._dropped])
        self._file.close()
        self._context.__exit__(kind, error, trace)

    def add(self, sequence: SimulatedSequence) -> None:
        """Append a sequence; ``ValueError`` when its shapes do not fit the header or a number is not finite."""
        _check_sequence(sequence, len(self._header.template_vertices), self._header.parameter_names)
        group = self._file.create_group(f"sequences/{self._count:04d}")
        for name in _ARRAYS:
            array = np.asarray(getattr(sequence, name), dtype=np.float32)
            group.create_dataset(name, data=array, **_storage(array))
        names = self._header.parameter_names
        group["parameters"] = np.array([sequence.parameters[n] for n in names], dtype=np.float64)
        for name in ("clip", "take", "take_index", "label", "phi", "body_index"):
            group.attrs[name] = getattr(sequence, name)
        group.attrs["shape"] = np.asarray(sequence.shape, dtype=np.float64)
        for name, value in sequence.quality.items():
            group.attrs[f"quality_{name}"] = value
        self._count += 1

    def drop(self, dropped: DroppedSimulation) -> None:
        """Record a simulation that is missing from the shard, and why."""
        self._dropped.append(dropped)

    def _write_header(self) -> None:
        h, file = self._header, self._file
        file.attrs.update(format=FORMAT, version=VERSION, garment=h.garment, plan=h.plan, seed=h.seed, fps=h.fps)
        file.attrs.update(solver_version=h.solver_version, spec=h.spec)
        for name, array in (("vertices", h.template_vertices), ("faces", h.template_faces), ("pinned", h.pinned)):
            file.create_dataset(f"garment/{name}", data=array)
        body = file.create_group("body")
        body.attrs.update(name=h.body_name, digest=h.body_digest)
        body.create_dataset("faces", data=h.body_faces, compression="gzip", shuffle=True)
        body.create_dataset("shape", data=h.body_shape)
        for name in ("names", "units", "groups"):
            strings = list(getattr(h, f"parameter_{name}"))
            file.create_dataset(f"parameters/{name}", data=strings, dtype=h5py.string_dtype())


def read_header(path: str | os.PathLike) -> ShardHeader:
    """The header of a shard; ``ValueError`` in one sentence when the file is no shard of this version."""
    with _open(path) as file:
        return _header(file)


def read_dropped(path: str | os.PathLike) -> list[DroppedSimulation]:
    """The simulations that this shard misses."""
    with _open(path) as file:
        return [DroppedSimulation(**record) for record in json.loads(file["dropped"].attrs["records"])]


def read_quality(path: str | os.PathLike) -> list[dict[str, float | str]]:
    """Clip, label, phi, body, parameters and quality figures of every sequence, without its arrays."""
    with _open(path) as file:
        names = [n.decode() for n in file["parameters/names"][:]]
        rows = []
        for group in file["sequences"].values() if "sequences" in file else ():
            row = {name: _plain(group.attrs[name]) for name in ("clip", "take", "label", "phi")}
            row["body_index"] = int(group.attrs.get("body_index", 0))
            row |= {k.removeprefix("quality_"): _plain(v) for k, v in group.attrs.items() if k.startswith("quality_")}
            row |= {f"parameter_{n}": float(v) for n, v in zip(names, group["parameters"][:])}
            rows.append(row | {"frames": int(group["vertices"].shape[0])})
        return rows


def read_sequences(
    path: str | os.PathLike, wanted: Callable[[int, int, str, int], bool] | None = None
) -> Iterator[SimulatedSequence]:
    """The sequences of a shard, one at a time; ``ValueError`` names the shard and the sequence that is damaged.

    Args:
        path: The shard.
        wanted: Asked with ``phi``, ``take_index``, ``label`` and ``body_index`` of a sequence before its arrays are
            read, which takes most of the time; all are wanted where None.
    """
    with _open(path) as file:
        names = [n.decode() for n in file["parameters/names"][:]]
        count = len(file["garment/vertices"])
        for group in file["sequences"].values() if "sequences" in file else ():
            phi, take_index = int(group.attrs["phi"]), int(group.attrs["take_index"])
            # Shards from before there were body shapes lack their number, and the shape below.
            body_index = int(group.attrs.get("body_index", 0))
            if wanted is not None and not wanted(phi, take_index, group.attrs["label"], body_index):
                continue
            quality = {
                k.removeprefix("quality_"): _plain(v) for k, v in group.attrs.items() if k.startswith("quality_")
            }
            sequence = SimulatedSequence(
                clip=group.attrs["clip"],
                take=group.attrs["take"],
                take_index=take_index,
                label=group.attrs["label"],
                phi=phi,
                parameters=dict(zip(names, map(float, group["parameters"][:]))),
                quality=quality,
                shape=np.asarray(group.attrs.get("shape", ()), dtype=np.float64),
                body_index=body_index,
                **{name: group[name][:] for name in _ARRAYS},
            )
            _check_sequence(sequence, count, names)
            yield sequence


def _header(file: h5py.File) -> ShardHeader:
    attrs, body = file.attrs, file["body"]
    return ShardHeader(
        garment=attrs["garment"],
        plan=attrs["plan"],
        solver_version=attrs["solver_version"],
        seed=int(attrs["seed"]),
        fps=float(attrs["fps"]),
        spec=attrs["spec"],
        template_vertices=file["garment/vertices"][:],
        template_faces=file["garment/faces"][:],
        pinned=file["garment/pinned"][:],
        body_name=body.attrs["name"],
        body_digest=body.attrs["digest"],
        body_faces=body["faces"][:],
        body_shape=body["shape"][:],
        **{
            f"parameter_{name}": tuple(s.decode() for s in file[f"parameters/{name}"][:])
            for name in ("names", "units", "groups")
        },
    )


@contextmanager
def _open(path: str | os.PathLike) -> Iterator[h5py.File]:
    """A shard for reading; whatever is missing from it or damaged in it ends as a ``ValueError`` that names it."""
    try:
        with h5py.File(path, "r") as file:
            found, version = file.attrs.get("format"), _plain(file.attrs.get("version"))
            if found != FORMAT or version != VERSION:
                raise ValueError(
                    f"format {found!r}, version {version!r}; this program reads {FORMAT!r}, version {VERSION}"
                )
            yield file
    except OSError as error:
        raise ValueError(f"{path}: not a readable HDF5 file ({error})") from None
    except KeyError as error:
        raise ValueError(f"{path}: the shard lacks a part ({error.args[0]})") from None
    except (ValueError, TypeError, AttributeError, RuntimeError) as error:
        # A part of another kind than expected, or bytes that cannot be decoded.
        raise ValueError(f"{path}: {error}") from None


def _check_sequence(sequence: SimulatedSequence, vertices: int, names: Sequence[str]) -> None:
    """Shapes that fit each other and the shard, finite numbers, the shard's parameters."""
    frames, lead = len(sequence.pose), len(sequence.lead_pose)
    expected = {"vertices": (frames, vertices, 3)}
    for prefix, length in (("", frames), ("lead_", lead)):
        expected |= {f"{prefix}pose": (length, 24, 3), f"{prefix}root": (length, 3), f"{prefix}joints": (length, 24, 3)}
    for name, shape in expected.items():
        got = np.shape(getattr(sequence, name))
        if got != shape:
            raise ValueError(f"sequence {sequence.clip}: {name} has shape {list(got)}, expected {list(shape)}")
    shape = np.asarray(sequence.shape)
    if shape.ndim != 1 or len(shape) > SHAPE_COMPONENTS or not np.isfinite(shape).all():
        what = f"shape {shape.tolist()}, expected at most {SHAPE_COMPONENTS} finite body shape coefficients"
        raise ValueError(f"sequence {sequence.clip}: {what}")
    for name in _ARRAYS:
        if not np.isfinite(getattr(sequence, name)).all():
            raise ValueError(f"sequence {sequence.clip}: {name} holds a number that is not finite")
    if set(sequence.parameters) != set(names):
        raise ValueError(f"sequence {sequence.clip}: parameters {sorted(sequence.parameters)} do not fit the shard")


def _storage(array: np.ndarray) -> dict:
    """Chunking and compression: lossless, shuffled Zstandard; tiny arrays are left contiguous."""
    if array.size < 4096:
        return {}
    chunk = (min(FRAMES_PER_CHUNK, len(array)), *array.shape[1:])
    return {"chunks": chunk, **hdf5plugin.Blosc(cname="zstd", clevel=3, shuffle=hdf5plugin.Blosc.SHUFFLE)}


def _plain(value: object) -> float | int | str:
    return value.item() if isinstance(value, np.generic) else value
