"""OBJ files, one a mesh and frame: ``<mesh>_0000.obj`` in a folder, with ``materials.mtl`` beside them.

The number in a file's name is that of the frame, counted from 0. Positions are written to a micrometre.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from formats.animation import AnimatedMesh, Animation
from formats.target import new_folder

SUFFIXES = (".obj", ".mtl")
MATERIALS = "materials.mtl"


def write_obj_sequence(folder: str | os.PathLike, animation: Animation, force: bool = False) -> None:
    """Write a folder of OBJ files, whole or not at all; errors as those of ``formats.target``."""
    digits = max(4, len(str(animation.frames - 1)))
    with new_folder(folder, force, SUFFIXES) as temporary:
        write_materials(temporary / MATERIALS, animation.meshes)
        for mesh in animation.meshes:
            head, tail = _constant_parts(mesh, animation.fps)
            for number, (vertices, normals) in enumerate(zip(mesh.frames, mesh.normals())):
                text = head + _lines("v", vertices, 6) + _lines("vn", normals, 4) + tail
                (temporary / f"{mesh.name}_{number:0{digits}d}.obj").write_text(text, encoding="ascii")


def write_obj(path: Path, mesh: AnimatedMesh, fps: float, frame: int = 0) -> None:
    """Write one frame of a mesh, with normals and the name of its material."""
    head, tail = _constant_parts(mesh, fps)
    normals = AnimatedMesh(mesh.name, mesh.faces, mesh.frames[frame : frame + 1]).normals()
    text = head + _lines("v", mesh.frames[frame], 6) + _lines("vn", next(normals), 4) + tail
    path.write_text(text, encoding="ascii")


def write_materials(path: Path, meshes: Sequence[AnimatedMesh]) -> None:
    """Write the material library of meshes: matt, in their colours."""
    blocks = []
    for name, mesh in {mesh.material: mesh for mesh in meshes}.items():
        red, green, blue = mesh.linear_colour
        blocks.append(f"newmtl {name}\nKd {red:g} {green:g} {blue:g}\nKs 0 0 0\nd 1\nillum 1\n")
    path.write_text("\n".join(blocks), encoding="ascii")


def _constant_parts(mesh: AnimatedMesh, fps: float) -> tuple[str, str]:
    """What comes before the vertices and after the normals: the same in all frames."""
    head = f"# metres, y up, {fps:g} frames a second\nmtllib {MATERIALS}\no {mesh.name}\n"
    corners = (mesh.faces + 1).repeat(2 if mesh.uv is None else 3, axis=1)
    texture = "" if mesh.uv is None else _lines("vt", mesh.uv, 6)
    corner = "%d//%d" if mesh.uv is None else "%d/%d/%d"
    faces = f"f {corner} {corner} {corner}\n" * len(corners) % tuple(corners.ravel().tolist())
    return head, f"{texture}usemtl {mesh.material}\ns 1\n{faces}"


def _lines(word: str, values: np.ndarray, decimals: int) -> str:
    row = word + f" %.{decimals}f" * values.shape[1] + "\n"
    return row * len(values) % tuple(values.ravel().tolist())
