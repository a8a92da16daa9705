"""Take a garment's look from one animation to another motion, or to another body.

    python -m pipeline.retarget --garment skirt --in soft_walk.h5 --motion dance.bvh --format glb,mp4
    python -m pipeline.retarget --garment skirt --shard results/default/shards/skirt/materials_0000.h5 \\
        --sequence '#3' --motion run --frames 240 --shape 1.5 0 -1

The animation is one of this program's (--format h5 of generate, dress, compose or export), or a simulated sequence of a
shard. What its frames say of the intrinsic space, taken together, is what the garment is made of; it is decoded along
the new motion, and no vertex is left inside the body (Wang 2019, section 4: the same z, a new motion).

A garment that changes on the way, as composed ones do, is taken along with --parts: so many equal parts of the
animation give a keyframe each, at the same share of the new one.
"""

from __future__ import annotations

import argparse
from dataclasses import replace

import numpy as np

from formats.animation import plain_name
from pipeline.command import Output, add_output, asked_garment, run_command
from pipeline.keyframe_options import add_motion, asked_clip, told
from pipeline.shown_options import add_shown, shown_animation
from runtime.composing import Composer
from runtime.intrinsic_space import IntrinsicSpace
from runtime.keyframes import Keyframe
from runtime.shown_garment import ShownGarment
from runtime.wishes import body_shape


def define(parser: argparse.ArgumentParser) -> None:
    """Options of the command."""
    parser.add_argument("--run", default="results/default", help="folder of a finished run (%(default)s)")
    parser.add_argument("--garment", required=True, help="garment of the run, such as skirt")
    add_shown(parser, required=True)
    add_motion(parser)
    parser.add_argument("--shape", type=float, nargs="+", metavar="SD", help="body shape [standard deviations]")
    parser.add_argument("--parts", type=int, default=1, help="equal parts that have a keyframe each (%(default)s)")
    parser.add_argument("--no-refine", action="store_true", help="leave vertices that are inside the body")
    add_output(parser)


def retarget(options: argparse.Namespace) -> None:
    """Read, estimate, compose, write; nothing is written if anything asked for is wrong."""
    output, garment = Output.asked(options), asked_garment(options)
    shape, space = body_shape(options.shape), IntrinsicSpace(garment)
    shown = ShownGarment.of_animation(space, shown_animation(options))
    clip = asked_clip(options, garment.run)
    name = plain_name(f"{garment.name}_{clip.name}_retargeted")
    paths = output.paths(name)
    composer = Composer(space, clip, shape)
    latents = shown.latents(options.parts)
    places = (np.arange(len(latents)) + 0.5) / len(latents) * (clip.frames - 1)
    if len(np.unique(np.round(places))) < len(latents):
        raise ValueError(f"--parts {options.parts}: the new motion has {clip.frames} frames, too few for as many parts")
    for place, latent in zip(places, latents, strict=True):
        composer.add(Keyframe(round(float(place)), latent, None, f"seen in {shown.origin}"))
    composed = composer.compose(not options.no_refine)
    print(f"[retarget] {shown.origin}: {shown.frames} frames were looked at")
    told("retarget", name, composed, composer)
    output.write(replace(composed.animation, name=name), paths)


def main(given: list[str] | None = None) -> None:
    """Command line."""
    run_command("retarget", __doc__, define, retarget, given)


if __name__ == "__main__":
    main()
