"""Distances between animated garments, and figures of one garment against its template and the body.

In: vertex positions [m], predicted and true, shape [T, V, 3]. Out: one number a sequence. Definitions follow the papers
named at each function; lengths leave in metres, tables turn them into millimetres.

T frames, V garment vertices, F garment faces, E edges, B body vertices.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from geometry.proximity import SurfaceQuery
from geometry.topology import MeshTopology, by_coordinate, edge_lengths, vertex_normals

COLLISION_MARGIN = 1.0e-3
"""Second threshold of the collision rate [m]: cloth nearer than this looks like it touches or shines through."""

FIRST_ASKED = 32
"""Vertices whose distance is looked up first where the largest is wanted; then twice as many, and so on."""


class VertexDistances:
    """Distances of predicted vertices from the true ones, of which several errors are made.

    Args:
        predicted, truth: Shape [T, V, 3] [m].
    """

    def __init__(self, predicted: np.ndarray, truth: np.ndarray) -> None:
        self.squared = _squared_distances(predicted, truth)

    def rmse(self) -> float:
        """Root of the mean over vertices and frames of the squared vertex distance [m] (Shi 2023, section 5.2)."""
        return float(np.sqrt(np.mean(self.squared)))

    def mean(self) -> float:
        """Mean over vertices and frames of the vertex distance [m] (Peng 2023 "Error", CAPE, TailorNet)."""
        return float(np.mean(np.sqrt(self.squared)))

    def kg_error(self, variation: float) -> float:
        """Karni-Gotsman error: 100 times the error's norm over the root of the truth's ``squared_variation`` [%]."""
        return float(100.0 * np.sqrt(self.squared.sum() / variation))


def squared_variation(truth: np.ndarray) -> float:
    """Squared norm [m^2] of vertices [T, V, 3] about each frame's mean point."""
    centred = truth.astype(np.float64) - truth.mean(axis=1, keepdims=True, dtype=np.float64)
    return float((centred**2).sum())


def rmse(predicted: np.ndarray, truth: np.ndarray) -> float:
    """``VertexDistances.rmse`` [m]."""
    return VertexDistances(predicted, truth).rmse()


def mean_vertex_error(predicted: np.ndarray, truth: np.ndarray) -> float:
    """``VertexDistances.mean`` [m]."""
    return VertexDistances(predicted, truth).mean()


def kg_error(predicted: np.ndarray, truth: np.ndarray) -> float:
    """``VertexDistances.kg_error`` [%]."""
    return VertexDistances(predicted, truth).kg_error(squared_variation(truth))


def hausdorff(predicted: np.ndarray, truth: np.ndarray, stride: int = 1) -> float:
    """Symmetric Hausdorff distance between the vertex sets, mean over every ``stride``-th frame [m]."""
    bounds = np.sqrt(_squared_distances(predicted[::stride], truth[::stride]))
    worst = []
    for a, b, bound in zip(predicted[::stride], truth[::stride], bounds, strict=True):
        # No vertex is farther from the other set than from its counterpart there: who may be the farthest comes first.
        order = np.argsort(-bound)
        a, b, bound = a[order], b[order], bound[order]
        worst.append(_farthest(b, a, bound, _farthest(a, b, bound, 0.0)))
    return float(np.mean(worst))


def normal_cosine_distance(predicted: np.ndarray, truth: np.ndarray, faces: np.ndarray) -> float:
    """Mean over vertices and frames of ``1 - n . n'``, unit vertex normals (Shi 2023, lower is better)."""
    _check_pair(predicted, truth)
    return cosine_distance(vertex_normals(predicted, faces), vertex_normals(truth, faces))


def cosine_distance(normals: np.ndarray, true_normals: np.ndarray) -> float:
    """``normal_cosine_distance`` of unit normals that are there already, [T, V, 3] both."""
    return float(np.mean(1.0 - np.einsum("tvc,tvc->tv", normals, true_normals)))


def edge_deviation(vertices: np.ndarray, template: np.ndarray, edges: np.ndarray) -> float:
    """Mean over edges and frames of ``| l - l_template |`` [m] ("edge" of DeePSD and GSNet, there times 1000)."""
    return float(np.mean(np.abs(edge_lengths(vertices, edges) - edge_lengths(template, edges))))


def bend(vertices: np.ndarray, topology: MeshTopology) -> float:
    """Mean over vertices of the neighbour average of ``1 - n_i . n_j`` ("bend" of DeePSD and GSNet)."""
    return bend_of_normals(vertex_normals(vertices, topology.faces), topology)


def bend_of_normals(normals: np.ndarray, topology: MeshTopology) -> float:
    """``bend`` of unit vertex normals [T, V, 3] that are there already."""
    i, j = topology.edges.T
    bent = 1.0 - sum(n.take(i, axis=0) * n.take(j, axis=0) for n in by_coordinate(normals))  # [E, T]
    degree = np.bincount(topology.edges.reshape(-1), minlength=topology.vertex_count)
    # Each edge counts once at either end, divided by that end's number of neighbours; lone vertices count nothing.
    share = (1.0 / degree[i] + 1.0 / degree[j]) / np.count_nonzero(degree)
    return float(np.mean(share @ bent))


