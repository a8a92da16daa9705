"""Invent clothed animations: a label (or several), a garment, a number, a seed.

    python -m pipeline.generate --garment skirt --label walk --count 3 --format glb,mp4
    python -m pipeline.generate --garment tshirt --label walk,wave-both --frames 1000 --set bend=2e-5
    python -m pipeline.generate --garment skirt --label run --sample-material --shape 1.5 0 -1

Several labels follow each other, each for an equal part of the time, and fade into one another. Motions of any length
are made and dressed as a whole. With --set or --sample-material a regressor dresses them that is told the material;
with --shape the garment is graded to another body. No vertex is inside the body, unless --no-refine is given.
"""

from __future__ import annotations

import argparse
from dataclasses import replace

import torch

from formats.animation import plain_name
from pipeline.command import Output, add_output, add_wearing, asked_garment, asked_wearing, run_command
from runtime.dressing import Wearing, dress
from runtime.motion_making import generated_clip
from runtime.wishes import labels

MOST = 1000
"""Animations of one call."""


def define(parser: argparse.ArgumentParser) -> None:
    """Options of the command."""
    add_wearing(parser)
    parser.add_argument("--label", required=True, nargs="+", help="motion label or labels, in their order")
    parser.add_argument("--frames", type=int, help="length; that of the run's clips by default")
    parser.add_argument("--count", type=int, default=1, help="number of animations (%(default)s)")
    parser.add_argument("--seed", type=int, default=0, help="other seeds, other animations (%(default)s)")
    parser.add_argument("--sample-material", action="store_true", help="a sampled material for each animation")
    add_output(parser)


def generate(options: argparse.Namespace) -> None:
    """Generate, dress, write, one animation after the other; nothing is begun if anything asked for is wrong."""
    wanted, output, garment = labels(options.label), Output.asked(options), asked_garment(options)
    if not 1 <= options.count <= MOST:
        raise ValueError(f"--count {options.count}: allowed are 1 to {MOST}")
    if not 0 <= options.seed < 2**31:
        raise ValueError(f"--seed {options.seed}: allowed are 0 to {2**31 - 1}")
    if options.sample_material and options.set:
        raise ValueError("--sample-material and --set exclude each other")
    run, wearing = garment.run, asked_wearing(options, garment, learned=True)
    run.generator.label_numbers(wanted)
    seeds = range(options.seed, options.seed + options.count)
    names = {seed: f"{garment.name}_{'_'.join(wanted)}_{seed:04d}" for seed in seeds}
    paths = {seed: output.paths(name) for seed, name in names.items()}
    for seed, name in names.items():
        clip = generated_clip(
            run.generator,
            wanted,
            options.frames or run.segment,
            run.segment,
            run.fps,
            run.body,
            torch.Generator().manual_seed(seed),
            f"{'_'.join(wanted)}_{seed:04d}",
        )
        worn = wearing
        if options.sample_material:
            worn = Wearing(garment, garment.sampled_parameters(seed, 1), wearing.shape)
        dressed = dress(clip, worn, refine=not options.no_refine)
        left = f"{100.0 * dressed.inside:.2f}% of the vertices inside the body"
        print(f"[generate] {name}: {clip.frames} frames, {left} before refinement, {dressed.inside_after} left")
        output.write(replace(dressed.animation, name=plain_name(name)), paths[seed])


def main(given: list[str] | None = None) -> None:
    """Command line."""
    run_command("generate", __doc__, define, generate, given)


if __name__ == "__main__":
    main()
