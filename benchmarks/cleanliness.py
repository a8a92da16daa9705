"""How clean simulated cloth is: clips simulated and every recorded frame checked for crossings, depth and strain.

    python -m benchmarks.cleanliness --garments skirt tshirt pants --vertices 3300 --clips default --json out.json

Clips: ``default`` and ``all`` (generated labels), ``mocap`` (every recording of ``--mocap``), a label (``walk``), a
variant of it (``walk_003``), or ``mocap:`` with a label, recording or clip of that folder. What counts as a crossing
stands in ``sim.crossings``, what counts as pinched in ``sim.buried``. Counts and depths without the word *pinched* are
faults: cloth in the body where the body leaves room for it. Hands are left out of contact on purpose
(``sim.body_parts.handless``): what is inside them is counted apart. Garments worn over each other are surveyed as one,
with ``--vertices`` each and their crossings with each other among their own:

    python -m benchmarks.cleanliness --configs configs/default.yaml configs/outfit.yaml --garments dressed
"""

from __future__ import annotations

import argparse
import json
import re
import sys
import time
from collections.abc import Iterable, Iterator, Sequence
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from benchmarks.clean_table import ClipReport, report_text
from benchmarks.subjects import Subject, make_subjects
from body.skeleton import JOINT_NAMES

if TYPE_CHECKING:
    from benchmarks.worst_frames import Album
    from body.model import Body
    from motions.clip import Clip
    from sim.buried import Closure
    from sim.crossings import Crossings

CONFIGS = ("configs/default.yaml", "configs/paper.yaml")
"""Where garments and their materials come from."""


def find_clips(names: Sequence[str], config: dict, body: Body, folder: str, variants: int, windows: int) -> Iterator:
    """The clips that names stand for, made one after the other; ``ValueError`` for a name that means nothing."""
    from motions.procedural import DEFAULT_LABELS, LABELS, generate_clip

    frames, fps, seed = config["motions"]["frames"], config["motions"]["fps"], config["seed"]
    groups = {"default": DEFAULT_LABELS, "all": LABELS}

    def generated(labels: Iterable[str], numbers: Iterable[int]) -> Iterator[Clip]:
        labels = list(labels)
        return (generate_clip(label, number, frames, fps, seed, body) for number in numbers for label in labels)

    plans = []
    for name in names:
        variant = re.fullmatch(r"(.+)_(\d{3})", name)
        if name in groups or name in LABELS:
            plans.append(generated(groups.get(name, [name]), range(variants)))
        elif name == "mocap" or name.startswith("mocap:"):
            plans.append(_recorded(name.partition(":")[2], folder, config["motions"], body, windows))
        elif variant and variant[1] in LABELS:
            plans.append(generated([variant[1]], [int(variant[2])]))
        else:
            raise ValueError(
                f"unknown clip {name!r}: allowed are default, all, mocap, mocap:NAME, or a generated label such as "
                f"{', '.join(LABELS[:5])} or {LABELS[0]}_003"
            )
    return (clip for plan in plans for clip in plan)


def _recorded(wanted: str, folder: str, motions: dict, body: Body, windows: int) -> Iterator[Clip]:
    """Clips of recordings, label after label in turn; of all of them when nothing is wanted in particular."""
    from motions.bvh_folder import list_takes

    takes = list_takes(folder, motions["bvh"]["labels"])
    rank: dict[str, int] = {}
    keyed = []
    for position, take in enumerate(takes):
        rank[take.label] = rank.get(take.label, -1) + 1
        stem = Path(take.file).stem
        if wanted in ("", take.label, stem) or re.fullmatch(re.escape(stem) + r"_\d{3}", wanted):
            keyed.append((rank[take.label], position, take))
    if not keyed:
        raise ValueError(f"no recording in {folder} is called {wanted!r}, by label, file or clip")

    def clips() -> Iterator[Clip]:
        for _, _, take in sorted(keyed, key=lambda entry: entry[:2]):
            made = take.clips(motions["frames"], motions["fps"], body)
            named = [clip for clip in made if clip.name == wanted]
            yield from named or made[:windows]

    return clips()


