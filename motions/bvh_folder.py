"""A folder of labelled BVH recordings: the list of takes, and the clips that they are cut into."""

from __future__ import annotations

import csv
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from body.model import Body
from body.motion_limits import check_speeds
from motions.bvh import read_bvh, read_bvh_length
from motions.clip import Clip
from motions.retarget import retarget, turn_to_front

MAX_ROWS = 100_000


@dataclass(frozen=True)
class Take:
    """One recording.

    Attributes:
        file: Path relative to the folder, as in the label file; the take's name.
        label: Class of the motion.
        path: Where the file is.
    """

    file: str
    label: str
    path: Path

    def clip_count(self, frames: int, fps: float) -> int:
        """Number of consecutive clips of `frames` frames at `fps` [Hz]; only the head of the file is read."""
        recorded, rate = read_bvh_length(self.path)
        return (int((recorded - 1) / rate * fps + 1e-3) + 1) // frames

    def clips(self, frames: int, fps: float, body: Body) -> list[Clip]:
        """The recording on a body, cut into consecutive clips of `frames` frames; a shorter remainder is left out.

        Every clip starts over the origin and faces +z; its height over the ground is that of the whole take.

        Raises:
            ValueError: The file is malformed, of an unknown rig, or its motion teleports; the sentence names the file.
        """
        try:
            pose, root = retarget(read_bvh(self.path), body, fps)
            check_speeds("the recording", pose, root, fps, body.joint_positions(pose, root))
            starts = range(0, len(pose) - frames + 1, frames)
            return [self._cut(pose, root, start, frames, fps, body) for start in starts]
        except ValueError as error:
            text = str(error)
            raise ValueError(text if self.path.name in text else f"{self.file}: {text}") from None

    def _cut(self, pose: np.ndarray, root: np.ndarray, start: int, frames: int, fps: float, body: Body) -> Clip:
        window = slice(start, start + frames)
        turned, path = turn_to_front(pose[window].astype(np.float64), root[window] + body.joints[0].astype(np.float64))
        root_of_clip = path - body.joints[0]
        root_of_clip[:, [0, 2]] -= root_of_clip[0, [0, 2]]
        name = f"{Path(self.file).stem}_{start // frames:03d}"
        return Clip(name, self.file, self.label, turned, root_of_clip, fps, "bvh")


def list_takes(folder: str | Path, labels_csv: str | Path = "labels.csv") -> list[Take]:
    """Takes of a folder in the order of its label file.

    Args:
        folder: Folder of the recordings.
        labels_csv: Comma-separated file with a header and at least the columns ``file`` (relative to the folder) and
            ``label``; other columns are ignored. A relative path is looked up in the folder.

    Raises:
        FileNotFoundError: Folder or label file does not exist.
        ValueError: A column is missing, or a row is empty, twice there, points outside the folder or to no file; with
            its line.
    """
    folder = Path(folder)
    if not folder.is_dir():
        raise FileNotFoundError(f"Motion folder {folder} does not exist")
    labels = folder / labels_csv
    if not labels.is_file():
        raise FileNotFoundError(f"Label file {labels} does not exist; it lists the recordings as columns file,label")
    takes: dict[str, Take] = {}
    try:
        with labels.open(newline="", encoding="utf-8-sig") as stream:
            reader = csv.DictReader(stream)
            missing = [column for column in ("file", "label") if column not in (reader.fieldnames or [])]
            if missing:
                raise ValueError(f"{labels.name} has no column '{missing[0]}'; its header must name file and label")
            for row in reader:
                if len(takes) >= MAX_ROWS:
                    raise ValueError(f"{labels.name} has more than {MAX_ROWS} rows")
                take = _take_of_row(folder, row, f"{labels.name}, line {reader.line_num}")
                if take.file in takes:
                    raise ValueError(f"{labels.name}, line {reader.line_num}: {take.file} is listed twice")
                takes[take.file] = take
    except (UnicodeDecodeError, csv.Error) as error:
        raise ValueError(f"{labels.name} is not a readable comma-separated text file: {error}") from None
    if not takes:
        raise ValueError(f"{labels.name} lists no recordings")
    return list(takes.values())


def _take_of_row(folder: Path, row: dict[str, str | None], where: str) -> Take:
    file, label = (row["file"] or "").strip(), (row["label"] or "").strip()
    if not file or not label:
        raise ValueError(f"{where}: {'file' if not file else 'label'} is empty")
    path = folder / file
    if Path(file).is_absolute() or ".." in Path(file).parts:
        raise ValueError(f"{where}: {file} points outside the folder")
    if not path.is_file():
        raise ValueError(f"{where}: {file} does not exist in the folder")
    return Take(file, label, path)
