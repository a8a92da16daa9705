"""Keyframes as a user writes them: ``FRAME:...`` on a command line, or a list in a YAML or JSON file.

    - {frame: 0, shape: soft.obj}              # the garment's own mesh, on the body's pose of that frame
    - {frame: 20, shape: drawn.ply, space: canonical}   # in the frame of the pelvis instead
    - {frame: 40, candidate: 7}                # drawn from the latent space by a seed
    - {frame: 59, set: {bend: 8.0e-5}}         # intrinsic parameters, SI units; all others are those of the base

Files are untrusted. Each ``ValueError`` is one sentence that says what is allowed.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from formats.keyframe import read_keyframe
from runtime.composing import Composer
from runtime.keyframes import Keyframe
from runtime.wishes import material

WORLD, CANONICAL = "world", "canonical"
SPACES = (WORLD, CANONICAL)
LARGEST_FILE = 2**20
"""Bytes of a file of keyframes, at most."""
MOST = 10_000
"""Keyframes of one file."""


@dataclass(frozen=True)
class KeyframeWish:
    """One keyframe, not yet looked at: exactly one of ``shape``, ``candidate`` and ``parameters`` is given.

    Attributes:
        frame: Its number.
        shape: Mesh file.
        space: One of ``SPACES``: what the mesh's coordinates are in.
        candidate: Seed of a draw from the latent space.
        parameters: Texts such as ``bend=8e-5``.
    """

    frame: int
    shape: Path | None = None
    space: str = WORLD
    candidate: int | None = None
    parameters: tuple[str, ...] = ()


def shape_wish(text: str, space: str = WORLD) -> KeyframeWish:
    """Of ``FRAME:FILE``."""
    frame, rest = _parted(text, "--keyframe", "FRAME:FILE, such as 30:folded.obj")
    return KeyframeWish(frame, Path(rest), space)


def candidate_wish(text: str) -> KeyframeWish:
    """Of ``FRAME:SEED``."""
    what = "FRAME:SEED, such as 30:7"
    frame, rest = _parted(text, "--candidate", what)
    if not rest.isdecimal() or int(rest) >= 2**31:
        raise ValueError(f"--candidate {text!r}: expected {what}, with a seed from 0 to {2**31 - 1}")
    return KeyframeWish(frame, candidate=int(rest))


def parameter_wish(text: str) -> KeyframeWish:
    """Of ``FRAME:NAME=VALUE``, with commas between several."""
    frame, rest = _parted(text, "--set-at", "FRAME:NAME=VALUE, such as 30:bend=8e-5")
    return KeyframeWish(frame, parameters=tuple(part.strip() for part in rest.split(",") if part.strip()))


def read_wishes(path: str | Path) -> list[KeyframeWish]:
    """Keyframes of a YAML or JSON file; meshes are looked for beside it.

    Raises:
        FileNotFoundError: No such file.
        ValueError: It is too large, no YAML, or no list of keyframes; says which one is wrong and how.
    """
    path = Path(path)
    if not path.is_file():
        raise FileNotFoundError(f"{path}: no such file")
    if path.stat().st_size > LARGEST_FILE:
        raise ValueError(f"{path}: {path.stat().st_size} bytes, a file of keyframes has at most {LARGEST_FILE}")
    try:
        found = yaml.safe_load(path.read_text(encoding="utf-8"))
    except (UnicodeDecodeError, yaml.YAMLError, RecursionError) as error:
        raise ValueError(f"{path}: no YAML or JSON ({' '.join(str(error).split())[:120]})") from None
    rows = found.get("keyframes") if isinstance(found, dict) else found
    if not isinstance(rows, list) or not 1 <= len(rows) <= MOST:
        raise ValueError(f"{path}: expected a list of 1 to {MOST} keyframes, such as - {{frame: 0, candidate: 7}}")
    return [_wish(row, f"{path}: keyframe {number}", path.parent) for number, row in enumerate(rows)]


def add_wishes(composer: Composer, wishes: Iterable[KeyframeWish], base: Sequence[str] = ()) -> list[Keyframe]:
    """Add keyframes to a composer, in their order.

    Args:
        composer: Garment and motion.
        wishes: What is asked for.
        base: Texts such as ``gravity=12`` that hold at every keyframe of parameters.

    Returns:
        The keyframes.

    Raises:
        ValueError: A frame outside of the motion or asked for twice, a mesh of another topology (says both counts), a
            parameter that is unknown or out of its range.
        FileNotFoundError: A mesh file that is not there.
    """
    wishes = _merged(wishes)
    garment, made = composer.space.garment, []
    for wish in wishes:
        if wish.shape is not None:
            template = garment.template
            vertices = read_keyframe(wish.shape, template.faces, len(template.vertices))
            made.append(composer.add_shape(wish.frame, vertices, wish.space == CANONICAL, wish.shape.name))
        elif wish.candidate is not None:
            made.append(composer.add_candidate(wish.frame, wish.candidate))
        else:
            texts = [*base, *wish.parameters]
            made.append(composer.add_parameters(wish.frame, told_material(composer, texts), ", ".join(texts)))
    return made


def told_material(composer: Composer, wishes: Sequence[str]) -> Mapping[str, float] | None:
    """The material of texts such as ``bend=8e-5``; ``ValueError`` for a parameter that the autoencoder is not told."""
    space = composer.space
    found = material(space.garment, wishes, True)
    for wish in wishes:
        name = wish.partition("=")[0]
        if name not in space.tellable:
            raise ValueError(f"{wish!r}: the autoencoder is not told {name}; it knows {', '.join(space.tellable)}")
    return found


def _merged(wishes: Iterable[KeyframeWish]) -> list[KeyframeWish]:
    """Parameters of one frame that were given apart belong together; anything else at one frame is a mistake."""
    frames: dict[int, KeyframeWish] = {}
    for wish in wishes:
        other = frames.get(wish.frame)
        if other is None:
            frames[wish.frame] = wish
        elif wish.parameters and other.parameters:
            frames[wish.frame] = KeyframeWish(wish.frame, parameters=other.parameters + wish.parameters)
        else:
            raise ValueError(f"frame {wish.frame} has two keyframes; give one")
    return [frames[frame] for frame in sorted(frames)]


def _parted(text: str, option: str, what: str) -> tuple[int, str]:
    frame, colon, rest = text.partition(":")
    if not colon or not rest.strip() or not frame.strip().isdecimal():
        raise ValueError(f"{option} {text!r}: expected {what}")
    return int(frame), rest.strip()


def _wish(row: Any, where: str, folder: Path) -> KeyframeWish:
    if not isinstance(row, dict):
        raise ValueError(f"{where}: expected something like {{frame: 0, candidate: 7}}")
    unknown = [str(key) for key in row if key not in ("frame", "shape", "space", "candidate", "set")]
    if unknown:
        raise ValueError(f"{where}: unknown key {unknown[0]!r}; known are frame, shape, space, candidate, set")
    if not _whole(row.get("frame")):
        raise ValueError(f"{where}: needs a frame, a number from 0")
    given = [key for key in ("shape", "candidate", "set") if key in row]
    if len(given) != 1:
        raise ValueError(f"{where}: needs one of shape, candidate and set, has {' and '.join(given) or 'none'}")
    if "space" in row and ("shape" not in row or row["space"] not in SPACES):
        raise ValueError(f"{where}: space is {' or '.join(SPACES)}, and only for a shape")
    frame, value = row["frame"], row[given[0]]
    if given == ["shape"]:
        if not isinstance(value, str) or not value:
            raise ValueError(f"{where}: shape must be the path of a mesh file")
        return KeyframeWish(frame, folder / value, row.get("space", WORLD))
    if given == ["candidate"]:
        if not _whole(value) or value >= 2**31:
            raise ValueError(f"{where}: candidate must be a seed from 0 to {2**31 - 1}")
        return KeyframeWish(frame, candidate=value)
    numbers = isinstance(value, dict) and all(isinstance(v, int | float | str) for v in value.values())
    if not numbers or not value:
        raise ValueError(f"{where}: set must name parameters and their values, such as {{bend: 8.0e-5}}")
    # As text, for YAML takes 8e-5 for one.
    return KeyframeWish(frame, parameters=tuple(f"{name}={number}" for name, number in value.items()))


def _whole(value: Any) -> bool:
    return isinstance(value, int | np.integer) and not isinstance(value, bool) and value >= 0
