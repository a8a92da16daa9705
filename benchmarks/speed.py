"""Seconds a frame of the simulator beside what a user could take instead, on one core, one mesh and one clip.

``python -m benchmarks.speed`` prints three tables: times, starts, memory. Every row is made in a process of its own
that is held to one core, so that no solver profits from another one's warm caches or threads. Times are those of the
processor (median and 95th percentile over the recorded frames), with the wall's median beside them: on a machine that
does other work the two differ, and the processor's are the ones to compare.

Peers are optional: ``--peers-python`` names the interpreter of an environment with ``requirements-peers.txt``. A peer
that is missing or fails has a row that says so. Next to each time stands what the solver made of the scene: strain,
vertices inside the body, distance from our own result; a fast row that explodes is shown exploding.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks.measure import cleanliness, pin_to_one_core
from benchmarks.own import OwnJob
from benchmarks.peers.__main__ import NOT_INSTALLED
from benchmarks.peers.recording import PeerRun
from benchmarks.scene import BODY, MATERIALS, Scene, make_scene
from benchmarks.starts import LARGE, ROOT, RowFailed, last_line, memory_rows, run_own, run_quietly, start_rows

Row = dict[str, str | int | float | None]

PEERS: dict[str, tuple[tuple[str, str, bool], ...]] = {
    "newton-xpbd": (("newton", "XPBD", False), ("newton", "XPBD_FEW_SUBSTEPS", False)),
    "newton-vbd": (("newton", "VBD", False),),
    "blender": (("blender", "-", False),),
    "implicit": (("implicit", "-", True),),
}
"""Runs of each peer: its module, the name of its settings there, and whether it is part of this project."""

DEFAULT_GARMENTS = ("skirt:3300", "tshirt:3170", "pants:3300")
PEER_SECONDS = 1800.0
"""Longest time that a peer may take [s]."""


@dataclass(frozen=True)
class Plan:
    """What the benchmark shall run; see the command's options."""

    garments: tuple[tuple[str, int], ...]
    worlds: tuple[int, ...] = (1, 16)
    substeps: int = 32
    self_contact: tuple[bool, ...] = (False,)
    frames: int = 60
    peers: tuple[str, ...] = ()
    peers_python: str = sys.executable
    starts: bool = True
    large: int = LARGE


def run_plan(plan: Plan, folder: Path) -> dict[str, list[Row]]:
    """Make every row.

    Args:
        plan: What to run.
        folder: Where scenes and results of the processes go.

    Returns:
        Rows of the tables ``speed``, ``starts`` and ``memory``.
    """
    rows: list[Row] = []
    templates = {garment: _template(*garment, folder) for garment in plan.garments}
    for template in templates.values():
        rows += garment_rows(plan, template, folder)
    tables = {"speed": rows, "starts": [], "memory": []}
    if plan.starts:
        first = next(iter(templates.values()))
        large = _template(plan.garments[0][0], plan.large, folder)
        tables["starts"] = start_rows(first, list(plan.worlds), folder)
        tables["memory"] = memory_rows(large, list(plan.worlds), list(plan.self_contact), plan.frames, folder)
    return tables


def garment_rows(plan: Plan, template: Path, folder: Path) -> list[Row]:
    """All solvers on one garment; the ratio is to our single world without self-contact."""
    rows: list[Row] = []
    base: float | None = None
    for touching in plan.self_contact:
        scene = make_scene(template, plan.frames, plan.substeps, touching)
        ours: np.ndarray | None = None
        for worlds in plan.worlds:
            say(f"{scene.garment}: our simulator, {worlds} worlds, self-contact {_switch(touching)}")
            row = _row(scene, "XPBD (ours)", plan.substeps, "own parts", worlds)
            job = OwnJob(str(template), str(folder / "own.npz"), plan.frames, plan.substeps, worlds, touching)
            try:
                result = run_own(job, folder)
            except RowFailed as failure:
                rows.append(row | {"note": str(failure)})
                continue
            times, facts = _times(result["wall"], result["cpu"], worlds), _judged(scene, result["vertices"], ours)
            row |= times | facts | {"peak_mb": result["memory_mb"]}
            if result["failed_worlds"]:
                row["note"] = f"{result['failed_worlds']} of {worlds} worlds failed"
            rows.append(row)
            if worlds == 1:
                ours = result["vertices"]
                base = base or times["median_ms"]
        scene_path = folder / "scene.npz"
        scene.save(scene_path)
        for name in plan.peers:
            for module, variant, of_this_project in PEERS[name]:
                say(f"{scene.garment}: {name} {variant}, self-contact {_switch(touching)}")
                python = sys.executable if of_this_project else plan.peers_python
                rows.append(peer_row(scene, scene_path, name, (module, variant, python), ours, folder))
    for row in rows:
        if base is not None and row.get("world_ms") is not None:
            row["ratio"] = row["world_ms"] / base
    return rows


