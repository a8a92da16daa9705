"""Refinement: no vertex inside afterwards, detail kept, far vertices unmoved, deep cases on the right side."""

from __future__ import annotations

import numpy as np
import pytest

from geometry.proximity import SurfaceQuery
from geometry.topology import MeshTopology, vertex_normals
from models.handle_solver import HandleSolver
from models.last_resort import project_out
from models.refinement import RefinementSettings, Refiner, refine_sequence


def sheet(side: int = 25, size: float = 0.6) -> tuple[np.ndarray, MeshTopology]:
    """Wavy horizontal sheet around y = 0: vertices [side^2, 3] and connectivity."""
    line = np.linspace(-size / 2, size / 2, side)
    x, z = np.meshgrid(line, line, indexing="ij")
    vertices = np.stack([x, 0.004 * np.sin(40 * x), z], axis=-1).reshape(-1, 3)
    index = np.arange(side * side).reshape(side, side)
    a, b = index[:-1, :-1].ravel(), index[1:, :-1].ravel()
    c, d = index[:-1, 1:].ravel(), index[1:, 1:].ravel()
    faces = np.concatenate([np.stack([a, c, b], axis=1), np.stack([b, c, d], axis=1)])
    return vertices, MeshTopology.from_faces(faces, len(vertices))


