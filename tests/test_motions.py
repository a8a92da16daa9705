"""Clips, their file, mirror, lead-in, and the generated motions: what can be believed is measured, not looked at."""

from __future__ import annotations

import dataclasses
from pathlib import Path

import h5py
import numpy as np
import pytest

from body.model import Body
from body.skeleton import JOINT_INDEX
from geometry.rotations import axis_angle_to_matrix
from motions.clip import Clip
from motions.clip_file import read_clips, write_clips
from motions.feet import FootPlan, Step
from motions.figure import Figure, farthest_reach, solve_leg
from motions.lead_in import lead_in
from motions.mirror import mirror
from motions.procedural import DEFAULT_LABELS, LABELS, MAX_JOINT_SPEED, generate_clip
from motions.quality import CONTACT_HEIGHT, joint_velocity, measure, sliding_speed, sole_points
from motions.timing import minimum_jerk, rotation_about


@pytest.fixture(scope="module")
def body() -> Body:
    return Body.load("small")


@pytest.fixture(scope="module")
def clips(body: Body) -> dict[str, Clip]:
    return {label: generate_clip(label, 0, 60, 30.0, 0, body) for label in LABELS}


def _still(name: str = "still", frames: int = 5, **changes: object) -> Clip:
    values = {"name": name, "take": "t", "label": "stand", "fps": 30.0, "source": "test"}
    arrays = {"pose": np.zeros((frames, 24, 3)), "root": np.zeros((frames, 3))}
    return Clip(**(values | arrays | changes))


# --- clips ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"pose": np.zeros((5, 22, 3))}, r"shape \[5, 22, 3\], expected \[T, 24, 3\]"),
        ({"root": np.zeros((4, 3))}, r"root has shape \[4, 3\], expected \[5, 3\]"),
        ({"root": np.full((5, 3), np.nan)}, "root is NaN or infinite in frame 0"),
        ({"pose": np.full((5, 24, 3), 90.0)}, "degrees"),
        ({"root": np.array([[0, 0, 0]] * 3 + [[2.0, 0, 0]] * 2)}, "jumps 2.00 m between frames 2 and 3"),
        ({"fps": 0.0}, "fps is 0.0"),
        ({"label": ""}, "empty label"),
    ],
)
def test_clip_refuses_impossible_motion(changes: dict, said: str) -> None:
    with pytest.raises(ValueError, match=said):
        _still(**changes)


def test_clip_file_returns_what_was_written(tmp_path: Path, clips: dict[str, Clip]) -> None:
    path = tmp_path / "clips.h5"
    written = [clips["walk"], _still(frames=7)]
    write_clips(path, written)
    read = read_clips(path)
    assert [clip.name for clip in read] == ["walk_000", "still"]
    for before, after in zip(written, read):
        assert (before.take, before.label, before.fps, before.source) == (
            after.take,
            after.label,
            after.fps,
            after.source,
        )
        np.testing.assert_array_equal(before.pose, after.pose)
        np.testing.assert_array_equal(before.root, after.root)
    assert list(tmp_path.iterdir()) == [path]  # no temporary file is left


def test_clip_file_says_what_is_wrong(tmp_path: Path) -> None:
    path = tmp_path / "clips.h5"
    with pytest.raises(ValueError, match="Two clips are named 'still'"):
        write_clips(path, [_still(), _still()])
    path.write_bytes(b"not hdf5")
    with pytest.raises(ValueError, match="damaged or not an HDF5 file"):
        read_clips(path)
    write_clips(path, [_still()])
    with h5py.File(path, "a") as file:
        file["clips/00000/pose"][2, 3, 1] = np.nan
    with pytest.raises(ValueError, match="pose is NaN or infinite in frame 2"):
        read_clips(path)
    with h5py.File(path, "a") as file:
        file.attrs["version"] = 99
    with pytest.raises(ValueError, match="version 99"):
        read_clips(path)
    with h5py.File(path, "a") as file:
        file.attrs["format"] = "something else"
    with pytest.raises(ValueError, match="not a motion file"):
        read_clips(path)


