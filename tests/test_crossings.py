"""Crossings of garment and body: exact counts, depth, inside and pinched, on shapes whose answer is known."""

from __future__ import annotations

import numpy as np
import pytest

from body.model import Body
from motions.procedural import generate_clip
from sim.buried import PINCH_REACH, Closure
from sim.crossings import CrossingChecker

CUBE_VERTICES = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], dtype=np.float64) - 0.5
CUBE_FACES = np.array(
    [[0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1]]
    + [[2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3]]
)
FAR = 50.0 * CUBE_VERTICES  # a body that nothing meets; centred, so that float32 keeps the positions as they are


def _sheet(rows: int, columns: int, width: float, height: float) -> tuple[np.ndarray, np.ndarray]:
    """A grid in the plane z = 0 around the origin, sheared so that nothing lies on anything else."""
    u, v = np.meshgrid(np.linspace(-0.5, 0.5, columns), np.linspace(-0.5, 0.5, rows))
    points = np.stack([width * u + 0.0137 * v, height * v + 0.0071 * u, np.zeros_like(u)], axis=-1).reshape(-1, 3)
    corner = (np.arange(rows - 1)[:, None] * columns + np.arange(columns - 1)).ravel()
    lower = np.stack([corner, corner + 1, corner + columns + 1], axis=1)
    upper = np.stack([corner, corner + columns + 1, corner + columns], axis=1)
    return points, np.concatenate([lower, upper])


