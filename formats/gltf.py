"""Binary glTF 2.0 (GLB): every mesh a node with morph targets, whose weights one animation moves.

The targets are those of ``formats.morph_targets``: as many as the motion needs, 200 at most, because graphics cards
take no more. A long clip of crumpled cloth needs more: its mesh is cut in time into pieces ``<mesh>_0``, ``<mesh>_1``
..., each shown (scale 1, else 0: the format's own way) while it is its turn. How far a frame is off at most is in the
``extras`` of a mesh [m]. The rest shape is the first frame, so that a program without animation shows that one. Times
are in seconds, from 0: Blender, three.js and all others play it at its own rate. Materials are matt; cloth is seen from
both sides.
"""

from __future__ import annotations

import json
import os
import struct
from dataclasses import replace
from itertools import pairwise

import numpy as np

from formats.animation import AnimatedMesh, Animation
from formats.morph_targets import MOST_TARGETS, TOLERANCE, MorphTargets, morph_targets
from formats.target import new_file, refuse_existing

LARGEST = 2**32 - 1
"""Bytes of a GLB file: its length is 32 bits wide."""

ROUNDING = 2e-6
"""Distance [m] that single precision leaves in any case."""

FLOAT, UNSIGNED = 5126, 5125
ARRAY_BUFFER, ELEMENT_ARRAY_BUFFER = 34962, 34963


def write_glb(
    path: str | os.PathLike,
    animation: Animation,
    force: bool = False,
    tolerance: float = TOLERANCE,
    most_targets: int = MOST_TARGETS,
) -> None:
    """Write a GLB file, whole or not at all.

    Args:
        path: The file.
        animation: What to write.
        force: Whether a file that exists may be replaced.
        tolerance: Root mean square distance of a mesh's vertices that is aimed at in every frame [m].
        most_targets: Morph targets of a mesh, at most; at least 3.

    Raises:
        ValueError: The file exists, or would be larger than the format allows.
        OSError: See ``formats.target``.
    """
    refuse_existing(path, force)
    content = _Content()
    for mesh in animation.meshes:
        content.add(mesh, animation.fps, tolerance, most_targets)
    head = content.document(animation.name)
    size = 12 + 8 + len(head) + 8 + content.size
    if size > LARGEST:
        raise ValueError(
            f"{path}: {size / 2**30:.1f} GiB, a GLB file holds at most 4; write fewer frames, or another format"
        )
    with new_file(path, force) as temporary, open(temporary, "wb") as stream:
        stream.write(struct.pack("<4sII", b"glTF", 2, size))
        stream.write(struct.pack("<I4s", len(head), b"JSON") + head)
        stream.write(struct.pack("<I4s", content.size, b"BIN\0"))
        for chunk in content.chunks:
            stream.write(chunk.data)