# --- mirror and lead-in ---------------------------------------------------------------------------------------------


def test_mirror_swaps_sides_and_undoes_itself(clips: dict[str, Clip], body: Body) -> None:
    clip = clips["wave-left"]
    mirrored = mirror(clip)
    assert mirrored.label == "wave-right" and mirrored.take == clip.take and mirrored.name != clip.name
    joints, other = (body.joint_positions(c.pose, c.root) for c in (clip, mirrored))
    left, right = JOINT_INDEX["left_wrist"], JOINT_INDEX["right_wrist"]
    np.testing.assert_allclose(other[:, right], joints[:, left] * [-1, 1, 1], atol=1e-5)
    assert joints[40, left, 1] - joints[40, right, 1] > 0.5  # it is the left hand that waves
    back = mirror(mirrored)
    assert (back.name, back.label) == (clip.name, clip.label)
    np.testing.assert_array_equal(back.pose, clip.pose)
    np.testing.assert_array_equal(back.root, clip.root)


@pytest.mark.parametrize("start", [0, 30])
def test_lead_in_joins_bind_pose_and_clip(start: int, clips: dict[str, Clip], body: Body) -> None:
    """From frame 30 the walk moves fully: its velocity must be met, not only its pose."""
    whole = clips["walk"]
    clip = dataclasses.replace(whole, pose=whole.pose[start:], root=whole.root[start:] - whole.root[start] * [1, 0, 1])
    pose, root = lead_in(clip, body, 24)
    assert pose.shape == (24, 24, 3) and root.shape == (24, 3)
    np.testing.assert_allclose(body.posed(pose[:1], root[:1])[0], body.vertices, atol=1e-5)
    joined = body.joint_positions(np.concatenate([pose, clip.pose]), np.concatenate([root, clip.root]))
    velocity = np.diff(joined, axis=0) * clip.fps
    # A clip moving at 30 fps comes in as a quintic: its first step is s^3 of the whole way, nearly nothing.
    assert np.abs(velocity[0]).max() < 0.05
    seam = np.abs(velocity[23] - velocity[24]).max()
    inside = np.abs(np.diff(velocity, axis=0)).max(axis=(1, 2))
    assert seam <= 1.5 * np.maximum(inside[18:22].max(), inside[24:30].max()) + 0.02


def test_lead_in_needs_two_frames(clips: dict[str, Clip], body: Body) -> None:
    with pytest.raises(ValueError, match="at least 2 frames"):
        lead_in(clips["walk"], body, 1)


# --- the parts of the generator -------------------------------------------------------------------------------------


def test_leg_reaches_its_target_and_bends_forward(body: Body) -> None:
    figure = Figure.of(body)
    generator = np.random.default_rng(0)
    hip = np.tile([0.1, 0.9, 0.0], (50, 1))
    direction = generator.normal(size=(50, 3)) * [0.3, 0.0, 0.4] + [0, -1, 0]
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    ankle = hip + direction * generator.uniform(0.35, farthest_reach(figure, "left") - 0.03, (50, 1))
    thigh, flexion = solve_leg(figure, "left", hip, ankle, np.zeros(50))
    knee = hip + thigh @ figure.offset("left_knee")
    reached = knee + np.einsum("tij,j->ti", thigh @ rotation_about("x", flexion), figure.offset("left_ankle"))
    np.testing.assert_allclose(reached, ankle, atol=5e-4)
    middle = 0.5 * (hip + ankle)
    assert ((knee - middle)[:, 2] > 0.0).all() and (flexion > 0.0).all()


