"""Where a posed body passes through itself or closes on itself: arms pressed to the torso, thighs, hip crease, armpits.

It depends on the motion alone, so it is found once a frame of a clip, for every garment and parameter set.

The rule by which cloth is judged, here in one place (``sim.crossings`` applies it):

- A garment point is *inside* where the winding number of the body is positive.
- A body face is *buried* where the winding number just outside of it is not zero: the face is no border between flesh
  and air, because another part of the body lies over it or the skin is turned inside out.
- A body face lies in a *gap* where it looks at another face of the body across less than ``gap`` [m], twice the
  thickness of the cloth: cloth that keeps its thickness from both cannot be there.
- A garment vertex inside the body is *pinched* where such a face (buried or in a gap) lies within ``PINCH_REACH`` of
  the closest point of the body's surface; a garment triangle that crosses the body or has a corner inside is pinched
  where such a face lies within ``PINCH_REACH`` of the triangle's box or one of its corners is pinched.
- Everything else inside the body is a fault of the simulation.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import warp as wp

from sim.compile import resolve_device
from sim.kernels import buried as kernels

PINCH_REACH = 0.010
"""Distance to a buried face or a gap within which cloth in the body counts as pinched [m]: half an edge of cloth."""


@dataclass(frozen=True)
class Closure:
    """Where a posed body is closed to cloth.

    Attributes:
        winding: Winding number of the body just outside of each face, shape [F]: 0 on the open surface, 1 under another
            part of the body, -1 where the skin is turned inside out.
        gaps: Whether a face that is not buried looks at another across less than the gap, shape [F].
    """

    winding: np.ndarray
    gaps: np.ndarray

    @property
    def buried(self) -> np.ndarray:
        """Whether the body lies on both sides of a face, or on the wrong one, shape [F]."""
        return self.winding != 0

    @property
    def closed(self) -> np.ndarray:
        """Faces that are buried or in a gap, shape [F]: cloth that is inside the body near them is pinched."""
        return self.buried | self.gaps


class ClosureFinder:
    """Finds where a body of fixed faces is closed to cloth, pose by pose."""

    def __init__(self, faces: np.ndarray, device: str = "auto"):
        """Take the faces of the body.

        Args:
            faces: Outward oriented triangles of a closed surface, shape [F, 3].
            device: ``auto``, ``cpu`` or ``cuda``.

        Raises:
            ValueError: The surface is not closed.
        """
        self.device = resolve_device(device)
        self.faces = checked_closed(faces)
        self._tree = SurfaceTree(self.faces, self.device)

    def at(self, positions: np.ndarray, gap: float) -> Closure:
        """Buried faces and gaps of one pose.

        Args:
            positions: World positions of the body [m], shape [B, 3].
            gap: Distance below which faces that look at each other leave no room for cloth [m]: twice its thickness.

        Raises:
            ValueError: Wrong shape, NaN, or a gap that is negative or above 0.1 m.
        """
        positions = checked_points(positions, self._tree.vertex_count, "body positions")
        if not 0.0 <= gap <= 0.1:
            raise ValueError(f"gap = {gap}: allowed are 0 to 0.1 m")
        self._tree.move(positions - positions.mean(axis=0))
        count = len(self.faces)
        winding = wp.zeros(count, dtype=int, device=self.device)
        gaps = wp.zeros(count, dtype=wp.bool, device=self.device)
        inputs = [self._tree.mesh.id, self._tree.points, self._tree.indices]
        wp.launch(kernels.wind_faces, count, inputs, [winding], device=self.device)
        wp.launch(kernels.find_gaps, count, [*inputs, winding, float(gap)], [gaps], device=self.device)
        number = winding.numpy()
        return Closure(number.copy(), gaps.numpy().astype(bool) & (number == 0))


class SurfaceTree:
    """A triangle mesh on the device with a search tree that follows its vertices.

    The tree is built at the first positions, and only refitted to later ones.
    """

    def __init__(self, faces: np.ndarray, device: str):
        self.vertex_count = int(faces.max()) + 1
        self.face_count = len(faces)
        self.points = wp.zeros(self.vertex_count, dtype=wp.vec3, device=device)
        self.indices = wp.array(np.ascontiguousarray(faces, dtype=np.int32).ravel(), dtype=int, device=device)
        self.mesh: wp.Mesh | None = None

    def move(self, positions: np.ndarray) -> None:
        """Take vertices [m], shape [B, 3], relative to an origin near them: they are kept in float32."""
        self.points.assign(np.ascontiguousarray(positions, dtype=np.float32))
        if self.mesh is None:
            self.mesh = wp.Mesh(self.points, self.indices)
        else:
            self.mesh.refit()


def checked_closed(faces: np.ndarray) -> np.ndarray:
    """Body faces as int64 [F, 3]; ``ValueError`` unless every edge has one face on either side."""
    faces = checked_faces(faces, "body faces")
    edges = np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]])
    count = int(faces.max()) + 1
    forth, back = edges @ (count, 1), edges @ (1, count)
    if len(np.unique(forth)) < len(forth):
        raise ValueError("body faces: an edge is used twice in one direction; neighbours must be oriented alike")
    open_edges = ~np.isin(forth, back)
    if open_edges.any():
        i, j = edges[np.argmax(open_edges)]
        raise ValueError(
            f"body faces: the surface is not closed, {int(open_edges.sum())} edges have one face only (first {i}-{j})"
        )
    return faces


def checked_faces(faces: np.ndarray, what: str) -> np.ndarray:
    """Triangles as int64 [F, 3]; ``ValueError`` for another shape, none at all or negative indices."""
    faces = np.asarray(faces)
    if faces.ndim != 2 or faces.shape[1] != 3 or len(faces) == 0 or faces.dtype.kind not in "iu":
        raise ValueError(
            f"{what}: expected integers of shape [F, 3] with F >= 1, got {faces.dtype} {list(faces.shape)}"
        )
    if faces.min() < 0:
        raise ValueError(f"{what}: vertex index {faces.min()} is negative")
    return faces.astype(np.int64)


def checked_points(points: np.ndarray, least: int, what: str) -> np.ndarray:
    """World positions as float64 [N, 3] of at least ``least`` vertices; ``ValueError`` for other shapes and NaN."""
    points = np.asarray(points, dtype=np.float64)
    if points.ndim != 2 or points.shape[1] != 3 or len(points) < least:
        raise ValueError(f"{what}: expected shape [{least}, 3], got {list(points.shape)}")
    bad = ~np.isfinite(points).all(axis=1)
    if bad.any():
        raise ValueError(f"{what}: vertex {int(np.argmax(bad))} is not finite ({int(bad.sum())} in all)")
    return points[:least]