def peer_row(
    scene: Scene,
    scene_path: Path,
    name: str,
    peer: tuple[str, str, str],
    ours: np.ndarray | None,
    folder: Path,
) -> Row:
    """One run of a peer (module, settings, interpreter), or the reason why there is none."""
    module, variant, python = peer
    contact = "own parts" if module == "implicit" else "whole body"
    row = _row(scene, name, None, contact, 1)
    out = folder / "peer.npz"
    out.unlink(missing_ok=True)
    command = [python, "-m", "benchmarks.peers", module, variant, str(scene_path), str(out)]
    try:
        done = run_quietly(command, os.environ | {"OMP_NUM_THREADS": "1"}, PEER_SECONDS)
    except subprocess.TimeoutExpired:
        return row | {"note": f"longer than {PEER_SECONDS:g} s"}
    except OSError as error:
        return row | {"note": f"not installed: {error}"}
    if done.returncode == NOT_INSTALLED:
        return row | {"note": f"not installed: {last_line(done.stderr)}"}
    if done.returncode != 0 or not out.exists():
        return row | {"note": f"failed: {last_line(done.stderr)}"}
    run = PeerRun.load(out)
    row |= {"solver": run.solver, "substeps": run.steps, "settings": run.settings}
    return row | _times(run.wall, run.cpu, 1) | _judged(scene, run.vertices, ours)


def _row(scene: Scene, solver: str, substeps: int | None, contact: str, worlds: int) -> Row:
    return {
        "solver": solver,
        "garment": scene.garment,
        "vertices": len(scene.vertices),
        "worlds": worlds,
        "substeps": substeps,
        "contact": contact,
        "self": _switch(scene.self_contact),
        "threads": 1,
    }


def _times(wall: np.ndarray, cpu: np.ndarray, worlds: int) -> Row:
    median = 1e3 * float(np.median(cpu))
    return {
        "median_ms": median,
        "p95_ms": 1e3 * float(np.quantile(cpu, 0.95)),
        "world_ms": median / worlds,
        "world_p95_ms": 1e3 * float(np.quantile(cpu, 0.95)) / worlds,
        "wall_ms": 1e3 * float(np.median(wall)),
    }


def _judged(scene: Scene, vertices: np.ndarray, ours: np.ndarray | None) -> Row:
    try:
        found = cleanliness(scene, vertices, ours)
    except ValueError as error:
        return {"note": str(error)}
    row: Row = {
        "strain_p99_percent": 100.0 * found.p99_strain,
        "strain_max_percent": 100.0 * found.max_strain,
        "inside_percent": 100.0 * found.inside,
        "deepest_mm": 1e3 * found.deepest,
    }
    return row if found.apart is None else row | {"apart_mm": 1e3 * found.apart}


def _template(kind: str, vertices: int, folder: Path) -> Path:
    from body.model import Body
    from garments.build import build_template
    from garments.spec import GarmentSpec

    path = folder / f"{kind}_{vertices}.npz"
    if not path.exists():
        say(f"building {kind} of {vertices} vertices")
        build_template(GarmentSpec(kind, kind, vertices), Body.load(BODY)).save(path)
    return path


def _switch(on: bool) -> str:
    return "on" if on else "off"


def say(text: str) -> None:
    """Progress, apart from the tables."""
    print(f"[speed] {text}", file=sys.stderr, flush=True)


COLUMNS = (
    ("solver", "solver"),
    ("settings", "settings"),
    ("garment", "garment"),
    ("start", "start"),
    ("vertices", "verts"),
    ("worlds", "worlds"),
    ("substeps", "substeps"),
    ("contact", "contact"),
    ("self", "self"),
    ("threads", "threads"),
    ("median_ms", "median"),
    ("p95_ms", "p95"),
    ("world_ms", "world median"),
    ("world_p95_ms", "world p95"),
    ("wall_ms", "wall median"),
    ("ratio", "ratio"),
    ("strain_p99_percent", "strain p99 %"),
    ("strain_max_percent", "max %"),
    ("inside_percent", "inside %"),
    ("deepest_mm", "deepest mm"),
    ("apart_mm", "apart mm"),
    ("peak_mb", "peak MB"),
    ("total_s", "total s"),
    ("cpu_s", "processor s"),
    ("imports_s", "imports s"),
    ("kernels_s", "kernels s"),
    ("simulation_s", "simulation s"),
    ("note", "note"),
)
"""Key of a row and what stands above its column, in the order of the printed tables."""


