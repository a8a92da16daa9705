"""Take an animation elsewhere: a simulated sequence of a shard, or an animation file, in the formats of others.

    python -m pipeline.export --in walk.h5 --format glb,mp4 --out exports
    python -m pipeline.export --shard results/default/shards/skirt/motions_0000.h5 --list
    python -m pipeline.export --shard results/default/shards/skirt/motions_0000.h5 --sequence walk_000 --format usd

Formats: glb, usd, usda, usdc; obj (a folder, one file a mesh and frame), pc2 (a folder, one point cache a mesh); mp4,
gif, png (a sheet of frames); h5 (our own, without loss). Metres, y up. What exists is kept unless --force is given.
"""

from __future__ import annotations

import argparse
import itertools
from pathlib import Path

from body.model import Body
from datasets.shards import read_header, read_quality, read_sequences
from formats.animation import Animation, dressed, plain_name
from formats.animation_file import load_animation
from formats.body_notes import body_notes
from motions.clip import Clip
from pipeline.command import Output, add_output, run_command

SHOWN = 12
"""Sequences that an error lists."""


def shard_animation(path: str | Path, index: int) -> Animation:
    """A sequence of a shard with its body, and its motion, garment and parameters as notes.

    Args:
        path: The shard.
        index: Place of the sequence in it, see :func:`sequence_index`.

    Raises:
        ValueError: The shard is damaged, or its body is not one of the project's.
    """
    header, one = read_header(path), next(itertools.islice(read_sequences(path), index, None), None)
    if one is None:
        raise ValueError(f"{path}: has no sequence #{index}")
    body = Body.load(header.body_name).shaped(one.shape if len(one.shape) else header.body_shape)
    if body.digest != header.body_digest:
        raise ValueError(f"{path}: was made with another body named '{header.body_name}' than this program has")
    clip = Clip(one.clip, one.take, one.label, one.pose, one.root, header.fps, "shard")
    notes = {"garment": header.garment, "label": one.label, "parameter_set": one.phi, "body": header.body_name}
    notes |= {f"parameter_{name}": value for name, value in one.parameters.items()}
    notes |= body_notes(body, one.shape if len(one.shape) else None)
    return dressed(
        plain_name(f"{header.garment}_{one.clip}" + (f"_{one.phi}" if one.phi else "")),
        header.garment,
        one.vertices,
        header.template_faces,
        body.posed(one.pose, one.root),
        body.faces,
        header.fps,
        clip,
        notes,
    )


def sequence_index(path: str | Path, name: str) -> int:
    """Place in a shard of a sequence: ``CLIP``, ``CLIP:SET`` where its clip was simulated under several parameter sets,
    or ``#PLACE``.

    Raises:
        ValueError: No such sequence, or several of the name; lists what there is.
    """
    names = sequence_names(path)
    if name.startswith("#") and name[1:].isdigit() and int(name[1:]) < len(names):
        return int(name[1:])
    found = [index for index, full in enumerate(names) if name in (full, full.rpartition(":")[0])]
    if len(found) == 1:
        return found[0]
    shown = [names[index] for index in found] or names
    listed = ", ".join(shown[:SHOWN]) + (", ..." if len(shown) > SHOWN else "")
    what = f"has {len(found)} sequences '{name}', name one" if found else f"has no sequence '{name}', it has"
    raise ValueError(f"{path}: {what}: {listed} (--list shows all)")


def sequence_names(path: str | Path) -> list[str]:
    """Names of the sequences of a shard, in order: clip, parameter set, and the body where it is not the run's."""
    names = []
    for row in read_quality(path):
        body = f"@{row['body_index']}" if row["body_index"] else ""
        names.append(f"{row['clip']}{body}:{row['phi']}")
    return names


def define(parser: argparse.ArgumentParser) -> None:
    """Options of the command."""
    source = parser.add_mutually_exclusive_group(required=True)
    source.add_argument("--in", dest="file", help="an animation file (.h5)")
    source.add_argument("--shard", help="a shard of simulated sequences")
    parser.add_argument("--sequence", help="sequence of the shard: CLIP, CLIP:PARAMETER_SET or #PLACE")
    parser.add_argument("--list", action="store_true", help="list the sequences of the shard and end")
    add_output(parser)


def export(options: argparse.Namespace) -> None:
    """Write an animation in each format; nothing is written at all if one of them exists and is to be kept."""
    output = Output.asked(options)
    if options.list:
        if not options.shard:
            raise ValueError("--list needs --shard")
        print("\n".join(f"#{place}  {name}" for place, name in enumerate(sequence_names(options.shard))))
        return
    if options.shard:
        if not options.sequence:
            raise ValueError("--shard needs --sequence; --list shows what there is")
        animation = shard_animation(options.shard, sequence_index(options.shard, options.sequence))
    else:
        animation = load_animation(options.file)
    output.write(animation, output.paths(animation.name))


def main(given: list[str] | None = None) -> None:
    """Command line."""
    run_command("export", __doc__, define, export, given)


if __name__ == "__main__":
    main()
