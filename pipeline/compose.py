"""Compose a garment animation from keyframes (Wang 2019, garment authoring).

    python -m pipeline.compose --garment skirt --motion walk --frames 240 --set-at 0:bend=3e-6 --set-at 239:bend=8e-5
    python -m pipeline.compose --garment skirt --motion walk_003 --keyframe 30:folded.obj --candidate 59:7
    python -m pipeline.compose --garment tshirt --motion dance.bvh --keyframes keys.yaml --format usd,mp4

A keyframe is a frame number, from 0, and a garment: a mesh (OBJ or PLY with the garment's own vertices and triangles,
on the body's pose of that frame; export a frame with --format obj to have one to change), a draw from the space of
garments, or intrinsic parameters (all that are not named stay at the base material, or at what --set says).

Each becomes a point of the intrinsic space, which knows what a garment is made of and not how its wearer moves. Between
keyframes the point moves straight, before the first and after the last it rests; one keyframe is one garment for the
whole animation. The motion does the rest, and no vertex is left inside the body.

The same in a file (--keyframes), beside whose folder meshes are looked for:

    - {frame: 0, shape: soft.obj}
    - {frame: 30, candidate: 7}
    - {frame: 59, set: {bend: 8.0e-5, density: 0.2}}
"""

from __future__ import annotations

import argparse

from pipeline.command import Output, add_output, add_wearing, asked_garment, run_command
from pipeline.keyframe_options import add_keyframes, add_motion, asked_clip, compose_and_write


def define(parser: argparse.ArgumentParser) -> None:
    """Options of the command."""
    add_wearing(parser)
    add_motion(parser)
    add_keyframes(parser)
    add_output(parser)


def compose(options: argparse.Namespace) -> None:
    """Read, compose, write; nothing is written if anything asked for is wrong."""
    output, garment = Output.asked(options), asked_garment(options)
    compose_and_write("compose", options, output, garment, asked_clip(options, garment.run), "composed")


def main(given: list[str] | None = None) -> None:
    """Command line."""
    run_command("compose", __doc__, define, compose, given)


if __name__ == "__main__":
    main()
