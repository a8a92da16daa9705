"""A garment on other bodies: grading carried along a pose is exact for a skinned garment, and zero on the own body."""

from __future__ import annotations

import numpy as np
import pytest

from body.model import Body, apply_skin, skin_matrix
from body.shapes import scaled_root
from garments.build import build_template
from garments.grading import graded
from garments.spec import GarmentSpec
from garments.template import GarmentTemplate
from models.motion_features import MotionTrack
from models.other_bodies import OtherBody
from motions.procedural import generate_clip

SHAPE = np.array([1.5, -1.0])


@pytest.fixture(scope="module")
def own() -> Body:
    return Body.load("small")


@pytest.fixture(scope="module")
def template(own: Body) -> GarmentTemplate:
    return build_template(GarmentSpec("skirt", "skirt", 300), own)


def _track(body: Body, root_of: Body) -> MotionTrack:
    """A squat as a body makes it, three frames of which lead in."""
    clip = generate_clip("squat", 0, 12, 30.0, 1, root_of)
    root = scaled_root(clip.root, root_of, body)
    return MotionTrack(clip.pose, body.joint_positions(clip.pose, root), 3, 30.0)


def _worn(body: Body, template: GarmentTemplate, track: MotionTrack) -> np.ndarray:
    """Canonical vertices of a garment that follows the skin."""
    pose = track.pose[track.lead :]
    root = track.joints[track.lead :, 0] - body.joints[0]
    skin = skin_matrix(template.vertices, template.skin_index, template.skin_weight)
    rotation, position = body.pelvis_frames(pose, root)
    return np.matmul(apply_skin(skin, body.joint_transforms(pose, root)) - position[:, None], rotation)


def test_a_skinned_garment_is_moved_to_where_it_is_on_the_other_body(own, template):
    other = own.shaped(SHAPE)
    worn = OtherBody(template, own, other)
    track = _track(other, own)
    expected = _worn(other, graded(template, own, other), track)
    mine = _worn(own, template, worn.own_track(track))
    assert np.abs(expected - mine).max() > 0.01
    np.testing.assert_allclose(mine + worn.change(track), expected, atol=1e-5)


def test_the_own_body_makes_the_motion_in_steps_of_its_own(own, template):
    other = own.shaped(SHAPE)
    track, mine = _track(other, own), _track(own, own)
    found = OtherBody(template, own, other).own_track(track)
    np.testing.assert_allclose(found.joints, mine.joints, atol=1e-5)
    np.testing.assert_array_equal(found.pose, track.pose)
    assert found.lead == track.lead


def test_on_the_own_body_nothing_changes(own, template):
    track = _track(own, own)
    same = OtherBody(template, own, own.shaped(np.zeros(3)))
    np.testing.assert_allclose(same.change(track), 0.0, atol=1e-6)
    np.testing.assert_allclose(same.own_track(track).joints, track.joints, atol=1e-6)


def test_another_body_altogether_is_refused(own, template):
    with pytest.raises(ValueError, match="they must be one body"):
        OtherBody(template, own, Body.load("full"))
