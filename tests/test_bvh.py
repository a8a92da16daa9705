"""BVH files: reading (known rotations, malformed input), retargeting, labelled folders, real recordings."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from body.model import Body
from body.skeleton import JOINT_INDEX
from motions.bvh import read_bvh, read_bvh_length
from motions.bvh_folder import list_takes
from motions.quality import measure, sole_points
from motions.retarget import retarget

TINY = """HIERARCHY
ROOT Hips
{
  OFFSET 0 0 0
  CHANNELS 6 Xposition Yposition Zposition Zrotation Xrotation Yrotation
  JOINT Spine
  {
    OFFSET 0 10 0
    CHANNELS 3 Yrotation Xrotation Zrotation
    End Site
    {
      OFFSET 0 5 0
    }
  }
}
MOTION
Frames: 2
Frame Time: 0.04
1 2 3 90 0 0 0 0 0
1 2 3 30 40 50 20 -60 70
"""


def _write(folder: Path, text: str, name: str = "a.bvh") -> Path:
    path = folder / name
    path.write_text(text)
    return path


@pytest.fixture(scope="module")
def body() -> Body:
    return Body.load("small")


def test_known_rotations(tmp_path: Path) -> None:
    motion = read_bvh(_write(tmp_path, TINY))
    assert motion.names == ("Hips", "Spine") and motion.fps == pytest.approx(25.0)
    rotation, position = motion.world()
    # A quarter turn about z carries the spine, 10 up, to 10 along -x.
    np.testing.assert_allclose(position[0], [[1, 2, 3], [-9, 2, 3]], atol=1e-12)

    def turn(axis: str, degrees: float) -> np.ndarray:
        return Rotation.from_euler(axis, degrees, degrees=True).as_matrix()

    hips = turn("z", 30) @ turn("x", 40) @ turn("y", 50)
    np.testing.assert_allclose(rotation[1, 0], hips, atol=1e-12)
    np.testing.assert_allclose(rotation[1, 1], hips @ turn("y", 20) @ turn("x", -60) @ turn("z", 70), atol=1e-12)
    np.testing.assert_allclose(motion.ends[1], [0, 5, 0])
    assert read_bvh_length(_write(tmp_path, TINY)) == (2, 25.0)


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("HIERARCHY", "HIERARCHIE", "line 1: expected HIERARCHY"),
        ("OFFSET 0 10 0", "OFFSET 0 10", "line 8: OFFSET has 2 values, expected 3"),
        ("OFFSET 0 10 0", "OFFSET 0 x 0", "line 8: OFFSET holds something that is not a number"),
        ("CHANNELS 3", "CHANNELS 4", "line 9: CHANNELS announces 4 channels but names 3"),
        ("Yrotation Xrotation Zrotation\n    End", "Yrotation Xrotation Wrotation\n    End", "unknown channel 'Wrot"),
        ("JOINT Spine", "JOINT Hips", "line 6: a second joint is named 'Hips'"),
        ("JOINT Spine\n  {", "JOINT Spine\n  OFFSET", "line 7: expected {"),
        ("MOTION", "}", "line 16: expected MOTION"),
        ("Frames: 2", "Frames: 3", "3 frames are announced but 2 are there"),
        ("Frames: 2", "Frames: 99999999999", "allowed are 1 to"),
        ("Frame Time: 0.04", "Frame Time: 0", "line 18: Frame Time is 0.0 s"),
        ("1 2 3 90 0 0 0 0 0", "1 2 3 90 0 0 0 0", "line 19: the frame has 8 values, expected 9"),
        ("-60 70", "nan 70", "line 20: the frame holds NaN"),
    ],
)
def test_malformed_files_are_named_by_line(tmp_path: Path, old: str, new: str, said: str) -> None:
    assert old in TINY
    with pytest.raises(ValueError, match=said):
        read_bvh(_write(tmp_path, TINY.replace(old, new, 1)))


def test_truncated_and_foreign_files(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="ends at line 10 where"):
        read_bvh(_write(tmp_path, "\n".join(TINY.splitlines()[:10])))
    with pytest.raises(ValueError, match="ends at line 0"):
        read_bvh(_write(tmp_path, ""))
    binary = tmp_path / "b.bvh"
    binary.write_bytes(b"\xff\xfe\x00\x9c" * 20)
    with pytest.raises(ValueError, match="not a text file"):
        read_bvh(binary)
    with pytest.raises(FileNotFoundError, match="does not exist"):
        read_bvh(tmp_path / "none.bvh")
    deep = "HIERARCHY\nROOT j\n{\nOFFSET 0 0 0\nCHANNELS 0\n" + "".join(
        f"JOINT j{i}\n{{\nOFFSET 0 0 0\nCHANNELS 0\n" for i in range(5000)
    )
    with pytest.raises(ValueError, match="more than 512 joints"):
        read_bvh(_write(tmp_path, deep))


# A z-up rig facing -y with its arms hanging down: (name, parent, rest position) in centimetres.
RIG = [
    ("Hips", None, (0, 0, 90)),
    ("Spine", "Hips", (0, 0, 105)),
    ("Spine1", "Spine", (0, 0, 120)),
    ("Neck", "Spine1", (0, 0, 145)),
    ("Head", "Neck", (0, 0, 155)),
    *[
        joint
        for side, x in (("Left", 1), ("Right", -1))
        for joint in (
            (f"{side}Shoulder", "Spine1", (4 * x, 0, 140)),
            (f"{side}Arm", f"{side}Shoulder", (18 * x, 0, 140)),
            (f"{side}ForeArm", f"{side}Arm", (18 * x, 0, 112)),
            (f"{side}Hand", f"{side}ForeArm", (18 * x, 0, 88)),
            (f"{side}UpLeg", "Hips", (10 * x, 0, 86)),
            (f"{side}Leg", f"{side}UpLeg", (10 * x, 0, 46)),
            (f"{side}Foot", f"{side}Leg", (10 * x, 0, 8)),
            (f"{side}ToeBase", f"{side}Foot", (10 * x, -14, 2)),
        )
    ],
]


def _rig_bvh(frames: list[dict[str, tuple[float, float, float]]], seconds: float = 1 / 60) -> str:
    """BVH text of the rig; a frame gives rotations (z, x, y) [degree] of joints, and the root position as "root"."""
    position = {name: np.array(at, float) for name, _, at in RIG}
    order: list[str] = []

    def block(name: str, parent: str | None, indent: str) -> list[str]:
        order.append(name)
        offset = position[name] - position[parent] if parent else np.zeros(3)
        root = "6 Xposition Yposition Zposition" if parent is None else "3"
        lines = [f"{indent}{'JOINT' if parent else 'ROOT'} {name}", indent + "{"]
        lines += [f"{indent} OFFSET {offset[0]} {offset[1]} {offset[2]}"]
        lines += [f"{indent} CHANNELS {root} Zrotation Xrotation Yrotation"]
        children = [joint for joint, above, _ in RIG if above == name]
        for child in children:
            lines += block(child, name, indent + " ")
        if not children:
            lines += [f"{indent} End Site", indent + " {", f"{indent}  OFFSET 0 0 1", indent + " }"]
        return [*lines, indent + "}"]

    text = ["HIERARCHY", *block("Hips", None, "")]
    text += ["MOTION", f"Frames: {len(frames)}", f"Frame Time: {seconds:.8f}"]
    for frame in frames:
        values = [*frame.get("root", (0, 0, 90))]
        for name in order:
            values += frame.get(name, (0, 0, 0))
        text.append(" ".join(f"{value:.6f}" for value in values))
    return "\n".join(text) + "\n"


def test_rig_with_hanging_arms_and_z_up(tmp_path: Path, body: Body) -> None:
    """The zero pose is matched by bone directions: arms hang, legs are straight, the body faces +z and stands."""
    pose, root = retarget(read_bvh(_write(tmp_path, _rig_bvh([{}] * 5))), body, 30.0)
    joints = body.joint_positions(pose, root)[0]
    for side, outward in (("left", 1.0), ("right", -1.0)):
        arm = joints[JOINT_INDEX[f"{side}_wrist"]] - joints[JOINT_INDEX[f"{side}_shoulder"]]
        np.testing.assert_allclose(arm / np.linalg.norm(arm), [0, -1, 0], atol=1e-3)
        assert outward * joints[JOINT_INDEX[f"{side}_hip"], 0] > 0.05
        leg = joints[JOINT_INDEX[f"{side}_ankle"]] - joints[JOINT_INDEX[f"{side}_hip"]]
        np.testing.assert_allclose(leg / np.linalg.norm(leg), [0, -1, 0], atol=1e-3)
        toes = joints[JOINT_INDEX[f"{side}_foot"]] - joints[JOINT_INDEX[f"{side}_ankle"]]
        assert toes[2] > 0.1
    lowest = min(points[..., 1].min() for points in sole_points(pose, root, body))
    assert abs(lowest) < 1e-3


def test_rotations_and_path_are_carried_over(tmp_path: Path, body: Body) -> None:
    """Half a second of walking 60 cm ahead (-y), the left thigh raised by 90 degrees about the rig's x axis."""
    frames = [
        {"root": (0, -60 * i / 30, 90), "LeftUpLeg": (0, -90 * i / 30, 0), "Hips": (20, 0, 0), "Spine1": (0, 0, 30)}
        for i in range(31)
    ]
    pose, root = retarget(read_bvh(_write(tmp_path, _rig_bvh(frames))), body, 30.0)
    assert len(pose) == 16  # 0.5 s at 30 fps
    joints = body.joint_positions(pose, root)
    heading = np.radians(20.0)  # about the rig's vertical, to the left
    np.testing.assert_allclose(pose[0, 0], [0, heading, 0], atol=1e-5)
    thigh = joints[-1, JOINT_INDEX["left_knee"]] - joints[-1, JOINT_INDEX["left_hip"]]
    np.testing.assert_allclose(thigh / np.linalg.norm(thigh), [np.sin(heading), 0, np.cos(heading)], atol=2e-3)
    legs = [np.linalg.norm(joints[0, a] - joints[0, b]) for a, b in ((1, 4), (4, 7))]
    np.testing.assert_allclose(root[-1, [0, 2]], [0, 60 * sum(legs) / 78.0], atol=2e-3)
    # The rig turns its upper spine by 30 degrees about +y, its backward axis: the body's -z.
    chest = Rotation.from_rotvec(pose[0, 0])
    for joint in ("spine1", "spine2", "spine3"):
        chest = chest * Rotation.from_rotvec(pose[0, JOINT_INDEX[joint]])
    relative = Rotation.from_rotvec(pose[0, 0]).inv() * chest
    np.testing.assert_allclose(relative.as_rotvec(), [0, 0, -np.radians(30.0)], atol=1e-5)
    forward, _ = retarget(read_bvh(tmp_path / "a.bvh"), body, 30.0, face_forward=True)
    np.testing.assert_allclose(forward[0, 0], 0.0, atol=1e-5)


