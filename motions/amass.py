"""Reading AMASS recordings: SMPL+H ``*_poses.npz`` and SMPL-X ``*_stageii.npz`` (Mahmood et al. 2019).

The first 22 joints are those of SMPL; the hands' own two stay straight, fingers and shape are left out. AMASS is z up:
it is turned to y up, put over the origin facing +z, and onto the ground, as other recordings are
(``motions.retarget``). The file is untrusted: nothing in it is executed (no pickle), and its sizes are judged before it
is unpacked.
"""

from __future__ import annotations

import re
import zipfile
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from body.model import Body
from body.skeleton import JOINT_COUNT
from motions.clip import Clip, validate_motion
from motions.quality import sole_points
from motions.resample import plain_rate, resampled
from motions.retarget import GROUND_PERCENTILE, turn_to_front

LARGEST = 2 * 2**30
"""Bytes of the arrays that are used, unpacked, at most."""

BODY_JOINTS = 22
_RATES = ("mocap_framerate", "mocap_frame_rate")
_SMPL_X = {"root_orient", "pose_body"}


def is_amass(names: set[str]) -> bool:
    """Whether arrays of these names are an AMASS recording."""
    return "trans" in names and ("poses" in names or names >= _SMPL_X)


def read_amass(path: str | Path, body: Body, fps: float | None = None) -> Clip:
    """Read an AMASS recording.

    Args:
        path: The file. Its name is that of the clip; the label is the name without ``_poses`` or ``_stageii`` and the
            numbers at its end.
        body: Body that the motion is put on the ground with.
        fps: Frames per second wanted [Hz]; the recording's own where None.

    Raises:
        ValueError: Not such a recording, damaged, or a motion that makes no sense; one sentence that names the file.
    """
    path = Path(path)
    try:
        pose, path_of_root, rate = _arrays(path)
        validate_motion(pose, path_of_root, rate, "the recording")
        rate_wanted = plain_rate(rate) if fps is None else fps
        pose, path_of_root = resampled(pose.astype(np.float64), path_of_root.astype(np.float64), rate, rate_wanted)
        pose, root = _upright(pose, path_of_root, body)
        name = re.sub(r"_(poses|stageii)$", "", path.stem)
        label = re.sub(r"[\W\d_]+$", "", name).strip("_ ") or "motion"
        return Clip(path.stem, path.stem, label, pose, root, rate_wanted, "amass")
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from None


def _arrays(path: Path) -> tuple[np.ndarray, np.ndarray, float]:
    """Pose [T, 24, 3], translation [T, 3] and frame rate [Hz], as they stand in the file."""
    sizes = _sizes(path)
    if not is_amass(set(sizes)):
        raise ValueError(_other(set(sizes)))
    rate_name = next((name for name in _RATES if name in sizes), None)
    if rate_name is None:
        raise ValueError(f"has no frame rate (an array {_RATES[0]} or {_RATES[1]})")
    used = ["trans", rate_name] + (["root_orient", "pose_body"] if set(sizes) >= _SMPL_X else ["poses"])
    if sum(sizes[name] for name in used) > LARGEST:
        raise ValueError(f"holds more than {LARGEST / 2**30:.0f} GiB")
    try:
        with np.load(path, allow_pickle=False) as content:
            arrays = {name: content[name] for name in used}
    except Exception as error:  # a parser of untrusted bytes may fail in any way
        raise ValueError(f"is damaged ({error})") from None
    for name, array in arrays.items():
        if array.dtype.kind not in "iuf" or (name == rate_name) != (array.size == 1 and array.ndim < 2):
            raise ValueError(f"'{name}' must hold numbers, got {array.dtype} of shape {list(array.shape)}")
    flat = arrays["poses"] if "poses" in arrays else _joined(arrays["root_orient"], arrays["pose_body"])
    if flat.ndim != 2 or flat.shape[1] < 3 * BODY_JOINTS or flat.shape[1] % 3:
        raise ValueError(f"the poses have shape {list(flat.shape)}, expected [T, {3 * BODY_JOINTS} or more]")
    pose = np.zeros((len(flat), JOINT_COUNT, 3))
    pose[:, :BODY_JOINTS] = flat[:, : 3 * BODY_JOINTS].reshape(len(flat), BODY_JOINTS, 3)
    return pose, arrays["trans"], float(arrays[rate_name].reshape(-1)[0])


def _sizes(path: Path) -> dict[str, int]:
    """Bytes of each array of an archive, unpacked."""
    try:
        with zipfile.ZipFile(path) as archive:
            return {info.filename.removesuffix(".npy"): info.file_size for info in archive.infolist()}
    except (OSError, zipfile.BadZipFile, NotImplementedError) as error:
        raise ValueError(f"is not a readable .npz file ({error})") from None


def _joined(root_orient: np.ndarray, pose_body: np.ndarray) -> np.ndarray:
    if root_orient.ndim != 2 or pose_body.ndim != 2 or len(root_orient) != len(pose_body):
        raise ValueError(
            f"root_orient {list(root_orient.shape)} and pose_body {list(pose_body.shape)} must be [T, 3] and [T, 63]"
        )
    return np.concatenate([root_orient, pose_body], axis=1)


def _other(names: set[str]) -> str:
    """Why an archive is no recording of a motion."""
    if "betas" in names and not names & {"poses", "trans"}:
        return "holds a body shape, not a motion; take the files *_poses.npz or *_stageii.npz"
    shown = ", ".join(sorted(names)[:8]) or "none"
    return f"is no AMASS recording: trans and poses, or root_orient and pose_body, are needed, its arrays are {shown}"


def _upright(pose: np.ndarray, path: np.ndarray, body: Body) -> tuple[np.ndarray, np.ndarray]:
    """From z up to y up, facing +z, over the origin, feet on the ground: pose and root.

    The pelvis of SMPL lies a constant vector away from its origin; recentring takes that out.
    """
    turn = Rotation.from_rotvec([-np.pi / 2, 0.0, 0.0])
    turned = pose.copy()
    turned[:, 0] = (turn * Rotation.from_rotvec(pose[:, 0])).as_rotvec()
    turned, pelvis = turn_to_front(turned, turn.apply(path))
    root = pelvis - body.joints[0]
    root[:, [0, 2]] -= root[0, [0, 2]]
    lowest = np.minimum(*(points[..., 1].min(axis=1) for points in sole_points(turned, root, body)))
    root[:, 1] -= np.percentile(lowest, GROUND_PERCENTILE)
    return turned, root
