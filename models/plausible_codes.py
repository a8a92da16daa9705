"""Descriptors as near as the training frames' own: the nearest one that the data hold plausible.

In: descriptors [N, C]. Out: descriptors [N, C]. A shape that no cloth has is often encoded far outside of what the
decoder was trained on, and decoded to something as wrong as it was. So the code is moved to the nearest point of the
ellipsoid, around the mean and with the axes of the training codes, that holds half of them: nearest by the plain
distance, for a distance between descriptors is nearly one between shapes. A code inside of it stays as it is.

This is an option of the projection of implausible shapes (Wang 2019, Fig. 9), not of the paper and not part of
``encode``: frames that are simulated need no mending.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

SHARE = 0.5
"""Part of the training codes that the ellipsoid holds [1]. Codes have more dimensions than cloth has causes, so that
most of the ellipsoid is empty: one that holds nearly all codes holds inflated garments too."""
_BISECTIONS = 60


@dataclass(frozen=True)
class PlausibleCodes:
    """The ellipsoid of training codes.

    Attributes:
        mean: Centre, shape [C].
        axes: Orthonormal columns, shape [C, C].
        deviations: Standard deviation of the training codes along each axis, shape [C].
        radius: Mahalanobis distance of its surface [1].
    """

    mean: np.ndarray
    axes: np.ndarray
    deviations: np.ndarray
    radius: float

    @classmethod
    def of(cls, codes: np.ndarray, share: float = SHARE) -> PlausibleCodes:
        """The ellipsoid that holds a ``share`` of ``codes [N, C]``.

        Raises:
            ValueError: Fewer than two codes, or a share that is not between 0 and 1.
        """
        if codes.ndim != 2 or len(codes) < 2:
            raise ValueError(f"plausible codes: expected shape [N >= 2, C], got {list(codes.shape)}")
        if not 0.0 < share <= 1.0:
            raise ValueError(f"plausible codes: share must be above 0 and at most 1, got {share}")
        mean = codes.mean(axis=0, dtype=np.float64)
        centred = codes - mean
        values, axes = np.linalg.eigh(centred.T @ centred / len(codes))
        # A direction in which no training code varies must not vary afterwards either, but not divide by zero.
        deviations = np.sqrt(np.maximum(values, 1e-12 * max(values[-1], 1e-300)))
        distances = np.linalg.norm(centred @ axes / deviations, axis=1)
        return cls(mean, axes, deviations, float(np.quantile(distances, share)))

    def distances(self, codes: np.ndarray) -> np.ndarray:
        """Mahalanobis distance from the mean [1], shape [N], of ``codes [N, C]``."""
        return np.linalg.norm((codes - self.mean) @ self.axes / self.deviations, axis=1)

    def nearest(self, codes: np.ndarray) -> np.ndarray:
        """The nearest codes [N, C] float32 inside of the ellipsoid."""
        along = (codes - self.mean) @ self.axes
        variance = self.deviations**2
        # Lagrange: x_i variance_i / (variance_i + m), with the multiplier m >= 0 at which the surface is reached.
        low = np.zeros(len(along))
        high = np.linalg.norm(along * self.deviations, axis=1) / self.radius
        for _ in range(_BISECTIONS):
            middle = 0.5 * (low + high)
            inside = np.linalg.norm(along * self.deviations / (variance + middle[:, None]), axis=1) <= self.radius
            high, low = np.where(inside, middle, high), np.where(inside, low, middle)
        outside = np.linalg.norm(along / self.deviations, axis=1) > self.radius
        moved = (along * variance / (variance + high[:, None])) @ self.axes.T + self.mean
        return np.where(outside[:, None], moved, codes).astype(np.float32)