def test_unknown_rig_is_named(tmp_path: Path, body: Body) -> None:
    with pytest.raises(ValueError, match="could be taken for 'head'"):
        retarget(read_bvh(_write(tmp_path, TINY)), body, 30.0)


def _folder(tmp_path: Path, rows: str) -> Path:
    _write(tmp_path, _rig_bvh([{"root": (0, -i, 90)} for i in range(130)]))
    (tmp_path / "labels.csv").write_text("file,style,label\n" + rows)
    return tmp_path


def test_takes_are_cut_into_consecutive_clips(tmp_path: Path, body: Body) -> None:
    takes = list_takes(_folder(tmp_path, "a.bvh,calm,walk\n"))
    assert [(take.file, take.label) for take in takes] == [("a.bvh", "walk")]
    clips = takes[0].clips(20, 30.0, body)  # 130 frames at 60 fps are 65 at 30 fps
    assert len(clips) == takes[0].clip_count(20, 30.0) == 3
    assert [clip.name for clip in clips] == ["a_000", "a_001", "a_002"]
    for clip in clips:
        assert clip.take == "a.bvh" and clip.label == "walk" and clip.frames == 20 and clip.source == "bvh"
        np.testing.assert_allclose(clip.root[0, [0, 2]], 0.0, atol=1e-6)
    np.testing.assert_allclose(clips[1].root, clips[0].root, atol=1e-4)  # the rig glides evenly


