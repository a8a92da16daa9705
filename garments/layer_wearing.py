"""A garment's own vertices from the body mesh that wears it as a layer: the way back of ``garments.body_layer``.

In: where the points of the cloth are that lie over body vertices, in the world. Out: all vertices of the garment. Each
such point is a weighted sum of garment vertices (``LayerMap.points``), so the garment whose points lie where they
should is a linear least squares problem. What no point speaks for, a hem that hangs below all covered vertices, follows
its neighbours: of all garments that fit, the one is taken whose distance from the skinned template is smoothest.

T frames, V garment vertices, C points.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np
import scipy.sparse as sp
from scipy.sparse.linalg import splu

from body.model import skin

if TYPE_CHECKING:
    from body.model import Body
    from garments.body_layer import LayerMap
    from garments.template import GarmentTemplate

SMOOTHNESS = 1.0e-2
"""Weight of the umbrella Laplacian of what is added to the skinned template, against the points."""

STILLNESS = 1.0e-6
"""Weight of what is added itself: without it, a garment that no point speaks for could be anywhere."""


class LayerWearing:
    """Garment vertices of points over the body, and the points of garment vertices.

    Args:
        template: The garment.
        body: The body that it was built on.
        layer: Which point of the garment lies over which body vertex.
        trusted: Body vertices whose points are looked at, of those that the layer covers; all where None.

    Raises:
        ValueError: The layer is of another garment or body, or none of its points is trusted.
    """

    def __init__(
        self, template: GarmentTemplate, body: Body, layer: LayerMap, trusted: np.ndarray | None = None
    ) -> None:
        if layer.body_digest != body.digest or layer.points.shape[1] != len(template.vertices):
            raise ValueError(
                f"layer of garment '{layer.garment}' on body {layer.body_digest}: it is not that of garment "
                f"'{template.name}' on body {body.name} ({body.digest})"
            )
        rows = np.ones(len(layer.covered), dtype=bool) if trusted is None else np.isin(layer.covered, trusted)
        if not rows.any():
            raise ValueError(f"garment '{template.name}': no point of it lies over a body vertex that is trusted")
        self.template, self.body = template, body
        points = layer.points[rows]
        self.layer = replace(layer, covered=layer.covered[rows], points=points, worn=layer.worn[rows])
        umbrella = template.topology.uniform_laplacian()
        normal = points.T @ points + SMOOTHNESS * (umbrella.T @ umbrella)
        self._solver = splu((normal + STILLNESS * sp.identity(len(template.vertices))).tocsc())

    def points(self, garment: np.ndarray) -> np.ndarray:
        """The points [T, C, 3] [m] of a garment [T, V, 3] [m]."""
        return _each(self.layer.points, np.asarray(garment, dtype=np.float64))

    def garment(self, points: np.ndarray, pose: np.ndarray, root: np.ndarray) -> np.ndarray:
        """The garment [T, V, 3] float32 [m] whose points lie at ``points [T, C, 3]``, all in the world.

        Args:
            points: [m], shape [T, C, 3].
            pose: Poses [rad], shape [T, 24, 3].
            root: Root translations [m], shape [T, 3].
        """
        transforms = self.body.joint_transforms(pose, root)
        skinned = skin(self.template.vertices, self.template.skin_index, self.template.skin_weight, transforms)
        missing = _each(self.layer.points.T, points - self.points(skinned))  # [T, V, 3]
        columns = missing.transpose(1, 0, 2).reshape(missing.shape[1], -1)
        moved = self._solver.solve(columns).reshape(missing.shape[1], len(missing), 3).transpose(1, 0, 2)
        return (skinned + moved).astype(np.float32)


def _each(matrix: sp.spmatrix, frames: np.ndarray) -> np.ndarray:
    """A matrix [M, N] times every frame of ``frames [T, N, 3]``, shape [T, M, 3]."""
    flat = frames.transpose(1, 0, 2).reshape(frames.shape[1], -1)
    return (matrix @ flat).reshape(matrix.shape[0], len(frames), 3).transpose(1, 0, 2)
