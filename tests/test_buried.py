"""Where a body passes through itself or closes on itself, on shapes whose answer is known and on the real body."""

from __future__ import annotations

import numpy as np
import pytest

from body.model import Body
from body.skeleton import JOINT_INDEX
from sim.buried import Closure, ClosureFinder


def _ball(steps: int = 24) -> tuple[np.ndarray, np.ndarray]:
    """A unit ball of rings, outward."""
    theta = np.linspace(0.0, np.pi, steps // 2 + 1)[1:-1]
    phi = np.arange(steps) * 2.0 * np.pi / steps
    rings = np.stack(
        [
            np.sin(theta)[:, None] * np.cos(phi),
            np.tile(np.cos(theta)[:, None], (1, steps)),
            np.sin(theta)[:, None] * np.sin(phi),
        ],
        axis=-1,
    ).reshape(-1, 3)
    points = np.concatenate([rings, [[0.0, 1.0, 0.0], [0.0, -1.0, 0.0]]])
    faces, last = [], (len(theta) - 1) * steps
    for k in range(steps):
        after = (k + 1) % steps
        faces += [[len(rings), after, k], [len(rings) + 1, last + k, last + after]]
        for ring in range(len(theta) - 1):
            a, b = ring * steps + k, ring * steps + after
            faces += [[a, b, b + steps], [a, b + steps, a + steps]]
    return points, np.array(faces)


BALL, BALL_FACES = _ball()
PAIR_FACES = np.concatenate([BALL_FACES, BALL_FACES + len(BALL)])


def _centres(points: np.ndarray) -> np.ndarray:
    return points[PAIR_FACES].mean(axis=1)


@pytest.mark.parametrize("apart", [0.9, 1.5, 1.9])
def test_overlapping_balls_bury_the_caps_in_each_other(apart):
    points = np.concatenate([BALL, BALL + [0.36 * apart, 0.48 * apart, 0.8 * apart]])
    winding = ClosureFinder(PAIR_FACES, "cpu").at(points, 0.0).winding
    centres, half = _centres(points), len(BALL_FACES)
    other = np.repeat([points[len(BALL) :].mean(axis=0), [0.0, 0.0, 0.0]], half, axis=0)
    distance = np.linalg.norm(centres - other, axis=1)
    sure = np.abs(distance - 0.985) > 0.02  # the faceted ball lies between these radii
    np.testing.assert_array_equal(winding[sure], (distance < 0.985)[sure].astype(int))
    assert (winding == 1).sum() > 4


def test_skin_that_is_turned_inside_out_is_buried():
    finder = ClosureFinder(BALL_FACES, "cpu")
    assert not finder.at(BALL, 0.0).buried.any()
    assert (finder.at(BALL * [1.0, -1.0, 1.0], 0.0).winding == -1).all()


def test_gap_between_two_balls():
    """Faces look at each other along their normals: the gap is thinner than 0.1 within a cap that geometry gives."""
    points = np.concatenate([BALL, BALL + [0.0, 2.02, 0.0]]) * 0.5
    points[:, [0, 2]] += 0.003  # no ray through a vertex of the other ball
    finder = ClosureFinder(PAIR_FACES, "cpu")
    wide = finder.at(points, 0.1)
    centres = _centres(points)
    from_axis = np.linalg.norm(centres[:, [0, 2]] - 0.003, axis=1)
    facing = np.abs(centres[:, 1] - 0.505) < 0.3
    assert not wide.buried.any()
    assert wide.gaps[facing & (from_axis < 0.12)].all()
    assert not wide.gaps[~facing | (from_axis > 0.3)].any()
    np.testing.assert_array_equal(wide.closed, wide.gaps)
    assert not finder.at(points, 0.005).gaps.any()  # 10 mm at the narrowest


def test_gap_is_seen_from_either_side_and_measured_along_the_normal():
    """A small box before a large one: the centres of the large faces see past it, it sees them."""
    cube = np.array([[x, y, z] for x in (-1.0, 1.0) for y in (-1.0, 1.0) for z in (-1.0, 1.0)])
    sides = [[0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1]]
    sides = np.array([*sides, [2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3]])
    points = np.concatenate([cube, 0.05 * cube + [0.85, 0.75, 1.06]])  # 10 mm before the side at z = 1
    finder = ClosureFinder(np.concatenate([sides, sides + 8]), "cpu")
    assert not finder.at(points, 0.0099).gaps.any()
    gaps = np.flatnonzero(finder.at(points, 0.0101).gaps)
    small, large = gaps[gaps >= 12] - 12, gaps[gaps < 12]
    np.testing.assert_array_equal(small, [8, 9])  # its side at z = -1
    assert set(large) < {10, 11} and len(large) == 1


def test_one_finder_follows_the_pose():
    finder = ClosureFinder(PAIR_FACES, "cpu")
    apart, into = (np.concatenate([BALL, BALL + [0.0, y, 0.1]]) for y in (3.0, 1.2))
    assert not finder.at(apart, 0.01).closed.any()
    buried = finder.at(into, 0.01).buried
    assert buried.sum() > 100
    np.testing.assert_array_equal(finder.at(into + [7.0, -3.0, 90.0], 0.01).buried, buried)
    assert not finder.at(apart, 0.01).closed.any()


def test_arms_in_the_torso():
    """Standing, the body is open but for folds of a hand; with the arms pressed in, arms and flanks are buried."""
    body = Body.load("small")
    finder = ClosureFinder(body.faces, "cpu")
    assert not finder.at(body.vertices, 0.0).closed.any()
    pose = np.zeros((1, 24, 3))
    pose[0, JOINT_INDEX["left_shoulder"], 2] = -1.6
    pose[0, JOINT_INDEX["right_shoulder"], 2] = 1.6
    pressed = finder.at(body.posed(pose, np.zeros((1, 3)))[0], 0.0)
    assert isinstance(pressed, Closure) and (pressed.winding >= 0).all() and pressed.buried.sum() > 60
    part = body.part_of_vertex[body.faces[pressed.buried, 0]]
    names = {name for name, index in JOINT_INDEX.items() if index in part}
    assert {"left_shoulder", "right_shoulder"} <= names and names & {"spine2", "spine3", "spine1"}
    assert not names & {"left_knee", "right_knee", "left_foot", "right_foot", "head"}


def test_bad_input_is_named():
    with pytest.raises(ValueError, match="not closed"):
        ClosureFinder(BALL_FACES[3:], "cpu")
    finder = ClosureFinder(BALL_FACES, "cpu")
    with pytest.raises(ValueError, match="gap"):
        finder.at(BALL, -0.001)
    with pytest.raises(ValueError, match="gap"):
        finder.at(BALL, float("nan"))
    with pytest.raises(ValueError, match="vertex 0 is not finite"):
        finder.at(np.full_like(BALL, np.nan), 0.01)
