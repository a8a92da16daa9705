"""An animation as it is taken elsewhere: frames of one or several meshes, in metres, y up.

Shapes: T frames, V vertices and F triangles of a mesh.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field

import numpy as np

from geometry.mesh_check import check_arrays
from geometry.topology import vertex_normals
from motions.clip import Clip
from report.colours import BODY, GARMENT_COLOURS

MAX_POINTS = 100_000_000
"""Frames × vertices of a mesh, at most: 1.2 GB of positions."""

FRAMES_PER_CHUNK = 32
"""Bounds the temporary memory of work over all frames."""

_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]{0,62}")


@dataclass(frozen=True, eq=False)
class AnimatedMesh:
    """One mesh that keeps its triangles while its vertices move.

    Attributes:
        name: A letter, then letters, digits and underscores: what it is called in every format. The mesh named
            ``body`` is drawn as one.
        faces: Triangles, counter-clockwise from outside, shape [F, 3] int32.
        frames: Vertices in the world [m], y up, shape [T, V, 3] float32.
        colour: RGB in 0..1, as shown on a screen (sRGB).
        material: Name of the material, by the same rule; the mesh's name where empty.
        uv: Texture coordinates of the vertices, shape [V, 2] float32, or None.

    Raises:
        ValueError: Wrong shapes, indices out of range, values that are not finite, an unusable name.
    """

    name: str
    faces: np.ndarray
    frames: np.ndarray
    colour: tuple[float, float, float] = GARMENT_COLOURS["skirt"]
    material: str = ""
    uv: np.ndarray | None = None

    def __post_init__(self) -> None:
        object.__setattr__(self, "material", self.material or self.name)
        for what, text in (("name", self.name), ("material", self.material)):
            if not _NAME.fullmatch(text):
                raise ValueError(
                    f"mesh {text[:40]!r}: a {what} must be a letter and then at most 62 letters, digits or underscores"
                )
        where = f"mesh '{self.name}'"
        frames, faces = np.asarray(self.frames), np.asarray(self.faces)
        if frames.ndim != 3 or len(frames) == 0 or frames.dtype.kind not in "iuf":
            raise ValueError(
                f"{where}: frames must be numbers of shape [T, V, 3], got {frames.dtype} {list(frames.shape)}"
            )
        if frames.shape[0] * frames.shape[1] > MAX_POINTS:
            raise ValueError(
                f"{where}: {frames.shape[0]} frames of {frames.shape[1]} vertices, at most {MAX_POINTS} points are kept"
            )
        check_arrays(where, frames[0], faces)
        object.__setattr__(self, "frames", np.ascontiguousarray(frames, dtype=np.float32))
        object.__setattr__(self, "faces", np.ascontiguousarray(faces, dtype=np.int32))
        bad = ~np.isfinite(self.frames).all(axis=(1, 2))
        if bad.any():
            raise ValueError(f"{where}: frame {int(bad.argmax())} has a vertex that is not finite")
        colour = np.asarray(self.colour, dtype=np.float64)
        if colour.shape != (3,) or not ((colour >= 0) & (colour <= 1)).all():
            raise ValueError(f"{where}: a colour must be three numbers from 0 to 1, got {self.colour}")
        object.__setattr__(self, "colour", tuple(colour.tolist()))
        if self.uv is not None:
            uv = np.ascontiguousarray(self.uv, dtype=np.float32)
            if uv.shape != (frames.shape[1], 2) or not np.isfinite(uv).all():
                raise ValueError(
                    f"{where}: uv must be finite, of shape [{frames.shape[1]}, 2], got {list(np.shape(self.uv))}"
                )
            object.__setattr__(self, "uv", uv)

    def normals(self) -> Iterator[np.ndarray]:
        """Smooth unit vertex normals of each frame in turn, shape [V, 3] float32."""
        for start in range(0, len(self.frames), FRAMES_PER_CHUNK):
            yield from vertex_normals(self.frames[start : start + FRAMES_PER_CHUNK], self.faces).astype(np.float32)

    @property
    def linear_colour(self) -> tuple[float, float, float]:
        """The colour without the screen's gamma (IEC 61966-2-1), which is what materials are given in."""
        srgb = np.asarray(self.colour)
        linear = np.where(srgb <= 0.04045, srgb / 12.92, ((srgb + 0.055) / 1.055) ** 2.4)
        return tuple(linear.round(6).tolist())


