"""Cold and warm start of the simulator, and the memory of a large job: each in a fresh process.

A start is the time from the launch of Python to the first simulated frame of a garment, template and body read from
their files; settling is left out, for it is simulation. Cold means an empty kernel cache, so that every kernel is
compiled.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from pathlib import Path

import numpy as np

from benchmarks.measure import children_seconds
from benchmarks.own import OwnJob, write_job

ROOT = Path(__file__).parent.parent
LARGE = 12_540
"""Vertices of the largest published garment."""

START_TIMES = ("total_s", "cpu_s", "imports_s", "kernels_s", "simulation_s")
"""Of a start: wall and processor seconds of the whole process, and the wall's of its parts."""


class RowFailed(Exception):
    """A row that cannot be made; the message says why, in one line."""


def run_own(job: OwnJob, folder: Path, cache: Path | None = None) -> dict:
    """Run a job in a process of its own.

    Args:
        job: What to simulate.
        folder: Where the job's file goes.
        cache: Folder of compiled kernels; the user's own where None.

    Returns:
        The archive's contents with its facts, and of the whole process, from its launch to its end, ``total_s`` [s of
        the wall] and ``cpu_s`` [s of the processor].

    Raises:
        RowFailed: The process failed.
    """
    path = folder / "job.json"
    write_job(job, path)
    environment = os.environ | {"OMP_NUM_THREADS": "1"}
    if cache is not None:
        environment["WARP_CACHE_PATH"] = str(cache)
    begun, before = time.perf_counter(), children_seconds()
    done = run_quietly([sys.executable, "-m", "benchmarks.own", str(path)], environment)
    seconds, used = time.perf_counter() - begun, children_seconds() - before
    if done.returncode != 0:
        raise RowFailed(f"failed: {last_line(done.stderr)}")
    with np.load(job.out) as archive:
        facts = json.loads(archive["facts"].tobytes())
        arrays = {name: archive[name] for name in ("vertices", "wall", "cpu")}
        return facts | arrays | {"total_s": seconds, "cpu_s": used}


def run_quietly(
    command: list[str], environment: dict[str, str], seconds: float | None = None
) -> subprocess.CompletedProcess[str]:
    """Run a command from the project's root and keep what it prints."""
    return subprocess.run(
        command, cwd=ROOT, env=environment, capture_output=True, text=True, check=False, timeout=seconds
    )


def last_line(text: str) -> str:
    """The last line that says something."""
    lines = [line.strip() for line in text.splitlines() if line.strip()]
    return lines[-1] if lines else "no word"


def start_rows(template: Path, worlds: list[int], folder: Path) -> list[dict]:
    """A cold and a warm start for each number of worlds; every number begins with an empty cache."""
    rows = []
    for count in worlds:
        cache = folder / f"kernels_{count}"
        for start in ("cold", "warm"):
            row: dict = {"start": start, "worlds": count}
            job = OwnJob(str(template), str(folder / "start.npz"), worlds=count, first_frame=True)
            try:
                facts = run_own(job, folder, cache)
            except RowFailed as failure:
                rows.append(row | {"note": str(failure)})
                continue
            rows.append(row | {name: facts[name] for name in START_TIMES})
    return rows


def memory_rows(template: Path, worlds: list[int], self_contact: list[bool], frames: int, folder: Path) -> list[dict]:
    """Peak resident memory of a whole job at ``LARGE`` vertices."""
    rows = []
    for count in worlds:
        for touching in self_contact:
            row: dict = {"vertices": LARGE, "worlds": count, "self": "on" if touching else "off"}
            job = OwnJob(str(template), str(folder / "large.npz"), frames, worlds=count, self_contact=touching)
            try:
                facts = run_own(job, folder)
            except RowFailed as failure:
                rows.append(row | {"note": str(failure)})
                continue
            rows.append(row | {"peak_mb": facts["memory_mb"], "total_s": facts["total_s"]})
    return rows
