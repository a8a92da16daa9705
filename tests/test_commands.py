"""The commands for users on a finished run: what they write, and one sentence for each mistake."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from body.model import Body
from formats.animation import Animation
from formats.animation_file import load_animation
from formats.motion_file import read_motion
from geometry.proximity import SurfaceQuery
from motions.clip_file import write_clips
from motions.procedural import generate_clip
from motions.quality import measure
from pipeline import dress, generate
from runtime.finished_run import FinishedRun


@pytest.fixture(scope="module")
def run(smoke) -> Path:
    """Folder of a finished run of two garments, clips of 16 frames."""
    return smoke.results


def made(run: Path, out: Path, *given: str) -> Animation:
    """What ``generate`` writes for a skirt."""
    generate.main(["--run", str(run), "--garment", "skirt", "--out", str(out), "--format", "h5", *given])
    (path,) = out.glob("*.h5")
    return load_animation(path)


def vertices_inside(animation: Animation) -> int:
    meshes = {mesh.name: mesh for mesh in animation.meshes}
    garment, body = meshes["skirt"], meshes["body"]
    query = SurfaceQuery(body.faces, body.frames.shape[1])
    return sum(int((query.query(g, b).distance < 0.0).sum()) for g, b in zip(garment.frames, body.frames, strict=True))


def test_a_label_becomes_a_clothed_animation_without_collisions(run, tmp_path):
    animation = made(run, tmp_path, "--label", "walk")
    assert animation.name == "skirt_walk_0000" and animation.clip.name == "walk_0000"
    assert animation.clip.frames == 16 and animation.clip.label == "walk"
    assert animation.notes["solver"] == "learned" and animation.notes["parameter_density"] > 0.0
    assert vertices_inside(animation) == 0


def test_several_labels_at_any_length_follow_each_other(run, tmp_path):
    animation = made(run, tmp_path, "--label", "walk,squat", "--frames", "130")
    assert animation.clip.frames == 130 and animation.clip.label == "walk+squat"
    knees = np.linalg.norm(animation.clip.pose[:, 4], axis=1)
    assert knees[80:].max() > knees[:50].max() + 0.1  # the squat is in the second half
    steps = np.linalg.norm(np.diff(animation.meshes[0].frames, axis=0), axis=2)
    assert steps.max() < 0.35  # [m] a frame: no jump where motions meet
    assert vertices_inside(animation) == 0


def test_a_seed_is_an_animation(run, tmp_path):
    one, same, other = (
        made(run, tmp_path / name, "--label", "walk", "--seed", seed)
        for name, seed in (("one", "4"), ("same", "4"), ("other", "5"))
    )
    np.testing.assert_array_equal(one.meshes[0].frames, same.meshes[0].frames)
    assert np.abs(one.clip.pose - other.clip.pose).max() > 1e-3


def test_material_and_body_are_told(run, tmp_path):
    base = made(run, tmp_path / "base", "--label", "walk")
    bent = made(run, tmp_path / "bent", "--label", "walk", "--set", "bend=8e-5")
    tall = made(run, tmp_path / "tall", "--label", "walk", "--shape", "2")
    assert bent.notes["parameter_bend"] == pytest.approx(8e-5)
    np.testing.assert_array_equal(base.clip.pose, bent.clip.pose)
    assert np.abs(base.meshes[0].frames - bent.meshes[0].frames).max() > 1e-4
    expected = Body.load("small").shaped(np.array([2.0])).posed(tall.clip.pose, tall.clip.root)
    np.testing.assert_allclose(tall.meshes[1].frames, expected, atol=1e-4)
    assert tall.notes["shape_0"] == 2.0
    # Opened as a motion, it is again that of the run's own body.
    (path,) = (tmp_path / "tall").glob("*.h5")
    np.testing.assert_allclose(read_motion(path, body=Body.load("small")).root, base.clip.root, atol=1e-6)
    assert np.abs(tall.clip.root - base.clip.root).max() > 1e-3


@pytest.mark.parametrize("solver", ["learned", "xpbd"])
def test_a_motion_file_is_dressed(run, tmp_path, solver, capsys):
    made(run, tmp_path / "motion", "--label", "walk")
    (motion,) = (tmp_path / "motion").glob("*.h5")
    given = ["--run", str(run), "--garment", "tshirt", "--motion", str(motion), "--solver", solver, "--frames", "9"]
    dress.main([*given, "--out", str(tmp_path / "worn"), "--format", "h5"])
    (path,) = (tmp_path / "worn").glob("*.h5")
    worn = load_animation(path)
    said = capsys.readouterr().out.partition("[dress]")[2]
    assert ("before refinement, 0 left" in said) == (solver == "learned")
    assert worn.clip.frames == 9 and worn.notes["solver"] == solver
    assert {mesh.name for mesh in worn.meshes} == {"tshirt", "body"}


def test_feet_of_a_motion_file_are_planted_where_asked(run, tmp_path, capsys):
    body = Body.load("small")
    clip = generate_clip("walk", 0, 24, FinishedRun.open(run).fps, 1, body)
    slid = clip.root + np.float32(0.03) * np.sin(np.arange(24) / 6.0)[:, None].astype(np.float32) * (1.0, 0.0, 0.0)
    write_clips(tmp_path / "slid.h5", [replace(clip, root=slid)])
    skate = {}
    for name, given in (("as it is", []), ("planted", ["--plant"])):
        command = ["--run", str(run), "--garment", "skirt", "--motion", str(tmp_path / "slid.h5"), *given]
        dress.main([*command, "--first", "4", "--out", str(tmp_path / name), "--format", "h5"])
        (path,) = (tmp_path / name).glob("*.h5")
        worn = load_animation(path)
        skate[name] = measure(worn.clip, body).skate_m_s
        assert vertices_inside(worn) == 0 and worn.frames == 20
        np.testing.assert_allclose(worn.mesh("body").frames, body.posed(worn.clip.pose, worn.clip.root), atol=1e-5)
    said = capsys.readouterr().out
    assert skate["as it is"] > 0.1 and skate["planted"] < 0.015
    assert said.count("[plant]") == 1 and "touching feet slid up to 0.1" in said


MISTAKES = {
    "an unknown label": (["--label", "fly"], "label 'fly' was not trained; known: squat, walk, wave-left"),
    "an unknown garment": (["--label", "walk", "--garment", "hat"], "garment 'hat' is not in"),
    "no such run": (["--label", "walk", "--run", "nowhere"], "nowhere: no such run; `snakemake all` makes"),
    "an unknown format": (["--label", "walk", "--format", "fbx"], "unknown is 'fbx'; known are"),
    "no name=value": (["--label", "walk", "--set", "bend"], "expected name=value"),
    "an unknown parameter": (["--label", "walk", "--set", "bent=1"], "unknown intrinsic parameter 'bent'; known:"),
    "a parameter that was not sampled": (["--label", "walk", "--set", "wind_speed=2"], "was trained on samples of"),
    "a value out of range": (["--label", "walk", "--set", "bend=1"], "was trained on 2.5e-06 to 8.8e-05 N m"),
    "a body out of range": (["--label", "walk", "--shape", "9"], "from -3 to 3 standard deviations"),
    "no frames": (["--label", "walk", "--frames", "1"], "has 2 to 100000 frames, asked for are 1"),
    "no animations": (["--label", "walk", "--count", "0"], "--count 0: allowed are 1 to 1000"),
    "two materials": (["--label", "walk", "--sample-material", "--set", "bend=1e-5"], "exclude each other"),
}


@pytest.mark.parametrize("mistake", MISTAKES)
def test_a_mistake_gets_one_sentence_and_writes_nothing(run, tmp_path, mistake):
    given, sentence = MISTAKES[mistake]
    with pytest.raises(SystemExit) as stopped:
        generate.main(["--run", str(run), "--garment", "skirt", "--out", str(tmp_path / "out"), *given])
    assert sentence in str(stopped.value) and "\n" not in str(stopped.value)
    assert not (tmp_path / "out").exists()


def test_what_exists_is_kept(run, tmp_path):
    made(run, tmp_path, "--label", "walk")
    (path,) = tmp_path.glob("*.h5")
    before = path.read_bytes()
    with pytest.raises(SystemExit, match="exists and is kept"):
        made(run, tmp_path, "--label", "walk")
    assert path.read_bytes() == before
    made(run, tmp_path, "--label", "walk", "--force")


def test_frames_outside_of_the_motion_are_refused(run, tmp_path):
    made(run, tmp_path, "--label", "walk")
    (motion,) = tmp_path.glob("*.h5")
    given = ["--run", str(run), "--garment", "skirt", "--motion", str(motion), "--first", "12", "--frames", "9"]
    with pytest.raises(SystemExit, match="frames 12 to 20 are asked for"):
        dress.main([*given, "--out", str(tmp_path / "worn")])


def test_an_unfinished_run_says_what_to_run(run, tmp_path):
    (tmp_path / "config.json").write_text((run / "config.json").read_text())
    with pytest.raises(SystemExit, match="is not finished; `snakemake all` makes what lacks"):
        generate.main(["--run", str(tmp_path), "--garment", "skirt", "--label", "walk"])
    (tmp_path / "config.json").write_text("{")
    with pytest.raises(SystemExit, match="is damaged"):
        generate.main(["--run", str(tmp_path), "--garment", "skirt", "--label", "walk"])


def test_a_regressor_of_another_mesh_with_as_many_vertices_is_refused(run):
    garment = FinishedRun.open(run).garment("skirt")
    assert garment.regressor.config.vertices == len(garment.template.vertices)
    other = FinishedRun.open(run).garment("skirt")
    vars(other)["template"] = replace(other.template, faces=other.template.faces[::-1].copy())
    with pytest.raises(ValueError, match="the regressor of 'skirt' was trained on other triangles"):
        _ = other.regressor