class _Content:
    """A glTF document and its buffer, as they grow. All numbers are four bytes wide, so all offsets are aligned."""

    def __init__(self) -> None:
        self.chunks: list[np.ndarray] = []
        self.size = 0
        self.views: list[dict] = []
        self.accessors: list[dict] = []
        self.materials: dict[str, dict] = {}
        self.meshes: list[dict] = []
        self.nodes: list[dict] = []
        self.samplers: list[dict] = []
        self.channels: list[dict] = []
        self.times: dict[bytes, int] = {}

    def add(self, mesh: AnimatedMesh, fps: float, tolerance: float, most: int) -> None:
        """A mesh with its node and material, its targets and their weights; or several, one after the other in time."""
        shared: dict[str, dict | int] = {"attributes": {}, "material": self._material(mesh)}
        shared["indices"] = self.accessor(mesh.faces.astype(np.uint32).reshape(-1), "SCALAR", ELEMENT_ARRAY_BUFFER)
        if mesh.uv is not None:
            # glTF counts texture rows from the top.
            flipped = np.stack([mesh.uv[:, 0], 1.0 - mesh.uv[:, 1]], axis=1).astype(np.float32)
            shared["attributes"]["TEXCOORD_0"] = self.accessor(flipped, "VEC2", ARRAY_BUFFER)
        last = len(mesh.frames) - 1
        whole = morph_targets(mesh, tolerance, most)
        if whole.worst_rms <= max(1.01 * tolerance, ROUNDING) or last < most:
            self._piece(mesh.name, mesh, whole, shared, np.arange(last + 1) / fps)
            return
        # With fewer frames than targets a piece is exact. Neighbours share a frame, so that none is shown for longer.
        starts = np.linspace(0, last, -(-last // (most - 2)) + 1).round().astype(int)
        for number, (start, end) in enumerate(pairwise(starts.tolist())):
            piece = replace(mesh, frames=mesh.frames[start : end + 1])
            times = np.arange(start, end + 1) / fps
            node = self._piece(f"{mesh.name}_{number}", piece, morph_targets(piece, tolerance, most), shared, times)
            self._show(node, start / fps, None if end == last else end / fps)

    def _piece(self, name: str, mesh: AnimatedMesh, targets: MorphTargets, shared: dict, times: np.ndarray) -> int:
        """Number of a new node with a mesh over some time [s]."""
        own = {
            "POSITION": self.accessor(mesh.frames[0], "VEC3", ARRAY_BUFFER, bounds=True),
            "NORMAL": self.accessor(targets.base_normals, "VEC3", ARRAY_BUFFER),
        }
        primitive = shared | {"attributes": own | shared["attributes"]}
        described: dict = {"name": name, "primitives": [primitive]}
        node = len(self.nodes)
        self.nodes.append({"name": name, "mesh": len(self.meshes)})
        self.meshes.append(described)
        count = targets.weights.shape[1]
        if count:
            positions = self.stacked(targets.positions, bounds=True)
            normals = self.stacked(targets.normals)
            primitive["targets"] = [{"POSITION": p, "NORMAL": n} for p, n in zip(positions, normals)]
            described["weights"] = [0.0] * count
            described["extras"] = {
                "targetNames": [f"shape_{k:03d}" for k in range(count)],
                "largest_distance_m": float(f"{targets.worst:.3g}"),
                "rms_distance_m": float(f"{targets.worst_rms:.3g}"),
            }
            self._track(node, "weights", times, targets.weights.reshape(-1), "SCALAR", "LINEAR")
        return node

    def _show(self, node: int, start: float, end: float | None) -> None:
        """Show a node from a moment to another [s] only."""
        times, sizes = [start], [1.0]
        if start > 0.0:
            times, sizes = [0.0, *times], [0.0, *sizes]
            self.nodes[node]["scale"] = [0.0, 0.0, 0.0]
        if end is not None:
            times, sizes = [*times, end], [*sizes, 0.0]
        values = np.repeat(np.array(sizes, dtype=np.float32)[:, None], 3, axis=1)
        self._track(node, "scale", np.array(times), values, "VEC3", "STEP")

    def _track(self, node: int, path: str, times: np.ndarray, values: np.ndarray, kind: str, steps: str) -> None:
        key = times.astype(np.float32).tobytes()
        if key not in self.times:
            self.times[key] = self.accessor(times.astype(np.float32), "SCALAR", bounds=True)
        self.channels.append({"sampler": len(self.samplers), "target": {"node": node, "path": path}})
        self.samplers.append({"input": self.times[key], "output": self.accessor(values, kind), "interpolation": steps})

    def accessor(self, values: np.ndarray, kind: str, target: int | None = None, bounds: bool = False) -> int:
        """Number of a new accessor with a view of its own."""
        view: dict = {"buffer": 0, "byteOffset": self.size, "byteLength": values.nbytes}
        if target is not None:
            view["target"] = target
        return self._described(self._view(view, values), 0, values, kind, bounds)

    def stacked(self, values: np.ndarray, bounds: bool = False) -> list[int]:
        """Numbers of one new accessor for each of ``values [K, V, 3]``, in one view."""
        view = {"buffer": 0, "byteOffset": self.size, "byteLength": values.nbytes}
        number = self._view(view | {"byteStride": 12, "target": ARRAY_BUFFER}, values)
        return [self._described(number, k * values[0].nbytes, one, "VEC3", bounds) for k, one in enumerate(values)]

    def _view(self, view: dict, values: np.ndarray) -> int:
        self.chunks.append(np.ascontiguousarray(values, dtype=values.dtype.newbyteorder("<")))
        self.size += values.nbytes
        self.views.append(view)
        return len(self.views) - 1

    def _described(self, view: int, offset: int, values: np.ndarray, kind: str, bounds: bool) -> int:
        described = {
            "bufferView": view,
            "byteOffset": offset,
            "componentType": FLOAT if values.dtype.kind == "f" else UNSIGNED,
            "count": len(values),
            "type": kind,
        }
        if bounds:
            rows = values.reshape(len(values), -1)
            # Python prints a float32 widened to 64 bits with all digits that the reader compares.
            described |= {"min": rows.min(axis=0).tolist(), "max": rows.max(axis=0).tolist()}
        self.accessors.append(described)
        return len(self.accessors) - 1

    def _material(self, mesh: AnimatedMesh) -> int:
        self.materials.setdefault(
            mesh.material,
            {
                "name": mesh.material,
                "doubleSided": mesh.name != "body",
                "pbrMetallicRoughness": {
                    "baseColorFactor": [*mesh.linear_colour, 1.0],
                    "metallicFactor": 0.0,
                    "roughnessFactor": 0.9,
                },
            },
        )
        return list(self.materials).index(mesh.material)

    def document(self, name: str) -> bytes:
        """The JSON part, padded to four bytes."""
        whole: dict = {
            "asset": {"version": "2.0", "generator": "Drapeline"},
            "scene": 0,
            "scenes": [{"name": name, "nodes": list(range(len(self.nodes)))}],
            "nodes": self.nodes,
            "meshes": self.meshes,
            "materials": list(self.materials.values()),
            "accessors": self.accessors,
            "bufferViews": self.views,
            "buffers": [{"byteLength": self.size}],
        }
        if self.channels:
            whole["animations"] = [{"name": name, "channels": self.channels, "samplers": self.samplers}]
        text = json.dumps(whole, separators=(",", ":"), allow_nan=False).encode()
        return text + b" " * (-len(text) % 4)
