"""Skin weights of a garment: those of the nearest body surface, made smooth over the garment.

They move held vertices with the body, carry the skinned baseline, and say which body part a vertex belongs to. The
nearest point jumps between the legs under a skirt and from arm to trunk in the armpit, so the raw weights are smoothed
by one implicit diffusion step over the garment mesh; held vertices keep the raw weights, for they must follow the skin
under them.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import scipy.sparse as sp
from scipy.sparse.linalg import splu

from garments.ease import smooth_step
from garments.landmarks import Landmarks
from geometry.proximity import closest_surface
from geometry.topology import MeshTopology, edge_lengths

if TYPE_CHECKING:
    from body.model import Body

JOINT_COUNT = 24
WEIGHTS_PER_VERTEX = 4

WEIGHT_REACH = 0.025
"""Smoothing length of the skin weights [m]."""

BETWEEN_LEGS_REACH = 0.09
"""The same for a skirt below the crotch, where the nearest body point jumps from one leg to the other [m]."""


def weight_reach(kind: str, vertices: np.ndarray, marks: Landmarks) -> np.ndarray:
    """Smoothing length of the weights [m], shape [V], of a garment of that kind: far between the legs of a skirt."""
    reach = np.full(len(vertices), WEIGHT_REACH)
    if kind in ("skirt", "dress"):
        reach += (BETWEEN_LEGS_REACH - WEIGHT_REACH) * smooth_step((marks.crotch + 0.15 - vertices[:, 1]) / 0.2)
    return reach


def garment_weights(
    vertices: np.ndarray,
    faces: np.ndarray,
    held: np.ndarray,
    body: Body,
    marks: Landmarks,
    reach: np.ndarray,
    arms: bool,
) -> tuple[np.ndarray, np.ndarray]:
    """Smooth skin weights of a garment on the bind-pose body.

    Args:
        vertices: Garment vertices [m], shape [V, 3].
        faces: Garment triangles, shape [F, 3].
        held: Vertices that keep the raw weights, shape [P].
        body: The body under the garment.
        marks: Its landmarks.
        reach: Smoothing length per vertex [m], shape [V].
        arms: Whether the arms may lend weights, as in ``body_under``.

    Returns:
        Joint numbers, shape [V, 4] int32, and weights summing to one, shape [V, 4] float32.
    """
    corners, barycentric = body_under(vertices, marks, arms)
    dense_body = np.zeros((len(marks.vertices), JOINT_COUNT))
    np.add.at(dense_body, (np.arange(len(dense_body))[:, None], body.skin_index), body.skin_weight)
    raw = np.einsum("vk,vkj->vj", barycentric, dense_body[corners])
    smooth = np.maximum(smoothed(raw, vertices, faces, reach, held), 0.0)
    index = np.argsort(-smooth, axis=1, kind="stable")[:, :WEIGHTS_PER_VERTEX]
    weight = np.take_along_axis(smooth, index, axis=1)
    weight /= weight.sum(axis=1, keepdims=True)
    return index.astype(np.int32), weight.astype(np.float32)


def body_under(vertices: np.ndarray, marks: Landmarks, arms: bool) -> tuple[np.ndarray, np.ndarray]:
    """The body surface closest to each vertex of a garment.

    Args:
        vertices: Garment vertices [m], shape [V, 3].
        marks: The body.
        arms: Whether the garment is worn on the arms. Below the crotch they count for none: a wide hem is not a hand's
            because the hand happens to be near.

    Returns:
        Corners of the closest body triangles, shape [V, 3], and the closest points' barycentric coordinates, [V, 3].
    """
    corners, barycentric = np.empty((len(vertices), 3), dtype=np.int64), np.empty((len(vertices), 3))
    on_arms = (vertices[:, 1] > marks.crotch) & arms
    for mine, faces in ((on_arms, marks.faces), (~on_arms, marks.trunk_faces)):
        if mine.any():
            hits = closest_surface(vertices[mine], marks.vertices, faces)
            corners[mine], barycentric[mine] = faces[hits.face], hits.barycentric
    return corners, barycentric


def smoothed(
    values: np.ndarray, vertices: np.ndarray, faces: np.ndarray, reach: np.ndarray, held: np.ndarray
) -> np.ndarray:
    """Values on a garment's vertices after one implicit step of diffusion over its mesh.

    Args:
        values: Shape [V, K].
        vertices: Garment vertices [m], shape [V, 3].
        faces: Garment triangles, shape [F, 3].
        reach: Smoothing length per vertex [m], shape [V].
        held: Vertices that keep their values, shape [P].
    """
    topology = MeshTopology.from_faces(faces, len(vertices))
    edge = edge_lengths(vertices, topology.edges).mean()
    # On a triangular lattice the umbrella operator is -(edge^2 / 4) times the Laplace operator.
    strength = 4.0 * (reach / edge) ** 2
    strength[held] = 0.0
    system = sp.identity(len(vertices)) + sp.diags(strength) @ topology.uniform_laplacian()
    return splu(system.tocsc()).solve(values)
