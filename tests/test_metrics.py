"""Metrics: analytic values and invariances."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from evaluation import metrics
from evaluation.sted import Sted, StedParameters
from geometry.proximity import SurfaceQuery
from geometry.topology import MeshTopology


def grid(rows: int = 6, columns: int = 7, step: float = 0.1) -> tuple[np.ndarray, MeshTopology]:
    """Flat grid in the x-z plane with upward normals."""
    x, z = np.meshgrid(np.arange(rows) * step, np.arange(columns) * step, indexing="ij")
    vertices = np.stack([x, np.zeros_like(x), z], axis=-1).reshape(-1, 3)
    index = np.arange(rows * columns).reshape(rows, columns)
    a, b, c, d = index[:-1, :-1].ravel(), index[1:, :-1].ravel(), index[:-1, 1:].ravel(), index[1:, 1:].ravel()
    faces = np.concatenate([np.stack([a, c, b], axis=1), np.stack([b, c, d], axis=1)])
    return vertices, MeshTopology.from_faces(faces, len(vertices))


def octahedron(radius: float) -> tuple[np.ndarray, np.ndarray]:
    vertices = radius * np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]], dtype=float)
    faces = [[x, y, z] if (x + y + z) % 2 == 0 else [x, z, y] for x in (0, 1) for y in (2, 3) for z in (4, 5)]
    return vertices, np.array(faces)


@pytest.fixture
def animation() -> tuple[np.ndarray, np.ndarray, MeshTopology]:
    rng = np.random.default_rng(0)
    rest, topology = grid()
    truth = rest + 0.02 * rng.standard_normal((9, 1, 3)) + 0.01 * rng.standard_normal((9, len(rest), 3))
    return truth, truth + 0.005 * rng.standard_normal(truth.shape), topology


def test_distances_of_a_shifted_sequence() -> None:
    truth = np.random.default_rng(1).normal(size=(4, 20, 3))
    shifted = truth + [0.003, 0.0, 0.004]
    assert metrics.rmse(shifted, truth) == pytest.approx(0.005)
    assert metrics.mean_vertex_error(shifted, truth) == pytest.approx(0.005)
    # One vertex of twenty far off: the mean sees a twentieth, the root mean square the root of it.
    outlier = truth.copy()
    outlier[:, 3, 1] += 0.2
    assert metrics.mean_vertex_error(outlier, truth) == pytest.approx(0.01)
    assert metrics.rmse(outlier, truth) == pytest.approx(0.2 / np.sqrt(20))


def test_hausdorff_is_symmetric_and_blind_to_order() -> None:
    line = np.stack([np.arange(10.0), np.zeros(10), np.zeros(10)], axis=1)[None]
    far = line.copy()
    far[0, 4, 1] = 2.5  # nearest of it: x = 4 of the line at 2.5; nearest of x = 4: a neighbour at 1
    assert metrics.hausdorff(far, line) == pytest.approx(2.5)
    assert metrics.hausdorff(line, far) == pytest.approx(2.5)
    assert metrics.hausdorff(line[:, ::-1].copy(), line) == 0.0


@pytest.mark.parametrize("spread", [0.01, 0.3])
def test_hausdorff_equals_brute_force(spread: float) -> None:
    rng = np.random.default_rng(3)
    truth = rng.normal(size=(3, 150, 3)).astype(np.float32)
    predicted = (truth + spread * rng.normal(size=truth.shape)).astype(np.float32)
    predicted[1, 7] += 2.0  # the farthest of one set only
    truth[2, 9] -= 2.0
    apart = np.linalg.norm(predicted[:, :, None].astype(float) - truth[:, None], axis=-1)
    worst = np.maximum(apart.min(axis=2).max(axis=1), apart.min(axis=1).max(axis=1))
    assert metrics.hausdorff(predicted, truth) == pytest.approx(worst.mean(), rel=1e-12)
    assert metrics.hausdorff(predicted, truth, stride=2) == pytest.approx(worst[::2].mean(), rel=1e-12)


def test_kg_error_of_the_mean_shape_is_100() -> None:
    truth = np.random.default_rng(2).normal(size=(5, 30, 3))
    flat = np.repeat(truth.mean(axis=1, keepdims=True), 30, axis=1)
    assert metrics.kg_error(flat, truth) == pytest.approx(100.0)
    assert metrics.kg_error(truth, truth) == 0.0


def test_normal_cosine_distance_of_a_tilted_plane() -> None:
    rest, topology = grid()
    angle = 0.3
    tilted = rest @ Rotation.from_rotvec([angle, 0, 0]).as_matrix().T
    value = metrics.normal_cosine_distance(tilted[None], rest[None], topology.faces)
    assert value == pytest.approx(1 - np.cos(angle))
    assert metrics.normal_cosine_distance(rest[None] + 3.0, rest[None], topology.faces) == pytest.approx(0, abs=1e-12)


def test_edge_and_strain_of_a_stretched_sheet() -> None:
    rest, topology = grid(step=0.1)
    stretched = np.stack([rest, rest * 1.1])
    lengths = np.linalg.norm(rest[topology.edges[:, 0]] - rest[topology.edges[:, 1]], axis=1)
    assert metrics.edge_deviation(stretched, rest, topology.edges) == pytest.approx(0.5 * 0.1 * lengths.mean())
    strain = metrics.edge_strain(rest[None] * 1.1, rest, topology.edges)
    assert (strain.p50, strain.p99, strain.maximum) == pytest.approx((0.1, 0.1, 0.1))
    squeezed = metrics.edge_strain(rest[None] * 0.8, rest, topology.edges)
    assert squeezed.maximum == pytest.approx(0.2)


def test_bend_of_a_plane_and_of_an_octahedron() -> None:
    rest, topology = grid()
    assert metrics.bend(rest[None], topology) == pytest.approx(0.0, abs=1e-12)
    vertices, faces = octahedron(1.0)
    # Neighbouring vertex normals of an octahedron are perpendicular.
    assert metrics.bend(vertices[None], MeshTopology.from_faces(faces)) == pytest.approx(1.0)


def test_collision_figures_of_an_octahedron_body() -> None:
    body, faces = octahedron(0.3)
    query = SurfaceQuery(faces)
    plane_distance = 0.3 / np.sqrt(3)
    direction = np.ones(3) / np.sqrt(3)
    points = np.stack([direction * (plane_distance + d) for d in (-0.02, -0.0001, 0.0005, 0.002)])
    frames = np.stack([points, points + direction * 0.1])
    figures = metrics.collision_figures(frames, np.stack([body, body]), query)
    assert figures.rate == pytest.approx(2 / 8)
    assert figures.rate_margin == pytest.approx(3 / 8)
    assert figures.deepest == pytest.approx(0.02)
    assert metrics.collision_figures(frames[1:], body[None], query).deepest == 0.0
    assert metrics.collision_figures(frames, np.stack([body, body]), query, stride=2).frames == 1


def test_nearest_vertex_rate_uses_the_vertex_normal() -> None:
    body, faces = octahedron(0.3)
    # In front of a face but below the vertex's tangent plane: outside the surface, a collision for DeePSD's rule.
    point = np.array([0.2, 0.09, 0.09])
    assert SurfaceQuery(faces).query(point[None], body).distance[0] > 0
    rate = metrics.NearestVertices(body[None], faces).collision_rate(np.stack([point, point * 4])[None])
    assert rate == pytest.approx(0.5)


def test_sted_sees_shape_not_place(animation: tuple[np.ndarray, np.ndarray, MeshTopology]) -> None:
    truth, predicted, topology = animation
    sted = Sted(topology)
    assert sted.compare(truth, truth).sted == 0.0
    moved = truth + [1.0, -2.0, 0.5]
    assert sted.compare(moved, truth).sted == pytest.approx(0.0, abs=1e-7)
    rotation = Rotation.from_rotvec([0.3, 1.0, -0.2]).as_matrix()
    assert sted.compare(truth @ rotation.T, truth).sted == pytest.approx(0.0, abs=1e-7)
    # All edges change alike: the spread, which is what STED measures, is nought.
    assert sted.compare(truth * 1.2, truth).spatial == pytest.approx(0.0, abs=1e-7)
    result = sted.compare(predicted, truth)
    assert result.sted == pytest.approx(np.hypot(result.spatial, result.temporal)) and result.spatial > 0.01


def test_sted_spatial_part_by_hand() -> None:
    # One triangle with edges 3, 4, 5; the prediction stretches the side of 4 to 5 (others kept).
    truth = np.array([[[0, 0, 0], [3, 0, 0], [0, 4, 0]]], dtype=float)
    x = (9 + 25 - 25) / 6
    predicted = np.array([[[0, 0, 0], [3, 0, 0], [x, np.sqrt(25 - x**2), 0]]])
    change, length = np.array([0.0, 0.25, 0.0]), np.array([3.0, 4.0, 5.0])
    mean = (length * change).sum() / 12
    spread = np.sqrt((length * (change - mean) ** 2).sum() / 12)
    result = Sted(MeshTopology.from_faces(np.array([[0, 1, 2]]))).compare(predicted, truth)
    assert result.spatial == pytest.approx(spread)
    assert result.temporal == 0.0 and result.sted == pytest.approx(spread)


def test_sted_temporal_part_sees_jitter_more_than_drift() -> None:
    rest, topology = grid()
    truth = np.repeat(rest[None], 40, axis=0)
    phase = np.arange(40)[:, None, None]
    drift = truth + 0.002 * phase
    jitter = truth + 0.002 * (-1.0) ** (phase // 4 % 2 + phase)
    sted = Sted(topology, StedParameters(window=3))
    assert sted.compare(drift, truth).temporal == pytest.approx(0.0, abs=1e-7)
    assert sted.compare(jitter, truth).temporal > 0.005


def test_sted_equals_its_definition(animation: tuple[np.ndarray, np.ndarray, MeshTopology]) -> None:
    truth, predicted, topology = animation
    sted, (i, j) = Sted(topology), topology.edges.T
    true_length, length = (np.linalg.norm(x[:, i] - x[:, j], axis=-1) for x in (truth, predicted))
    change = np.abs(length / true_length - 1.0)
    near = np.eye(topology.vertex_count, dtype=bool) | (topology.adjacency().toarray() > 0)
    spatial = [
        np.sqrt(np.cov(c[n[i] & n[j]], aweights=t[n[i] & n[j]], ddof=0))
        for c, t in zip(change, true_length, strict=True)
        for n in near
    ]
    diagonal = np.linalg.norm(truth.max(axis=(0, 1)) - truth.min(axis=(0, 1)))
    true_path, path = (
        np.hypot(np.linalg.norm(np.diff(x, axis=0), axis=-1) / diagonal, 0.01) for x in (truth, predicted)
    )
    change = np.abs(path / true_path - 1.0)
    windows = [slice(max(t - 5, 0), t + 6) for t in range(len(path))]
    temporal = [
        np.sqrt(np.cov(change[w, v], aweights=true_path[w, v], ddof=0)) for w in windows for v in range(len(near))
    ]
    # The truth is prepared once, whatever it is compared with in between.
    beside = sted.beside(truth)
    assert beside.compare(truth).sted == 0.0
    assert beside.compare(predicted) == sted.compare(predicted, truth)
    assert beside.compare(predicted).spatial == pytest.approx(np.mean(spatial), rel=1e-9)
    assert beside.compare(predicted).temporal == pytest.approx(np.mean(temporal), rel=1e-9)
    with pytest.raises(ValueError, match="expected shape"):
        beside.compare(predicted[1:])


def test_sted_parameters_matter_and_are_printed(animation: tuple[np.ndarray, np.ndarray, MeshTopology]) -> None:
    truth, predicted, topology = animation
    wide = StedParameters(rings=2, window=2, time_step=0.05, weight=0.5)
    assert wide.label == "d=2 w=2 dt=0.05 c=0.5"
    assert Sted(topology, wide).compare(predicted, truth).sted != Sted(topology).compare(predicted, truth).sted
    # In the middle of a 6 x 7 grid, two rings hold more edges than one.
    narrow = Sted(topology).neighbourhood.sum(axis=1)
    assert (Sted(topology, wide).neighbourhood.sum(axis=1) > narrow).all()


def test_wrong_shapes_are_named() -> None:
    with pytest.raises(ValueError, match=r"got \[2, 5, 3\] and \[2, 4, 3\]"):
        metrics.rmse(np.zeros((2, 5, 3)), np.zeros((2, 4, 3)))
    with pytest.raises(ValueError, match="edges have no length"):
        metrics.edge_strain(np.zeros((1, 3, 3)), np.zeros((3, 3)), np.array([[0, 1]]))
