"""The option of commands that take a motion to plant its feet, and what is said about it."""

from __future__ import annotations

import argparse

from body.model import Body
from motions.clip import Clip
from motions.quality import measure
from runtime.motion_making import planted


def add_planting(parser: argparse.ArgumentParser) -> None:
    """The option ``--plant``."""
    parser.add_argument(
        "--plant",
        action="store_true",
        help="plant the feet of the motion: while one touches the ground, it neither slides, as in recordings it does, "
        "nor sinks; invented motions have planted feet already",
    )


def as_planted(options: argparse.Namespace, clip: Clip, body: Body) -> Clip:
    """The clip with planted feet where the options ask for it; says on standard output how much its feet slid."""
    if not options.plant:
        return clip
    made = planted(clip, body)
    before, after = (measure(one, body).skate_m_s for one in (clip, made))
    print(f"[plant] {clip.name}: touching feet slid up to {before:.3f} m/s, now {after:.3f} (99% of the frames)")
    return made
