"""Signed distances of the body on a regular grid, and its morphological closing.

In: the watertight body mesh in its bind pose. Out: a grid whose zero level, offset by the ease, is the surface that a
T-shirt or trousers are cut from. Closing (dilate by r, erode by r) fills what cloth would bridge: armpits, the small of
the back, the navel.

Exact distances are asked only in the shell around the level that will be used; elsewhere the Euclidean distance
transform of the occupancy is enough. That makes a 10 mm grid of a torso a matter of a second.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.ndimage import distance_transform_edt
from skimage.measure import marching_cubes

from garments.landmarks import Landmarks
from garments.surface import DenseSurface
from geometry.proximity import SurfaceQuery

COARSEST_GRID, FINEST_GRID = 0.012, 0.004
"""Limits of the grid's spacing [m]."""

EXACT_CELLS = 2.0
"""Exact distances reach this many cells to either side of a level: one for marching cubes, one for the rough guess."""

GRID_PER_EDGE = 0.5
"""Grid spacing as a share of the garment's edge length; above 0.6 the clusters see the grid's steps."""


@dataclass(frozen=True)
class DistanceField:
    """A scalar field on a regular grid, a signed distance near the level it was made for.

    Attributes:
        values: Signed distances [m], negative inside, shape [NX, NY, NZ].
        origin: Position of the first grid point [m], shape [3].
        spacing: Distance of grid points [m].
    """

    values: np.ndarray
    origin: np.ndarray
    spacing: float

    def points(self) -> np.ndarray:
        """Grid point positions [m], shape [NX, NY, NZ, 3]."""
        axes = [self.origin[k] + self.spacing * np.arange(self.values.shape[k]) for k in range(3)]
        return np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)

    def with_values(self, values: np.ndarray) -> DistanceField:
        """The same grid with other values, shape [NX, NY, NZ]."""
        return DistanceField(values, self.origin, self.spacing)

    def level_surface(self, level: float = 0.0) -> DenseSurface:
        """Marching cubes at ``level`` [m], normals pointing to larger values; open where it leaves the grid."""
        if not self.values.min() < level < self.values.max():
            raise ValueError(
                f"the field has no surface at {level:.4f} m, its values run "
                f"{self.values.min():.4f}..{self.values.max():.4f} m"
            )
        vertices, faces, _, _ = marching_cubes(
            self.values, level, spacing=(self.spacing,) * 3, gradient_direction="descent"
        )
        return DenseSurface(vertices.astype(np.float64) + self.origin, faces.astype(np.int64))


def grid_spacing(edge: float) -> float:
    """Grid spacing [m] for a garment of that edge length [m]."""
    return float(np.clip(GRID_PER_EDGE * edge, FINEST_GRID, COARSEST_GRID))


def empty_grid(low: np.ndarray, high: np.ndarray, spacing: float) -> DistanceField:
    """A grid over the box ``low``..``high`` [m] whose values are not known yet."""
    shape = tuple(np.ceil((np.asarray(high) - np.asarray(low)) / spacing).astype(int) + 1)
    return DistanceField(np.full(shape, np.nan), np.asarray(low, dtype=np.float64), spacing)


def eased_field(
    grid: DistanceField, marks: Landmarks, covered: np.ndarray, gap: np.ndarray, bridged: np.ndarray, close: float
) -> DistanceField:
    """A field whose zero level stands off the body by ``gap``, and off its closing where hollows are bridged.

    Args:
        grid: Grid over the part of the body to cover.
        marks: The body.
        covered: Faces that distances are measured to, shape [G, 3]; what is inside the body is told by all its faces.
        gap: Distance of the garment from the (closed) body at each grid point [m], shape [NX, NY, NZ].
        bridged: 1 where the closing replaces the body, 0 where the body itself counts, else a blend; same shape.
        close: Radius of the closing ball [m].
    """
    near = EXACT_CELLS * grid.spacing
    inside = _occupancy(marks.vertices, marks.faces, grid)
    body = _rough_distance(inside, grid.spacing)
    # Exact at the dilated surface, and where the garment will be: a blend with the closing can sit anywhere up to it.
    highest = np.where(bridged > 0.0, np.maximum(gap, close), gap)
    wanted = np.abs(body - close) < near
    wanted |= (bridged < 1.0) & (body > gap - near) & (body < highest + near)
    body[wanted] = _exact_distance(grid, wanted, inside, marks.vertices, covered)

    # The closing is what a ball cannot reach from outside: the distance to the dilated surface, less the radius.
    dilated = grid.with_values(body).level_surface(close)
    inside = body < close
    closed = _rough_distance(inside, grid.spacing) + close
    lowest = np.where(bridged < 1.0, gap - close, gap)
    wanted = (bridged > 0.0) & (closed > lowest - near) & (closed < gap + near)
    closed[wanted] = _exact_distance(grid, wanted, inside, dilated.vertices, dilated.faces) + close
    return grid.with_values(body + bridged * (closed - body) - gap)


