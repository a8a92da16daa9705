"""What the commands that compose share: options for the motion and the keyframes, composing, and what is said."""

from __future__ import annotations

import argparse
from dataclasses import replace

import numpy as np

from formats.animation import plain_name
from motions.clip import Clip
from pipeline.command import Output
from pipeline.planting_options import add_planting, as_planted
from runtime.asked_motion import asked_motion, stretch
from runtime.composing import Composed, Composer
from runtime.finished_run import FinishedRun, LearnedGarment
from runtime.intrinsic_space import IntrinsicSpace
from runtime.keyframe_wishes import (
    SPACES,
    WORLD,
    KeyframeWish,
    add_wishes,
    candidate_wish,
    parameter_wish,
    read_wishes,
    shape_wish,
    told_material,
)
from runtime.keyframes import HOLD
from runtime.wishes import body_shape


def add_motion(parser: argparse.ArgumentParser) -> None:
    """Options that name a motion and a stretch of it."""
    parser.add_argument(
        "--motion",
        required=True,
        metavar="WHAT",
        help="a motion file (BVH, AMASS .npz, our own), a clip of the run such as walk_003, or a label, or several "
        "with commas between them, to invent one from",
    )
    parser.add_argument("--clip", help="name of the clip, of a file that holds several")
    parser.add_argument("--seed", type=int, default=0, help="of an invented motion (%(default)s)")
    parser.add_argument("--first", type=int, default=0, help="first frame that is taken (%(default)s)")
    parser.add_argument("--frames", type=int, help="how many frames; all of them, or the run's length, by default")
    add_planting(parser)


def add_keyframes(parser: argparse.ArgumentParser) -> None:
    """Options that give keyframes."""
    parser.add_argument("--keyframe", action="append", default=[], metavar="FRAME:FILE", help="a mesh (OBJ, PLY)")
    parser.add_argument(
        "--space",
        choices=SPACES,
        default=WORLD,
        help="coordinates of the meshes: of the world, on the body's pose of that frame, or canonical, in the frame of "
        "its pelvis (%(default)s)",
    )
    parser.add_argument("--candidate", action="append", default=[], metavar="FRAME:SEED", help="a draw")
    parser.add_argument(
        "--set-at", action="append", default=[], metavar="FRAME:NAME=VALUE", help="intrinsic parameters, SI units"
    )
    parser.add_argument("--keyframes", metavar="FILE", help="keyframes in a YAML or JSON file")
    parser.add_argument(
        "--hold",
        type=float,
        default=HOLD,
        metavar="SECONDS",
        help="how long what a mesh has beyond the network's shape lasts around it; 0: not at all (%(default)s)",
    )


def asked_clip(options: argparse.Namespace, run: FinishedRun) -> Clip:
    """The motion that the options name."""
    if not 0 <= options.seed < 2**31:
        raise ValueError(f"--seed {options.seed}: allowed are 0 to {2**31 - 1}")
    # An invented motion is as long as asked for, so that a stretch of it is there too.
    frames = None if options.frames is None else options.first + options.frames
    clip = asked_motion(run, options.motion, options.clip, frames, options.seed)
    return stretch(as_planted(options, clip, run.body), options.first, options.frames)


def asked_keyframes(options: argparse.Namespace) -> list[KeyframeWish]:
    """The keyframes that the options give."""
    wishes = [shape_wish(text, options.space) for text in options.keyframe]
    wishes += [candidate_wish(text) for text in options.candidate]
    wishes += [parameter_wish(text) for text in options.set_at]
    return wishes + (read_wishes(options.keyframes) if options.keyframes else [])


def compose_and_write(
    command: str,
    options: argparse.Namespace,
    output: Output,
    garment: LearnedGarment,
    clip: Clip,
    ending: str,
    loop: bool = False,
) -> None:
    """Compose what the options ask for, say what came out, and write it.

    Args:
        command: Name of the command that says it.
        options: Those of ``add_wearing`` and ``add_keyframes``.
        output: What is written and where.
        garment: Garment of a finished run.
        clip: Motion of the run's own body.
        ending: Last part of the animation's name.
        loop: Whether the clip is a loop, and the garment is to be one too.

    Raises:
        ValueError: Something that was asked for is wrong; nothing is written.
    """
    name = plain_name(f"{garment.name}_{clip.name}_{ending}")
    shape, paths = body_shape(options.shape), output.paths(name)
    composer = Composer(IntrinsicSpace(garment), clip, shape, options.hold, loop)
    set_keyframes(composer, options, command)
    composed = composer.compose(not options.no_refine)
    told(command, name, composed, composer)
    output.write(replace(composed.animation, name=name), paths)


def set_keyframes(composer: Composer, options: argparse.Namespace, command: str) -> None:
    """Give a composer the keyframes of the options, and say how near the space comes to given shapes."""
    made = add_wishes(composer, asked_keyframes(options), options.set)
    if not made and options.set:
        composer.add_parameters(0, told_material(composer, options.set), ", ".join(options.set))
    for keyframe in made:
        if keyframe.detail is not None:
            apart = 1e3 * float(np.sqrt(np.square(keyframe.detail).sum(1).mean()))
            what = "kept there" if options.hold > 0.0 else "lost"
            print(
                f"[{command}] keyframe {keyframe.frame}, {keyframe.origin}: the space comes within {apart:.1f} mm of "
                f"it, the rest is {what}"
            )


def told(command: str, name: str, composed: Composed, composer: Composer) -> None:
    """Say what came out."""
    count, inside = len(composer.keyframes), f"{100.0 * composed.inside:.2f}% of the vertices inside the body"
    print(
        f"[{command}] {name}: {composer.frames} frames, {count} keyframe{'' if count == 1 else 's'}, "
        f"{inside} before refinement, {composed.inside_after} left"
    )
