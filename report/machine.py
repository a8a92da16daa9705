"""Where a run was made: processor, memory, versions. Linux is read in detail, other systems as far as Python tells."""

from __future__ import annotations

import os
import platform
import subprocess
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

PACKAGES = ("torch", "warp-lang", "numpy", "scipy", "h5py", "pyvista", "snakemake")


def machine_facts() -> list[tuple[str, str]]:
    """(what, value) pairs in the order of the page; nothing that names the machine or its user."""
    facts = [("Processor", _processor()), ("Cores", str(_cores())), ("Memory", _memory())]
    facts += [("Graphics", name) for name in _graphics()]
    facts += [("System", f"{platform.system()} {platform.machine()}"), ("Python", platform.python_version())]
    for package in PACKAGES:
        try:
            facts.append((package, version(package)))
        except PackageNotFoundError:
            continue
    return [(name, value) for name, value in facts if value]


def source_version() -> str:
    """Short commit of the checkout that runs, with a plus sign when files differ; empty without git."""
    try:
        commit = _git("rev-parse", "--short=10", "HEAD")
        return commit + ("+" if _git("status", "--porcelain", "--untracked-files=no") else "")
    except (OSError, subprocess.SubprocessError):
        return ""


def _git(*arguments: str) -> str:
    here = Path(__file__).parent
    done = subprocess.run(["git", *arguments], cwd=here, capture_output=True, text=True, timeout=10, check=True)
    return done.stdout.strip()


def _cores() -> int:
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


def _processor() -> str:
    for line in _lines("/proc/cpuinfo"):
        if line.startswith("model name"):
            return line.split(":", 1)[1].strip()
    return platform.processor() or platform.machine()


def _memory() -> str:
    for line in _lines("/proc/meminfo"):
        if line.startswith("MemTotal"):
            return f"{int(line.split()[1]) / 2**20:.1f} GiB"
    return ""


def _graphics() -> list[str]:
    found = []
    for path in sorted(Path("/proc/driver/nvidia/gpus").glob("*/information")):
        found += [line.split(":", 1)[1].strip() for line in _lines(path) if line.startswith("Model")]
    return found


def _lines(path: str | Path) -> list[str]:
    try:
        return Path(path).read_text(encoding="utf-8", errors="replace").splitlines()
    except OSError:
        return []
