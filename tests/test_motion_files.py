"""Motions from outside: AMASS, own files, whatever is no motion; the content decides, and faults end in a sentence."""

from __future__ import annotations

import io
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from body.model import Body
from formats.motion_file import read_motion
from motions.clip import Clip
from motions.clip_file import write_clips
from tests.moving_tube import FRAMES, walk


@pytest.fixture(scope="module")
def body() -> Body:
    return Body.load("small")


def amass(path: Path, clip: Clip, kind: str, **other: object) -> Path:
    """A clip as AMASS would have recorded it: z up, the hands' fingers behind the body's joints."""
    turn = Rotation.from_rotvec([np.pi / 2, 0, 0])
    pose = clip.pose.astype(float)
    pose[:, 0] = (turn * Rotation.from_rotvec(pose[:, 0])).as_rotvec()
    trans = turn.apply(clip.root) + [3.0, -2.0, 0.9]
    flat = pose[:, :22].reshape(clip.frames, -1)
    if kind == "smplh":
        fingers = np.full((clip.frames, 90), 0.3)
        arrays = {"poses": np.concatenate([flat, fingers], axis=1), "mocap_framerate": clip.fps, "gender": b"male"}
    else:
        arrays = {"root_orient": flat[:, :3], "pose_body": flat[:, 3:], "mocap_frame_rate": clip.fps}
        arrays |= {"poses": np.zeros((clip.frames, 165)), "latent": np.array([{}], dtype=object)}
    np.savez(path, **(arrays | {"trans": trans, "betas": np.zeros(16)} | other))
    return path


@pytest.mark.parametrize(("kind", "name"), [("smplh", "walk_03_poses.npz"), ("smplx", "walk_03_stageii.npz")])
def test_amass_comes_upright_facing_forward_on_the_ground(tmp_path: Path, body: Body, kind: str, name: str) -> None:
    truth = walk(40, 120.0)
    read = read_motion(amass(tmp_path / name, truth, kind), body=body)
    assert (read.frames, read.fps, read.label, read.source) == (40, 120.0, "walk", "amass")
    np.testing.assert_allclose(read.pose[:, 1:], truth.pose[:, 1:], atol=1e-6)
    assert not read.pose[:, 22:].any()
    # The same motion but for a turn about the vertical and where it starts.
    turns = Rotation.from_rotvec(read.pose[:, 0]) * Rotation.from_rotvec(truth.pose[:, 0]).inv()
    np.testing.assert_allclose(turns.as_rotvec()[:, [0, 2]], 0, atol=1e-5)
    way = turns[0].apply(truth.root - truth.root[0])
    np.testing.assert_allclose(read.root - read.root[0], way, atol=1e-5)
    ahead = Rotation.from_rotvec(read.pose[0, 0]).apply([0, 0, 1])
    assert abs(ahead[0]) < 1e-5 and ahead[2] > 0
    np.testing.assert_allclose(read.root[0, [0, 2]], 0, atol=1e-6)
    assert abs(body.posed(read.pose[:1], read.root[:1])[..., 1].min()) < 0.03


def test_frame_rates_are_converted(tmp_path: Path, body: Body) -> None:
    truth = walk(41, 119.97)
    path = amass(tmp_path / "a_poses.npz", truth, "smplh")
    quarter = read_motion(path, fps=30.0, body=body)
    assert (quarter.frames, quarter.fps) == (11, 30.0)
    np.testing.assert_allclose(quarter.pose[:, 1:], truth.pose[::4, 1:], atol=1e-6)
    other = read_motion(path, fps=50.0, body=body)
    assert other.frames == int(40 / 119.97 * 50) + 1
    half = Rotation.from_rotvec(truth.pose[2, 5]) * Rotation.from_rotvec(
        0.3994 * (Rotation.from_rotvec(truth.pose[2, 5]).inv() * Rotation.from_rotvec(truth.pose[3, 5])).as_rotvec()
    )
    np.testing.assert_allclose(other.pose[1, 5], half.as_rotvec(), atol=1e-4)


BVH_HEAD = "HIERARCHY\nROOT Hips\n{\n OFFSET 0 0 0\n CHANNELS 3 Xposition Yposition Zposition\n End Site\n {\n"
BVH = BVH_HEAD + "  OFFSET 0 1 0\n }\n}\nMOTION\nFrames: 2\nFrame Time: 0.04\n0 0 0\n0 0 0\n"


def test_the_content_decides_what_a_motion_file_is(tmp_path: Path, body: Body) -> None:
    path = amass(tmp_path / "a.npz", walk(), "smplh").rename(tmp_path / "a.bvh")
    assert read_motion(path, body=body).source == "amass"
    clips = [walk(), replace(walk(), name="walk_02")]
    write_clips(tmp_path / "c.h5", clips)
    own = (tmp_path / "c.h5").rename(tmp_path / "c.npz")
    assert read_motion(own, name="walk_02", body=body).name == "walk_02"
    assert read_motion(own, name="walk_02", fps=12.0).frames == FRAMES // 2
    with pytest.raises(ValueError, match="holds 2 motions, ask for one of them: walk_01, walk_02"):
        read_motion(own)
    with pytest.raises(ValueError, match="there is no 'run'"):
        read_motion(own, name="run")
    (tmp_path / "b.txt").write_text(BVH)
    with pytest.raises(ValueError, match=r"b\.txt: no joint of the recorded skeleton could be taken for"):
        read_motion(tmp_path / "b.txt", body=body)


def _npz(**arrays: object) -> bytes:
    buffer = io.BytesIO()
    np.savez(buffer, **arrays)
    return buffer.getvalue()


def _recording(**other: object) -> bytes:
    good = {"poses": np.zeros((5, 156)), "trans": np.zeros((5, 3)), "mocap_framerate": 60.0}
    return _npz(**(good | other))


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (b"", "is no motion that this program reads; it reads BVH, AMASS"),
        (b"\x00" * 100, "is no motion"),
        (b"PK\x03\x04 nothing", "is no motion"),
        (b"\x89HDF\r\n\x1a\n nothing", "not a readable HDF5 file"),
        (_npz(betas=np.zeros(10), gender="male"), "holds a body shape, not a motion"),
        (_npz(vertices=np.zeros(3)), "its arrays are vertices"),
        (_recording(poses=np.array([{}])), "is damaged"),
        (_recording(poses=np.zeros((5, 60))), "poses have shape"),
        (_recording(poses=np.full((5, 156), np.nan)), "pose is NaN or infinite"),
        (_recording(poses=np.full((5, 156), 90.0)), "are these degrees"),
        (_recording(trans=np.zeros((4, 3))), "root has shape"),
        (_recording(trans=np.array([[0, 0, 50.0 * i] for i in range(5)])), "jumps"),
        (_recording(mocap_framerate=np.inf), "fps is inf"),
        (_recording(mocap_framerate="60"), "must hold numbers"),
        (_npz(poses=np.zeros((5, 156)), trans=np.zeros((5, 3))), "has no frame rate"),
        (_recording()[:400], "is no motion"),
        (_recording().replace(b"'shape': (5, 156)", b"'shape': (9, 956)"), "is damaged"),
    ],
)
def test_other_files_are_no_motions(tmp_path: Path, body: Body, content: bytes, said: str) -> None:
    (tmp_path / "a_poses.npz").write_bytes(content)
    with pytest.raises(ValueError, match=said) as error:
        read_motion(tmp_path / "a_poses.npz", body=body)
    assert "a_poses.npz" in str(error.value) and "\n" not in str(error.value)
