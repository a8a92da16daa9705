"""Principal components of garment shapes by a randomized singular value decomposition.

In: frames as rows. Out: mean, orthonormal components and their standard deviations. Wang 2019 compares the shape
descriptor with it at equal dimension (Fig. 7); the "residual-pca" descriptor starts from it.
Source: Halko, Martinsson, Tropp 2011, "Finding structure with randomness", algorithms 4.4 and 5.1.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

# Rows are taken in blocks: centring a whole copy of the data would double the memory.
_BLOCK = 4096


@dataclass(frozen=True)
class Pca:
    """A linear shape space.

    Attributes:
        mean: Mean of the frames, shape [D].
        components: Orthonormal rows, largest variance first, shape [K, D].
        deviations: Standard deviation of the frames along each component, same unit as the frames, shape [K].
    """

    mean: np.ndarray
    components: np.ndarray
    deviations: np.ndarray

    def encode(self, frames: np.ndarray, count: int | None = None) -> np.ndarray:
        """Coefficients of ``frames [N, D]``, shape [N, count] (default: all components)."""
        chosen = self.components[:count]
        return frames @ chosen.T - self.mean @ chosen.T

    def decode(self, coefficients: np.ndarray) -> np.ndarray:
        """Frames [N, D] of ``coefficients [N, K']`` with K' <= K."""
        return coefficients @ self.components[: coefficients.shape[1]] + self.mean


def fit_pca(frames: np.ndarray, count: int, seed: int = 0, iterations: int = 3, oversampling: int = 16) -> Pca:
    """Leading components of ``frames [N, D]``; at most min(N - 1, D) exist, and asking for more is a ``ValueError``."""
    if frames.ndim != 2:
        raise ValueError(f"principal components: expected frames of shape [N, D], got {list(frames.shape)}")
    rows, columns = frames.shape
    most = min(rows - 1, columns)
    if not 1 <= count <= most:
        raise ValueError(
            f"principal components: {rows} frames of {columns} numbers have 1 to {most}, asked for {count}"
        )
    frames = np.asarray(frames, dtype=np.float32)
    mean = frames.mean(axis=0, dtype=np.float64).astype(np.float32)
    sketch = min(count + oversampling, most)
    directions = np.random.default_rng(seed).standard_normal((columns, sketch)).astype(np.float32)
    for _ in range(iterations):
        directions = np.linalg.qr(_gram_times(frames, mean, directions))[0]
    # Exact decomposition inside the subspace that was found: of the small covariance Q^T X^T X Q.
    projected = frames @ directions - mean @ directions
    covariance = (projected.T @ projected).astype(np.float64) / rows
    values, vectors = np.linalg.eigh(covariance)
    order = np.argsort(values)[::-1][:count]
    components = (directions @ vectors[:, order].astype(np.float32)).T
    return Pca(mean, np.ascontiguousarray(components), np.sqrt(np.maximum(values[order], 0.0)).astype(np.float32))


def _gram_times(frames: np.ndarray, mean: np.ndarray, directions: np.ndarray) -> np.ndarray:
    """``Xc^T Xc directions`` of the centred frames Xc."""
    result = np.zeros_like(directions)
    shift = mean @ directions
    for start in range(0, len(frames), _BLOCK):
        block = frames[start : start + _BLOCK]
        weights = block @ directions - shift
        result += block.T @ weights - np.outer(mean, weights.sum(axis=0))
    return result
