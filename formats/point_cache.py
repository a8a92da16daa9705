"""PC2 point caches: ``<mesh>.pc2`` for each mesh, and the ``<mesh>.obj`` that it moves, in a folder.

The format holds no frame rate: one sample is one frame. Layout (little-endian): ``POINTCACHE2\\0``, version 1 (int32),
points (int32), first frame (float32), frames a sample (float32), samples (int32), then x y z (float32) of every point
of every sample. In Blender: import the OBJ, then add the modifier *Mesh Cache* with its axes as they are:
the importer turns the object, not its vertices.
"""

from __future__ import annotations

import os
import struct

import numpy as np

from formats.animation import Animation
from formats.obj_sequence import MATERIALS, write_materials, write_obj
from formats.target import new_folder

SUFFIXES = (".pc2", ".obj", ".mtl")
MAGIC = b"POINTCACHE2\0"


def write_point_cache(folder: str | os.PathLike, animation: Animation, force: bool = False) -> None:
    """Write a folder of point caches, whole or not at all; errors as those of ``formats.target``."""
    with new_folder(folder, force, SUFFIXES) as temporary:
        write_materials(temporary / MATERIALS, animation.meshes)
        for mesh in animation.meshes:
            write_obj(temporary / f"{mesh.name}.obj", mesh, animation.fps)
            samples, points, _ = mesh.frames.shape
            with open(temporary / f"{mesh.name}.pc2", "wb") as stream:
                stream.write(MAGIC + struct.pack("<iiffi", 1, points, 0.0, 1.0, samples))
                stream.write(np.ascontiguousarray(mesh.frames, dtype="<f4").data)
