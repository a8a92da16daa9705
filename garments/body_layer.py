"""A garment as a layer on the body mesh: displacements of the body's own vertices in the unposed space (Ma 2019).

In: a garment's template on its body, and the garment as it was simulated. Out: for each covered body vertex how far it
has to be moved *before* skinning, so that the skinned body wears the garment.

Which point of the cloth lies over a body vertex is decided once, on the bind pose, where the garment is as it was cut:
the nearest point of the outermost garment over it. The same point of the cloth then belongs to the same body vertex in
every frame and on every body, for grading keeps triangles. Where cloth slides, the layer slides with it, and a hem that
rises takes the body's vertices along: the layer is the cloth, sampled at the body's vertices.

Unposing is the inverse of linear blend skinning at the vertex itself, ``d = M^-1 x - v`` with ``M = sum_j w_j T_j``;
skinning ``v + d`` gives ``x`` again, whatever the pose.

T frames, V garment vertices, B body vertices, C covered ones.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np
import scipy.sparse as sp
from scipy.sparse.csgraph import connected_components

from geometry.proximity import closest_surface
from geometry.topology import MeshTopology, vertex_normals

if TYPE_CHECKING:
    from body.model import Body
    from garments.template import GarmentTemplate

REACH = 0.10
"""Farthest that cloth may be from the vertex that it covers, on the bind pose [m]."""

BARE_JOINTS = (7, 8, 10, 11, 15, 20, 21, 22, 23)
"""Feet, toes, head, wrists and hands: never covered (the paper leaves them out of its errors)."""

LARGEST_HOLE = 40
"""Vertices that no cloth was found over, but cloth around: so many are a fold of the body, an armpit; more are skin."""

LOOSE = 0.03
"""Cloth farther from the naked body than this is called loose [m]."""

SMALLEST_VOLUME = 0.01
"""Least determinant of a blended skinning matrix that is inverted."""


@dataclass(frozen=True)
class LayerMap:
    """Which point of a garment lies over which vertex of the body.

    Attributes:
        garment: Name of the garment.
        body_digest: Digest of the body.
        covered: Covered body vertices, ascending, shape [C].
        points: Weights of the garment's vertices at the points over them, shape [C, V].
        worn: Number of the garment over each, counted from the body outwards, shape [C].
        visible: Garment vertices that no other garment lies over, shape [V].
    """

    garment: str
    body_digest: str
    covered: np.ndarray
    points: sp.csr_matrix
    worn: np.ndarray
    visible: np.ndarray


def cast_layer(template: GarmentTemplate, body: Body) -> LayerMap:
    """Cast every body vertex onto the outermost garment over it, on the bind pose.

    Raises:
        ValueError: The garment was made for another body, or covers nothing of it.
    """
    _check_body(f"garment '{template.name}'", template.body_digest, body)
    vertices = template.vertices.astype(np.float64)
    skin, normals = body.vertices.astype(np.float64), vertex_normals(body.vertices.astype(np.float64), body.faces)
    clothable = ~np.isin(body.part_of_vertex, BARE_JOINTS)
    face, weight = np.full(len(skin), -1), np.zeros((len(skin), 3))
    visible = np.ones(len(vertices), dtype=bool)
    for layer in reversed(range(len(template.worn))):
        faces = np.flatnonzero(template.face_layer == layer)
        rim = _Rim(template.faces[faces], len(vertices))
        asked = np.flatnonzero(clothable & (face < 0))
        hits = closest_surface(skin[asked], vertices, template.faces[faces])
        outwards = np.einsum("vc,vc->v", hits.point - skin[asked], normals[asked]) > 0.0
        near = np.linalg.norm(hits.point - skin[asked], axis=1) < REACH
        over = outwards & near & ~rim.holds(hits.face, hits.barycentric)
        over = _holes_filled(over, near, asked, clothable & (face < 0), body)
        face[asked[over]], weight[asked[over]] = faces[hits.face[over]], hits.barycentric[over]
        under = np.flatnonzero(template.layer < layer)
        if len(under):
            above = closest_surface(vertices[under], vertices, template.faces[faces])
            hidden = (np.abs(above.distance) < REACH) & ~rim.holds(above.face, above.barycentric)
            visible[under[hidden]] = False
    covered = np.flatnonzero(face >= 0)
    if not len(covered):
        raise ValueError(f"garment '{template.name}': no vertex of body {body.name} lies under it")
    rows = np.repeat(np.arange(len(covered)), 3)
    columns = template.faces[face[covered]].reshape(-1)
    shape = (len(covered), len(vertices))
    points = sp.csr_matrix((weight[covered].reshape(-1), (rows, columns)), shape=shape)
    return LayerMap(template.name, body.digest, covered, points, template.face_layer[face[covered]], visible)


class BodyLayer:
    """The layer of one garment on one body, in the shape that the garment was graded to.

    Raises:
        ValueError: The map was made for another body.
    """

    def __init__(self, layer: LayerMap, body: Body) -> None:
        _check_body(f"layer of garment '{layer.garment}'", layer.body_digest, body)
        self.layer, self.body = layer, body

    def displacements(self, garment: np.ndarray, pose: np.ndarray, root: np.ndarray) -> np.ndarray:
        """How far each covered body vertex is moved in the unposed space [m], shape [T, C, 3] float32.

        Args:
            garment: Garment in the world [m], shape [T, V, 3].
            pose: Poses [rad], shape [T, 24, 3].
            root: Root translations [m], shape [T, 3].
        """
        garment = np.asarray(garment)
        if garment.ndim != 3 or garment.shape[1:] != (self.layer.points.shape[1], 3) or len(garment) != len(pose):
            raise ValueError(
                f"layer of garment '{self.layer.garment}': expected {len(pose)} frames of "
                f"{self.layer.points.shape[1]} vertices, got shape {list(garment.shape)}"
            )
        covered = self.layer.covered
        cloth = np.stack([self.layer.points @ frame for frame in garment.astype(np.float64)])
        return (unposed(cloth, self.body, covered, pose, root) - self.body.vertices[covered]).astype(np.float32)

    def dressed(self, displacements: np.ndarray, pose: np.ndarray, root: np.ndarray) -> np.ndarray:
        """The posed body with its layer on [m], shape [T, B, 3] float32; displacements [T, C, 3] as above."""
        whole = np.zeros((len(displacements), len(self.body.vertices), 3), dtype=np.float32)
        whole[:, self.layer.covered] = displacements
        return dressed_body(self.body, whole, pose, root)


def dressed_body(body: Body, displacements: np.ndarray, pose: np.ndarray, root: np.ndarray) -> np.ndarray:
    """The posed body with displacements of all its vertices [m], [T, B, 3] before and after, float32 (Ma 2019, eq. 3).

    Raises:
        ValueError: Displacements of another number of vertices than the body has.
    """
    if displacements.ndim != 3 or displacements.shape[1:] != (len(body.vertices), 3):
        expected = f"[T, {len(body.vertices)}, 3]"
        raise ValueError(f"displacements: expected shape {expected} for body {body.name}, got {displacements.shape}")
    linear, shift = blended_transforms(body, np.arange(len(body.vertices)), pose, root)
    moved = body.vertices.astype(np.float64) + displacements
    return (np.einsum("tbij,tbj->tbi", linear, moved) + shift).astype(np.float32)


def unposed(points: np.ndarray, body: Body, of: np.ndarray, pose: np.ndarray, root: np.ndarray) -> np.ndarray:
    """World points [T, N, 3] [m], each carried back to the unposed space by the skinning of the body vertex ``of`` [N].

    Raises:
        ValueError: A skinning matrix that is flat cannot be inverted: a joint is twisted by half a turn.
    """
    linear, shift = blended_transforms(body, of, pose, root)
    cofactors = np.stack(
        [np.cross(linear[..., 1, :], linear[..., 2, :]), np.cross(linear[..., 2, :], linear[..., 0, :]),
         np.cross(linear[..., 0, :], linear[..., 1, :])], axis=-1,
    )  # fmt: skip
    volume = np.einsum("...i,...i->...", linear[..., 0, :], cofactors[..., :, 0])
    if volume.min() < SMALLEST_VOLUME:
        frame, point = np.unravel_index(int(volume.argmin()), volume.shape)
        raise ValueError(
            f"frame {frame}: the skinning of body vertex {int(of[point])} is flat (volume {volume.min():.3g}, at least "
            f"{SMALLEST_VOLUME} is needed to unpose): a joint beside it is twisted by half a turn"
        )
    return np.einsum("tnij,tnj->tni", cofactors, points - shift) / volume[..., None]


def blended_transforms(body: Body, of: np.ndarray, pose: np.ndarray, root: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Linear part [T, N, 3, 3] and shift [T, N, 3] [m] of the skinning of the body vertices ``of`` [N]."""
    transforms = body.joint_transforms(pose, root)[:, :, :3]  # [T, 24, 3, 4]
    weights = np.zeros((len(of), transforms.shape[1]))
    np.add.at(weights, (np.arange(len(of))[:, None], body.skin_index[of]), body.skin_weight[of])
    blended = (weights @ transforms.reshape(len(transforms), transforms.shape[1], 12)).reshape(-1, len(of), 3, 4)
    return blended[..., :3], blended[..., 3]