def table(rows: list[Row]) -> str:
    """Rows as aligned text; a column appears where any row has it, a missing cell is a dash."""
    shown = [(key, title) for key, title in COLUMNS if any(row.get(key) is not None for row in rows)]
    lines = [[title for _, title in shown]] + [[_cell(row.get(key)) for key, _ in shown] for row in rows]
    width = [max(len(line[k]) for line in lines) for k in range(len(shown))]
    return "\n".join("  ".join(word.ljust(size) for word, size in zip(line, width)).rstrip() for line in lines)


def _cell(value: str | int | float | None) -> str:
    if value is None:
        return "-"
    if isinstance(value, float):
        return f"{value:.3g}" if abs(value) < 1000.0 else f"{value:.0f}"
    return str(value)


def machine() -> dict[str, str]:
    """What the times were taken on."""
    model = platform.processor() or platform.machine()
    info = Path("/proc/cpuinfo")
    if info.exists():
        names = [
            line.split(":", 1)[1].strip() for line in info.read_text().splitlines() if line.startswith("model name")
        ]
        model = names[0] if names else model
    return {"processor": model, "system": platform.platform(), "python": platform.python_version()}


def parsed(arguments: list[str] | None = None) -> tuple[Plan, str | None]:
    """The plan of a command line, and where its JSON goes."""
    parser = argparse.ArgumentParser(prog="python -m benchmarks.speed", description=__doc__.split("\n\n")[0])
    parser.add_argument("--garments", nargs="+", default=list(DEFAULT_GARMENTS), metavar="KIND:VERTICES")
    parser.add_argument("--worlds", nargs="+", type=int, default=[1, 16], help="parameter sets at once")
    parser.add_argument("--substeps", type=int, default=32, help="of our simulator, a frame")
    parser.add_argument("--self-contact", action="store_true", help="every row with self-contact as well")
    parser.add_argument("--frames", type=int, default=60, help="recorded frames of the clip")
    parser.add_argument("--peers", nargs="*", default=[], choices=sorted(PEERS), help="solvers of others, and implicit")
    parser.add_argument("--peers-python", default=_peers_python(), help="interpreter with requirements-peers.txt")
    parser.add_argument("--no-starts", action="store_true", help="leave out starts and memory")
    parser.add_argument("--json", help="write the tables here as well")
    options = parser.parse_args(arguments)
    plan = Plan(
        garments=tuple(_garment(text) for text in options.garments),
        worlds=tuple(options.worlds),
        substeps=options.substeps,
        self_contact=(False, True) if options.self_contact else (False,),
        frames=options.frames,
        peers=tuple(options.peers),
        peers_python=options.peers_python,
        starts=not options.no_starts,
    )
    if min(plan.worlds) < 1 or plan.substeps < 1 or plan.frames < 2:
        raise ValueError(
            f"benchmark: worlds {list(plan.worlds)}, substeps {plan.substeps}, frames {plan.frames}: "
            "at least 1, 1 and 2 are needed"
        )
    return plan, options.json


def _garment(text: str) -> tuple[str, int]:
    kind, _, count = text.partition(":")
    if kind not in MATERIALS or not count.isdigit():
        raise ValueError(f"benchmark: garment {text!r}: expected KIND:VERTICES with a kind of {', '.join(MATERIALS)}")
    return kind, int(count)


def _peers_python() -> str:
    own = ROOT / ".venv-peers" / "bin" / "python"
    return str(own) if own.exists() else sys.executable


def main() -> None:
    """Run the benchmark of the command line."""
    try:
        plan, json_path = parsed()
    except ValueError as error:
        sys.exit(str(error))
    core = pin_to_one_core()
    facts = machine() | {"core": "not pinned: this system cannot" if core is None else f"pinned to core {core}"}
    with tempfile.TemporaryDirectory(prefix="speed_") as folder:
        tables = run_plan(plan, Path(folder))
    print("; ".join(facts.values()))
    print(
        "median, p95: processor ms a frame over the recorded frames; world: the same a world; ratio: to our one world"
    )
    print("inside: vertices in the body, mean over frames; apart: root mean square distance to our one world")
    for name, rows in tables.items():
        if rows:
            print(f"\n{name}\n{table(rows)}")
    if json_path is not None:
        Path(json_path).write_text(json.dumps({"machine": facts} | tables, indent=1) + "\n")


if __name__ == "__main__":
    main()
