"""What the commands that look at a garment in motion share: where it is shown."""

from __future__ import annotations

import argparse

from formats.animation import Animation
from formats.animation_file import load_animation
from pipeline.export import sequence_index, shard_animation


def add_shown(parser: argparse.ArgumentParser, required: bool) -> None:
    """Options that name an animation, or a simulated sequence."""
    source = parser.add_mutually_exclusive_group(required=required)
    source.add_argument("--in", dest="file", metavar="FILE", help="an animation file (.h5) with its motion")
    source.add_argument("--shard", help="a shard of simulated sequences, with --sequence")
    parser.add_argument("--sequence", help="sequence of the shard: CLIP, CLIP:PARAMETER_SET or #PLACE")


def shown_animation(options: argparse.Namespace) -> Animation:
    """The animation that the options name."""
    if options.file:
        return load_animation(options.file)
    if not options.sequence:
        raise ValueError("--shard needs --sequence; `python -m pipeline.export --shard ... --list` shows what there is")
    return shard_animation(options.shard, sequence_index(options.shard, options.sequence))
