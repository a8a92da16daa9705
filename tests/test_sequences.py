"""Splits, canonical frames and motion signatures."""

from __future__ import annotations

import numpy as np
import pytest

from body.model import Body
from datasets.sequences import Sequence, from_canonical, motion_signature, to_canonical
from datasets.splits import SPLITS, SplitRule
from geometry.rotations import axis_angle_to_matrix, matrix_to_axis_angle


@pytest.fixture(scope="module")
def body() -> Body:
    return Body.load("small")


def make_sequence(body: Body, frames: int = 6, lead: int = 4) -> Sequence:
    rng = np.random.default_rng(3)
    pose = rng.normal(scale=0.3, size=(lead + frames, 24, 3)).astype(np.float32)
    root = rng.normal(size=(lead + frames, 3)).astype(np.float32)
    joints = body.joint_positions(pose, root)
    return Sequence(
        garment="skirt",
        clip="a",
        take="a",
        label="walk",
        plan="motions",
        phi=0,
        split="train",
        fps=30.0,
        vertices=rng.normal(size=(frames, 20, 3)).astype(np.float32),
        pose=pose[lead:],
        root=root[lead:],
        joints=joints[lead:],
        lead_pose=pose[:lead],
        lead_root=root[:lead],
        lead_joints=joints[:lead],
        parameters={},
    )


def test_splits_share_neither_parameters_nor_takes():
    rule = SplitRule(parameters_every=5, takes_every=4)
    split = {(phi, take): rule.split(phi, take) for phi in range(30) for take in range(30)}
    seen = [key for key, name in split.items() if name == "train"]
    for (phi, take), name in split.items():
        assert (phi in {p for p, _ in seen}) == (name in ("train", "unseen_motions"))
        assert (take in {t for _, t in seen}) == (name in ("train", "unseen_parameters"))
    assert rule.split(0, 0) == "train"
    with pytest.raises(ValueError, match="takes_every is 1"):
        SplitRule(5, 1)


def test_bodies_are_held_out_like_parameters():
    rule = SplitRule(5, 4, labels=["kick"], bodies_every=3)
    split = {(body, take): rule.split(0, take, "walk", body) for body in range(10) for take in range(8)}
    assert {body for (body, _), name in split.items() if name in ("train", "unseen_motions")} == {0, 1, 2, 4, 5, 7, 8}
    assert {body for (body, _), name in split.items() if "unseen_bodies" in name} == {3, 6, 9}
    assert {take for (_, take), name in split.items() if name == "unseen_bodies"} == {0, 1, 2, 4, 5, 6}
    assert split[3, 3] == "unseen_bodies_and_motions" and split[1, 3] == "unseen_motions"
    assert rule.split(0, 0, "kick", 3) == "unseen_labels"
    assert set(split.values()) <= set(SPLITS)
    with pytest.raises(ValueError, match="bodies_every is 1"):
        SplitRule(5, 4, bodies_every=1)


def test_a_label_is_held_out_whole():
    rule = SplitRule(5, 4, styles=["walk-fast"], labels=["kick"])
    for phi, take in ((0, 0), (0, 3), (5, 3)):
        assert rule.split(phi, take, "walk-fast") == "unseen_styles"
        assert rule.split(phi, take, "kick") == "unseen_labels"
        assert rule.split(phi, take, "walk") == rule.split(phi, take)
    with pytest.raises(ValueError, match="kick cannot be both"):
        SplitRule(5, 4, styles=["kick"], labels=["kick"])


def test_canonical_frame_round_trip_and_invariance(body):
    s = make_sequence(body)
    local = to_canonical(s.vertices, s.pose, s.root, body)
    np.testing.assert_allclose(from_canonical(local, s.pose, s.root, body), s.vertices, atol=1e-5)
    # Turning and moving the whole scene changes nothing in the character's own frame.
    turn = axis_angle_to_matrix(np.array([0.0, 1.1, 0.0]))
    pelvis = body.pelvis_frames(s.pose, s.root)[1]
    pose = s.pose.copy()
    pose[:, 0] = matrix_to_axis_angle(turn @ axis_angle_to_matrix(s.pose[:, 0]))
    moved_pelvis = pelvis @ turn.T + [3.0, 0.0, -2.0]
    root = s.root + (moved_pelvis - body.pelvis_frames(pose, s.root)[1])
    vertices = s.vertices @ turn.T + [3.0, 0.0, -2.0]
    np.testing.assert_allclose(to_canonical(vertices, pose, root, body), local, atol=1e-5)


def test_motion_signature_against_a_loop(body):
    s, window = make_sequence(body), 7
    signature = motion_signature(s, window, body).reshape(s.frames, window + 1, 24, 3)
    joints = np.concatenate([s.lead_joints, s.joints])
    rotation, position = body.pelvis_frames(s.pose, s.root)
    for t in range(s.frames):
        for w in range(window + 1):
            past = joints[max(len(s.lead_joints) + t - w, 0)]
            np.testing.assert_allclose(signature[t, w], (past - position[t]) @ rotation[t], atol=1e-5)
    np.testing.assert_allclose(signature[:, 0, 0], 0.0, atol=1e-6)  # the pelvis is the origin of its own frame
