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

from geometry.topology import MeshTopology, edge_lengths


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
        if predicted.shape != truth.shape or truth.ndim != 3:
            raise ValueError(f"expected equal shapes [T, V, 3], got {list(predicted.shape)} and {list(truth.shape)}")
        spatial = self._spatial(predicted, truth)
        temporal = self._temporal(predicted, truth)
        return StedResult(float(np.hypot(spatial, self.parameters.weight * temporal)), spatial, temporal)

    def _spatial(self, predicted: np.ndarray, truth: np.ndarray) -> float:
        """Mean over vertices and frames of the length-weighted deviation of ``|l - l'| / l`` in the d-ring."""
        length = edge_lengths(truth.astype(np.float64), self.edges).T  # [E, T]
        change = np.abs(length - edge_lengths(predicted.astype(np.float64), self.edges).T) / np.maximum(length, 1e-12)
        weight = np.maximum(self.neighbourhood @ length, 1e-12)  # [V, T]
        mean = (self.neighbourhood @ (length * change)) / weight
        square = (self.neighbourhood @ (length * change**2)) / weight
        return float(np.sqrt(np.maximum(square - mean**2, 0.0)).mean())

    def _temporal(self, predicted: np.ndarray, truth: np.ndarray) -> float:
        """Mean over vertices and frames of the deviation of the temporal edges' relative change in the window."""
        if len(truth) < 2:
            return 0.0
        low, high = truth.min(axis=(0, 1)), truth.max(axis=(0, 1))
        diagonal = max(float(np.linalg.norm((high - low).astype(np.float64))), 1e-12)
        length = _path_edges(truth, diagonal, self.parameters.time_step)  # [T-1, V]
        change = np.abs(length - _path_edges(predicted, diagonal, self.parameters.time_step)) / length
        weight = _window_sum(length, self.parameters.window)
        mean = _window_sum(length * change, self.parameters.window) / weight
        square = _window_sum(length * change**2, self.parameters.window) / weight
        return float(np.sqrt(np.maximum(square - mean**2, 0.0)).mean())


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