@pytest.mark.parametrize(
    ("rows", "said"),
    [
        ("b.bvh,,walk\n", "line 2: b.bvh does not exist"),
        ("a.bvh,,\n", "line 2: label is empty"),
        ("a.bvh,,walk\na.bvh,,run\n", "line 3: a.bvh is listed twice"),
        ("../a.bvh,,walk\n", "points outside the folder"),
        ("", "lists no recordings"),
    ],
)
def test_label_file_errors_name_the_row(tmp_path: Path, rows: str, said: str) -> None:
    with pytest.raises(ValueError, match=said):
        list_takes(_folder(tmp_path, rows))


def test_label_file_needs_its_columns(tmp_path: Path) -> None:
    _folder(tmp_path, "")
    (tmp_path / "labels.csv").write_text("path,label\n")
    with pytest.raises(ValueError, match="no column 'file'"):
        list_takes(tmp_path)
    with pytest.raises(FileNotFoundError, match="does not exist"):
        list_takes(tmp_path / "nowhere")


def test_broken_take_is_named(tmp_path: Path, body: Body) -> None:
    folder = _folder(tmp_path, "a.bvh,,walk\n")
    _write(folder, TINY)
    with pytest.raises(ValueError, match=r"^a\.bvh: no joint"):
        list_takes(folder)[0].clips(20, 30.0, body)


MOCAP = Path(os.environ.get("DRAPELINE_MOCAP", Path(__file__).resolve().parents[1].parent / "shared" / "mocap"))


@pytest.mark.skipif(not (MOCAP / "labels.csv").is_file(), reason="no folder of recordings (DRAPELINE_MOCAP)")
def test_real_recordings_stand_and_move_like_people(body: Body) -> None:
    takes = {take.label: take for take in list_takes(MOCAP)}
    chosen = [takes[label] for label in ("walk", "run", "bow", "jumping-jacks", "zombie-walk") if label in takes]
    for take in chosen or list(takes.values())[:3]:
        clips = take.clips(45, 30.0, body)
        assert len(clips) == take.clip_count(45, 30.0) >= 1
        for clip in clips[:2]:
            quality = measure(clip, body)
            assert quality.penetration_m < 0.04, clip.name
            assert quality.joint_speed_rad_s < 60.0, clip.name
            joints = body.joint_positions(clip.pose, clip.root)
            # Upright in the first frame, facing ahead, head over the feet.
            assert joints[0, JOINT_INDEX["head"], 1] > 1.0, clip.name
            assert joints[0, JOINT_INDEX["left_hip"], 0] > joints[0, JOINT_INDEX["right_hip"], 0], clip.name