def _edge_hits(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Whether edges [N, 2, 3] hit triangles [N, 3, 3], by solving for the point: another road than determinants."""
    along = a[:, 1] - a[:, 0]
    system = np.stack([b[:, 1] - b[:, 0], b[:, 2] - b[:, 0], -along], axis=-1)
    u, v, t = np.linalg.solve(system, (a[:, 0] - b[:, 0])[..., None])[..., 0].T
    return (u > 0) & (v > 0) & (u + v < 1) & (t > 0) & (t < 1)


def _crossing_pairs(points: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """All crossing pairs without a common vertex, by brute force, shape [N, 2]."""
    i, j = np.triu_indices(len(faces), 1)
    apart = ~(faces[i][:, :, None] == faces[j][:, None, :]).any(axis=(1, 2))
    i, j = i[apart], j[apart]
    hit = np.zeros(len(i), dtype=bool)
    for one, other in ((points[faces[i]], points[faces[j]]), (points[faces[j]], points[faces[i]])):
        for edge in ([0, 1], [1, 2], [2, 0]):
            hit |= _edge_hits(one[:, edge], other)
    return np.stack([i[hit], j[hit]], axis=1)


def test_self_crossings_of_a_random_soup_equal_brute_force():
    generator = np.random.default_rng(3)
    points = generator.uniform(-1.0, 1.0, (180, 3)).astype(np.float32).astype(np.float64)
    faces = np.arange(180).reshape(60, 3)
    faces[30:40, 0] = faces[:10, 0]  # pairs with a common vertex are left out
    pairs = _crossing_pairs(points, faces)
    assert len(pairs) > 50
    found = CrossingChecker(faces, CUBE_FACES, "cpu").check(points, FAR)
    assert found.self_pairs == len(pairs)
    np.testing.assert_array_equal(found.self_count, np.bincount(pairs.ravel(), minlength=60))


def _two_sheets() -> tuple[np.ndarray, np.ndarray, int]:
    """Two crumpled sheets that pass through each other: points, faces and the first point of the second sheet."""
    points, faces = _sheet(9, 9, 1.0, 1.0)
    turned = points[:, [0, 2, 1]] @ np.array([[0.8, 0.0, 0.6], [0.0, 1.0, 0.0], [-0.6, 0.0, 0.8]])
    both = np.concatenate([points, turned]) + np.random.default_rng(5).normal(0.0, 0.004, (2 * len(points), 3))
    return both.astype(np.float32).astype(np.float64), np.concatenate([faces, faces + len(points)]), len(points)


def test_sheet_through_sheet_and_back():
    points, faces, second = _two_sheets()
    checker = CrossingChecker(faces, CUBE_FACES, "cpu")
    assert checker.check(points, FAR).self_pairs == len(_crossing_pairs(points, faces)) > 20
    # The search tree follows: apart again, there is nothing to count.
    points[second:, 2] += 2.0
    apart = checker.check(points, FAR)
    assert apart.self_pairs == 0 and not apart.self_count.any()


def test_touching_is_no_crossing():
    faces = np.array([[0, 1, 2], [3, 4, 5]])
    flat = [[-1.0, 0.0, -1.0], [1.0, 0.0, -1.0], [0.0, 0.0, 1.0]]
    checker = CrossingChecker(faces, CUBE_FACES, "cpu")

    def pairs(lift: float) -> int:
        standing = np.array([[0.0, 0.0, 0.0], [0.3, 1.0, 0.0], [-0.3, 1.0, 0.1]]) + [0.0, lift, 0.0]
        return checker.check(np.concatenate([flat, standing]), FAR).self_pairs

    assert pairs(0.0) == 0  # a corner on the face
    assert pairs(1.0e-6) == 0
    assert pairs(-1.0e-6) == 1
    coplanar = np.concatenate([flat, np.add(flat, [0.1, 0.0, 0.1])])
    assert checker.check(coplanar, FAR).self_pairs == 0


@pytest.mark.parametrize("place", [np.zeros(3), np.array([300.0, 2.0, -400.0])])
def test_depth_below_the_faces_of_a_box(place):
    """A sheet 3 cm below the top of a box is 3 cm deep wherever it is inside, anywhere in the world."""
    points, faces = _sheet(24, 24, 1.6, 1.6)
    points = points[:, [0, 2, 1]] + [0.003, 0.47, 0.001]
    found = CrossingChecker(faces, CUBE_FACES, "cpu").check(points + place, CUBE_VERTICES + place)
    inside = (np.abs(points[:, [0, 2]]) < 0.5).all(axis=1)
    np.testing.assert_array_equal(found.vertex_depth > 0.0, inside)
    expected = 0.5 - np.abs(points[inside]).max(axis=1)
    np.testing.assert_allclose(found.vertex_depth[inside], expected, atol=1e-6)
    corners = inside[faces]
    assert (found.body_count > 0)[corners.any(axis=1) & ~corners.all(axis=1)].all()  # those across the rim cross it
    assert not found.body_count[corners.all(axis=1)].any()
    assert found.triangle_inside[corners.any(axis=1)].all()
    assert found.vertices_inside == inside.sum() and found.pinched_vertices == 0
    assert found.deepest_m == pytest.approx(0.03, abs=1e-4)


def test_body_vertex_that_pokes_through_a_large_triangle():
    """No corner, midpoint or centroid of the triangle is inside; it has the depth of the tip that pierces it."""
    tip = np.array([0.25, 0.0, 0.05])
    body = np.array([tip, [0.19, -0.08, -0.03], [0.33, -0.08, 0.0], [0.22, -0.08, 0.17]])
    faces = np.array([[0, 1, 3], [0, 2, 1], [0, 3, 2], [1, 2, 3]])
    cloth = np.array([[-0.6, 0.0, -0.3], [0.6, 0.0, -0.3], [0.0, 0.0, 1.1]])
    checker = CrossingChecker(np.array([[0, 1, 2]]), faces, "cpu")
    for depth in (0.004, 0.02):
        found = checker.check(cloth - [0.0, depth, 0.0], body)
        assert found.vertices_inside == 0 and found.triangles_inside == 1 and found.body_pairs == 3
        # The sides of the tip are nearer than its point.
        assert 0.3 * depth < found.deepest_m <= depth
    assert checker.check(cloth + [0.0, 0.001, 0.0], body).triangles_inside == 0


def _winding_numbers(points: np.ndarray, vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Sum of the solid angles of all faces (van Oosterom and Strackee 1983), shape [N]."""
    a, b, c = (vertices[faces[:, k]][None] - points[:, None] for k in range(3))
    la, lb, lc = (np.linalg.norm(side, axis=-1) for side in (a, b, c))
    determinant = np.einsum("nfi,nfi->nf", a, np.cross(b, c))
    weight = la * lb * lc + (a * b).sum(-1) * lc + (b * c).sum(-1) * la + (c * a).sum(-1) * lb
    return np.arctan2(determinant, weight).sum(axis=1) / (2.0 * np.pi)


def test_inside_a_squatting_body_is_where_solid_angles_say():
    body = Body.load("small")
    clip = generate_clip("squat", 0, 40, 30.0, 1, body)
    vertices = body.posed(clip.pose, clip.root)[39].astype(np.float64)
    generator = np.random.default_rng(2)
    picked = vertices[generator.choice(len(vertices), 240, replace=False)]
    points = picked + generator.normal(0.0, 0.03, picked.shape)
    found = CrossingChecker(np.arange(240).reshape(80, 3), body.faces, "cpu").check(points, vertices)
    expected = np.rint(_winding_numbers(points, vertices, body.faces)) > 0
    assert 60 < expected.sum() < 180
    np.testing.assert_array_equal(found.vertex_depth > 0.0, expected)


def test_only_what_is_near_closed_faces_is_pinched():
    points, faces = _sheet(64, 64, 1.2, 1.2)
    points = points[:, [0, 2, 1]] + [0.003, 0.47, 0.001]
    # One side of the box is closed to cloth; most of the sheet is far from it.
    side = (CUBE_VERTICES[CUBE_FACES][:, :, 0] > 0.0).all(axis=1)
    closure = Closure(side.astype(np.int32), np.zeros(len(side), dtype=bool))
    found = CrossingChecker(faces, CUBE_FACES, "cpu").check(points, CUBE_VERTICES, closure)
    inside = (np.abs(points[:, [0, 2]]) < 0.5).all(axis=1)
    room = 0.5 - np.abs(points)
    nearest_is_side = (points[:, 0] > 0.0) & (room.argmin(axis=1) == 0)
    pinched = inside & (nearest_is_side | (points[:, 0] > 0.5 - PINCH_REACH))
    np.testing.assert_array_equal(found.vertex_pinched, pinched)
    assert found.pinched_vertices == pinched.sum() > 40
    assert found.vertices_inside == inside.sum() - pinched.sum()
    assert found.pinched_triangles > 0 and found.triangles_inside > 10 * found.pinched_triangles
    assert found.pinched_body_pairs > 0 and found.body_pairs > found.pinched_body_pairs
    assert found.deepest_pinched_m == pytest.approx(0.03, abs=1e-4)


def test_what_is_inside_at_faces_set_aside_is_no_fault():
    points, faces = _sheet(64, 64, 1.2, 1.2)
    points = points[:, [0, 2, 1]] + [0.003, 0.47, 0.001]
    side = (CUBE_VERTICES[CUBE_FACES][:, :, 0] > 0.0).all(axis=1)
    everywhere = Closure(np.ones(len(CUBE_FACES), dtype=np.int32), np.zeros(len(CUBE_FACES), dtype=bool))
    checker = CrossingChecker(faces, CUBE_FACES, "cpu", aside=side)
    found, plain = (
        checker.check(points, CUBE_VERTICES),
        CrossingChecker(faces, CUBE_FACES, "cpu").check(points, CUBE_VERTICES),
    )
    inside = (np.abs(points[:, [0, 2]]) < 0.5).all(axis=1)
    at_side = inside & (points[:, 0] > 0.0) & ((0.5 - np.abs(points)).argmin(axis=1) == 0)
    np.testing.assert_array_equal(found.vertex_aside, at_side)
    assert found.aside_vertices == at_side.sum() and found.vertices_inside == (inside & ~at_side).sum()
    # Triangles through that side alone are aside; those through the rim that it shares with another are not.
    x, z = points[faces][:, :, 0], points[faces][:, :, 2]
    across = (x.min(axis=1) < 0.5) & (x.max(axis=1) > 0.5)
    assert found.triangle_aside[across & (np.abs(z) < 0.5).all(axis=1)].all()
    other = (np.abs(z).min(axis=1) < 0.5) & (np.abs(z).max(axis=1) > 0.5) & (np.abs(x) < 0.5).all(axis=1)
    assert other.sum() > 50 and not found.triangle_aside[other].any()
    # Around a vertical edge of the box: all turns have one sign.
    turns = (x - 0.5) * np.roll(z - 0.5, 1, axis=1) - (z - 0.5) * np.roll(x - 0.5, 1, axis=1)
    around_edge = (turns > 0.0).all(axis=1) | (turns < 0.0).all(axis=1)
    assert around_edge.sum() == 1 and not found.triangle_aside[around_edge].any()
    assert found.triangles_inside + found.aside_triangles == plain.triangles_inside
    assert found.body_pairs < plain.body_pairs and plain.aside_triangles == plain.aside_vertices == 0
    closed = checker.check(points, CUBE_VERTICES, everywhere)  # what is aside does not count as pinched either
    assert closed.aside_triangles == found.aside_triangles and closed.pinched_triangles == found.triangles_inside
    assert closed.aside_vertices == found.aside_vertices and closed.pinched_vertices == found.vertices_inside


def test_self_crossings_in_a_pinch_are_told_apart():
    points, faces, _ = _two_sheets()
    checker = CrossingChecker(faces, CUBE_FACES, "cpu")
    everywhere = Closure(np.ones(len(CUBE_FACES), dtype=np.int32), np.zeros(len(CUBE_FACES), dtype=bool))
    around = 3.0 * CUBE_VERTICES + [1.5, 0.0, 0.0]  # one of its sides cuts through the sheets
    found = checker.check(points, around, everywhere)
    assert 0 < found.pinched_self_pairs < found.self_pairs
    assert checker.check(points, around).pinched_self_pairs == 0


def test_the_same_positions_give_the_same_figures():
    points, faces = _sheet(12, 12, 1.2, 1.2)
    points = points[:, [0, 2, 1]] + [0.003, 0.49, 0.001]
    checker = CrossingChecker(faces, CUBE_FACES, "cpu")
    first = checker.check(points, CUBE_VERTICES)
    checker.check(points + 1.0, CUBE_VERTICES)
    second = checker.check(points, CUBE_VERTICES)
    np.testing.assert_array_equal(first.triangle_depth, second.triangle_depth)
    np.testing.assert_array_equal(first.body_count, second.body_count)


def test_bad_input_is_named():
    with pytest.raises(ValueError, match="not closed"):
        CrossingChecker(CUBE_FACES, CUBE_FACES[1:], "cpu")
    with pytest.raises(ValueError, match="oriented alike"):
        CrossingChecker(CUBE_FACES, np.concatenate([CUBE_FACES[1:], CUBE_FACES[:1, ::-1]]), "cpu")
    with pytest.raises(ValueError, match="aside: expected bool of shape"):
        CrossingChecker(CUBE_FACES, CUBE_FACES, "cpu", aside=np.zeros(5, dtype=bool))
    with pytest.raises(ValueError, match="garment faces"):
        CrossingChecker(CUBE_FACES.astype(float), CUBE_FACES, "cpu")
    checker = CrossingChecker(CUBE_FACES, CUBE_FACES, "cpu")
    with pytest.raises(ValueError, match="garment positions: expected shape"):
        checker.check(CUBE_VERTICES[:5], CUBE_VERTICES)
    broken = CUBE_VERTICES.copy()
    broken[3, 1] = np.nan
    with pytest.raises(ValueError, match="vertex 3 is not finite"):
        checker.check(CUBE_VERTICES, broken)
    with pytest.raises(ValueError, match="closure"):
        checker.check(CUBE_VERTICES, CUBE_VERTICES, Closure(np.zeros(3, dtype=np.int32), np.zeros(3, dtype=bool)))
