"""A garment template: the mesh as worn on the bind-pose body, and how it hangs on it.

Garments worn over each other are one template too (``garments.outfit``): ``layer`` says which vertex is whose.

The file is a plain ``.npz`` (no pickle): arrays of ``GarmentTemplate`` under their own names and ``format_version``.
"""

from __future__ import annotations

import zipfile
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import numpy as np

from datasets.atomic import atomic_path
from geometry.mesh_check import check_mesh
from geometry.topology import MeshTopology

FORMAT_VERSION = 1

_TEXTS = ("name", "kind", "body_name", "body_digest")
_ARRAYS = ("vertices", "faces", "pinned", "skin_index", "skin_weight")
_OPTIONAL = ("pieces", "layer", "worn", "worn_as")  # files from before garments in layers lack them


@dataclass(frozen=True, eq=False)
class GarmentTemplate:
    """A garment on a body in its bind pose; the built shape is the rest shape.

    Attributes:
        name: Name of the garment.
        kind: One of ``garments.build.GARMENT_KINDS``; of a user's own mesh, what it is worn as; "outfit" of several
            garments.
        vertices: Positions on the bind-pose body [m], shape [V, 3] float32.
        faces: Outward triangles, shape [F, 3] int32.
        pinned: Vertices that are held to the body (the waist ring; empty for a T-shirt), shape [P] int32, sorted.
        skin_index: Joints that move a vertex, shape [V, 4] int32.
        skin_weight: Their weights, not negative, summing to one, shape [V, 4] float32.
        body_name: Body that the garment was built on.
        body_digest: Digest of that body.
        pieces: Connected pieces that the mesh may have; more than 1 only for garments worn in layers.
        layer: Garment of each vertex, counted from the body outwards, shape [V] int32; None: all 0.
        worn: Names of the garments, innermost first; of one garment its name, whatever is given.
        worn_as: Their kinds, likewise.

    Raises:
        ValueError: in one sentence, for arrays of wrong shape, a mesh that ``geometry.mesh_check`` refuses, indices
            out of range or weights that do not sum to one.
    """

    name: str
    kind: str
    vertices: np.ndarray
    faces: np.ndarray
    pinned: np.ndarray
    skin_index: np.ndarray
    skin_weight: np.ndarray
    body_name: str
    body_digest: str
    pieces: int = 1
    layer: np.ndarray | None = None
    worn: tuple[str, ...] = ()
    worn_as: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        where = f"garment '{self.name}'"
        if self.layer is None:
            object.__setattr__(self, "layer", np.zeros(np.shape(self.vertices)[:1], dtype=np.int32))
        if not np.any(self.layer):  # one garment
            object.__setattr__(self, "worn", (self.name,))
            object.__setattr__(self, "worn_as", (self.kind,))
        for field, dtype in (
            ("vertices", np.float32),
            ("faces", np.int32),
            ("pinned", np.int32),
            ("skin_index", np.int32),
            ("skin_weight", np.float32),
            ("layer", np.int32),
        ):
            object.__setattr__(self, field, _numbers(where, field, getattr(self, field), dtype))
        count = len(self.vertices)
        for field, shape in (
            ("vertices", (None, 3)),
            ("faces", (None, 3)),
            ("pinned", (None,)),
            ("skin_index", (count, 4)),
            ("skin_weight", (count, 4)),
            ("layer", (count,)),
        ):
            got = getattr(self, field).shape
            if len(got) != len(shape) or any(w is not None and w != g for w, g in zip(shape, got)):
                wanted = [{"vertices": "V", "faces": "F", "pinned": "P"}[field] if w is None else w for w in shape]
                raise ValueError(f"{where}: '{field}' must have shape {_listed(wanted)}, got {_listed(got)}")
        check_mesh(where, self.vertices, self.faces, self.pieces)
        bad = ~np.isfinite(self.skin_weight).all(axis=1)
        if bad.any():
            raise ValueError(
                f"{where}: 'skin_weight' row {int(bad.argmax())} is not finite ({int(bad.sum())} such rows)"
            )
        for field, limit in (("pinned", count), ("skin_index", 24)):
            values = getattr(self, field)
            if values.size and (values.min() < 0 or values.max() >= limit):
                raise ValueError(f"{where}: '{field}' must lie in 0..{limit - 1}, got {values.min()}..{values.max()}")
        if len(np.unique(self.pinned)) != len(self.pinned):
            raise ValueError(f"{where}: 'pinned' names a vertex twice")
        if (self.skin_weight < 0).any() or (np.abs(self.skin_weight.sum(axis=1) - 1.0) > 1e-3).any():
            raise ValueError(f"{where}: 'skin_weight' rows must be non-negative and sum to one")
        self._check_layers(where)

    def _check_layers(self, where: str) -> None:
        if len(self.worn) != len(self.worn_as) or len(set(self.worn)) != len(self.worn):
            raise ValueError(
                f"{where}: 'worn' must name each garment once and 'worn_as' their kinds, got {', '.join(self.worn)} "
                f"and {', '.join(self.worn_as)}"
            )
        if not np.array_equal(np.unique(self.layer), np.arange(len(self.worn))):
            raise ValueError(
                f"{where}: 'layer' must have every value of 0..{len(self.worn) - 1}, one for each garment worn, got "
                f"{', '.join(map(str, np.unique(self.layer)[:8]))}"
            )
        mixed = (self.layer[self.faces] != self.layer[self.faces[:, :1]]).any(axis=1)
        if mixed.any():
            raise ValueError(f"{where}: triangle {int(mixed.argmax())} has corners in different layers")

    @cached_property
    def topology(self) -> MeshTopology:
        """Edges, hinges and boundary of the mesh."""
        return MeshTopology.from_faces(self.faces, len(self.vertices))

    @property
    def face_layer(self) -> np.ndarray:
        """Garment of each triangle, counted from the body outwards, shape [F]."""
        return self.layer[self.faces[:, 0]]

    def save(self, path: str | Path) -> None:
        """Write the template as one ``.npz`` file, whole or not at all."""
        content = {field: getattr(self, field) for field in _ARRAYS}
        content |= {field: np.array(getattr(self, field)) for field in (*_TEXTS, *_OPTIONAL)}
        with atomic_path(path) as partial, open(partial, "wb") as stream:
            np.savez_compressed(stream, format_version=np.array(FORMAT_VERSION), **content)

    @classmethod
    def load(cls, path: str | Path) -> GarmentTemplate:
        """Read a template; ``ValueError`` names the file and what is wrong with it, ``FileNotFoundError`` if absent."""
        path = Path(path)
        try:
            with np.load(path, allow_pickle=False) as archive:
                if not isinstance(archive, np.lib.npyio.NpzFile):
                    raise ValueError("a single array instead of an .npz archive")
                content = {key: archive[key] for key in archive.files}
        except FileNotFoundError:
            raise
        except (OSError, ValueError, EOFError, zipfile.BadZipFile, KeyError) as error:
            raise ValueError(f"{path}: not a readable garment template ({error})") from None
        missing = [key for key in ("format_version", *_TEXTS, *_ARRAYS) if key not in content]
        if missing:
            raise ValueError(f"{path}: not a garment template, it lacks {', '.join(missing)}")
        version = content["format_version"]
        if version.shape != () or version.dtype.kind not in "iu" or int(version) != FORMAT_VERSION:
            raise ValueError(f"{path}: garment template format {version} cannot be read, only {FORMAT_VERSION}")
        for key in _TEXTS:
            if content[key].shape != () or content[key].dtype.kind != "U":
                raise ValueError(f"{path}: '{key}' must be a text")
        try:
            texts, arrays = {key: str(content[key]) for key in _TEXTS}, {key: content[key] for key in _ARRAYS}
            optional = {key: _OPTIONAL_READERS[key](content[key]) for key in _OPTIONAL if key in content}
            return cls(**texts, **arrays, **optional)
        except ValueError as error:
            raise ValueError(f"{path}: {error}") from None


