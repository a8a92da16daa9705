"""Make an exact garment loop: the last frame is the first one, in body and garment.

    python -m pipeline.loop --garment skirt --motion cycle.bvh --format glb
    python -m pipeline.loop --garment skirt --motion walk.bvh --first 89 --frames 66 --tolerance 0.04 --set bend=8e-5
    python -m pipeline.loop --garment tshirt --motion wave-both --close --candidate 0:3 --candidate 30:4

The same motion gives the same garment, so a motion that loops gives a garment that does (Wang 2019): what came before
the first frame is the loop itself, over and over. A body that walks ends elsewhere, and perhaps turned; there, first
and last frame are the same as seen from its pelvis. Keyframes are those of pipeline.compose, and go around: after the
last comes the first.

A motion loops where every joint ends within --tolerance of where it began, the body brought back to its place and
heading; what is left is spread over all frames. One that does not is refused, and the stretch of it that comes nearest
is named; --close makes a loop of it, whose end fades into its beginning, by that time shorter, with planted feet.
"""

from __future__ import annotations

import argparse

from motions.clip import Clip
from motions.looping import TOLERANCE, best_loop, closed, loop_gap
from pipeline.command import Output, add_output, add_wearing, asked_garment, run_command
from pipeline.keyframe_options import add_keyframes, add_motion, asked_clip, compose_and_write
from runtime.finished_run import FinishedRun

FADE = 0.4
"""Seconds in which a motion that is closed fades into its beginning."""

SHORTEST = 0.5
"""Seconds of the shortest stretch that is named as nearly a loop."""


def define(parser: argparse.ArgumentParser) -> None:
    """Options of the command."""
    add_wearing(parser)
    add_motion(parser)
    parser.add_argument(
        "--tolerance", type=float, default=TOLERANCE, metavar="METRES", help="of a joint at the ends (%(default)s)"
    )
    parser.add_argument(
        "--close",
        type=float,
        nargs="?",
        const=FADE,
        metavar="SECONDS",
        help=f"close a motion that does not loop, by fading its end into its beginning ({FADE})",
    )
    add_keyframes(parser)
    add_output(parser)


def looping(clip: Clip, run: FinishedRun, tolerance: float, close: float | None, first: int = 0) -> Clip:
    """The clip as a loop of the run's body.

    Args:
        clip: The motion.
        run: Whose body makes it.
        tolerance: How far a joint may end from where it began [m].
        close: Seconds in which one that does not loop fades into its beginning; None where it is not to be closed.
        first: Number that the clip's first frame has for the user.

    Raises:
        ValueError: It does not loop and is not to be closed; or it is too short to be.
    """
    if not 0.0 < tolerance <= 1.0:
        raise ValueError(f"--tolerance {tolerance:g}: allowed are more than 0 and at most 1 m")
    if close is not None:
        if not 0.0 < close <= 10.0:
            raise ValueError(f"--close {close:g}: allowed are more than 0 and at most 10 s")
        return closed(clip, max(1, round(close * clip.fps)), run.body)
    gap = loop_gap(clip, run.body)
    if gap > tolerance:
        best = best_loop(clip, run.body, max(2, round(SHORTEST * clip.fps)))
        nearest = ""
        if best is not None:
            start, count = first + best.first, best.last - best.first + 1
            nearest = (
                f"; nearest are its frames {start} to {first + best.last}, {1e3 * best.gap:.0f} mm apart "
                f"(--first {start} --frames {count})"
            )
        raise ValueError(
            f"motion '{clip.name}' does not loop: a joint of its last frame is {1e3 * gap:.0f} mm from where the first "
            f"has it, at most {1e3 * tolerance:.0f} mm are allowed{nearest}; --close makes a loop of it"
        )
    return clip


def loop(options: argparse.Namespace) -> None:
    """Read, close, compose, write; nothing is written if anything asked for is wrong."""
    output, garment = Output.asked(options), asked_garment(options)
    clip = asked_clip(options, garment.run)
    clip = looping(clip, garment.run, options.tolerance, options.close, options.first)
    compose_and_write("loop", options, output, garment, clip, "loop", loop=True)


def main(given: list[str] | None = None) -> None:
    """Command line."""
    run_command("loop", __doc__, define, loop, given)


if __name__ == "__main__":
    main()
