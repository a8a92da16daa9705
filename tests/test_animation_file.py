"""Our own animation file: everything comes back, whatever is damaged in it ends in one sentence."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest

from body.model import Body
from formats.animation import Animation
from formats.animation_file import load_animation
from formats.body_notes import PELVIS_HEIGHT
from formats.motion_file import read_motion
from formats.save import save_animation
from motions.procedural import generate_clip
from motions.quality import measure
from runtime.motion_making import on_body
from tests.moving_tube import FPS, moving, turning_walk, walk


@pytest.fixture(scope="module")
def animation() -> Animation:
    return turning_walk()


def test_own_file_gives_everything_back(tmp_path: Path, animation: Animation) -> None:
    full = replace(animation, clip=walk(), notes={"garment": "skirt", "bend": 1.5e-5})
    again = load_animation(save_animation(tmp_path / "a.h5", full))
    assert (again.name, again.fps, dict(again.notes)) == (full.name, FPS, dict(full.notes))
    for mesh, found in zip(full.meshes, again.meshes):
        assert (mesh.name, mesh.material, mesh.colour) == (found.name, found.material, found.colour)
        np.testing.assert_array_equal(mesh.frames, found.frames)
        np.testing.assert_array_equal(mesh.faces, found.faces)
    np.testing.assert_array_equal(again.meshes[0].uv, full.meshes[0].uv)
    np.testing.assert_array_equal(again.clip.pose, full.clip.pose)
    np.testing.assert_array_equal(read_motion(tmp_path / "a.h5").root, full.clip.root)


def test_the_motion_of_another_body_stands_on_the_ground_of_this_one(tmp_path: Path, animation: Animation) -> None:
    # A squat: the root goes down as far as the legs of the body that made it are long.
    body = Body.load("small")
    clip = generate_clip("squat", 0, 40, FPS, 1, body)
    animation = replace(animation, meshes=(replace(animation.meshes[0], frames=moving(40)),))
    for shape in ((3.0,), (-3.0,), (0.0,)):
        other = body.shaped(np.array(shape))
        worn = on_body(clip, body, other)
        notes = {PELVIS_HEIGHT: float(other.joints[0, 1])}
        path = save_animation(tmp_path / f"{shape[0]}.h5", replace(animation, clip=worn, notes=notes))
        read = read_motion(path, body=body)
        np.testing.assert_allclose(read.root, clip.root, atol=1e-6)
        assert measure(read, body).penetration_m < 2e-4
        np.testing.assert_array_equal(read_motion(path, body=other).root, worn.root)
    assert measure(on_body(clip, body, body.shaped(np.array([3.0]))), body).penetration_m > 0.02
    for height in (float("nan"), 0.0, -1.0, 1e9, "tall"):
        wrong = save_animation(tmp_path / "w.h5", replace(animation, clip=clip, notes={PELVIS_HEIGHT: height}), True)
        with pytest.raises(
            ValueError, match=r"w\.h5: its body's pelvis is .* m above the ground, 0.2 to 2.5 are allowed"
        ):
            read_motion(wrong, body=body)


def _set_attribute(name: str, value: object):
    def change(file: h5py.File) -> None:
        file.attrs[name] = value

    return change


def _replace_frames(**options):
    def change(file: h5py.File) -> None:
        del file["meshes/00/frames"]
        file["meshes/00"].create_dataset("frames", **options)

    return change


def _link_frames(file: h5py.File) -> None:
    del file["meshes/00/frames"]
    file["meshes/00/frames"] = h5py.ExternalLink("/etc/passwd", "x")


def _endless_corner(file: h5py.File) -> None:
    file["meshes/00/faces"][0, 0] = 10**6


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (_set_attribute("version", 2), "version 2, this program reads version 1"),
        (_set_attribute("format", "other"), "is no animation file"),
        (_set_attribute("fps", np.nan), "fps is nan"),
        (_set_attribute("meshes", 10**9), "allowed are 1 to"),
        (_set_attribute("notes", "[1]"), "must be a JSON object"),
        (_set_attribute("notes", "{"), "a.h5: "),
        (_replace_frames(shape=(10**6, 10**6, 3), dtype="f4"), "larger than this program reads"),
        (_replace_frames(shape=(10, 72, 3), dtype="f4", external=[("/etc/passwd", 0, 8640)]), "refers to another file"),
        (
            _replace_frames(data=np.where(np.arange(10)[:, None, None] > 3, np.inf, moving())),
            "frame 4 has a vertex that is not finite",
        ),
        (_replace_frames(data=np.zeros((10, 72, 3), "S4")), "must be an array of numbers"),
        (_replace_frames(data=np.zeros((9, 72, 3), "f4")), "same number of frames"),
        (_link_frames, "'frames' is missing"),
        (_endless_corner, "outside the 72 vertices"),
    ],
)
def test_damaged_own_files_end_in_one_sentence(tmp_path: Path, animation: Animation, change, said: str) -> None:
    path = save_animation(tmp_path / "a.h5", animation)
    with h5py.File(path, "r+") as file:
        change(file)
    with pytest.raises(ValueError, match=said) as error:
        load_animation(path)
    assert "a.h5" in str(error.value) and "\n" not in str(error.value)


def test_truncated_own_files_are_refused(tmp_path: Path, animation: Animation) -> None:
    whole = save_animation(tmp_path / "a.h5", animation).read_bytes()
    for share in (0.0, 0.1, 0.5, 0.99):
        (tmp_path / "b.h5").write_bytes(whole[: int(share * len(whole))])
        with pytest.raises(ValueError, match=r"b\.h5"):
            load_animation(tmp_path / "b.h5")
