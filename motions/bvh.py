"""Reader for Biovision Hierarchy (BVH) motion capture files.

The file is untrusted: every fault ends in one sentence with the line number, and sizes are limited before anything is
allocated. Channels are applied in file order (R = R_first R_second R_third, intrinsic); position channels replace the
joint's OFFSET, as in files that repeat the offset in every frame.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

MAX_BYTES = 512 * 2**20
MAX_JOINTS = 512
MAX_FRAMES = 500_000
MAX_JOINT_FRAMES = 20_000_000  # joints × frames: what the arrays in memory grow with
_POSITIONS = ("Xposition", "Yposition", "Zposition")
_ROTATIONS = ("Xrotation", "Yrotation", "Zrotation")


@dataclass(frozen=True)
class BvhMotion:
    """A skeleton and its recorded motion, in the file's own unit of length and axes.

    Attributes:
        names: Joint names, parents before children, J of them (end sites are not joints).
        parents: Index of the parent joint, -1 for the root, shape [J].
        offsets: Rest position relative to the parent [file unit], shape [J, 3].
        ends: Offset of the end site below a joint [file unit], NaN where there is none, shape [J, 3].
        translations: Position relative to the parent in every frame [file unit], shape [T, J, 3].
        rotations: Rotation relative to the parent in every frame, shape [T, J, 3, 3].
        fps: Frames per second [Hz].
    """

    names: tuple[str, ...]
    parents: np.ndarray
    offsets: np.ndarray
    ends: np.ndarray
    translations: np.ndarray
    rotations: np.ndarray
    fps: float

    def world(self) -> tuple[np.ndarray, np.ndarray]:
        """Global rotations, shape [T, J, 3, 3], and positions [file unit], shape [T, J, 3], of all joints."""
        rotations, positions = self.rotations.copy(), self.translations.copy()
        for joint, parent in enumerate(self.parents):
            if parent >= 0:
                positions[:, joint] = positions[:, parent] + np.einsum(
                    "tij,tj->ti", rotations[:, parent], self.translations[:, joint]
                )
                rotations[:, joint] = rotations[:, parent] @ self.rotations[:, joint]
        return rotations, positions

    def rest_positions(self) -> np.ndarray:
        """Joint positions with all rotations zero and the root at the origin [file unit], shape [J, 3]."""
        positions = self.offsets.copy()
        positions[0] = 0.0
        for joint, parent in enumerate(self.parents):
            if parent >= 0:
                positions[joint] += positions[parent]
        return positions


def read_bvh(path: str | Path) -> BvhMotion:
    """Read a BVH file.

    Raises:
        FileNotFoundError: No such file.
        ValueError: Malformed hierarchy, wrong number of values, NaN, truncated motion, too large; with the line number.
    """
    path = Path(path)
    if not path.is_file():
        raise FileNotFoundError(f"Motion capture file {path} does not exist")
    if path.stat().st_size > MAX_BYTES:
        raise ValueError(
            f"{path.name}: {path.stat().st_size / 2**20:.0f} MiB, at most {MAX_BYTES // 2**20} MiB is read"
        )
    try:
        lines = path.read_text(encoding="utf-8-sig").splitlines()
    except UnicodeDecodeError:
        raise ValueError(f"{path.name} is not a text file, so it cannot be BVH") from None
    reader = _Reader(path.name, lines)
    skeleton = _read_hierarchy(reader)
    return _read_motion(reader, skeleton)


def read_bvh_length(path: str | Path) -> tuple[int, float]:
    """Number of frames and frames per second [Hz] of a BVH file, without reading its motion.

    Raises:
        FileNotFoundError: No such file.
        ValueError: No "Frames:" and "Frame Time:" lines within the first 10,000 lines, or impossible values.
    """
    path = Path(path)
    if not path.is_file():
        raise FileNotFoundError(f"Motion capture file {path} does not exist")
    head: list[str] = []
    with path.open(encoding="utf-8", errors="replace") as stream:
        while len(head) < 10_000 and not (head and head[-1].startswith("Frame Time:")):
            line = stream.readline(100_000)
            if not line:
                break
            head.append(line.strip())
    reader = _Reader(path.name, head)
    reader.skip_to("MOTION")
    return _read_timing(reader)


class _Reader:
    """Non-empty lines with their numbers."""

    def __init__(self, name: str, lines: list[str]) -> None:
        self.name = name
        self.last = len(lines)
        self._lines = [(number, line.split()) for number, line in enumerate(lines, 1) if line.strip()]
        self._next = 0

    def take(self, expected: str) -> tuple[int, list[str]]:
        """Next line as its number and words; running out of lines is an error that names what was expected."""
        if self._next >= len(self._lines):
            raise ValueError(f"{self.name} ends at line {self.last} where {expected} was expected")
        self._next += 1
        return self._lines[self._next - 1]

    def skip_to(self, word: str) -> None:
        """Go to the first line that begins with a word."""
        while self._next < len(self._lines) and self._lines[self._next][1][0] != word:
            self._next += 1

    def rest(self) -> list[tuple[int, list[str]]]:
        """All lines that are left."""
        return self._lines[self._next :]

    def error(self, line: int, text: str) -> ValueError:
        return ValueError(f"{self.name}, line {line}: {text}")


@dataclass
class _Skeleton:
    names: list[str]
    parents: list[int]
    offsets: list[np.ndarray]
    ends: list[np.ndarray]
    channels: list[list[str]]


def _numbers(reader: _Reader, line: int, words: list[str], expected: int, what: str) -> np.ndarray:
    if len(words) != expected:
        raise reader.error(line, f"{what} has {len(words)} values, expected {expected}")
    try:
        values = np.array(words, dtype=np.float64)
    except ValueError:
        raise reader.error(line, f"{what} holds something that is not a number") from None
    if not np.isfinite(values).all():
        raise reader.error(line, f"{what} holds NaN or infinite values")
    return values


def _read_hierarchy(reader: _Reader) -> _Skeleton:
    line, words = reader.take("HIERARCHY")
    if words != ["HIERARCHY"]:
        raise reader.error(line, f"expected HIERARCHY, found '{' '.join(words)[:40]}'")
    skeleton = _Skeleton([], [], [], [], [])
    line, words = reader.take("ROOT")
    if len(words) < 2 or words[0] != "ROOT":
        raise reader.error(line, f"expected ROOT and a name, found '{' '.join(words)[:40]}'")
    _open_joint(reader, skeleton, line, words, -1)
    open_joints = [0]  # explicit stack: a hostile file cannot exhaust the interpreter's recursion
    while open_joints:
        line, words = reader.take("a JOINT, an End Site or }")
        if words[0] == "}":
            open_joints.pop()
        elif words[0] == "JOINT" and len(words) >= 2:
            _open_joint(reader, skeleton, line, words, open_joints[-1])
            open_joints.append(len(skeleton.names) - 1)
        elif [word.lower() for word in words[:2]] == ["end", "site"]:
            _expect_brace(reader, "{")
            skeleton.ends[open_joints[-1]] = _offset(reader)
            _expect_brace(reader, "}")
        else:
            raise reader.error(line, f"expected JOINT, End Site or }}, found '{' '.join(words)[:40]}'")
    return skeleton


def _expect_brace(reader: _Reader, brace: str) -> None:
    line, words = reader.take(brace)
    if words != [brace]:
        raise reader.error(line, f"expected {brace}, found '{' '.join(words)[:40]}'")


def _offset(reader: _Reader) -> np.ndarray:
    line, words = reader.take("OFFSET")
    if words[0] != "OFFSET":
        raise reader.error(line, f"expected OFFSET, found '{words[0][:40]}'")
    return _numbers(reader, line, words[1:], 3, "OFFSET")


def _open_joint(reader: _Reader, skeleton: _Skeleton, line: int, words: list[str], parent: int) -> None:
    name = " ".join(words[1:])
    if name in skeleton.names:
        raise reader.error(line, f"a second joint is named '{name[:40]}'")
    if len(skeleton.names) >= MAX_JOINTS:
        raise reader.error(line, f"more than {MAX_JOINTS} joints")
    _expect_brace(reader, "{")
    offset = _offset(reader)
    line, words = reader.take("CHANNELS")
    if words[0] != "CHANNELS" or len(words) < 2 or not words[1].isdigit():
        raise reader.error(line, f"expected CHANNELS and their number, found '{' '.join(words)[:40]}'")
    channels = words[2:]
    if len(channels) != int(words[1][:6]):
        raise reader.error(line, f"CHANNELS announces {words[1][:6]} channels but names {len(channels)}")
    unknown = [channel for channel in channels if channel not in _POSITIONS + _ROTATIONS]
    if unknown or len(set(channels)) != len(channels):
        fault = f"unknown channel '{unknown[0][:40]}'" if unknown else "a channel is named twice"
        raise reader.error(line, f"{fault}; allowed are X/Y/Zposition and X/Y/Zrotation, each once")
    skeleton.names.append(name)
    skeleton.parents.append(parent)
    skeleton.offsets.append(offset)
    skeleton.ends.append(np.full(3, np.nan))
    skeleton.channels.append(channels)


def _read_timing(reader: _Reader) -> tuple[int, float]:
    """The head of the motion section: number of frames, and frames per second [Hz]."""
    line, words = reader.take("MOTION")
    if words != ["MOTION"]:
        raise reader.error(line, f"expected MOTION, found '{' '.join(words)[:40]}'")
    line, words = reader.take("Frames:")
    if len(words) != 2 or words[0] != "Frames:" or not words[1].isdigit():
        raise reader.error(line, f"expected 'Frames:' and a whole number, found '{' '.join(words)[:40]}'")
    frames = int(words[1][:12])
    if not 1 <= frames <= MAX_FRAMES:
        raise reader.error(line, f"{frames} frames, allowed are 1 to {MAX_FRAMES}")
    line, words = reader.take("Frame Time:")
    if words[:2] != ["Frame", "Time:"]:
        raise reader.error(line, f"expected 'Frame Time:' and seconds, found '{' '.join(words)[:40]}'")
    seconds = float(_numbers(reader, line, words[2:], 1, "Frame Time")[0])
    if not 1.0 / 1000.0 <= seconds <= 1.0:
        raise reader.error(line, f"Frame Time is {seconds} s, allowed are 0.001 to 1 s")
    return frames, 1.0 / seconds


def _read_motion(reader: _Reader, skeleton: _Skeleton) -> BvhMotion:
    frames, fps = _read_timing(reader)
    width = sum(len(channels) for channels in skeleton.channels)
    if frames * len(skeleton.names) > MAX_JOINT_FRAMES:
        raise ValueError(
            f"{reader.name}: {frames} frames of {len(skeleton.names)} joints are more than this program reads"
        )
    rows = reader.rest()
    if len(rows) != frames:
        raise ValueError(f"{reader.name}, line {reader.last}: {frames} frames are announced but {len(rows)} are there")
    values = np.stack([_numbers(reader, number, words, width, "the frame") for number, words in rows])

    joints = len(skeleton.names)
    translations = np.tile(np.stack(skeleton.offsets), (frames, 1, 1))
    rotations = np.tile(np.eye(3), (frames, joints, 1, 1))
    column = 0
    for joint, channels in enumerate(skeleton.channels):
        block = values[:, column : column + len(channels)]
        column += len(channels)
        for index, channel in enumerate(channels):
            if channel in _POSITIONS:
                translations[:, joint, _POSITIONS.index(channel)] = block[:, index]
        turning = [index for index, channel in enumerate(channels) if channel in _ROTATIONS]
        if turning:
            axes = "".join(channels[index][0] for index in turning)
            rotations[:, joint] = Rotation.from_euler(axes, block[:, turning], degrees=True).as_matrix()
    return BvhMotion(
        names=tuple(skeleton.names),
        parents=np.array(skeleton.parents),
        offsets=np.stack(skeleton.offsets),
        ends=np.stack(skeleton.ends),
        translations=translations,
        rotations=rotations,
        fps=fps,
    )