@dataclass(frozen=True)
class TransferError:
    """Distances from the garment's visible vertices to the displaced body surface in some frames.

    Attributes:
        distance: [m], shape [N].
        gap: Distance of the same vertices to the naked body [m], shape [N].
    """

    distance: np.ndarray
    gap: np.ndarray

    def figures(self) -> dict[str, float]:
        """Mean and 95th percentile [mm], of all cloth and of what is loose, and the share that is loose."""
        loose = self.gap > LOOSE
        row = {"mean_mm": 1e3 * float(self.distance.mean()), "p95_mm": 1e3 * float(np.percentile(self.distance, 95))}
        row["loose_share_percent"] = 100.0 * float(loose.mean())
        if loose.any():
            row["loose_mean_mm"] = 1e3 * float(self.distance[loose].mean())
            row["loose_p95_mm"] = 1e3 * float(np.percentile(self.distance[loose], 95))
        return row


def transfer_error(
    layer: BodyLayer, garment: np.ndarray, displacements: np.ndarray, pose: np.ndarray, root: np.ndarray
) -> TransferError:
    """What bringing a garment to the body's topology loses: how far its visible cloth is from the dressed body."""
    body, visible = layer.body, layer.layer.visible
    naked, dressed = body.posed(pose, root), layer.dressed(displacements, pose, root)
    distance, gap = [], []
    for cloth, skin, worn in zip(garment[:, visible], naked, dressed, strict=True):
        distance.append(np.abs(closest_surface(cloth, worn, body.faces).distance))
        gap.append(closest_surface(cloth, skin, body.faces).distance)
    return TransferError(np.concatenate(distance), np.concatenate(gap))


