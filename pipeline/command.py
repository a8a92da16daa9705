"""What the commands for users share: options, and one clear sentence for a mistake.

Stages of the workflow have another command line (``pipeline.stage``): these are called by people.
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from formats.animation import Animation, plain_name
from formats.save import FORMATS, check_target, save_animation
from pipeline.start_up import after_imports
from runtime.dressing import Wearing
from runtime.finished_run import FinishedRun, LearnedGarment
from runtime.wishes import body_shape, material


def run_command(name: str, description: str | None, define: Callable, run: Callable, given: list[str] | None) -> None:
    """Parse a command line and run the command; a user's mistake ends with exit code 1 and one sentence.

    Args:
        name: Of the command, as in ``python -m pipeline.<name>``.
        description: Its help text.
        define: Adds its options to a parser.
        run: Takes the parsed options.
        given: Arguments; those of the process where None.
    """
    parser = argparse.ArgumentParser(
        prog=f"python -m pipeline.{name}", description=description, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    define(parser)
    options = parser.parse_args(given)
    after_imports()
    try:
        run(options)
    except (ValueError, OSError) as error:
        if os.environ.get("DRAPELINE_TRACEBACK"):
            raise
        sys.exit(f"[{name}] error: {error}")


def add_wearing(parser: argparse.ArgumentParser) -> None:
    """Options that say which garment, of what, on whom."""
    parser.add_argument("--run", default="results/default", help="folder of a finished run (%(default)s)")
    parser.add_argument("--garment", required=True, help="garment of the run, such as skirt")
    parser.add_argument(
        "--set",
        action="append",
        default=[],
        metavar="NAME=VALUE",
        help="intrinsic parameter, SI units; may be repeated",
    )
    parser.add_argument("--shape", type=float, nargs="+", metavar="SD", help="body shape [standard deviations]")
    parser.add_argument("--no-refine", action="store_true", help="leave vertices that are inside the body")


def add_output(parser: argparse.ArgumentParser) -> None:
    """Options that say what is written and where."""
    parser.add_argument("--format", default="glb", help=f"formats, separated by commas: {', '.join(FORMATS)}")
    parser.add_argument("--out", default="exports", help="folder, made where it is missing (%(default)s)")
    parser.add_argument("--force", action="store_true", help="replace what exists")


def asked_garment(options: argparse.Namespace) -> LearnedGarment:
    """The garment of the run that the options name."""
    return FinishedRun.open(options.run).garment(options.garment)


def asked_wearing(options: argparse.Namespace, garment: LearnedGarment, learned: bool) -> Wearing:
    """Material and body that the options name."""
    return Wearing(garment, material(garment, options.set, learned), body_shape(options.shape))


@dataclass(frozen=True)
class Output:
    """What is written and where.

    Attributes:
        formats: Names of formats, each once.
        folder: Where to; made where it is missing.
        force: Whether what exists may be replaced.
    """

    formats: list[str]
    folder: Path
    force: bool

    @classmethod
    def asked(cls, options: argparse.Namespace) -> Output:
        """What the options of :func:`add_output` say; ``ValueError`` lists the known formats for another one."""
        return cls(_formats(options.format), Path(options.out), options.force)

    def paths(self, name: str) -> list[Path]:
        """Paths of an animation in each format; ``ValueError`` where one exists and is to be kept."""
        paths = [self.folder / f"{plain_name(name)}.{kind}" for kind in self.formats]
        for path in paths:
            check_target(path, self.force)
        return paths

    def write(self, animation: Animation, paths: list[Path]) -> None:
        """Write an animation to each path; says each, its size and how long it took on standard output."""
        for path in paths:
            start = time.monotonic()
            written = save_animation(path, animation, self.force)
            print(f"{written}  {_bytes(written) / 1e6:.2f} MB, {time.monotonic() - start:.1f} s", flush=True)


def _formats(text: str) -> list[str]:
    formats = list(dict.fromkeys(part.strip().lower() for part in text.split(",") if part.strip()))
    unknown = [name for name in formats if name not in FORMATS]
    if unknown or not formats:
        wrong = f"unknown is {unknown[0]!r}" if unknown else "names none"
        raise ValueError(f"--format {text!r}: {wrong}; known are {', '.join(FORMATS)}")
    return formats


def _bytes(path: Path) -> int:
    return sum(f.stat().st_size for f in path.iterdir()) if path.is_dir() else path.stat().st_size
