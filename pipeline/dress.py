"""Dress a motion file: BVH, AMASS .npz, or one of this program's own, in a garment of a finished run.

    python -m pipeline.dress --motion walk.bvh --garment tshirt --format glb,mp4
    python -m pipeline.dress --motion clip.npz --garment skirt --set bend=5e-5 --shape 1 -0.5
    python -m pipeline.dress --motion walk.bvh --garment skirt --solver xpbd --set wind_speed=3
    python -m pipeline.dress --motion walk.bvh --garment skirt --plant

The network dresses it in a moment; --solver xpbd simulates it, to compare or as final quality. The motion is brought to
the frame rate that the run was trained at. Feet slide in recordings, at 0.1 to 0.2 m/s; with --plant they do not.
"""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path

from formats.animation import plain_name
from formats.motion_file import read_motion
from pipeline.command import Output, add_output, add_wearing, asked_garment, asked_wearing, run_command
from pipeline.planting_options import add_planting, as_planted
from runtime.dressing import dress, simulate

LEARNED, XPBD = "learned", "xpbd"

UNLIKE = 0.08
"""Share of vertices inside the body before refinement, from which on the user is told of the simulator [1]."""


def define(parser: argparse.ArgumentParser) -> None:
    """Options of the command."""
    parser.add_argument("--motion", required=True, help="motion file")
    parser.add_argument("--clip", help="name of the clip, of a file that holds several")
    add_wearing(parser)
    parser.add_argument("--solver", choices=(LEARNED, XPBD), default=LEARNED, help="who dresses it (%(default)s)")
    parser.add_argument("--first", type=int, default=0, help="first frame that is dressed (%(default)s)")
    parser.add_argument("--frames", type=int, help="how many frames; all that follow by default")
    add_planting(parser)
    add_output(parser)


def dress_file(options: argparse.Namespace) -> None:
    """Read, dress, write."""
    output, garment = Output.asked(options), asked_garment(options)
    learned = options.solver == LEARNED
    wearing = asked_wearing(options, garment, learned)
    run = garment.run
    clip = read_motion(options.motion, run.fps, run.body, options.clip)
    last = clip.frames if options.frames is None else options.first + options.frames
    if not 0 <= options.first < last - 1 < clip.frames:
        raise ValueError(
            f"{options.motion}: frames {options.first} to {last - 1} are asked for, at least two of its frames "
            f"0 to {clip.frames - 1} are allowed"
        )
    name = plain_name(f"{garment.name}_{options.clip or Path(options.motion).stem}_{options.solver}")
    part, clip = slice(options.first, last), as_planted(options, clip, run.body)
    clip = replace(clip, pose=clip.pose[part], root=clip.root[part])
    paths = output.paths(name)
    dressed = dress(clip, wearing, not options.no_refine) if learned else simulate(clip, wearing)
    found = f"{dressed.inside_after} vertices inside the body"
    if learned:
        before = f"{100.0 * dressed.inside:.2f}% of the vertices inside the body before refinement"
        found = f"{before}, {dressed.inside_after} left"
    print(f"[dress] {name}: {clip.frames} frames, {found}")
    if learned and dressed.inside > UNLIKE:
        print("[dress] this motion is unlike those that the network learned from; --solver xpbd simulates it")
    output.write(replace(dressed.animation, name=name), paths)


def main(given: list[str] | None = None) -> None:
    """Command line."""
    run_command("dress", __doc__, define, dress_file, given)


if __name__ == "__main__":
    main()