def survey_clip(subject: Subject, clip: Clip, lead_in: int, posed: np.ndarray, closures: list[Closure]) -> ClipReport:
    """Simulate one clip and check its frames.

    Args:
        subject: The garment.
        clip: The motion.
        lead_in: Frames from the bind pose into the clip.
        posed: The body in every frame [m], shape [T, B, 3].
        closures: Where it is closed to cloth, for every frame.
    """
    from motions.lead_in import lead_in as lead_into

    simulator = subject.simulator
    lead_pose, lead_root = lead_into(clip, simulator.body, lead_in)
    pose, root = np.concatenate([lead_pose, clip.pose]), np.concatenate([lead_root, clip.root])
    result = simulator.run(pose, root, len(lead_pose), subject.parameters)
    report = ClipReport(subject.garment, len(simulator.template.vertices), clip.name, clip.label, result.failure)
    if result.failure is not None:
        return report
    strain = np.abs(simulator.rest.edge_strain(result.vertices))
    for frame, cloth in enumerate(result.vertices):
        found = subject.check(cloth, posed[frame], closures[frame])
        report.add(
            vertices=found.vertices_inside,
            triangles=found.triangles_inside,
            deepest_mm=1e3 * found.deepest_m,
            pinched_vertices=found.pinched_vertices,
            pinched_triangles=found.pinched_triangles,
            pinched_deepest_mm=1e3 * found.deepest_pinched_m,
            hand_vertices=found.aside_vertices,
            hand_triangles=found.aside_triangles,
            self_pairs=found.self_pairs,
            pinched_self_pairs=found.pinched_self_pairs,
            p99_strain=float(np.quantile(strain[frame], 0.99)),
            max_strain=float(strain[frame].max()),
            place=_place(found, simulator.body),
        )
    report.positions = result.vertices
    return report


def _place(found: Crossings, body: Body) -> str:
    """The joint that carries the body where the deepest fault is, empty without any."""
    depth = np.where(found.triangle_fault, found.triangle_depth, -1.0)
    worst = int(np.argmax(depth))
    if depth[worst] < 0.0:
        return ""
    return JOINT_NAMES[body.part_of_vertex[body.faces[found.triangle_face[worst], 0]]]


def survey(arguments: argparse.Namespace) -> tuple[list[ClipReport], Album | None]:
    """Every clip under every garment, with a line of progress for each clip.

    Returns:
        A report for every clip and garment, and the worst frames if pictures of them are asked for.
    """
    from body.model import Body
    from pipeline.config import load_config
    from sim.buried import ClosureFinder

    config = load_config(arguments.configs)
    body = Body.load(config["body"]["resolution"]).shaped(config["body"]["shape"])
    clips = find_clips(arguments.clips, config, body, arguments.mocap, arguments.variants, arguments.windows)
    subjects = make_subjects(config, body, arguments.garments, arguments.vertices, arguments.substeps, arguments.device)
    finder = ClosureFinder(body.faces, arguments.device)
    reports, started = [], time.perf_counter()
    album = None
    if arguments.pictures:
        from benchmarks.worst_frames import Album

        album = Album(body.faces, arguments.worst)
    try:
        for clip in islice(clips, arguments.limit):
            posed = body.posed(clip.pose, clip.root)
            gap = 2.0 * subjects[0].parameters["thickness"]
            closures = [finder.at(vertices, gap) for vertices in posed]
            for subject in subjects:
                report = survey_clip(subject, clip, config["motions"]["lead_in"], posed, closures)
                if album is not None:
                    album.keep(report, subject, posed, closures)
                report.positions = None
                reports.append(report)
            minutes = (time.perf_counter() - started) / 60.0
            print(f"[cleanliness] {clip.name} done, {minutes:.1f} min", file=sys.stderr, flush=True)
    except KeyboardInterrupt:
        print("[cleanliness] interrupted: what is done so far follows", file=sys.stderr, flush=True)
    return reports, album


def main(given: Sequence[str] | None = None) -> None:
    """Command line."""
    parser = argparse.ArgumentParser(prog="benchmarks.cleanliness", description=__doc__.splitlines()[0])
    parser.add_argument("--garments", nargs="+", default=["skirt", "tshirt", "pants"])
    parser.add_argument("--vertices", nargs="+", type=int, default=[3300])
    parser.add_argument("--clips", nargs="+", default=["default"], help="default, all, mocap, mocap:NAME, or labels")
    parser.add_argument("--substeps", type=int, default=32)
    parser.add_argument("--variants", type=int, default=1, help="generated clips a label")
    parser.add_argument("--windows", type=int, default=2, help="clips a recording, at most")
    parser.add_argument("--limit", type=int, help="clips, at most")
    parser.add_argument("--mocap", default="mocap", help="folder of the recordings and their label file")
    parser.add_argument("--configs", nargs="+", default=list(CONFIGS), help="where garments come from")
    parser.add_argument("--device", default="cpu", choices=("auto", "cpu", "cuda"))
    parser.add_argument("--worst", type=int, default=8, help="frames listed as the worst")
    parser.add_argument("--pictures", help="folder for pictures of the worst frames")
    parser.add_argument("--json", help="file for every figure of every frame")
    arguments = parser.parse_args(given)
    try:
        reports, album = survey(arguments)
    except (ValueError, OSError) as error:
        parser.error(str(error))
    if not reports:
        parser.error("no clip was found")
    print(report_text(reports, arguments.worst), flush=True)
    if arguments.json:
        from datasets.atomic import write_text

        write_text(arguments.json, json.dumps([report.as_dict() for report in reports]) + "\n")
    if album is not None:
        album.draw(arguments.pictures)


if __name__ == "__main__":
    main()
