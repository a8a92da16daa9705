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
import os
import sys
import time
from pathlib import Path

from body.model import Body
from datasets.shards import read_header, read_quality, read_sequences
from formats.animation import Animation, dressed, plain_name
from formats.animation_file import load_animation
from formats.save import FORMATS, check_target, save_animation
from motions.clip import Clip

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


def export(animation: Animation, folder: str | Path, formats: list[str], force: bool) -> list[Path]:
    """Write an animation in several formats under its name; says each file on standard output.

    Raises:
        ValueError: Unknown format, or a target exists and ``force`` is not given: then nothing is written at all.
        OSError: A file could not be written; those before it stay.
    """
    paths = [Path(folder) / f"{plain_name(animation.name)}.{kind}" for kind in formats]
    for path in paths:
        check_target(path, force)
    written = []
    for path in paths:
        start = time.monotonic()
        target = save_animation(path, animation, force)
        written.append(target)
        print(f"{target}  {_bytes(target) / 1e6:.2f} MB, {time.monotonic() - start:.1f} s", flush=True)
    return written


def _bytes(path: Path) -> int:
    return sum(f.stat().st_size for f in path.iterdir()) if path.is_dir() else path.stat().st_size


def _formats(text: str) -> list[str]:
    formats = list(dict.fromkeys(part.strip().lower() for part in text.split(",") if part.strip()))
    unknown = [name for name in formats if name not in FORMATS]
    if unknown or not formats:
        wrong = f"unknown is {unknown[0]!r}" if unknown else "names none"
        raise ValueError(f"--format {text!r}: {wrong}; known are {', '.join(FORMATS)}")
    return formats


def main(arguments: list[str] | None = None) -> None:
    """Command line."""
    parser = argparse.ArgumentParser(
        prog="python -m pipeline.export", description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    source = parser.add_mutually_exclusive_group(required=True)
    source.add_argument("--in", dest="file", help="an animation file (.h5)")
    source.add_argument("--shard", help="a shard of simulated sequences")
    parser.add_argument("--sequence", help="sequence of the shard: CLIP, CLIP:PARAMETER_SET or #PLACE")
    parser.add_argument("--list", action="store_true", help="list the sequences of the shard and end")
    parser.add_argument("--format", default="glb", help=f"formats, separated by commas: {', '.join(FORMATS)}")
    parser.add_argument("--out", default="exports", help="folder, made where it is missing")
    parser.add_argument("--force", action="store_true", help="replace earlier exports")
    options = parser.parse_args(arguments)
    try:
        _run(options)
    except (ValueError, OSError) as error:
        if os.environ.get("DRAPELINE_TRACEBACK"):
            raise
        sys.exit(f"[export] error: {error}")


def _run(options: argparse.Namespace) -> None:
    formats = _formats(options.format)
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
    export(animation, options.out, formats, options.force)


if __name__ == "__main__":
    main()
