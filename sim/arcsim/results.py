"""What ARCSim leaves behind: frames as OBJ files and a file of seconds, read into arrays.

The files come from outside, so whatever does not fit ends in one sentence that names the file and the line.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from sim.arcsim.scene import MODULES


def read_obj_vertices(path: str | Path) -> np.ndarray:
    """Positions [V, 3] [m] of an OBJ file; all other records are passed over.

    Raises:
        ValueError: No vertices, or a vertex that is not three finite numbers.
    """
    path = Path(path)
    rows = []
    with path.open(encoding="utf-8", errors="replace") as file:
        for number, line in enumerate(file, 1):
            if not line.startswith("v "):
                continue
            try:
                x, y, z = (float(word) for word in line.split()[1:4])
            except ValueError:
                raise ValueError(f"{path}: line {number}: expected 'v x y z', found {line.strip()[:60]!r}") from None
            rows.append((x, y, z))
            if not np.isfinite(rows[-1]).all():
                raise ValueError(f"{path}: line {number}: vertex {len(rows) - 1} is not finite")
    if not rows:
        raise ValueError(f"{path}: no vertex in it")
    return np.array(rows)


def read_frames(folder: str | Path, vertices: int, first: int, frames: int, cloth: int = 0) -> np.ndarray:
    """Frames ``first`` to ``first + frames - 1`` of a run.

    Args:
        folder: Output folder of the run, with files ``<frame>_<cloth>.obj``.
        vertices: Vertices that the garment has.
        first: Number of the first frame wanted.
        frames: How many.
        cloth: Number of the cloth.

    Returns:
        Positions [m], shape [frames, vertices, 3], float32.

    Raises:
        ValueError: A frame is missing, or its mesh was changed by remeshing.
    """
    recorded = np.empty((frames, vertices, 3), dtype=np.float32)
    for k in range(frames):
        path = Path(folder) / f"{first + k:04d}_{cloth:02d}.obj"
        if not path.is_file():
            raise ValueError(f"{path}: missing; frames {first} to {first + frames - 1} are needed")
        points = read_obj_vertices(path)
        if len(points) != vertices:
            raise ValueError(f"{path}: {len(points)} vertices, the garment has {vertices}: was remeshing switched on?")
        recorded[k] = points
    return recorded


def read_timing(path: str | Path) -> np.ndarray:
    """Wall seconds of each frame and part of the program (``MODULES``), shape [frames, 8].

    Raises:
        ValueError: A line that is not eight numbers, none of them negative.
    """
    rows = []
    for number, line in enumerate(Path(path).read_text(encoding="utf-8", errors="replace").splitlines(), 1):
        if not line.strip():
            continue
        try:
            row = [float(word) for word in line.split()]
        except ValueError:
            row = []
        if len(row) != len(MODULES) or not np.isfinite(row).all() or min(row) < 0.0:
            raise ValueError(f"{path}: line {number}: expected {len(MODULES)} times [s], found {line.strip()[:80]!r}")
        rows.append(row)
    if not rows:
        raise ValueError(f"{path}: no frame in it")
    return np.array(rows)
