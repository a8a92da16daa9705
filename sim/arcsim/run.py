"""Run ARCSim on a scene, where the program is there, and read what it made."""

from __future__ import annotations

import os
import shutil
import subprocess
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from sim.arcsim.results import read_frames, read_timing
from sim.arcsim.scene import MODULES, ArcsimScene, ArcsimSettings, write_scene

if TYPE_CHECKING:
    from body.model import Body
    from garments.template import GarmentTemplate

OUTPUT = "out"
"""Folder, inside that of the scene, where the program writes."""


@dataclass(frozen=True)
class ArcsimRun:
    """What a run gave over the recorded frames.

    Attributes:
        vertices: Positions [m], shape [T, V, 3], float32.
        seconds: Wall seconds of each frame and part of the program, shape [T, 8] (``MODULES``).
    """

    vertices: np.ndarray
    seconds: np.ndarray


def find_binary(binary: str) -> str:
    """Full path of the program, given as a path or as a name on the search path.

    Raises:
        ValueError: It is not there or cannot be executed.
    """
    found = shutil.which(binary)
    if found is None:
        raise ValueError(f"timing.arcsim.binary = {binary!r}: there is no such program, or it is not executable")
    return str(Path(found).resolve())


def run_scene(binary: str, scene: ArcsimScene, timeout: float = 7200.0) -> ArcsimRun:
    """Simulate a scene with ``<binary> simulateoffline scene.json out`` in its folder, on one thread.

    Args:
        binary: The program.
        scene: What :func:`sim.arcsim.scene.write_scene` wrote.
        timeout: Longest that it may take [s].

    Raises:
        ValueError: The program is missing, failed, took too long or left something that cannot be read.
    """
    program = find_binary(binary)
    output = scene.folder / OUTPUT
    shutil.rmtree(output, ignore_errors=True)
    output.mkdir(parents=True)
    command = [program, "simulateoffline", "scene.json", OUTPUT]
    with (scene.folder / "log.txt").open("w", encoding="utf-8") as log:
        try:
            done = subprocess.run(
                command,
                cwd=scene.folder,
                stdin=subprocess.DEVNULL,
                stdout=log,
                stderr=subprocess.STDOUT,
                env=os.environ | {"OMP_NUM_THREADS": "1"},
                timeout=timeout,
                check=False,
            )
        except subprocess.TimeoutExpired:
            raise ValueError(f"arcsim: {program} was stopped after {timeout:g} s, see {log.name}") from None
        except OSError as error:
            raise ValueError(f"arcsim: {program} cannot be started: {error.strerror}") from None
    if done.returncode:
        last = Path(log.name).read_text(encoding="utf-8", errors="replace").strip().splitlines()[-1:]
        said = f": {last[0][:200]}" if last else ""
        raise ValueError(f"arcsim: {program} ended with status {done.returncode}{said}")
    timing = output / "timing"
    if not timing.is_file():
        raise ValueError(f"arcsim: {program} left no file {timing}")
    vertices = read_frames(output, scene.vertices, scene.first_frame, scene.frames)
    seconds = read_timing(timing)
    # The start is a frame (number 0) but takes no time, so that line k belongs to frame k + 1.
    last_frame = scene.first_frame + scene.frames - 1
    if len(seconds) < last_frame:
        raise ValueError(f"{timing}: {len(seconds)} frames in it, {last_frame} were simulated")
    timed = np.arange(scene.first_frame, last_frame + 1) - 1
    return ArcsimRun(vertices, np.where(timed[:, None] >= 0, seconds[timed], 0.0))


def arcsim_rows(
    binary: str,
    template: GarmentTemplate,
    body: Body,
    pose: np.ndarray,
    root: np.ndarray,
    lead_in: int,
    parameters: Mapping[str, float],
    frames: int,
    warm_up: int,
    settings: ArcsimSettings,
    strain_limits: tuple[float, float] | None = (0.95, 1.05),
) -> list[dict]:
    """Rows for the timing table: ARCSim without and with strain limits, on the clip of the other solvers.

    Arguments as of :func:`sim.timing.time_solvers`. A frame's time is the sum over the parts of the program.
    """
    find_binary(binary)  # before time is spent
    needed = lead_in + warm_up + frames
    if len(pose) < needed:
        raise ValueError(f"arcsim: {needed} frames are needed (lead-in, warm-up and timed), the clip has {len(pose)}")
    rows = []
    for limits in (None, strain_limits) if strain_limits is not None else (None,):
        with tempfile.TemporaryDirectory(prefix="arcsim-") as folder:
            scene = write_scene(
                folder,
                template,
                body,
                pose[:needed],
                root[:needed],
                lead_in,
                parameters,
                replace(settings, strain_limits=limits),
            )
            seconds = run_scene(binary, scene).seconds[warm_up:]
        name = "ARCSim, no strain limits" if limits is None else f"ARCSim, strain limits {limits[0]:g}-{limits[1]:g}"
        rows.append(_row(name, scene, seconds))
    return rows


def _row(name: str, scene: ArcsimScene, seconds: np.ndarray) -> dict:
    total = seconds.sum(axis=1)
    row: dict = {
        "solver": name,
        "vertices": scene.vertices,
        "frames": len(seconds),
        "threads": 1,
        "median_s_per_frame": float(np.median(total)),
        "p95_s_per_frame": float(np.quantile(total, 0.95)),
        "substeps": scene.steps_per_frame,
        "source": "measured in this run",
    }
    means = dict(zip(MODULES, seconds.mean(axis=0)))
    return row | {f"{part}_s_per_frame": float(means[part]) for part in MODULES if means[part] > 0.0}
