"""Closest points and signed distances against brute force and analytic solids."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.sparse import coo_matrix

from geometry.proximity import Sheet, SurfaceQuery, closest_surface


def closest_on_triangle(p: np.ndarray, a: np.ndarray, b: np.ndarray, c: np.ndarray) -> np.ndarray:
    """Reference for one pair (Ericson 2005, Real-Time Collision Detection, section 5.1.5)."""
    ab, ac, ap = b - a, c - a, p - a
    d1, d2 = ab @ ap, ac @ ap
    if d1 <= 0 and d2 <= 0:
        return a
    bp = p - b
    d3, d4 = ab @ bp, ac @ bp
    if d3 >= 0 and d4 <= d3:
        return b
    vc = d1 * d4 - d3 * d2
    if vc <= 0 and d1 >= 0 and d3 <= 0:
        return a + d1 / (d1 - d3) * ab
    cp = p - c
    d5, d6 = ab @ cp, ac @ cp
    if d6 >= 0 and d5 <= d6:
        return c
    vb = d5 * d2 - d1 * d6
    if vb <= 0 and d2 >= 0 and d6 <= 0:
        return a + d2 / (d2 - d6) * ac
    va = d3 * d6 - d5 * d4
    if va <= 0 and d4 - d3 >= 0 and d5 - d6 >= 0:
        return b + (d4 - d3) / ((d4 - d3) + (d5 - d6)) * (c - b)
    return a + ab * vb / (va + vb + vc) + ac * vc / (va + vb + vc)


def bumpy_sphere(rows: int = 12, columns: int = 18) -> tuple[np.ndarray, np.ndarray]:
    """Closed, star-shaped, uneven surface: small faces at the poles, large ones at the equator."""
    theta = np.linspace(0, np.pi, rows + 1)[1:-1]
    phi = np.arange(columns) * 2 * np.pi / columns
    t, p = np.meshgrid(theta, phi, indexing="ij")
    radius = 0.3 + 0.08 * np.sin(3 * p) * np.sin(t) + 0.05 * np.cos(5 * t)
    ring = np.stack([radius * np.sin(t) * np.cos(p), radius * np.cos(t), -radius * np.sin(t) * np.sin(p)], -1)
    vertices = np.concatenate([ring.reshape(-1, 3), [[0, 0.35, 0]], [[0, -0.35, 0]]])
    north, south = len(vertices) - 2, len(vertices) - 1
    faces = []
    for i in range(rows - 2):
        for j in range(columns):
            a, b = i * columns + j, i * columns + (j + 1) % columns
            faces += [[a, a + columns, b], [b, a + columns, b + columns]]
    for j in range(columns):
        last = (rows - 2) * columns
        faces += [[north, j, (j + 1) % columns], [south, last + (j + 1) % columns, last + j]]
    return vertices, np.array(faces)


def cube() -> tuple[np.ndarray, np.ndarray]:
    """Unit cube around the origin, outward faces."""
    vertices = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], dtype=float) - 0.5
    quads = [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]]
    return vertices, np.array([f for a, b, c, d in quads for f in ([a, b, c], [a, c, d])])


@pytest.mark.parametrize("spread", [0.02, 0.3, 2.0])
def test_equals_brute_force(spread: float) -> None:
    vertices, faces = bumpy_sphere()
    rng = np.random.default_rng(3)
    points = vertices[rng.integers(len(vertices), size=60)] + spread * rng.standard_normal((60, 3))
    hits = closest_surface(points, vertices, faces)
    for k, point in enumerate(points):
        best = min(np.linalg.norm(point - closest_on_triangle(point, *vertices[face])) for face in faces)
        assert abs(hits.distance[k]) == pytest.approx(best, abs=1e-12)
    rebuilt = np.einsum("nk,nkc->nc", hits.barycentric, vertices[faces[hits.face]])
    np.testing.assert_allclose(rebuilt, hits.point, atol=1e-14)
    np.testing.assert_allclose(np.linalg.norm(points - hits.point, axis=1), np.abs(hits.distance), atol=1e-12)


def test_sign_of_a_star_shaped_body() -> None:
    vertices, faces = bumpy_sphere()
    rng = np.random.default_rng(4)
    surface = vertices[faces].mean(axis=1)[rng.integers(len(faces), size=400)]
    factor = rng.uniform(0.2, 1.8, 400)
    hits = closest_surface(surface * factor[:, None], vertices, faces)
    np.testing.assert_array_equal(hits.distance < 0, factor < 1)


def test_cube_distance_is_analytic_also_beside_edges_and_corners() -> None:
    vertices, faces = cube()
    points = np.random.default_rng(5).uniform(-1.2, 1.2, (800, 3))
    corner_rays = np.array([[s, s, s] for s in np.linspace(0.51, 1.5, 20)])
    points = np.concatenate([points, corner_rays, corner_rays * [1, 1, 0]])
    over = np.abs(points) - 0.5
    expected = np.linalg.norm(np.maximum(over, 0), axis=1) + np.minimum(over.max(axis=1), 0)
    np.testing.assert_allclose(closest_surface(points, vertices, faces).distance, expected, atol=1e-12)


def test_pseudo_normal_of_a_sharp_spike() -> None:
    # A needle's tip: the face next to the point faces away from it, only the angle-weighted sum knows the outside.
    base = np.array([[0.05, 0, 0], [-0.03, 0, -0.04], [-0.03, 0, 0.04]])
    vertices = np.concatenate([base, [[0.4, 1.0, 0.3]]])
    faces = np.array([[0, 1, 3], [1, 2, 3], [2, 0, 3], [0, 2, 1]])
    above = vertices[3] + [[0.02, 0.03, 0.0], [0.0, 0.02, 0.03], [-0.01, 0.05, -0.01], [0.1, 0.02, -0.05]]
    hits = closest_surface(above, vertices, faces)
    np.testing.assert_allclose(hits.point, np.repeat(vertices[3:], 4, axis=0), atol=1e-12)
    assert (hits.distance > 0).all()


def test_sheet_knows_its_sides_beyond_the_reach() -> None:
    # A flat sheet through the solid: its middle is far inside, its rim far outside, and a loose vertex hangs nowhere.
    vertices, faces = bumpy_sphere(40, 60)
    line = np.linspace(-0.6, 0.6, 61)
    x, z = np.meshgrid(line, line, indexing="ij")
    points = np.stack([x, 0.01 + 0.0 * x, z], axis=-1).reshape(-1, 3)
    index = np.arange(61 * 61).reshape(61, 61)
    pairs = np.concatenate(
        [
            np.stack([index[1:], index[:-1]], -1).reshape(-1, 2),
            np.stack([index[:, 1:], index[:, :-1]], -1).reshape(-1, 2),
        ]
    )
    points, loose = np.concatenate([points, [[0.02, 0.0, 0.01]]]), 61 * 61
    graph = coo_matrix((np.ones(len(pairs)), pairs.T), shape=(loose + 1, loose + 1))
    posed = SurfaceQuery(faces, len(vertices)).at(vertices)
    whole, sheet = posed.query(points), posed.query_sheet(points, Sheet((graph + graph.T).tocsr()), 0.03)
    far = whole.distance > 0.03
    assert far.sum() > 1000 and (whole.distance < -0.1).sum() > 50
    np.testing.assert_array_equal(np.isinf(sheet.distance), far)
    np.testing.assert_array_equal(sheet.face < 0, far)
    for name in ("distance", "point", "normal"):
        np.testing.assert_allclose(getattr(sheet, name)[~far], getattr(whole, name)[~far], atol=1e-9)
    # Edges longer than the reach say nothing: every vertex is then asked for itself.
    wide = posed.query_sheet(points, Sheet((graph + graph.T).tocsr()), 0.019)
    np.testing.assert_allclose(wide.distance, whole.distance, atol=1e-9)
    with pytest.raises(ValueError, match="3722 vertices of the sheet, got 5"):
        posed.query_sheet(points[:5], Sheet((graph + graph.T).tocsr()), 0.03)


def test_two_instants_of_one_surface_do_not_mix() -> None:
    vertices, faces = bumpy_sphere()
    query, points, shift = SurfaceQuery(faces, len(vertices)), vertices * 1.1, np.array([0.0, 0.3, 0.0])
    here, there = query.at(vertices), query.at(vertices + shift)
    first = here.query(points).distance
    np.testing.assert_allclose(there.query(points + shift).distance, first, atol=1e-9)
    np.testing.assert_array_equal(here.query(points).distance, first)
    vertices += 1.0  # what was asked for stays what it was
    np.testing.assert_array_equal(here.query(points).distance, first)


def test_what_has_not_moved_is_not_looked_up_again() -> None:
    vertices, faces = bumpy_sphere()
    rng = np.random.default_rng(4)
    surface, before = SurfaceQuery(faces).at(vertices), rng.normal(size=(50, 3))
    known = surface.query(before)
    after = before.copy()
    after[::7] += 0.1
    found, expected = surface.query_moved(after, before, known), surface.query(after)
    for name, array in vars(expected).items():
        assert np.array_equal(getattr(found, name), array), name
    assert known.distance[0] != found.distance[0]  # what was known stays as it was
    assert surface.query_moved(before, before, known) is known
    wrong = surface.query(after + 1.0)
    assert np.array_equal(surface.query_moved(after, before, wrong).distance[1:7], wrong.distance[1:7])


def test_moves_with_the_mesh_and_survives_slivers() -> None:
    vertices, faces = bumpy_sphere()
    # A zero-area face does not disturb its neighbours.
    sliver = np.concatenate([faces, [[0, 1, 0]]])
    query = SurfaceQuery(sliver, len(vertices))
    points = np.random.default_rng(7).normal(size=(50, 3)) * 0.4
    shift = np.array([3.0, -1.0, 2.0])
    still, moved = query.query(points, vertices), query.query(points + shift, vertices + shift)
    np.testing.assert_allclose(moved.distance, still.distance, atol=1e-9)
    np.testing.assert_allclose(
        np.abs(still.distance), np.abs(closest_surface(points, vertices, faces).distance), atol=1e-12
    )


def test_bad_input_is_named() -> None:
    vertices, faces = cube()
    with pytest.raises(ValueError, match="expected 8 rows, got 7"):
        SurfaceQuery(faces, 8).query(vertices, vertices[:7])
    with pytest.raises(ValueError, match="not finite"):
        closest_surface(np.full((2, 3), np.nan), vertices, faces)
    with pytest.raises(ValueError, match="faces"):
        SurfaceQuery(faces[:, :2])
