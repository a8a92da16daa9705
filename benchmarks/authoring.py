"""How long authoring takes: from an edit to the present frame, and until the whole sequence is made again.

``python -m benchmarks.authoring --run results/default`` prints a table: milliseconds from an edit (a parameter, a
candidate, a mesh, refinement, undo, another body) until the frame that is looked at is there, idle and while the
sequence is being made, and seconds until all frames are. Wall clock, as the user waits; beside it the processor time,
which other work on the machine does not change. The browser comes on top: `tests/test_app_browser.py` opens one.
"""

from __future__ import annotations

import argparse
import json
import tempfile
import threading
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import torch
import trimesh

from app.session import Session
from runtime.finished_run import FinishedRun

EDIT_GOAL, SEQUENCE_GOAL = 0.1, 2.0
"""Seconds, at most, on two cores."""

Row = dict[str, str | float]


def measured(what: str, work: Callable[[int], object], repetitions: int, goal: float) -> Row:
    """Wall clock and processor time of ``work(number)`` [s], medians, best and longest; the first run warms up."""
    wall, processor = [], []
    for number in range(repetitions + 1):
        start, busy = time.perf_counter(), time.process_time()
        work(number)
        wall.append(time.perf_counter() - start)
        processor.append(time.process_time() - busy)
    return {
        "what": what,
        "median_s": float(np.median(wall[1:])),
        "best_s": min(wall[1:]),
        "longest_s": max(wall[1:]),
        "processor_s": float(np.median(processor[1:])),
        "goal_s": goal,
    }


def edit_rows(session: Session, repetitions: int, situation: str) -> list[Row]:
    """From an edit to the frame that is looked at."""
    frame, (low, high) = session.frames // 2, session.ranges["density"]
    candidates = session.candidates(range(repetitions + 1))
    session.insert(0)

    def parameter(number: int) -> None:
        session.insert_parameters(frame, {"density": low + (high - low) * (number + 1) / (repetitions + 2)})
        session.look(frame)

    def candidate(number: int) -> None:
        session.insert_latent(frame, candidates[number], "candidate")
        session.look(frame)

    def refinement(number: int) -> None:
        session.set_refine(number % 2 == 1)
        session.look(frame)

    def undo(number: int) -> None:
        session.redo() if number % 2 else session.undo()
        session.look(frame)

    def body(number: int) -> None:
        low, high = session.shapes.ends[0]
        session.use_shape([low + (high - low) * (number + 1) / (repetitions + 2), *session.shapes.own[1:5]])
        session.look(frame)

    def scrub(number: int) -> None:
        session.insert_parameters(0, {"density": low + (high - low) * (number + 1) / (repetitions + 2)})
        session.look(frame + 1)

    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "keyframe.obj"
        trimesh.Trimesh(session.look(frame).garment, session.faces, process=False).export(path)

        def mesh(_: int) -> None:
            session.insert_mesh(frame, path)
            session.look(frame)

        works = {"a parameter": parameter, "a candidate": candidate, "a mesh from a file": mesh}
        works |= {"a far keyframe": scrub, "refinement": refinement, "undo": undo}
        if session.shapes.ends:
            works["body shape"] = body
        rows = [measured(f"edit: {name}, {situation}", work, repetitions, EDIT_GOAL) for name, work in works.items()]
    session.set_refine(True)
    if session.shapes.ends:
        session.use_shape(session.shapes.own[: len(session.shapes.ends)])
    return rows


def sequence_rows(session: Session, repetitions: int) -> list[Row]:
    """Until all frames are made again."""
    low, high = session.ranges["density"]

    def remake(number: int) -> None:
        session.insert_parameters(0, {"density": low + (high - low) * (number + 1) / (repetitions + 2)})
        while not session.remake():
            pass

    rows = [measured(f"all {session.frames} frames", remake, repetitions, SEQUENCE_GOAL)]
    session.set_refine(False)
    rows.append(measured(f"all {session.frames} frames, not refined", remake, repetitions, SEQUENCE_GOAL))
    session.set_refine(True)
    return rows


def main() -> None:
    """Print the table; write it where ``--json`` says."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--run", default="results/default", help="folder of a finished run (%(default)s)")
    parser.add_argument("--garment", help="the run's first by default")
    parser.add_argument("--motion", default="walk")
    parser.add_argument("--frames", type=int, default=240)
    parser.add_argument("--repetitions", type=int, default=7)
    parser.add_argument("--json", type=Path, help="write the table here as well")
    options = parser.parse_args()
    torch.set_num_threads(1)
    session = Session(FinishedRun.open(options.run), options.garment, options.motion, options.frames)
    rows = edit_rows(session, options.repetitions, "idle")
    stopped = threading.Event()

    def busy() -> None:
        while not stopped.is_set():
            session.remake()

    maker = threading.Thread(target=busy)
    maker.start()
    rows += edit_rows(session, options.repetitions, "sequence being made")
    stopped.set()
    maker.join()
    rows += sequence_rows(session, options.repetitions)
    vertices = session.look(0).garment.shape[0]
    print(f"{session.garment}, {vertices} vertices, {session.frames} frames of '{session.clip.label}'")
    for row in rows:
        median, best, longest, busy, goal = (
            1e3 * row[f"{part}_s"] for part in ("median", "best", "longest", "processor", "goal")
        )
        span = f"{best:.0f} to {longest:.0f}"
        print(f"{row['what']:48s}{median:7.0f} ms, {span:>14s}, processor {busy:5.0f}, at most {goal:.0f}")
    if options.json:
        options.json.write_text(json.dumps(rows, indent=1))


if __name__ == "__main__":
    main()
