"""Reading a motion of any kind that this program understands; what the file holds decides, not its name."""

from __future__ import annotations

import os
import zipfile
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np

from body.model import Body
from body.shapes import PELVIS
from formats.animation_file import FORMAT as ANIMATION
from formats.animation_file import load_clip
from motions.amass import read_amass
from motions.bvh import read_bvh
from motions.clip import Clip
from motions.clip_file import FORMAT as MOTIONS
from motions.clip_file import read_clips
from motions.resample import plain_rate, resampled
from motions.retarget import retarget

KINDS = "BVH, AMASS (*_poses.npz, *_stageii.npz), and this program's own motion and animation files"

SAME_HEIGHT = 1.0e-5
"""Bodies whose pelvis differs by less [m] take the same steps."""

_HDF5, _ZIP = b"\x89HDF\r\n\x1a\n", b"PK\x03\x04"


def read_motion(
    path: str | os.PathLike, fps: float | None = None, body: Body | None = None, name: str | None = None
) -> Clip:
    """The motion in a file.

    Recordings start over the origin, face +z in their first frame and stand on the ground; own files are as they are,
    but that an animation of another body has its steps made as long as the wanted body's legs.

    Args:
        path: BVH, AMASS, a file of clips or an animation file.
        fps: Frames per second wanted [Hz]; the file's own where None.
        body: Body that a motion is carried over to; the project's own where None.
        name: Which clip, of a file that holds several.

    Raises:
        FileNotFoundError: No such file.
        ValueError: Not a motion, damaged, of an unknown rig, or one that makes no sense; one sentence that names the
            file.
    """
    path = Path(path)
    if not path.is_file():
        raise FileNotFoundError(f"{path}: no such file")
    with open(path, "rb") as stream:
        head = stream.read(4096)
    if head.startswith(_HDF5):
        return _at_rate(_own(path, name, body), fps, path)
    if head.startswith(_ZIP) and zipfile.is_zipfile(path):
        return read_amass(path, body or Body.load("full"), fps)
    if head.removeprefix(b"\xef\xbb\xbf").lstrip().startswith(b"HIERARCHY"):
        return _recording(path, fps, body or Body.load("full"))
    raise ValueError(f"{path}: is no motion that this program reads; it reads {KINDS}")


def _recording(path: Path, fps: float | None, body: Body) -> Clip:
    try:
        motion = read_bvh(path)
        rate = plain_rate(motion.fps) if fps is None else fps
        pose, root = retarget(motion, body, rate, face_forward=True)
        return Clip(path.stem, path.stem, path.stem, pose, root, rate, "bvh")
    except ValueError as error:
        text = str(error)
        raise ValueError(text if path.name in text else f"{path}: {text}") from None


def _own(path: Path, name: str | None, body: Body | None) -> Clip:
    try:
        with h5py.File(path, "r") as file:
            kind = file.attrs.get("format")
    except (OSError, RuntimeError) as error:
        raise ValueError(f"{path}: not a readable HDF5 file ({error})") from None
    if isinstance(kind, str) and kind == ANIMATION:
        clip, height = load_clip(path)
        return clip if height is None else _carried_over(clip, height, body or Body.load("full"), path)
    if not isinstance(kind, str) or kind != MOTIONS:
        raise ValueError(f"{path}: is an HDF5 file of the format {str(kind)[:40]!r}, not a motion; {KINDS} are read")
    clips = read_clips(path)
    names = [clip.name for clip in clips]
    if name is None and len(clips) == 1:
        return clips[0]
    if name not in names:
        asked = "ask for one of them" if name is None else f"there is no '{name}'"
        shown = ", ".join(names[:12]) + (", ..." if len(names) > 12 else "")
        raise ValueError(f"{path}: holds {len(clips)} motions, {asked}: {shown}")
    return clips[names.index(name)]


def _carried_over(clip: Clip, height: float, body: Body, path: Path) -> Clip:
    """A motion of a body whose pelvis is ``height`` [m] above the ground, as ``body`` makes it (``body.shapes``)."""
    own = float(body.joints[PELVIS, 1])
    if abs(own - height) < SAME_HEIGHT:
        return clip
    try:
        return replace(clip, root=clip.root * np.float32(own / height))
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from None


def _at_rate(clip: Clip, fps: float | None, path: Path) -> Clip:
    if fps is None or fps == clip.fps:
        return clip
    try:
        pose, root = resampled(clip.pose.astype(float), clip.root.astype(float), clip.fps, fps)
        return replace(clip, pose=pose, root=root, fps=fps)
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from None