class _Rim:
    """The openings of a garment."""

    def __init__(self, faces: np.ndarray, vertex_count: int) -> None:
        topology = MeshTopology.from_faces(faces, vertex_count)
        ends = topology.edges[topology.boundary]
        self.faces, self.count = faces, vertex_count
        self.keys = np.unique(ends.min(axis=1).astype(np.int64) * vertex_count + ends.max(axis=1))
        self.vertex = np.zeros(vertex_count, dtype=bool)
        self.vertex[ends] = True

    def holds(self, face: np.ndarray, barycentric: np.ndarray) -> np.ndarray:
        """Whether points of the faces lie on an opening: what is closest to it there may lie beyond the garment."""
        corners, off = self.faces[face], barycentric < 1e-6
        at_vertex = off.sum(axis=1) == 2
        found = at_vertex & self.vertex[corners[np.arange(len(corners)), barycentric.argmax(axis=1)]]
        for k in range(3):
            i, j = corners[:, (k + 1) % 3].astype(np.int64), corners[:, (k + 2) % 3].astype(np.int64)
            key = np.minimum(i, j) * self.count + np.maximum(i, j)
            found |= off[:, k] & ~at_vertex & np.isin(key, self.keys)
        return found


def _holes_filled(over: np.ndarray, near: np.ndarray, asked: np.ndarray, open_: np.ndarray, body: Body) -> np.ndarray:
    """``over`` of the asked vertices, with small patches that cloth is near to and lies around."""
    bare = np.ones(len(body.vertices), dtype=bool)
    bare[asked[over]] = False
    graph = MeshTopology.from_faces(body.faces, len(body.vertices)).adjacency()
    left = np.flatnonzero(bare)
    _, label = connected_components(graph[left][:, left], directed=False)
    small = np.bincount(label)[label] <= LARGEST_HOLE
    hole = np.zeros(len(bare), dtype=bool)
    hole[left[small]] = True
    return over | (hole & open_)[asked] & near


def _check_body(what: str, digest: str, body: Body) -> None:
    if digest != body.digest:
        raise ValueError(f"{what} was made for another body ({digest}) than {body.name} ({body.digest})")