def _exact_distance(
    grid: DistanceField, wanted: np.ndarray, inside: np.ndarray, vertices: np.ndarray, faces: np.ndarray
) -> np.ndarray:
    """Distances [m] of the wanted grid points to a surface, signed by occupancy: right for open surfaces too."""
    if not wanted.any():
        return np.zeros(0)
    hits = SurfaceQuery(faces, len(vertices)).query(grid.points()[wanted], vertices)
    return np.abs(hits.distance) * np.where(inside[wanted], -1.0, 1.0)


def _rough_distance(inside: np.ndarray, spacing: float) -> np.ndarray:
    """Signed distance [m] to within about one cell from an occupancy, shape [NX, NY, NZ]."""
    outer = distance_transform_edt(~inside) if inside.any() else np.full(inside.shape, max(inside.shape), dtype=float)
    inner = (
        distance_transform_edt(inside) if not inside.all() else np.full(inside.shape, max(inside.shape), dtype=float)
    )
    return (outer - inner + np.where(inside, 0.5, -0.5)) * spacing


def _occupancy(vertices: np.ndarray, faces: np.ndarray, grid: DistanceField) -> np.ndarray:
    """Inside flags by winding number along z columns, shape [NX, NY, NZ].

    Every triangle adds +-1 to the columns it covers, from its height downwards: exact also for a mesh that crosses
    itself, where a nearest-normal sign fails.
    """
    nx, ny, nz = grid.values.shape
    # An irrational shift keeps columns off the mesh's symmetry plane and vertices.
    shift = grid.spacing * np.array([np.sqrt(2.0) - 1.0, np.sqrt(3.0) - 1.0]) * 1e-3
    corners = vertices[faces].astype(np.float64)
    planar = (corners[..., :2] - grid.origin[:2] - shift) / grid.spacing
    first = np.maximum(np.ceil(planar.min(axis=1)).astype(int), 0)
    last = np.minimum(np.floor(planar.max(axis=1)).astype(int), [nx - 1, ny - 1])
    size = np.maximum(last - first + 1, 0)
    counts = size[:, 0] * size[:, 1]
    face = np.repeat(np.arange(len(faces)), counts)
    local = np.arange(counts.sum()) - np.repeat(np.cumsum(counts) - counts, counts)
    column = first[face] + np.stack([local // size[face, 1], local % size[face, 1]], axis=1)
    a, b, c = (planar[face, k] for k in range(3))
    doubled = _cross2(b - a, c - a)
    with np.errstate(divide="ignore", invalid="ignore"):
        wb, wc = _cross2(column - a, c - a) / doubled, _cross2(b - a, column - a) / doubled
    hit = (wb >= 0) & (wc >= 0) & (wb + wc <= 1) & (doubled != 0)
    face, column, wb, wc = face[hit], column[hit], wb[hit], wc[hit]
    z = corners[face, :, 2]
    height = z[:, 0] * (1 - wb - wc) + z[:, 1] * wb + z[:, 2] * wc
    # Grid points below the crossing are entered from above; an upward triangle opens the solid below it.
    top = np.clip(np.ceil((height - grid.origin[2]) / grid.spacing).astype(int), 0, nz)
    change = np.zeros((nx, ny, nz + 1), dtype=np.int32)
    np.add.at(change, (column[:, 0], column[:, 1], top), np.where(doubled[hit] > 0, 1, -1))
    # Sum of the crossings above each point.
    winding = change[..., ::-1].cumsum(axis=2)[..., ::-1][..., 1:]
    return winding > 0


def _cross2(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]