def test_planted_foot_pivots_about_its_ball(body: Body) -> None:
    shape = Figure.of(body).feet[0]
    plan = FootPlan(shape, (0.1, 0.0), 0.2, [Step(1.0, 1.4, (0.1, 0.5), 0.2, 0.08, push=0.6, strike=-0.3)])
    times = np.linspace(0.0, 2.0, 401)
    track = plan.track(times)
    ball = track.ankle + np.einsum("tij,j->ti", track.rotation @ rotation_about("y", shape.natural_yaw), shape.ball)
    before = times < 1.0
    assert np.ptp(ball[before], axis=0).max() < 1e-9 and np.ptp(track.ankle[before, 1]) > 0.05
    np.testing.assert_allclose(track.ankle[-1, [0, 2]], [0.1, 0.5], atol=1e-9)
    speed = np.diff(track.ankle, axis=0) / 0.005
    assert np.linalg.norm(np.diff(speed, axis=0), axis=1).max() < 0.6  # the foot is not kicked off the ground
    assert not track.planted[(times > 1.0) & (times < 1.4)].any() and track.planted[times > 1.4].all()


def test_minimum_jerk_is_at_rest_at_its_ends() -> None:
    s = np.array([-1.0, 0.0, 1e-4, 0.5, 1.0 - 1e-4, 1.0, 2.0])
    np.testing.assert_allclose(minimum_jerk(s), [0, 0, 1e-11, 0.5, 1, 1, 1], atol=1e-10)


def test_sliding_speed_is_the_lower_quartile_of_what_touches() -> None:
    generator = np.random.default_rng(3)
    points = generator.uniform(0.0, 0.04, (40, 9, 3))
    low = points[..., 1] < CONTACT_HEIGHT
    speed = np.linalg.norm(np.diff(points[..., [0, 2]], axis=0), axis=-1) * 30.0
    speed[~(low[1:] & low[:-1])] = np.nan
    touching = np.isfinite(speed).any(axis=1)
    expected = np.array([np.nanpercentile(row, 25.0) if any_ else 0.0 for row, any_ in zip(speed, touching)])
    assert 5 < touching.sum() < 39
    np.testing.assert_allclose(sliding_speed(points, 30.0), expected)


def test_sliding_speed_sees_a_slide_but_not_a_step() -> None:
    sole = np.zeros((4, 6, 3))
    sole[:, :, 0] = np.arange(4)[:, None] * 0.01  # 1 cm a frame at 30 fps
    np.testing.assert_allclose(sliding_speed(sole, 30.0), 0.3)
    sole[:, :, 1] = 0.05
    np.testing.assert_allclose(sliding_speed(sole, 30.0), 0.0)


# --- generated clips ------------------------------------------------------------------------------------------------


def test_enough_labels() -> None:
    assert 24 <= len(DEFAULT_LABELS) <= 28 and set(DEFAULT_LABELS) <= set(LABELS)
    assert len(LABELS) == len(set(LABELS)) >= 66


def test_clips_follow_their_arguments_alone(clips: dict[str, Clip], body: Body) -> None:
    again = generate_clip("kick", 0, 60, 30.0, 0, body)
    np.testing.assert_array_equal(again.pose, clips["kick"].pose)
    np.testing.assert_array_equal(again.root, clips["kick"].root)
    for variant, seed in ((1, 0), (0, 1)):
        other = generate_clip("kick", variant, 60, 30.0, seed, body)
        assert np.abs(other.pose - again.pose).max() > 0.1
    assert again.take == again.name == "kick_000"


def test_every_label_moves_believably(clips: dict[str, Clip], body: Body) -> None:
    """Feet do not slide or sink, joints stay below the cap, the start is calm, and something happens."""
    for label, clip in clips.items():
        quality = measure(clip, body)
        assert clip.label == label
        assert quality.skate_m_s < 0.02, label
        assert quality.penetration_m < 0.005, label
        assert quality.joint_speed_rad_s <= MAX_JOINT_SPEED + 1e-3, label
        assert quality.start_speed_rad_s < 0.3, label
        assert np.ptp(body.joint_positions(clip.pose, clip.root), axis=0).max() > 0.08, label


