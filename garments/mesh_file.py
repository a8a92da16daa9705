"""Reading a user's own mesh: OBJ, PLY or binary glTF. The file is untrusted.

In: a file of at most ``MAX_BYTES``. Out: positions in the file's own unit and triangles. Normals, texture coordinates,
materials and the names of objects are left out; nothing that the file refers to is opened. What is wrong with the mesh
itself is for ``geometry.mesh_check`` to say.
"""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np

MAX_BYTES = 256 * 2**20
MAX_VERTICES = 100_000
MESH_FILES = (".obj", ".ply", ".glb")


def read_mesh(path: str | Path) -> tuple[np.ndarray, np.ndarray]:
    """Vertices [file unit], shape [V, 3] float64, and triangles, shape [F, 3] int64; polygons become fans.

    Raises:
        FileNotFoundError: No such file.
        ValueError: Another kind of file, too large, damaged, or no triangles in it; names the file, and the line of
            an OBJ file.
    """
    path = Path(path)
    if not path.is_file():
        raise FileNotFoundError(f"{path}: no such file")
    if path.suffix.lower() not in MESH_FILES:
        raise ValueError(f"{path}: a mesh file must end in {', '.join(MESH_FILES)}")
    size = path.stat().st_size
    if size > MAX_BYTES:
        raise ValueError(f"{path}: {size / 2**20:.0f} MiB, at most {MAX_BYTES // 2**20} MiB is read")
    content = path.read_bytes()
    vertices, faces = _obj(path, content) if path.suffix.lower() == ".obj" else _by_trimesh(path, content)
    if len(faces) == 0:
        raise ValueError(f"{path}: holds no triangles")
    if len(vertices) > MAX_VERTICES:
        raise ValueError(f"{path}: {len(vertices)} vertices, at most {MAX_VERTICES} are read")
    return vertices, faces


def _obj(path: Path, content: bytes) -> tuple[np.ndarray, np.ndarray]:
    """Only ``v`` and ``f`` lines count, so that seams of a texture do not split the cloth."""
    vertices: list[list[float]] = []
    faces: list[tuple[int, int, int]] = []
    try:
        lines = content.decode("utf-8-sig").splitlines()
    except UnicodeDecodeError:
        raise ValueError(f"{path}: is not a text file, so it cannot be OBJ") from None
    for number, line in enumerate(lines, 1):
        words = line.split("#", 1)[0].split()
        if not words or words[0] not in ("v", "f"):
            continue
        try:
            if words[0] == "v":
                x, y, z = map(float, words[1:4])
                vertices.append([x, y, z])
            else:
                corners = [_obj_index(word, len(vertices)) for word in words[1:]]
                if len(corners) < 3:
                    raise ValueError("a face needs at least 3 corners")
                faces += [(corners[0], corners[k], corners[k + 1]) for k in range(1, len(corners) - 1)]
        except ValueError as error:
            reason = str(error) if words[0] == "f" else f"a vertex needs 3 numbers, found {' '.join(words[1:])[:60]!r}"
            raise ValueError(f"{path}, line {number}: {reason}") from None
    return np.array(vertices, dtype=np.float64).reshape(-1, 3), np.array(faces, dtype=np.int64).reshape(-1, 3)


def _obj_index(word: str, count: int) -> int:
    """Position in the list of vertices so far; OBJ counts from 1, or backwards from the last one."""
    try:
        number = int(word.split("/", 1)[0])
    except ValueError:
        raise ValueError(f"a face's corner must begin with a whole number, found {word[:20]!r}") from None
    index = number - 1 if number > 0 else count + number
    if number == 0 or not 0 <= index < count:
        raise ValueError(f"the face names vertex {number}, {count} vertices stand before it")
    return index


def _by_trimesh(path: Path, content: bytes) -> tuple[np.ndarray, np.ndarray]:
    import trimesh

    kind = path.suffix.lower().removeprefix(".")
    try:
        scene = trimesh.load_scene(io.BytesIO(content), file_type=kind, process=False)
        mesh = scene.to_mesh()
        vertices, faces = np.array(mesh.vertices, np.float64), np.array(mesh.faces, np.int64)
    except Exception as error:  # a parser of untrusted bytes may fail in any way
        raise ValueError(f"{path}: is not a readable {kind.upper()} mesh ({type(error).__name__}: {error})") from None
    if kind == "glb" and len(vertices):
        # glTF stores a vertex once for every normal and texture coordinate that it has.
        _, first, number = np.unique(vertices, axis=0, return_index=True, return_inverse=True)
        order = np.argsort(first)
        rank = np.empty(len(order), dtype=np.int64)
        rank[order] = np.arange(len(order))
        vertices, faces = vertices[first[order]], rank[number.reshape(-1)][faces]
    return vertices, faces