def _numbers(where: str, field: str, values: np.ndarray, dtype: type) -> np.ndarray:
    array = np.asarray(values)
    allowed = "iu" if dtype is np.int32 else "iuf"
    if array.size and array.dtype.kind not in allowed:
        raise ValueError(
            f"{where}: '{field}' must hold {'whole ' if dtype is np.int32 else ''}numbers, got {array.dtype}"
        )
    if dtype is np.int32 and array.size and not -(2**31) <= int(array.min()) <= int(array.max()) < 2**31:
        raise ValueError(f"{where}: '{field}' holds {array.min()}..{array.max()}, more than 32 bits")
    return np.ascontiguousarray(array, dtype=dtype)


def _pieces(value: np.ndarray) -> int:
    if value.shape != () or value.dtype.kind not in "iu" or value < 1:
        raise ValueError(f"'pieces' must be a whole number from 1 on, got {value}")
    return int(value)


def _names(value: np.ndarray) -> tuple[str, ...]:
    if value.ndim != 1 or value.dtype.kind != "U":
        raise ValueError(
            f"'worn' and 'worn_as' must be lists of texts, got {value.dtype} of shape {_listed(value.shape)}"
        )
    return tuple(value.tolist())


def _listed(shape: object) -> str:
    return "[" + ", ".join(str(part) for part in shape) + "]"


_OPTIONAL_READERS = {"pieces": _pieces, "layer": np.asarray, "worn": _names, "worn_as": _names}
