"""Flat panels for a garment that was built in three dimensions: ARCSim takes the rest shape from ``vt``.

The garment is cut into panels: first front from back, then wherever a panel cannot be laid flat within the allowed
stretch, in halves again. A panel is laid flat by least-squares conformal maps (Levy et al. 2002) and then as rigidly as
possible (Liu et al. 2008, ARAP, alternating local rotations and a global solve). A lone triangle is flat as it is, so
that the cutting always ends. A panel's v runs along the warp, on average over its triangles.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import scipy.sparse as sp
from scipy.sparse.csgraph import shortest_path
from scipy.sparse.linalg import splu

from geometry.topology import MeshTopology, face_normals
from sim.arcsim.surface_pieces import components, is_disc, own_vertices
from sim.implicit.energies import deformation_coefficients
from sim.rest_state import RestState

SWEEPS = 40  # of local rotations and global solve; nearly developable panels settle in ten
GAP = 0.02  # between panels in the plane [m]
SMALLEST_PANEL = 12  # [triangles] that a cut leaves on their own, where the other side can take them


@dataclass(frozen=True)
class Flattening:
    """Panels of a garment in the plane.

    Attributes:
        uv: Flat positions [m], shape [N, 2].
        corners: Row of ``uv`` at each corner of each triangle, shape [F, 3].
        panel: Panel of each triangle, shape [F].
        stretch: Principal stretches from the garment's own triangle to the flat one, larger first, shape [F, 2].
        turn: Angle from the panel's v to the triangle's warp or weft, whichever is nearer [rad], shape [F]; both have
            one stiffness.
    """

    uv: np.ndarray
    corners: np.ndarray
    panel: np.ndarray
    stretch: np.ndarray
    turn: np.ndarray

    @property
    def panels(self) -> int:
        """Number of panels."""
        return int(self.panel.max()) + 1

    def figures(self) -> dict[str, float]:
        """How good it is: panels, largest and mean distortion, smallest area ratio, mean and largest turn [rad]."""
        strain = np.abs(self.stretch - 1.0).max(axis=1)
        return {
            "panels": float(self.panels),
            "largest_strain": float(strain.max()),
            "mean_strain": float(strain.mean()),
            "area_ratio_min": float(self.stretch.prod(axis=1).min()),
            "area_ratio_max": float(self.stretch.prod(axis=1).max()),
            "mean_turn_rad": float(np.abs(self.turn).mean()),
            "largest_turn_rad": float(np.abs(self.turn).max()),
        }


def flatten(rest: RestState, allowed_strain: float = 0.03) -> Flattening:
    """Lay a garment flat.

    Args:
        rest: Rest state of the garment.
        allowed_strain: Largest strain that laying flat may put on any triangle, in any direction.

    Raises:
        ValueError: ``allowed_strain`` is not above 0.
    """
    if not allowed_strain > 0.0:
        raise ValueError(f"arcsim: allowed_strain = {allowed_strain}: must be above 0")
    faces = rest.topology.faces
    coefficients = np.stack(deformation_coefficients(rest), axis=2)  # [F, 3, 2]
    waiting = [np.asarray(part) for part in reversed(components(faces))]
    panel, corners = np.empty(len(faces), dtype=np.int32), np.empty((len(faces), 3), dtype=np.int32)
    gradient = np.empty((len(faces), 2, 2))
    laid: list[np.ndarray] = []
    number, count, right = 0, 0, 0.0
    while waiting:
        part = waiting.pop()
        local, _ = own_vertices(faces[part])
        uv = _laid_flat(local, coefficients[part], rest.area[part]) if is_disc(local) else None
        if uv is not None:
            columns = np.einsum("fia,fib->fab", uv[local], coefficients[part])  # w_u and w_v in the plane
            if _within(columns, allowed_strain):
                uv = uv - uv.min(axis=0) + [right, 0.0]
                right = uv[:, 0].max() + GAP
                panel[part], corners[part], gradient[part] = number, local + count, columns
                laid.append(uv)
                number, count = number + 1, count + len(uv)
                continue
        waiting += _halves(part, rest)
    rotation, singular = _polar(gradient)
    quarter = 0.5 * np.pi
    turn = np.remainder(np.arctan2(rotation[:, 1, 0], rotation[:, 0, 0]) + 0.5 * quarter, quarter) - 0.5 * quarter
    return Flattening(np.concatenate(laid), corners, panel, singular, turn)


def _within(columns: np.ndarray, allowed: float) -> bool:
    singular = np.linalg.svd(columns, compute_uv=False)
    return bool((np.linalg.det(columns) > 0.0).all() and (np.abs(singular - 1.0) <= allowed + 1e-9).all())


def _laid_flat(faces: np.ndarray, coefficients: np.ndarray, area: np.ndarray) -> np.ndarray:
    """Flat positions [N, 2] of a disc, its v along the mean warp."""
    uv = _conformal(faces, coefficients, area)
    count = len(uv)
    blocks = np.einsum("f,fia,fja->fij", area, coefficients, coefficients)
    rows, columns = np.repeat(faces, 3, axis=1), np.tile(faces, (1, 3))
    matrix = sp.coo_matrix((blocks.ravel(), (rows.ravel(), columns.ravel())), shape=(count, count)).tolil()
    # Energies know no translation: the first vertex stays at the origin.
    matrix[0, :] = 0.0
    matrix[0, 0] = 1.0
    solver = splu(matrix.tocsc())
    for _ in range(SWEEPS):
        rotation, _ = _polar(np.einsum("fia,fib->fab", uv[faces], coefficients))
        pull = np.einsum("f,fib,fab->fia", area, coefficients, rotation)
        right = np.stack([np.bincount(faces.ravel(), pull[:, :, a].ravel(), count) for a in range(2)], axis=1)
        right[0] = 0.0
        uv = solver.solve(right)
    rotation, _ = _polar(np.einsum("fia,fib->fab", uv[faces], coefficients))
    mean, _ = _polar(np.einsum("f,fab->ab", area, rotation)[None])
    return uv @ mean[0]


def _conformal(faces: np.ndarray, coefficients: np.ndarray, area: np.ndarray) -> np.ndarray:
    """Least-squares conformal map of a disc, two far vertices held at their distance along the warp."""
    count, number = int(faces.max()) + 1, np.arange(len(faces))
    first = faces[0, 0]
    last = _farthest(faces, first)
    weight = np.sqrt(area)[:, None]
    bu, bv = weight * coefficients[:, :, 0], weight * coefficients[:, :, 1]
    # w_v is w_u turned by a right angle: x_v = -y_u and y_v = x_u.
    rows, columns = np.repeat(number, 3), faces.ravel()
    shape = (len(faces), count)
    du, dv = (sp.csr_matrix((b.ravel(), (rows, columns)), shape=shape) for b in (bu, bv))
    system = sp.bmat([[dv, du], [-du, dv]]).tocsc()
    held = np.array([first, last, first + count, last + count])
    values = np.array([0.0, 0.0, 0.0, 1.0])
    free = np.setdiff1d(np.arange(2 * count), held)
    normal = (system[:, free].T @ system[:, free]).tocsc()
    solution = np.empty(2 * count)
    solution[held] = values
    solution[free] = splu(normal).solve(-system[:, free].T @ (system[:, held] @ values))
    uv = solution.reshape(2, count).T
    gradient = np.einsum("fia,fib->fab", uv[faces], coefficients)
    scale = np.sqrt((area * np.abs(np.linalg.det(gradient))).sum() / area.sum())
    return uv / max(scale, 1e-12)


def _farthest(faces: np.ndarray, start: int) -> int:
    """The vertex that is the most edges away from ``start``."""
    count = int(faces.max()) + 1
    rows, columns = faces.ravel(), np.roll(faces, 1, axis=1).ravel()
    graph = sp.coo_matrix((np.ones(len(rows)), (rows, columns)), shape=(count, count))
    return int(np.argmax(shortest_path(graph, directed=False, unweighted=True, indices=start)))


def _polar(matrices: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Nearest rotations [N, 2, 2] and singular values [N, 2] of 2 x 2 matrices."""
    left, singular, right = np.linalg.svd(matrices)
    flip = np.sign(np.linalg.det(left @ right))
    left[:, :, 1] *= flip[:, None]
    return left @ right, singular