def solid(rows: int, columns: int, radius: float, half_length: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """Closed sphere, or capsule along z of the given half length: vertices and outward faces."""
    theta = np.linspace(0, np.pi, rows + 1)[1:-1]
    phi = np.arange(columns) * 2 * np.pi / columns
    t, p = np.meshgrid(theta, phi, indexing="ij")
    z = radius * np.cos(t) + half_length * np.sign(np.round(np.cos(t), 9))
    ring = np.stack([radius * np.sin(t) * np.cos(p), radius * np.sin(t) * np.sin(p), z], axis=-1)
    end = radius + half_length
    vertices = np.concatenate([ring.reshape(-1, 3), [[0, 0, end], [0, 0, -end]]])
    north, south, last = len(vertices) - 2, len(vertices) - 1, (rows - 2) * columns
    faces = []
    for j in range(columns):
        k = (j + 1) % columns
        faces += [[north, j, k], [south, last + k, last + j]]
        for i in range(rows - 2):
            a, b = i * columns + j, i * columns + k
            faces += [[a, a + columns, b], [b, a + columns, b + columns]]
    return vertices, np.array(faces)


def test_sphere_pushed_into_a_sheet() -> None:
    vertices, topology = sheet()
    ball, faces = solid(16, 24, radius=0.1)
    ball = ball - [0.0031, 0.085, 0.0047]  # 15 mm through the sheet
    query = SurfaceQuery(faces, len(ball))
    assert (query.query(vertices, ball).distance < 0).sum() > 8
    refined, stats = refine_sequence(vertices[None], ball[None], topology, faces)
    assert query.query(refined[0], ball).distance.min() > 0
    assert stats.inside > 8 and stats.inside_after == 0 and stats.projected == 0
    assert stats.iterations <= 5

    move = np.linalg.norm(refined[0] - vertices, axis=1)
    assert 0.015 < move.max() < 0.03
    # The rim of the sheet is ten edges away from the ball and stays where it was.
    rim = np.abs(vertices[:, [0, 2]]).max(axis=1) > 0.29
    assert move[rim].max() < 0.15 * move.max()
    # Local shape: pushing the vertices out one by one would leave a far greater change of the Laplacian.
    laplacian = topology.uniform_laplacian()
    hits = query.query(vertices, ball)
    naive = np.where(hits.distance[:, None] < 0, hits.point + 0.003 * hits.normal, vertices)
    changes = [np.linalg.norm(laplacian @ (v - vertices)) for v in (refined[0], naive)]
    assert changes[0] < 0.8 * changes[1]


def test_body_between_the_vertices_of_a_coarse_sheet() -> None:
    # A small ball lies under the middle of the sheet's edges: no vertex is inside, its triangles are cut.
    vertices, topology = sheet(9, size=0.8)
    ball, faces = solid(16, 24, radius=0.04)
    ball = ball + [0.05, -0.032, 0.003]
    query = SurfaceQuery(faces, len(ball))
    assert query.query(vertices, ball).distance.min() > 0
    i, j = topology.edges.T

    def cut_edges(v: np.ndarray) -> int:
        return int((query.query(0.5 * (v[i] + v[j]), ball).distance < 0).sum())

    assert cut_edges(vertices) > 0
    as_paper, _ = refine_sequence(vertices[None], ball[None], topology, faces)
    np.testing.assert_array_equal(as_paper[0], vertices.astype(np.float32))
    refined, stats = refine_sequence(vertices[None], ball[None], topology, faces, RefinementSettings(edges=True))
    assert cut_edges(refined[0]) == 0 and stats.inside_after == 0
    assert query.query(refined[0], ball).distance.min() > 0
    assert stats.largest_move < 0.02


def test_body_is_not_seen_through_a_triangle_whose_edges_touch_it() -> None:
    vertices, topology = sheet(9, size=0.8)
    vertices[:, 1] = 0.0
    corners = topology.faces[60]
    ball, faces = solid(96, 96, radius=0.3)
    ball = ball + vertices[corners].mean(axis=0) - [0.0, 0.2992, 0.0]
    query, (i, j) = SurfaceQuery(faces, len(ball)), topology.edges.T
    assert query.query(0.5 * (vertices[i] + vertices[j]), ball).distance.min() > 0.0
    assert query.query(vertices[topology.faces].mean(axis=1), ball).distance.min() < -0.0005
    refined, stats = refine_sequence(vertices[None], ball[None], topology, faces, RefinementSettings(edges=True))
    assert stats.inside == 0 and query.query(refined[0][topology.faces].mean(axis=1), ball).distance.min() > 0.0


def test_free_garment_comes_back_bit_for_bit() -> None:
    vertices, topology = sheet(12)
    ball, faces = solid(10, 14, radius=0.1)
    clear = (vertices + [0, 0.15, 0]).astype(np.float32)
    refined, stats = refine_sequence(clear[None], ball[None], topology, faces)
    np.testing.assert_array_equal(refined[0], clear)
    assert stats.inside == stats.iterations == stats.frames_touched == 0


def test_sheet_beyond_the_middle_of_a_limb_goes_back_to_its_own_side() -> None:
    # The limb's axis lies above the sheet's middle: the closest surface of the deepest vertices is the far side, below.
    vertices, topology = sheet()
    limb, faces = solid(24, 20, radius=0.04, half_length=0.6)
    limb = limb + [0, 0.012, 0]
    assert SurfaceQuery(faces, len(limb)).query(vertices, limb).distance.min() < -0.02
    # The sheet comes from above: its rows beside the limb are lifted over it, as cloth hanging on an arm.
    lifted = vertices.copy()
    lifted[:, 1] += 0.06 * np.clip(np.abs(vertices[:, 0]) / 0.06, 0, 1)
    refiner = Refiner(topology, faces, len(limb))
    refined, stats = refiner.refine_frame(lifted, limb)
    assert stats.inside_after == 0 and stats.redirected > 0
    middle = np.abs(vertices[:, 0]) < 0.01
    assert (refined[middle, 1] > limb[:, 1].mean()).all(), "cloth was pulled through the limb"


def test_garment_wholly_inside_is_brought_out() -> None:
    vertices, topology = sheet(8, size=0.05)
    ball, faces = solid(12, 16, radius=0.1)
    refined, stats = refine_sequence(vertices[None], ball[None], topology, faces, RefinementSettings(iterations=1))
    assert stats.inside == len(vertices)
    assert stats.inside_after == 0
    assert SurfaceQuery(faces, len(ball)).query(refined[0], ball).distance.min() > 0


def test_vertex_whose_closest_surface_is_buried_is_drawn_out() -> None:
    # Two balls run through each other, like limbs in an armpit: the surface of either is buried in the other.
    vertices, topology = sheet(13, size=0.09)
    vertices[:, 1] = np.abs(vertices[:, 2]) + 0.02 * np.hypot(vertices[:, 0], vertices[:, 2]) + 0.001
    ball, faces = solid(16, 24, radius=0.03)
    two = np.concatenate([ball - [0.0, 0.0, 0.012], ball + [0.0, 0.0, 0.012]])
    both = np.concatenate([faces, faces + len(ball)])
    query = SurfaceQuery(both, len(two))
    refiner = Refiner(topology, both, len(two))
    rng = np.random.default_rng(0)
    drawn = 0
    for _ in range(8):
        scene = two + rng.normal(0.0, 0.0006, 3) + [0.0, rng.uniform(0.0, 0.006), 0.0]
        refined, stats = refiner.refine_frame(vertices, scene)
        assert stats.inside_after == 0
        assert query.query(refined, scene).distance.min() >= 0.0
        # The last step alone, with closest points that are no help at all.
        inside = query.query(vertices, scene).distance < 0.0
        buried = scene[: len(ball)].mean(0) + np.zeros_like(vertices)
        at = refiner.body.at(scene)
        nowhere = np.zeros_like(vertices)
        out, moved, left = project_out(at, topology.edges, vertices, inside, buried, nowhere, 0.003)
        assert moved == inside.sum() and left == 0
        assert query.query(out, scene).distance.min() >= 0.0
        drawn += moved
    assert drawn > 50


def test_displacements_equal_those_of_the_whole_system(monkeypatch: pytest.MonkeyPatch) -> None:
    vertices, topology = sheet(20)
    rng = np.random.default_rng(1)
    laplacian = topology.uniform_laplacian().toarray()
    solver = HandleSolver(topology, weight=100.0, anchor=1e-3)
    for count in (1, 30, 95):
        held = rng.choice(len(vertices), count, replace=False)
        wanted = 0.02 * rng.standard_normal((count, 3))
        matrix = laplacian.T @ laplacian + 1e-3 * np.eye(len(vertices))
        matrix[held, held] += 100.0
        right = np.zeros_like(vertices)
        right[held] = 100.0 * wanted
        full = np.linalg.solve(matrix, right)
        np.testing.assert_allclose(solver.solve(held, wanted), full, atol=1e-6)
        np.testing.assert_allclose(solver.solve_anew(held, wanted), full, atol=1e-9)
    # With room for a part of the rows the first ones make way for the next; with too many handles none are used.
    monkeypatch.setattr("models.handle_solver.MOST_BYTES", 40 * 4 * len(vertices))
    small = HandleSolver(topology, weight=100.0, anchor=1e-3)
    for held in (np.arange(25), np.arange(20, 50), np.arange(25), np.arange(95)):
        wanted = 0.02 * rng.standard_normal((len(held), 3))
        np.testing.assert_allclose(small.solve(held, wanted), small.solve_anew(held, wanted), atol=1e-6)


def test_no_vertex_is_left_inside_awkward_bodies() -> None:
    # Limbs that cross each other, a sheet that hangs through both of them, coarse (edges beyond the horizon) and fine.
    limb, faces = solid(16, 14, radius=0.05, half_length=0.3)
    rng = np.random.default_rng(5)
    across = limb[:, [2, 0, 1]] + [0.0, 0.02, 0.0]
    body = np.concatenate([limb, across])
    both = np.concatenate([faces, faces + len(limb)])
    query = SurfaceQuery(both, len(body))
    inside = deep = 0
    for side in (9, 30):
        vertices, topology = sheet(side, size=0.5)
        refiner = Refiner(topology, both, len(body), RefinementSettings(clearance=0.002))
        for turn in range(6):
            angle = 0.3 * turn
            tilt = np.array([[np.cos(angle), np.sin(angle), 0], [-np.sin(angle), np.cos(angle), 0], [0, 0, 1]])
            posed = vertices @ tilt + 0.03 * rng.standard_normal(3)
            refined, stats = refiner.refine_frame(posed, body)
            before = query.query(posed, body).distance
            assert stats.inside == (before < 0.0).sum() and stats.inside_after == 0
            assert query.query(refined, body).distance.min() >= 0.0
            inside, deep = inside + stats.inside, deep + (before < -0.02).sum()
    assert inside > 300 and deep > 50


def test_what_is_far_from_the_collision_stays() -> None:
    # The prediction is right there: error against the truth grew when a push spread over half of the garment.
    vertices, topology = sheet()
    ball, faces = solid(16, 24, radius=0.1)
    refined, _ = refine_sequence(vertices[None], (ball - [0.0031, 0.085, 0.0047])[None], topology, faces)
    move = np.linalg.norm(refined[0] - vertices, axis=1)
    reach = np.linalg.norm(vertices[:, [0, 2]] + [0.0031, 0.0047], axis=1)  # the ball touches up to 53 mm
    assert move[reach > 0.053 + 6 * 0.025].max() < 0.08 * move.max()


def test_result_moves_with_the_scene() -> None:
    vertices, topology = sheet(15)
    ball, faces = solid(12, 16, radius=0.12)
    ball = ball - [0.0031, 0.1, 0.0047]
    shift = np.array([1.0, 0.5, -2.0])
    here, _ = refine_sequence(vertices[None], ball[None], topology, faces)
    there, _ = refine_sequence((vertices + shift)[None], (ball + shift)[None], topology, faces)
    np.testing.assert_allclose(there - shift, here, atol=2e-6)


def test_bad_input_is_named() -> None:
    vertices, topology = sheet(8)
    ball, faces = solid(8, 10, radius=0.1)
    with pytest.raises(ValueError, match="expected shape \\[64, 3\\], got \\[63, 3\\]"):
        Refiner(topology, faces, len(ball)).refine_frame(vertices[:-1], ball)
    with pytest.raises(ValueError, match="2 frames, body_vertices 1"):
        refine_sequence(np.stack([vertices] * 2), ball[None], topology, faces)
    with pytest.raises(ValueError, match="clearance"):
        RefinementSettings(clearance=0.0)


def tube(radius: float, length: float, around: int, along: int) -> tuple[np.ndarray, MeshTopology]:
    """Open tube along z, faces outwards: vertices [around * along, 3] and connectivity."""
    angle, z = np.meshgrid((np.arange(around) + 0.5) * 2 * np.pi / around, np.linspace(-length / 2, length / 2, along))
    vertices = np.stack([radius * np.cos(angle), radius * np.sin(angle), z], axis=-1).reshape(-1, 3)
    index = np.arange(around * along).reshape(along, around)
    a, b = index[:-1], index[1:]
    c, d = np.roll(a, -1, axis=1), np.roll(b, -1, axis=1)
    faces = np.concatenate([np.stack(corners, axis=-1).reshape(-1, 3) for corners in ((a, c, b), (b, c, d))])
    return vertices, MeshTopology.from_faces(faces, len(vertices))


@pytest.mark.parametrize("outwards", [True, False])
def test_a_sleeve_that_sank_into_its_arm_is_not_drawn_through_it(outwards: bool) -> None:
    # The under side of the sleeve lies above the arm's axis: its closest surface is in front or behind, not below.
    sleeve, topology = tube(radius=0.052, length=0.3, around=20, along=13)
    sunk = np.exp(-np.square(sleeve[:, 2] / 0.06)) * np.maximum(0.0, -sleeve[:, 1] / 0.052)
    sleeve[:, 1] += 0.056 * sunk
    if not outwards:
        topology = MeshTopology.from_faces(topology.faces[:, ::-1], len(sleeve))
    arm, faces = solid(24, 28, radius=0.045, half_length=0.3)
    query = SurfaceQuery(faces, len(arm))
    assert query.query(sleeve, arm).distance.min() < -0.03
    refined, stats = refine_sequence(sleeve[None], arm[None], topology, faces, RefinementSettings(edges=True))
    assert stats.inside_after == 0 and stats.redirected > 0
    i, j = topology.edges.T
    assert query.query(0.5 * (refined[0][i] + refined[0][j]), arm).distance.min() > -0.002
    length, before = (np.linalg.norm(v[i] - v[j], axis=1) for v in (refined[0], sleeve))
    assert (length - before).max() < 0.045, "the sleeve is torn to both sides of the arm"
    assert refined[0][:, 1].min() < -0.04, "the sleeve is not around the arm"


def test_an_elbow_in_a_shirt_is_not_wrapped() -> None:
    # An arm is pressed into the side of a shirt: its cloth goes behind it, although its own normals lead
    # through the arm.
    side, topology = sheet(30, size=0.6)
    facing = np.sign(vertex_normals(side[None], topology.faces)[0, :, 1].mean())
    arm, faces = solid(24, 28, radius=0.045, half_length=0.1)
    # A second limb under the shirt, as the trunk is, tells which of its faces is the outer one.
    trunk = arm - [0.2, facing * 0.047, 0.0]
    both = np.concatenate([faces, faces + len(arm)])
    refiner = Refiner(topology, both, 2 * len(arm), RefinementSettings(edges=True))
    for height in (0.008, 0.004):
        refined, stats = refiner.refine_frame(side, np.concatenate([arm + [0.05, facing * height, 0.0], trunk]))
        assert stats.inside > 20 and stats.inside_after == 0
        assert (facing * refined[:, 1]).max() < 0.03, "the shirt is wrapped about the arm"


def test_edges_come_out_where_vertices_take_every_solve() -> None:
    # Two limbs run through each other, where vertices stay inside to the last; beside them a ball between vertices.
    limb, faces = solid(16, 14, radius=0.05, half_length=0.3)
    ball, round_ = solid(16, 24, radius=0.008)
    across = limb[:, [2, 0, 1]] + [0.0, 0.02, 0.0]
    vertices, topology = sheet(30, size=0.5)
    near = 0.5 * (vertices[4 * 30 + 4] + vertices[5 * 30 + 4])
    body = np.concatenate([limb, across, ball + near - [0.0, 0.006, 0.0]])
    every = np.concatenate([faces, faces + len(limb), round_ + 2 * len(limb)])
    alone, (i, j) = SurfaceQuery(round_, len(ball)), topology.edges.T

    def cut_edges(v: np.ndarray) -> int:
        return int((alone.query(0.5 * (v[i] + v[j]), body[-len(ball) :]).distance < 0.0).sum())

    assert cut_edges(vertices) > 0
    refiner = Refiner(topology, every, len(body), RefinementSettings(clearance=0.002, edges=True, iterations=2))
    refined, stats = refiner.refine_frame(vertices, body)
    assert stats.projected > 0, "no vertex is inside to the last"
    assert cut_edges(refined) == 0
