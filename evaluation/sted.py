"""STED, the spatio-temporal edge difference between two animated meshes.

Vasa and Skala 2011, "A perception correlated comparison method for dynamic meshes" (IEEE TVCG 17:2). The eye sees how
unevenly edges change, not where the mesh is: the spatial part measures the spread of the relative edge change around
each vertex, the temporal part the spread of the relative change of the path lengths over time. Both are blind to a
rigid displacement of the whole animation. No code was published and the figure depends on four parameters, so values
compare only under equal ``StedParameters``; tables print them by ``StedParameters.label``.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp

from geometry.topology import MeshTopology, by_coordinate


@dataclass(frozen=True)
class StedParameters:
    """What STED depends on.

    Attributes:
        rings: d, topological radius of the neighbourhood whose edges are compared.
        window: w, frames on each side of a frame that enter its temporal spread.
        time_step: dt, length of a frame in units of the bounding box diagonal of the true animation. It keeps the path
            of a vertex at rest from having no length; small values make the metric sensitive to slow jitter.
        weight: c, weight of the temporal part.
    """

    rings: int = 1
    window: int = 5
    time_step: float = 0.01
    weight: float = 1.0

    @property
    def label(self) -> str:
        """One string for tables: ``d=1 w=5 dt=0.01 c=1``."""
        return f"d={self.rings} w={self.window} dt={self.time_step:g} c={self.weight:g}"


@dataclass(frozen=True)
class StedResult:
    """STED and its two parts, without unit."""

    sted: float
    spatial: float
    temporal: float


class Sted:
    """STED for one connectivity: neighbourhoods are built once, sequences compared many times.

    Args:
        topology: The garment's connectivity.
        parameters: d, w, dt and c.
    """

    def __init__(self, topology: MeshTopology, parameters: StedParameters | None = None) -> None:
        self.parameters = parameters or StedParameters()
        if self.parameters.rings < 1 or self.parameters.window < 1 or self.parameters.time_step <= 0:
            raise ValueError(f"STED needs rings >= 1, window >= 1 and time_step > 0, got {self.parameters.label}")
        self.edges = topology.edges
        self.neighbourhood = _ring_edges(topology, self.parameters.rings)  # [V, E], 0/1

    def compare(self, predicted: np.ndarray, truth: np.ndarray) -> StedResult:
        """STED of ``predicted`` against ``truth``, both [T, V, 3] [m]; T = 1 has no temporal part."""
        return self.beside(truth).compare(predicted)

    def beside(self, truth: np.ndarray) -> TrueEdges:
        """``truth [T, V, 3]`` [m], which many predictions are compared with: its own part is computed once."""
        return TrueEdges(self, truth)


class TrueEdges:
    """Edges of a true animation in space and in time; made by ``Sted.beside``."""

    def __init__(self, sted: Sted, truth: np.ndarray) -> None:
        if truth.ndim != 3 or truth.shape[2] != 3:
            raise ValueError(f"STED: expected shape [T, V, 3], got {list(truth.shape)}")
        self._shape, self._parameters = truth.shape, sted.parameters
        self._edges, self._neighbourhood = sted.edges, sted.neighbourhood
        self._length = _edge_lengths(truth, self._edges)  # [E, T]
        self._weight = np.maximum(self._neighbourhood @ self._length, 1e-12)  # [V, T]
        if len(truth) > 1:
            extent = np.array([np.ptp(truth[..., k]) for k in range(3)], dtype=np.float64)
            self._diagonal = max(float(np.linalg.norm(extent)), 1e-12)
            self._path = _path_edges(truth, self._diagonal, self._parameters.time_step)  # [T-1, V]
            self._path_weight = _window_sum(self._path, self._parameters.window)

    def compare(self, predicted: np.ndarray) -> StedResult:
        """STED of ``predicted [T, V, 3]`` [m]; T = 1 has no temporal part."""
        if predicted.shape != self._shape:
            raise ValueError(f"STED: expected shape {list(self._shape)} as the truth has, got {list(predicted.shape)}")
        spatial, temporal = self._spatial(predicted), self._temporal(predicted)
        return StedResult(float(np.hypot(spatial, self._parameters.weight * temporal)), spatial, temporal)

    def _spatial(self, predicted: np.ndarray) -> float:
        """Mean over vertices and frames of the length-weighted deviation of ``|l - l'| / l`` in the d-ring."""
        change = np.abs(self._length - _edge_lengths(predicted, self._edges)) / np.maximum(self._length, 1e-12)
        weighted = self._length * change
        mean = (self._neighbourhood @ weighted) / self._weight
        square = (self._neighbourhood @ (weighted * change)) / self._weight
        return float(np.sqrt(np.maximum(square - mean**2, 0.0)).mean())

    def _temporal(self, predicted: np.ndarray) -> float:
        """Mean over vertices and frames of the deviation of the temporal edges' relative change in the window."""
        if len(predicted) < 2:
            return 0.0
        length, window = self._path, self._parameters.window
        change = np.abs(length - _path_edges(predicted, self._diagonal, self._parameters.time_step)) / length
        weighted = length * change
        mean = _window_sum(weighted, window) / self._path_weight
        square = _window_sum(weighted * change, window) / self._path_weight
        return float(np.sqrt(np.maximum(square - mean**2, 0.0)).mean())


def _edge_lengths(vertices: np.ndarray, edges: np.ndarray) -> np.ndarray:
    """Lengths of all edges [m] in the order in which neighbourhoods are summed, [E, T] float64."""
    i, j = edges.T
    x, y, z = (along.take(i, axis=0) - along.take(j, axis=0) for along in by_coordinate(vertices).astype(np.float64))
    return np.sqrt(x * x + y * y + z * z)


def _path_edges(vertices: np.ndarray, diagonal: float, time_step: float) -> np.ndarray:
    """Lengths of the virtual edges v_{f-1} -> v_f, ``sqrt(|dv|^2 + dt^2)`` in bounding box units, [T-1, V]."""
    step = np.diff(vertices.astype(np.float64), axis=0) / diagonal
    return np.sqrt(np.einsum("tvc,tvc->tv", step, step) + time_step**2)


def _window_sum(values: np.ndarray, window: int) -> np.ndarray:
    """Sum over frames f-w..f+w that exist, shape kept."""
    total = np.concatenate([np.zeros((1, *values.shape[1:])), np.cumsum(values, axis=0)])
    index = np.arange(len(values))
    return total[np.minimum(index + window + 1, len(values))] - total[np.maximum(index - window, 0)]


def _ring_edges(topology: MeshTopology, rings: int) -> sp.csr_matrix:
    """Edges with both ends within ``rings`` steps of each vertex, 0/1, shape [V, E]."""
    step = topology.adjacency() + sp.identity(topology.vertex_count, format="csr")
    reach = step.copy()
    for _ in range(rings - 1):
        reach = reach @ step
    reach.data[:] = 1.0
    count = len(topology.edges)
    ends = sp.csr_matrix(
        (np.ones(2 * count), (topology.edges.T.reshape(-1), np.tile(np.arange(count), 2))),
        shape=(topology.vertex_count, count),
    )
    both = reach @ ends
    return (both > 1.5).astype(np.float64).tocsr()