def test_only_airborne_labels_leave_the_ground(clips: dict[str, Clip], body: Body) -> None:
    airborne = ("jump", "hop", "skip", "run", "jog")
    for label, clip in clips.items():
        if not label.startswith(airborne):
            assert measure(clip, body).floating_m < 0.01, label
    assert measure(clips["jump"], body).floating_m > 0.08


def test_knees_and_elbows_bend_the_right_way(clips: dict[str, Clip]) -> None:
    for label, clip in clips.items():
        knees = clip.pose[:, [JOINT_INDEX["left_knee"], JOINT_INDEX["right_knee"]]]
        assert knees[..., 0].min() > 0.0 and np.abs(knees[..., 1:]).max() < 1e-4, label
        elbow = axis_angle_to_matrix(clip.pose[:, JOINT_INDEX["left_elbow"]])
        # The forearm, along x in the zero pose, swings ahead (towards +z of the upper arm), never back.
        assert elbow[:, 2, 0].min() > -0.05, label


def test_walk_travels_and_turn_turns(clips: dict[str, Clip]) -> None:
    assert clips["walk"].root[-1, 2] > 0.7 and abs(clips["walk"].root[-1, 0]) < 0.4
    assert clips["walk-back"].root[-1, 2] < -0.3
    assert clips["sidestep-left"].root[-1, 0] > 0.2 and clips["sidestep-right"].root[-1, 0] < -0.2
    assert clips["turn-left"].pose[-1, 0, 1] > 0.8 and clips["turn-right"].pose[-1, 0, 1] < -0.8


def test_hands_keep_clear_of_the_standing_body(clips: dict[str, Clip], body: Body) -> None:
    """Sleeves and skirts need room: no hand or forearm vertex lies inside the silhouette of trunk and thighs."""
    clip = clips["walk"]
    vertices = body.posed(clip.pose[:1], clip.root[:1])[0]
    part = body.part_of_vertex
    for side, outward in (("left", 1.0), ("right", -1.0)):
        hand = np.isin(part, [JOINT_INDEX[f"{side}_{name}"] for name in ("wrist", "hand")])
        thigh = part == JOINT_INDEX[f"{side}_hip"]
        assert (outward * vertices[hand, 0]).min() > (outward * vertices[thigh, 0]).max() + 0.01


@pytest.mark.parametrize(("frames", "fps"), [(16, 30.0), (300, 30.0), (50, 25.0), (75, 60.0)])
def test_other_lengths_and_rates(frames: int, fps: float, body: Body) -> None:
    for label in ("walk", "jump", "dance-sway"):
        clip = generate_clip(label, 2, frames, fps, 1, body)
        quality = measure(clip, body)
        assert clip.frames == frames and clip.fps == fps
        assert quality.skate_m_s < 0.02 and quality.joint_speed_rad_s <= MAX_JOINT_SPEED + 1e-3


def test_feet_fit_bodies_of_other_proportions(body: Body) -> None:
    tall = body.shaped(np.array([1.5, -1.0]))
    clip = generate_clip("walk", 0, 60, 30.0, 0, tall)
    soles = sole_points(clip.pose, clip.root, tall)
    assert min(points[..., 1].min() for points in soles) > -0.005
    assert measure(clip, tall).skate_m_s < 0.02


def test_noise_keeps_a_standing_person_alive(clips: dict[str, Clip]) -> None:
    speed = np.linalg.norm(joint_velocity(clips["wave-left"].pose, 30.0), axis=-1)
    assert speed[30:, JOINT_INDEX["right_shoulder"]].max() > 0.005


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (("moonwalk", 0, 60, 30.0, 0), "unknown motion label 'moonwalk'"),
        (("walk", -1, 60, 30.0, 0), "count from 0"),
        (("walk", 0, 1, 30.0, 0), "at least 2 frames"),
        (("walk", 0, 60, 0.0, 0), "1 to 480 frames a second"),
    ],
)
def test_generator_refuses_nonsense(arguments: tuple, said: str, body: Body) -> None:
    with pytest.raises(ValueError, match=said):
        generate_clip(*arguments, body)
