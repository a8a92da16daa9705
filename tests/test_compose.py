"""Composing from keyframes: what stands between them, loops, and the commands on a finished run."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from body.model import Body
from datasets.shards import read_sequences
from formats.animation import Animation
from formats.animation_file import load_animation
from geometry.proximity import SurfaceQuery
from models.intrinsic_fitting import load_motion_invariant
from motions.clip import Clip
from motions.looping import best_loop, closed, exact_loop, heading_joints, loop_gap, rounds_before
from motions.procedural import generate_clip
from motions.quality import measure
from pipeline import compose, infer, loop, retarget
from pipeline.export import shard_animation
from runtime import finished_run
from runtime.asked_motion import asked_motion
from runtime.composing import Composer
from runtime.finished_run import FinishedRun
from runtime.intrinsic_space import IntrinsicSpace
from runtime.keyframe_wishes import candidate_wish, parameter_wish, read_wishes, shape_wish
from runtime.keyframes import Interpolation, Keyframe
from runtime.shown_garment import ShownGarment


def keyframe(frame: int, value: float, detail: float | None = None) -> Keyframe:
    return Keyframe(frame, np.full(2, value, np.float32), None if detail is None else np.full((3, 3), detail))


def test_latents_move_straight_and_rest_at_the_ends():
    between = Interpolation([keyframe(10, 3.0), keyframe(2, 1.0)], hold=0.0)
    found = between.latents(np.array([0, 2, 4, 10, 15]))[:, 0]
    np.testing.assert_allclose(found, [1.0, 1.0, 1.5, 3.0, 3.0])
    assert between.detail(2) is None


def test_one_keyframe_is_one_latent():
    np.testing.assert_allclose(Interpolation([keyframe(7, 2.5)], 1.0).latents(np.arange(20)), 2.5)


def test_detail_is_whole_at_its_keyframe_and_fades():
    between = Interpolation([keyframe(5, 0.0, 1.0), keyframe(25, 0.0)], hold=4.0)
    at = [0.0 if (d := between.detail(t)) is None else d[0, 0] for t in (1, 5, 9, 15, 25)]
    assert at[1] == pytest.approx(1.0) and at[4] == 0.0
    assert at[0] == pytest.approx(np.exp(-1.0)) and at[2] == pytest.approx(np.exp(-1.0), abs=0.01)
    assert 0.0 < at[3] < at[2]


def test_between_close_keyframes_detail_is_interpolated_linearly():
    between = Interpolation([keyframe(0, 0.0, 1.0), keyframe(4, 0.0, 3.0)], hold=400.0)
    np.testing.assert_allclose([between.detail(t)[0, 0] for t in range(5)], [1.0, 1.5, 2.0, 2.5, 3.0], atol=1e-3)


def test_in_a_period_the_first_keyframe_follows_the_last():
    between = Interpolation([keyframe(2, 1.0), keyframe(6, 3.0)], 0.0, period=8)
    np.testing.assert_allclose(between.latents(np.array([0, 8, 7]))[:, 0], [2.0, 2.0, 2.5])


@pytest.fixture(scope="module")
def body() -> Body:
    return Body.load("small")


def turning_loop(frames: int = 25) -> Clip:
    """A body that swings an arm once while it walks and turns a quarter."""
    pose, root = np.zeros((frames, 24, 3)), np.zeros((frames, 3))
    phase = np.linspace(0.0, 2.0 * np.pi, frames)
    pose[:, 16, 2] = 0.4 * np.sin(phase)
    pose[:, 0] = (Rotation.from_rotvec([0.1, 0.0, 0.0]) * Rotation.identity(frames)).as_rotvec()
    turn = Rotation.from_rotvec(np.linspace([0, 0, 0], [0, np.pi / 2, 0], frames))
    pose[:, 0] = (turn * Rotation.from_rotvec(pose[:, 0])).as_rotvec()
    root[:, 0], root[:, 2] = np.sin(phase / 4), 1.0 - np.cos(phase / 4)
    return Clip("turning", "turning", "turning", pose, root, 30.0, "test")


def test_a_loop_is_told_wherever_it_walks(body):
    clip = turning_loop()
    assert loop_gap(clip, body) < 1e-5
    pose = clip.pose.copy()
    pose[-1, 16, 2] += 0.3
    broken = Clip("broken", "broken", "broken", pose, clip.root, 30.0, "test")
    assert loop_gap(broken, body) > 0.05
    assert best_loop(broken, body, 20).gap <= loop_gap(broken, body)


def test_rounds_before_a_loop_lead_into_it(body):
    clip = exact_loop(turning_loop())
    pose, root = rounds_before(clip, 30, body)
    assert len(pose) == 48
    whole = Clip("whole", "w", "w", np.concatenate([pose, clip.pose]), np.concatenate([root, clip.root]), 30.0, "test")
    joints = heading_joints(whole, body)
    np.testing.assert_allclose(joints[:24], joints[24:48], atol=1e-5)
    steps = np.linalg.norm(np.diff(body.joint_positions(whole.pose, whole.root), axis=0), axis=2)
    assert steps.max() < 1.05 * steps[48:].max()  # no jump where rounds meet


def test_a_closed_motion_loops_and_keeps_its_pace(body):
    clip = generate_clip("walk", 3, 60, 30.0, 1, body)
    made = closed(clip, 10, body)
    assert made.frames == 51
    assert loop_gap(made, body) < 1e-4
    np.testing.assert_array_equal(made.pose[0, 1:], made.pose[-1, 1:])
    around = np.concatenate([made.pose[:-1, 1:], made.pose[:2, 1:]])
    assert np.abs(np.diff(around, axis=0))[-2:].max() < np.abs(np.diff(clip.pose[:, 1:], axis=0)).max() * 1.2
    quality = measure(made, body)
    assert quality.skate_m_s < 0.05 and quality.penetration_m < 1e-3, "where ends fade into each other too"


def test_keyframes_are_read_from_a_file(tmp_path):
    path = tmp_path / "keys.yaml"
    path.write_text("- {frame: 3, shape: a.obj, space: canonical}\n- {frame: 0, set: {bend: 8e-5}}\n")
    shape, told = read_wishes(path)
    assert (shape.frame, shape.shape, shape.space) == (3, tmp_path / "a.obj", "canonical")
    assert told.parameters == ("bend=8e-5",)
    path.write_text(json.dumps({"keyframes": [{"frame": 1, "candidate": 5}]}))
    assert read_wishes(path)[0].candidate == 5


WRONG_FILES = {
    "- {frame: 1}": "needs one of shape, candidate and set",
    "- {frame: -1, candidate: 2}": "needs a frame",
    "- {frame: 1, candidate: two}": "candidate must be a seed",
    "- {frame: 1, candidate: 2, shape: a.obj}": "has shape and candidate",
    "- {frame: 1, colour: red}": "unknown key 'colour'",
    "- {frame: 1, candidate: 1, space: world}": "only for a shape",
    "- 7": "expected something like",
    "{}": "expected a list of 1 to",
    "[": "no YAML or JSON",
}


@pytest.mark.parametrize("text", WRONG_FILES)
def test_a_wrong_file_of_keyframes_gets_one_sentence(tmp_path, text):
    (tmp_path / "keys.yaml").write_text(text)
    with pytest.raises(ValueError, match=WRONG_FILES[text]) as raised:
        read_wishes(tmp_path / "keys.yaml")
    assert "\n" not in str(raised.value)


@pytest.mark.parametrize(
    ("wish", "text"), [(shape_wish, "a.obj"), (candidate_wish, "3:x"), (parameter_wish, "x:bend=1"), (shape_wish, "3:")]
)
def test_a_wrong_wish_says_what_is_expected(wish, text):
    with pytest.raises(ValueError, match="expected FRAME:"):
        wish(text)


@pytest.fixture(scope="module")
def run(smoke) -> Path:
    """Folder of a finished run of two garments, clips of 16 frames."""
    return smoke.results


@pytest.fixture(scope="module")
def space(run) -> IntrinsicSpace:
    return IntrinsicSpace(FinishedRun.open(run).garment("skirt"))


@pytest.fixture
def composer(space) -> Composer:
    return Composer(space, asked_motion(space.garment.run, "walk_000"))


def made(command, run: Path, out: Path, *given: str) -> Animation:
    """What a command writes for a skirt."""
    command.main(["--run", str(run), "--garment", "skirt", "--out", str(out), "--format", "h5", *given])
    (path,) = out.glob("*.h5")
    return load_animation(path)


def vertices_inside(animation: Animation) -> int:
    garment, under = animation.mesh("skirt"), animation.mesh("body")
    query = SurfaceQuery(under.faces, under.frames.shape[1])
    return sum(int((query.query(g, b).distance < 0.0).sum()) for g, b in zip(garment.frames, under.frames, strict=True))


def test_a_shape_stands_at_its_keyframe_and_its_detail_fades(composer, space):
    plain = composer.frame(6).vertices
    wanted = plain + np.array([0.0, 0.0, 0.03], np.float32) * (plain[:, 2:] > plain[:, 2:].mean())
    composer.add_shape(6, wanted)
    np.testing.assert_allclose(composer.frame(6, refine=False).vertices, wanted, atol=1e-5)
    bare = Composer(space, composer.clip, hold=0.0)
    bare.add_shape(6, wanted)
    apart = [
        np.abs(composer.frame(t, refine=False).vertices - bare.frame(t, refine=False).vertices).max() for t in (6, 15)
    ]
    assert apart[0] > 0.005 and apart[1] < 0.35 * apart[0]


def test_a_single_frame_is_that_of_the_whole(composer):
    composer.add_candidate(0, 1)
    composer.add_candidate(15, 2)
    reports = []
    whole = composer.compose(progress=lambda done, of: reports.append((done, of)))
    np.testing.assert_allclose(composer.frame(9).vertices, whole.animation.mesh("skirt").frames[9], atol=1e-5)
    assert reports[-1] == (16, 16) and whole.inside_after == 0
    assert composer.frame(9).inside.shape == composer.frame(9).vertices.shape[:1]


def test_keyframes_are_moved_and_deleted(composer):
    first = composer.add_candidate(2, 1)
    composer.add_candidate(12, 2)
    np.testing.assert_allclose(composer.latents(np.array([2]))[0], first.latent)
    composer.move(2, 5)
    assert [k.frame for k in composer.keyframes] == [5, 12]
    composer.delete(12)
    np.testing.assert_allclose(composer.latents()[-1], first.latent)
    with pytest.raises(ValueError, match="frame 12: there is no keyframe; there are: 5"):
        composer.delete(12)
    with pytest.raises(ValueError, match="has the frames 0 to 15"):
        composer.move(5, 16)


def test_canonical_and_world_shapes_are_one_keyframe(composer):
    world = composer.frame(4).vertices
    rotation, position = composer.body.pelvis_frames(composer.clip.pose, composer.clip.root)
    by_world = composer.add_shape(4, world)
    by_canonical = composer.add_shape(4, (world - position[4]) @ rotation[4], canonical=True)
    np.testing.assert_allclose(by_world.latent, by_canonical.latent, atol=1e-4)


def test_another_body_shows_the_same_latent(space):
    """What a shape says of z does not depend on the body that it was brought to."""
    clip, found = asked_motion(space.garment.run, "walk_000"), []
    for shape in (None, np.array([2.0])):
        worn = Composer(space, clip, shape)
        worn.add_candidate(0, 3)
        world = worn.frame(8, refine=False).vertices
        found.append(worn.add_shape(8, world).latent)
        np.testing.assert_allclose(worn.frame(8, refine=False).vertices, world, atol=1e-5)
    np.testing.assert_allclose(found[0], found[1], atol=2e-3)


def test_a_simulated_garment_is_seen_on_the_body_that_wore_it(run, space):
    shard = run / "shards" / "skirt" / "bodies_0000.h5"
    place, worn = next((n, one) for n, one in enumerate(read_sequences(shard)) if len(one.shape))
    animation = shard_animation(shard, place)
    seen = ShownGarment.of_animation(space, animation).composer.worn
    np.testing.assert_array_equal(seen.shape, worn.shape)
    np.testing.assert_allclose(seen.bodies[7], animation.mesh("body").frames[7], atol=1e-5)
    for wrong in (float("nan"), 1e9, "tall"):
        damaged = replace(animation, notes=dict(animation.notes) | {"shape_1": wrong})
        with pytest.raises(ValueError, match=r"notes shape_1 = .*, allowed are -3 to 3 standard deviations"):
            ShownGarment.of_animation(space, damaged)


def test_keyframes_of_the_command_line_and_of_a_file_agree(run, tmp_path):
    (tmp_path / "keys.json").write_text('[{"frame": 0, "candidate": 4}, {"frame": 15, "set": {"bend": "8e-5"}}]')
    given = ["--motion", "walk_000"]
    told = made(compose, run, tmp_path / "a", *given, "--candidate", "0:4", "--set-at", "15:bend=8e-5")
    read = made(compose, run, tmp_path / "b", *given, "--keyframes", str(tmp_path / "keys.json"))
    np.testing.assert_array_equal(told.mesh("skirt").frames, read.mesh("skirt").frames)
    assert vertices_inside(told) == 0 and told.notes["solver"] == "composed"
    plain = made(compose, run, tmp_path / "c", *given)
    assert np.abs(plain.mesh("skirt").frames - told.mesh("skirt").frames).max() > 1e-4


def test_a_loop_ends_as_it_began(run, tmp_path):
    animation = made(loop, run, tmp_path, "--motion", "walk", "--frames", "60", "--close", "--candidate", "5:1")
    garment, clip, body = animation.mesh("skirt").frames, animation.clip, Body.load("small")
    rotation, position = body.pelvis_frames(clip.pose, clip.root)
    ends = [(garment[k] - position[k]) @ rotation[k] for k in (0, -1)]
    np.testing.assert_allclose(ends[0], ends[1], atol=2e-6)
    np.testing.assert_array_equal(clip.pose[0, 1:], clip.pose[-1, 1:])
    assert vertices_inside(animation) == 0


def test_a_motion_that_does_not_loop_is_refused(run, tmp_path):
    sentence = (
        r"does not loop: .* mm are allowed; nearest are its frames (\d+) .* \(--first \1 --frames \d+\); --close makes"
    )
    with pytest.raises(SystemExit, match=sentence):
        made(loop, run, tmp_path, "--motion", "walk", "--frames", "40")
    assert not list(tmp_path.iterdir())


def test_a_look_is_taken_to_another_motion_and_read(run, tmp_path, capsys):
    made(compose, run, tmp_path / "shown", "--motion", "walk_000", "--candidate", "0:2")
    (path,) = (tmp_path / "shown").glob("*.h5")
    moved = made(retarget, run, tmp_path / "moved", "--in", str(path), "--motion", "squat", "--shape", "1")
    assert moved.clip.label == "squat" and moved.notes["shape_0"] == 1.0 and vertices_inside(moved) == 0
    infer.main(["--run", str(run), "--garment", "skirt", "--in", str(path), "--out", str(tmp_path / "read.csv")])
    said = capsys.readouterr().out
    assert "bend" in said and "16 frames" in said
    assert "parameter,estimate,low,high,known,unit" in (tmp_path / "read.csv").read_text()


MISTAKES = {
    "an unknown motion": (["--motion", "fly"], "known labels: squat, walk, wave-left"),
    "no such file": (["--motion", "fly.bvh"], "fly.bvh: no such file"),
    "a frame outside": (["--motion", "walk_000", "--candidate", "16:1"], "has the frames 0 to 15"),
    "two at one frame": (["--motion", "walk_000", "--candidate", "3:1", "--set-at", "3:bend=8e-5"], "two keyframes"),
    "an untold parameter": (["--motion", "walk_000", "--set-at", "0:substeps=20"], "the autoencoder is not told"),
    "out of range": (["--motion", "walk_000", "--set-at", "0:bend=1"], "was trained on"),
    "frames outside": (["--motion", "walk_000", "--first", "12", "--frames", "9"], "frames 12 to 20 are asked for"),
    "no mesh": (["--motion", "walk_000", "--keyframe", "3:none.obj"], "none.obj"),
}


@pytest.mark.parametrize("mistake", MISTAKES)
def test_a_mistake_gets_one_sentence_and_writes_nothing(run, tmp_path, mistake):
    given, sentence = MISTAKES[mistake]
    with pytest.raises(SystemExit) as stopped:
        made(compose, run, tmp_path / "out", *given)
    assert sentence in str(stopped.value) and "\n" not in str(stopped.value)
    assert not (tmp_path / "out").exists()


def test_a_mesh_of_another_topology_says_both_counts(run, tmp_path):
    (tmp_path / "other.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    with pytest.raises(SystemExit, match="has 3 vertices and 1 triangles, the garment has 300"):
        made(compose, run, tmp_path / "out", "--motion", "walk_000", "--keyframe", f"3:{tmp_path / 'other.obj'}")


def with_models_of_a_tshirt(run: Path, folder: Path, kinds: tuple[str, ...]) -> Path:
    """The run, in whose place of the skirt's models of some kinds the T-shirt's lie."""
    for entry in run.iterdir():
        if entry.name != "models":
            (folder / entry.name).symlink_to(entry)
    for entry in (run / "models").iterdir():
        (folder / "models" / entry.name).mkdir(parents=True)
        for kind in entry.iterdir():
            other = run / "models" / "tshirt" / kind.name
            source = other if entry.name == "skirt" and kind.name in kinds else kind
            (folder / "models" / entry.name / kind.name).symlink_to(source)
    return folder


@pytest.mark.parametrize(
    ("kind", "sentence"),
    [
        ("shape_descriptor", "describes a garment of .* vertices .* not this one of 300"),
        ("motion_invariant", r"\.pt was trained on the garment 'tshirt', not on 'skirt'"),
    ],
)
def test_models_of_another_garment_are_refused(run, tmp_path, kind, sentence):
    other = with_models_of_a_tshirt(run, tmp_path, (kind,))
    with pytest.raises(SystemExit, match=sentence):
        made(compose, other, tmp_path / "out", "--motion", "walk_000")


def test_an_older_file_of_another_garment_is_known_by_its_materials(run, tmp_path, monkeypatch):
    """Files of earlier versions do not say what they were trained on."""
    other = with_models_of_a_tshirt(run, tmp_path, ("motion_invariant",))
    monkeypatch.setattr(finished_run, "load_motion_invariant", lambda path, _: load_motion_invariant(path))
    with pytest.raises(SystemExit, match=r"was trained on .* around .* this garment is sampled from"):
        made(compose, other, tmp_path / "out", "--motion", "walk_000")


def test_what_exists_is_kept(run, tmp_path):
    made(compose, run, tmp_path, "--motion", "walk_000")
    with pytest.raises(SystemExit, match="exists and is kept"):
        made(compose, run, tmp_path, "--motion", "walk_000")