@dataclass(frozen=True)
class StrainFigures:
    """Absolute edge strain ``| l / l_rest - 1 |`` over all edges and frames."""

    p50: float
    p99: float
    maximum: float


def edge_strain(vertices: np.ndarray, rest: np.ndarray, edges: np.ndarray) -> StrainFigures:
    """Percentiles of the edge strain of ``vertices [T, V, 3]`` against the rest shape ``rest [V, 3]``."""
    length = edge_lengths(rest, edges)
    if (length <= 0.0).any():
        raise ValueError(f"rest: {int((length <= 0).sum())} edges have no length")
    strain = np.abs(edge_lengths(vertices, edges) / length - 1.0)
    p50, p99 = np.percentile(strain, [50, 99])
    return StrainFigures(float(p50), float(p99), float(strain.max()))


@dataclass(frozen=True)
class CollisionFigures:
    """Garment against body over the frames looked at.

    Attributes:
        rate: Share of the vertices with a signed distance below 0.
        rate_margin: Share below ``COLLISION_MARGIN``.
        deepest: Largest penetration [m], 0 when nothing is inside.
        frames: Number of frames looked at.
    """

    rate: float
    rate_margin: float
    deepest: float
    frames: int


def collision_figures(
    vertices: np.ndarray, body_vertices: np.ndarray, body: SurfaceQuery, stride: int = 1
) -> CollisionFigures:
    """Signed distances of ``vertices [T, V, 3]`` to the moving body surface ``body_vertices [T, B, 3]``."""
    if len(vertices) != len(body_vertices):
        raise ValueError(f"vertices have {len(vertices)} frames, body_vertices {len(body_vertices)}")
    below, near, deepest, frames = 0, 0, 0.0, range(0, len(vertices), stride)
    for t in frames:
        distance = body.query(vertices[t], body_vertices[t]).distance
        below += int((distance < 0.0).sum())
        near += int((distance < COLLISION_MARGIN).sum())
        deepest = max(deepest, -float(distance.min()))
    count = len(frames) * vertices.shape[1]
    return CollisionFigures(below / count, near / count, deepest, len(frames))


class NearestVertices:
    """Vertices of a body in some frames, of which many garments are asked: normals and trees are made once.

    Args:
        body_vertices: Body [m], shape [T, B, 3].
        body_faces: Its triangles, shape [F, 3].
    """

    def __init__(self, body_vertices: np.ndarray, body_faces: np.ndarray) -> None:
        self._vertices, self._normals = body_vertices, vertex_normals(body_vertices, body_faces)
        self._trees = [_tree(v) for v in body_vertices]

    def collision_rate(self, vertices: np.ndarray) -> float:
        """Share of garment vertices [T, V, 3] with ``(v - b) . n_b < 0``, b the nearest *vertex* (DeePSD, GSNet)."""
        below = 0
        for garment, body, normals, tree in zip(vertices, self._vertices, self._normals, self._trees, strict=True):
            index = tree.query(garment)[1]
            below += int((np.einsum("vc,vc->v", garment - body[index], normals[index]) < 0.0).sum())
        return below / (len(vertices) * vertices.shape[1])


def _farthest(points: np.ndarray, others: np.ndarray, bound: np.ndarray, least: float) -> float:
    """The largest distance of ``points [N, 3]`` from the nearest of ``others [M, 3]``, or ``least`` if that is larger.

    None of the points is farther than its ``bound [N]``; bounds are in falling order.
    """
    if bound[0] <= least:
        return least
    tree = _tree(others)
    start, count = 0, FIRST_ASKED
    while start < len(points) and bound[start] > least:
        end = min(start + count, len(points))
        least = max(least, float(tree.query(points[start:end])[0].max()))
        start, count = end, 2 * count
    return least


def _tree(points: np.ndarray) -> cKDTree:
    """Of a frame's points [N, 3], quick to build, for it is asked a few times alone."""
    return cKDTree(points, leafsize=32, balanced_tree=False, compact_nodes=False)


def _squared_distances(predicted: np.ndarray, truth: np.ndarray) -> np.ndarray:
    """Squared vertex distances [m^2], shape [T, V], float64."""
    _check_pair(predicted, truth)
    difference = np.subtract(predicted, truth, dtype=np.float64)
    return np.einsum("tvc,tvc->tv", difference, difference)


def _check_pair(predicted: np.ndarray, truth: np.ndarray) -> None:
    if predicted.shape != truth.shape or predicted.ndim != 3 or predicted.shape[2] != 3 or predicted.size == 0:
        raise ValueError(
            f"predicted and truth: expected equal shapes [T, V, 3], got {list(predicted.shape)} and {list(truth.shape)}"
        )
