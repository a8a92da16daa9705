"""Exports are kept or whole, keyframes come back, and the command does what its help says."""

from __future__ import annotations

import os
import re
import resource
import shutil
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh

from body.model import Body
from datasets.shards import ShardHeader, ShardWriter, SimulatedSequence
from formats.animation import AnimatedMesh, Animation, dressed, plain_name
from formats.animation_file import load_animation
from formats.keyframe import read_keyframe
from formats.save import FORMATS, save_animation
from pipeline.export import main as export_main
from tests.moving_tube import FPS, contents, cut, moving, tube, turning_walk, walk


@pytest.fixture(scope="module")
def animation() -> Animation:
    return turning_walk()


# --- Targets ----------------------------------------------------------------------------------------------------------


@contextmanager
def disk_with(free: int) -> Iterator[None]:
    """No file may grow beyond ``free`` bytes: a write fails as on a full disk."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    # Python would keep the compiled half of a module that is imported meanwhile, and fail to import it ever after.
    unwritten, sys.dont_write_bytecode = sys.dont_write_bytecode, True
    resource.setrlimit(resource.RLIMIT_FSIZE, (free, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
        sys.dont_write_bytecode = unwritten


@contextmanager
def small_disk(folder: Path, size: int) -> Iterator[Path]:
    """A folder that is a disk of ``size`` bytes; skips the test where none may be mounted."""
    folder.mkdir()
    if (
        shutil.which("mount") is None
        or subprocess.run(
            ["mount", "-t", "tmpfs", "-o", f"size={size}", "tmpfs", folder], capture_output=True
        ).returncode
    ):
        pytest.skip("no disk can be mounted here")
    try:
        yield folder
    finally:
        subprocess.run(["umount", folder], check=True)


LEFT = r"could not be written \(.+\); nothing of it was left behind"


@pytest.mark.parametrize("kind", FORMATS)
def test_a_full_disk_leaves_nothing_and_loses_nothing(tmp_path: Path, animation: Animation, kind: str) -> None:
    animation = cut(animation, 4)
    with disk_with(2000), pytest.raises(OSError, match=LEFT):
        save_animation(tmp_path / f"a.{kind}", animation)
    assert list(tmp_path.iterdir()) == []
    before = save_animation(tmp_path / f"a.{kind}", animation)
    kept = contents(before)
    with disk_with(2000), pytest.raises(OSError, match="could not be written"):
        save_animation(tmp_path / f"a.{kind}", animation, force=True)
    assert list(tmp_path.iterdir()) == [before] and contents(before) == kept


@pytest.mark.parametrize("kind", FORMATS)
def test_a_disk_that_fills_up_on_the_way_leaves_nothing_and_loses_nothing(
    tmp_path: Path, animation: Animation, kind: str
) -> None:
    """A real disk without room for more than a part: what a write says then is ENOSPC."""
    animation = cut(animation, 4)
    whole = save_animation(tmp_path / f"whole.{kind}", animation)
    # Pages of 4 kB are taken whole, so a format that packs as small as that needs the more that is missing.
    pages = sum(-(-len(content) // 4096) for content in contents(whole).values())
    with small_disk(tmp_path / "disk", 4096 * (pages + max(1, pages // 2))) as disk:
        before = save_animation(disk / f"a.{kind}", animation)
        kept = contents(before)
        with pytest.raises(OSError, match=LEFT):
            save_animation(disk / f"a.{kind}", animation, force=True)
        assert list(disk.iterdir()) == [before] and contents(before) == kept
        with pytest.raises(OSError, match=LEFT) as stopped:
            save_animation(disk / f"b.{kind}", animation)
        assert list(disk.iterdir()) == [before] and contents(before) == kept
        assert re.search("no space left on device|is the disk full", str(stopped.value)), stopped.value


@pytest.mark.parametrize("kind", ["usdc", "usda", "h5", "pc2", "glb"])
def test_a_file_that_cannot_grow_on_the_way_leaves_nothing(tmp_path: Path, kind: str) -> None:
    long = Animation((AnimatedMesh("skirt", tube()[1], moving(700)),), FPS)
    whole = save_animation(tmp_path / f"whole.{kind}", long)
    size = max(len(content) for content in contents(whole).values())
    with disk_with(int(0.7 * size)), pytest.raises(OSError, match="could not be written"):
        save_animation(tmp_path / f"a.{kind}", long)
    assert list(tmp_path.iterdir()) == [whole]


@pytest.mark.parametrize("kept", [slice(0, 0.6), slice(0.5, 0.6)])
def test_a_usd_file_with_a_hole_is_found_out(tmp_path: Path, animation: Animation, monkeypatch, kept: slice) -> None:
    """As after a write that failed and of which the library does not tell, as happens on a full disk."""
    from pxr import Sdf

    content = save_animation(tmp_path / "a.usdc", animation).read_bytes()
    start, end = (int(share * len(content)) for share in (kept.start, kept.stop))
    holed = content[:end] if start == 0 else content[:start] + bytes(end - start) + content[end:]
    monkeypatch.setattr(Sdf.Layer, "Export", lambda _, path: Path(path).write_bytes(holed) > 0)
    with pytest.raises(OSError, match="only a part of it could be stored"):
        save_animation(tmp_path / "b.usdc", animation)
    assert not (tmp_path / "b.usdc").exists()


@pytest.mark.parametrize("kind", ["glb", "obj"])
def test_what_exists_is_kept_unless_forced(tmp_path: Path, animation: Animation, kind: str) -> None:
    first = save_animation(tmp_path / f"a.{kind}", animation)
    kept = contents(first)
    shorter = cut(animation, 5)
    with pytest.raises(ValueError, match="exists and is kept; --force replaces it"):
        save_animation(tmp_path / f"a.{kind}", shorter)
    assert contents(first) == kept
    save_animation(tmp_path / f"a.{kind}", shorter, force=True)
    assert contents(first) != kept and (kind != "obj" or len(contents(first)) == 11)
    assert [path.name for path in tmp_path.iterdir()] == [first.name]


def test_a_folder_with_the_work_of_others_is_never_replaced(tmp_path: Path, animation: Animation) -> None:
    folder = save_animation(tmp_path / "a.obj", animation)
    (folder / "scene.blend").write_text("days of work")
    with pytest.raises(ValueError, match=r"holds scene\.blend"):
        save_animation(tmp_path / "a.obj", animation, force=True)
    (tmp_path / "b.glb").mkdir()
    with pytest.raises(ValueError, match="is a folder"):
        save_animation(tmp_path / "b.glb", animation, force=True)
    with pytest.raises(ValueError, match=r"unknown format; a name must end in \.h5, \.glb"):
        save_animation(tmp_path / "a.fbx", animation)


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ({"name": "9 lives"}, "must be a letter"),
        ({"faces": np.array([[0, 1, 72]])}, "outside the 72 vertices"),
        ({"frames": np.zeros((72, 3))}, r"shape \[T, V, 3\]"),
        ({"frames": np.full((2, 72, 3), np.nan)}, "not finite"),
        ({"colour": (1, 2, 3)}, "three numbers from 0 to 1"),
        ({"uv": np.zeros((3, 2))}, r"shape \[72, 2\]"),
    ],
)
def test_meshes_that_no_format_could_hold(animation: Animation, arguments: dict, said: str) -> None:
    with pytest.raises(ValueError, match=said):
        replace(animation.meshes[0], **arguments)


def test_names_are_made_plain() -> None:
    assert [plain_name(text) for text in ("walk_000", "a b/../c", "007", "ü")] == ["walk_000", "a_b_c", "m_007", "m_"]


# --- Imports ----------------------------------------------------------------------------------------------------------


def test_keyframes_of_another_mesh_are_refused_with_both_counts(tmp_path: Path) -> None:
    vertices, faces = tube()
    bent = vertices + [0, 0, 0.1]
    ply = tmp_path / "k.ply"
    trimesh.Trimesh(bent, faces, process=False).export(ply)
    np.testing.assert_allclose(read_keyframe(ply, faces, len(vertices)), bent, atol=1e-6)
    coarse = tube(5, 12)
    trimesh.Trimesh(*coarse, process=False).export(ply)
    with pytest.raises(ValueError, match="has 60 vertices and 96 triangles, the garment has 72 and 120"):
        read_keyframe(ply, faces, len(vertices))
    order = np.random.default_rng(0).permutation(len(vertices))
    trimesh.Trimesh(bent[order], np.argsort(order)[faces], process=False).export(ply)
    with pytest.raises(ValueError, match="another order"):
        read_keyframe(ply, faces, len(vertices))
    trimesh.Trimesh(100 * bent + 100, faces, process=False).export(ply)
    with pytest.raises(ValueError, match="is it in metres"):
        read_keyframe(ply, faces, len(vertices))
    ply.write_bytes(b"ply\nnonsense")
    with pytest.raises(ValueError, match=r"k\.ply: is not a readable PLY"):
        read_keyframe(ply, faces, len(vertices))
    (tmp_path / "k.obj").write_text("v 0 0 0\nv nan 0 0\nv 1 0 0\nf 1 2 3\n")
    with pytest.raises(ValueError, match="vertex 1 is not finite"):
        read_keyframe(tmp_path / "k.obj", np.array([[0, 1, 2]]), 3)
    with pytest.raises(ValueError, match=r"an \.obj or a \.ply"):
        (tmp_path / "k.stl").write_bytes(b"")
        read_keyframe(tmp_path / "k.stl", faces, 72)


@pytest.fixture(scope="module")
def body() -> Body:
    return Body.load("small")


# --- The command ------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def shard(tmp_path_factory, body: Body) -> Path:
    vertices, faces = tube()
    path = tmp_path_factory.mktemp("shards") / "s.h5"
    header = ShardHeader(
        "skirt", "materials", "1", 0, FPS, "{}", vertices, faces, np.zeros(0, np.int32), "small", body.digest,
        body.faces, np.zeros(10), ("bend",), ("N m",), ("material",),
    )  # fmt: skip
    clip = walk()
    joints = body.joint_positions(clip.pose, clip.root)
    arrays = {"pose": clip.pose, "root": clip.root, "joints": joints}
    arrays |= {f"lead_{name}": array[:1] for name, array in arrays.items()}
    with ShardWriter(path, header) as writer:
        for phi, name in ((1, "walk"), (2, "walk"), (1, "run")):
            cloth = moving(seed=phi)
            writer.add(SimulatedSequence(name, name, 0, "walk", phi, {"bend": 1e-5 * phi}, vertices=cloth, **arrays))
    return path


def test_the_command_exports_a_sequence_and_the_file_that_it_wrote(tmp_path: Path, shard: Path, body: Body) -> None:
    one = ["--shard", str(shard), "--sequence", "walk:2", "--out", str(tmp_path)]
    export_main([*one, "--format", "h5,glb"])
    animation = load_animation(tmp_path / "skirt_walk_2.h5")
    np.testing.assert_array_equal(animation.mesh("skirt").frames, moving(seed=2))
    np.testing.assert_allclose(animation.mesh("body").frames, body.posed(walk().pose, walk().root), atol=1e-5)
    assert animation.notes["parameter_bend"] == pytest.approx(2e-5) and animation.clip.label == "walk"
    export_main(["--in", str(tmp_path / "skirt_walk_2.h5"), "--out", str(tmp_path / "again"), "--format", "glb"])
    assert (tmp_path / "again" / "skirt_walk_2.glb").read_bytes() == (tmp_path / "skirt_walk_2.glb").read_bytes()
    with pytest.raises(SystemExit, match="exists and is kept"):
        export_main([*one, "--format", "usd,glb"])
    assert not (tmp_path / "skirt_walk_2.usd").exists(), "looked at all targets before writing the first"


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--sequence", "walk"], r"has 2 sequences 'walk', name one: walk:1, walk:2"),
        (["--sequence", "jump"], r"has no sequence 'jump', it has: walk:1, walk:2, run:1"),
        (["--sequence", "#9"], "has no sequence '#9'"),
        (["--sequence", "run", "--format", "fbx"], "unknown is 'fbx'; known are h5, glb"),
        ([], "--shard needs --sequence"),
    ],
)
def test_the_command_says_what_is_wrong(tmp_path: Path, shard: Path, arguments: list[str], said: str) -> None:
    with pytest.raises(SystemExit, match=said) as error:
        export_main(["--shard", str(shard), "--out", str(tmp_path / "out"), *arguments])
    assert str(error.value).startswith("[export] error: ") and not (tmp_path / "out").exists()


def test_the_command_as_a_user_runs_it(tmp_path: Path, shard: Path) -> None:
    command = [sys.executable, "-m", "pipeline.export", "--shard", str(shard)]
    listed = subprocess.run([*command, "--list"], capture_output=True, text=True, check=True)
    assert listed.stdout.splitlines() == ["#0  walk:1", "#1  walk:2", "#2  run:1"]
    failed = subprocess.run(
        [*command, "--sequence", "run", "--out", str(shard / "x")], capture_output=True, text=True, env=os.environ
    )
    assert failed.returncode == 1 and "could not be written" in failed.stderr and "Traceback" not in failed.stderr


def test_the_command_on_a_full_disk_says_one_sentence_and_keeps_what_is_whole(
    tmp_path: Path, shard: Path, capsys: pytest.CaptureFixture
) -> None:
    one = ["--shard", str(shard), "--sequence", "run", "--out", str(tmp_path), "--force"]
    export_main([*one, "--format", "h5,obj"])
    kept = {path: contents(path) for path in tmp_path.iterdir()}
    assert len(kept) == 2
    for kind in ("h5", "obj"):
        with disk_with(2000), pytest.raises(SystemExit) as stopped:
            export_main([*one, "--format", kind])
        assert re.fullmatch(r"\[export\] error: .*/skirt_run_1(\.h5|_obj) " + LEFT, str(stopped.value))
    assert {path: contents(path) for path in tmp_path.iterdir()} == kept


def test_dressed_names_and_colours_its_meshes(animation: Animation) -> None:
    skirt, body = animation.meshes
    made = dressed("a", "my coat", skirt.frames, skirt.faces, body.frames, body.faces, FPS)
    assert [mesh.name for mesh in made.meshes] == ["my_coat", "body"]
    with pytest.raises(ValueError, match="must have the same number of frames, skirt has 10, body has 4"):
        dressed("a", "skirt", skirt.frames, skirt.faces, body.frames[:4], body.faces, FPS)
    with pytest.raises(ValueError, match="it has my_coat, body"):
        made.mesh("skirt")