def _halves(part: np.ndarray, rest: RestState) -> list[np.ndarray]:
    """A panel cut across the direction in which its normals spread the most, as connected pieces."""
    faces = rest.topology.faces[part]
    centre, weight = rest.vertices[faces].mean(axis=1), rest.area[part]
    normal = face_normals(rest.vertices, faces)
    spread = normal - np.average(normal, axis=0, weights=weight)
    axis = np.linalg.svd(spread * np.sqrt(weight)[:, None], full_matrices=False)[2][0]
    place = centre @ axis
    if np.ptp(place) < 1e-9:
        place = np.arange(len(part), dtype=np.float64)
    straight = place > np.average(place, weights=weight)
    side = _tidied(faces, _smoothed(faces, straight))
    if side.all() or not side.any():
        side = straight
    return [half[piece] for half in (part[side], part[~side]) for piece in components(rest.topology.faces[half])]


def _tidied(faces: np.ndarray, side: np.ndarray) -> np.ndarray:
    """Sides without islands: a few triangles on their own go over to the other side."""
    tidied = side.copy()
    for which in (True, False):
        mine = np.flatnonzero(side == which)
        for piece in components(faces[mine]) if len(mine) else []:
            if len(piece) < SMALLEST_PANEL:
                tidied[mine[piece]] = not which
    return tidied


def _smoothed(faces: np.ndarray, side: np.ndarray) -> np.ndarray:
    """Sides without teeth: a triangle with most of its neighbours across the cut goes over to them."""
    topology = MeshTopology.from_faces(faces)
    first, second = topology.hinge_faces.T
    for _ in range(5):
        across = side[first] != side[second]
        count = np.bincount(np.concatenate([first[across], second[across]]), minlength=len(faces))
        lone = count >= 2
        changed = np.where(lone, ~side, side)
        if not changed.any() or changed.all():
            break
        side = changed
    return side