@dataclass(frozen=True, eq=False)
class Animation:
    """Meshes that move together.

    Attributes:
        meshes: One or several, of different names and the same number of frames T.
        fps: Frames per second [Hz].
        name: What the animation is called; names its files.
        clip: The motion of the body under it, of the same frames and rate, where it is known.
        notes: What is worth keeping beside it, such as the intrinsic parameters; texts and numbers.

    Raises:
        ValueError: No mesh, two of one name, meshes or a clip of different lengths, an impossible frame rate.
    """

    meshes: tuple[AnimatedMesh, ...]
    fps: float
    name: str = "animation"
    clip: Clip | None = None
    notes: Mapping[str, str | float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        object.__setattr__(self, "meshes", tuple(self.meshes))
        object.__setattr__(self, "fps", float(self.fps))
        where, names = f"animation '{self.name}'", [mesh.name for mesh in self.meshes]
        if not names or len(set(names)) != len(names):
            raise ValueError(f"{where}: meshes must be there and differ in name, got {', '.join(names) or 'none'}")
        if not (np.isfinite(self.fps) and 1.0 <= self.fps <= 480.0):
            raise ValueError(f"{where}: fps is {self.fps}, allowed are 1 to 480")
        lengths = {mesh.name: len(mesh.frames) for mesh in self.meshes}
        if self.clip is not None:
            lengths["the motion"] = self.clip.frames
            if self.clip.fps != self.fps:
                raise ValueError(
                    f"{where}: the motion has {self.clip.fps:g} frames a second, the meshes have {self.fps:g}"
                )
        if len(set(lengths.values())) != 1:
            listed = ", ".join(f"{name} has {count}" for name, count in lengths.items())
            raise ValueError(f"{where}: all must have the same number of frames, {listed}")
        for key, value in self.notes.items():
            if not isinstance(key, str) or not isinstance(value, str | int | float):
                raise ValueError(f"{where}: note {key!r} must be a text or a number under a text, got {value!r}")

    @property
    def frames(self) -> int:
        """Number of frames T."""
        return len(self.meshes[0].frames)

    def mesh(self, name: str) -> AnimatedMesh:
        """The mesh of a name; ``ValueError`` lists the names."""
        for mesh in self.meshes:
            if mesh.name == name:
                return mesh
        raise ValueError(
            f"animation '{self.name}' has no mesh '{name}'; it has {', '.join(mesh.name for mesh in self.meshes)}"
        )


def dressed(
    name: str,
    garment: str,
    vertices: np.ndarray,
    faces: np.ndarray,
    body_vertices: np.ndarray,
    body_faces: np.ndarray,
    fps: float,
    clip: Clip | None = None,
    notes: Mapping[str, str | float] | None = None,
) -> Animation:
    """The animation of a garment on a body.

    Args:
        name: Name of the animation.
        garment: Name of the garment; gives its mesh its name and colour.
        vertices, faces: Garment in the world [m], shape [T, V, 3], and its triangles, shape [F, 3].
        body_vertices, body_faces: The same of the body.
        fps: Frames per second [Hz].
        clip: The body's motion.
        notes: See :class:`Animation`.
    """
    known = GARMENT_COLOURS.get(garment, next(iter(GARMENT_COLOURS.values())))
    own = plain_name(garment)
    meshes = (
        AnimatedMesh("garment" if own == "body" else own, faces, vertices, known, "cloth"),
        AnimatedMesh("body", body_faces, body_vertices, BODY, "skin"),
    )
    return Animation(meshes, fps, name, clip, notes or {})


def plain_name(text: str) -> str:
    """A text made into a name that every format accepts."""
    plain = re.sub(r"[^A-Za-z0-9_]+", "_", text).strip("_")[:60]
    return plain if plain[:1].isalpha() else f"m_{plain}"
