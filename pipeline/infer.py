"""Estimate what a garment is made of from its shape, with how sure that is.

    python -m pipeline.infer --garment skirt --in walk.h5
    python -m pipeline.infer --garment skirt --shard results/default/shards/skirt/materials_0000.h5 --sequence '#3'
    python -m pipeline.infer --garment skirt --mesh folded.obj --motion walk_003 --frame 30 --out folded.csv

In goes a short sequence (an animation of this program or a simulated one), or one mesh (OBJ or PLY, the garment's own)
with the motion that led to it and the frame that it is in. Out come the intrinsic parameters that the run sampled, each
with an interval that holds the truth in nine of ten cases. The intervals are what was missed on materials that the
networks were not trained on; the run's table `inference` says how often they held on others. "Known" is how much
narrower an interval is than the sampled values: what a shape does not show stays unknown, and that is said. The more
frames, the more is known. Products such as bend / (density gravity) are what a shape can tell.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from datasets.codes import file_digest, read_codes
from datasets.shards import MATERIALS
from datasets.splits import TRAIN, UNSEEN_PARAMETERS
from evaluation.parameter_reader import COVERAGE, Estimate, ParameterReader
from evaluation.table import Row, write_table
from formats.keyframe import read_keyframe
from formats.target import refuse_existing
from models.parameter_groups import GROUPS
from pipeline.command import asked_garment, run_command
from pipeline.parameter_reading import fitted_reader
from pipeline.shown_options import add_shown, shown_animation
from runtime.asked_motion import asked_motion
from runtime.finished_run import LearnedGarment
from runtime.intrinsic_space import IntrinsicSpace
from runtime.keyframe_wishes import CANONICAL, SPACES, WORLD
from runtime.shown_garment import ShownGarment
from sim.parameters import parameter


def define(parser: argparse.ArgumentParser) -> None:
    """Options of the command."""
    parser.add_argument("--run", default="results/default", help="folder of a finished run (%(default)s)")
    parser.add_argument("--garment", required=True, help="garment of the run, such as skirt")
    add_shown(parser, required=False)
    parser.add_argument("--mesh", metavar="FILE", help="one mesh (OBJ, PLY), with --motion and --frame")
    parser.add_argument("--motion", metavar="WHAT", help="of the mesh: a motion file, a clip of the run, or a label")
    parser.add_argument("--clip", help="name of the clip, of a file that holds several")
    parser.add_argument("--seed", type=int, default=0, help="of an invented motion (%(default)s)")
    parser.add_argument("--frame", type=int, default=0, help="frame of the motion that the mesh is in (%(default)s)")
    parser.add_argument(
        "--space", choices=SPACES, default=WORLD, help="what the mesh's coordinates are in (%(default)s)"
    )
    parser.add_argument("--out", metavar="FILE", help="also write the estimates to a CSV file")
    parser.add_argument("--force", action="store_true", help="replace what exists")


def reader_of(garment: LearnedGarment, space: IntrinsicSpace) -> ParameterReader:
    """The reader for a garment, fitted to its run's training materials and calibrated on held-out ones: takes some
    seconds."""
    splits = (TRAIN, UNSEEN_PARAMETERS)
    codes = read_codes(garment.codes_path, garment.name, file_digest(garment.descriptor_path), splits, (MATERIALS,))
    return fitted_reader(space.network, *([s for s in codes if s.split == split] for split in splits))


def infer(options: argparse.Namespace) -> None:
    """Read, estimate, print, and write where asked to."""
    garment = asked_garment(options)
    if options.out:
        if Path(options.out).suffix.lower() != ".csv":
            raise ValueError(f"--out {options.out}: must end in .csv")
        refuse_existing(options.out, options.force)
    space = IntrinsicSpace(garment)
    shown = _shown(options, space)
    estimates = reader_of(garment, space).estimates(*shown.evidence())
    noun = "frame" if shown.frames == 1 else "frames"
    print(f"[infer] {garment.name}, {shown.origin}: {shown.frames} {noun}, intervals of {100 * COVERAGE:.0f}%")
    width = max(map(len, estimates))
    for name, estimate in sorted(estimates.items(), key=lambda item: -item[1].known):
        print(
            f"  {name:{width}}  {estimate.value:9.3g}  {estimate.low:9.3g} to {estimate.high:<9.3g}  "
            f"known {100 * estimate.known:3.0f}%  {_unit(name)}"
        )
    if options.out:
        write_table(options.out, [_row(name, estimate) for name, estimate in estimates.items()])
        print(options.out)


def _shown(options: argparse.Namespace, space: IntrinsicSpace) -> ShownGarment:
    if (options.mesh is None) == (options.file is None and options.shard is None):
        raise ValueError("one of --in, --shard and --mesh is needed")
    if options.mesh is None:
        return ShownGarment.of_animation(space, shown_animation(options))
    if options.motion is None:
        raise ValueError("--mesh needs --motion, and --frame: a shape tells of the material what its motion does not")
    garment = space.garment
    vertices = read_keyframe(options.mesh, garment.template.faces, len(garment.template.vertices))
    clip = asked_motion(garment.run, options.motion, options.clip, None, options.seed)
    return ShownGarment.of_mesh(space, clip, options.frame, vertices, options.space == CANONICAL)


def _row(name: str, estimate: Estimate) -> Row:
    ends = {"estimate": estimate.value, "low": estimate.low, "high": estimate.high, "known": estimate.known}
    return {"parameter": name, **ends, "unit": _unit(name)}


def _unit(name: str) -> str:
    return "" if name in GROUPS else parameter(name).unit


def main(given: list[str] | None = None) -> None:
    """Command line."""
    run_command("infer", __doc__, define, infer, given)


if __name__ == "__main__":
    main()
