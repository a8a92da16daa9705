"""A garment template as the networks for garments of any topology take it: a graph whose vertices carry features.

In: a template and the body that it was built on. Out: the normalized Laplacian of its mesh (Peng 2023, Eq. 2-3) and, a
row a vertex, where the vertex is and how tightly it sits; ``material_row`` gives what the cloth is made of, which goes
beside each row. No number of vertices and no order of them is special: a network on these rows serves every garment.

Dimensions: N garment vertices, E edges, F triangles, P parameters, J = 24 joints.
"""

from __future__ import annotations

import warnings
from collections.abc import Mapping
from collections.abc import Sequence as Many
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import scipy.sparse as sp
import torch
from torch import Tensor

from body.model import Body, skin_matrix
from garments.template import GarmentTemplate
from geometry.proximity import closest_surface
from geometry.topology import MeshTopology, edge_lengths, vertex_normals
from sim.parameters import parameter

JOINTS = 24
PLACE = ("x", "y", "z", "normal x", "normal y", "normal z", "tightness")
"""Features of a vertex beside its material: place about the pelvis [m], outward normal, gap to the body [m]."""

LOOSE = 0.15
"""Gap at which a vertex counts as loose as any [m]."""


@dataclass(frozen=True, eq=False)
class GarmentGraph:
    """A template with the features of its vertices.

    Attributes:
        name: Name of the garment.
        vertices: Rest positions on the bind-pose body [m], shape [N, 3] float32.
        topology: Connectivity.
        place: ``PLACE`` of every vertex, shape [N, 7] float32.
        skin_weight: Weights of the joints at each vertex, rows of sum 1, shape [N, 24] float32.
        pinned: Vertices that are held to the body, shape [.].
        body_digest: Body that the template was built on.
    """

    name: str
    vertices: np.ndarray
    topology: MeshTopology
    place: np.ndarray
    skin_weight: np.ndarray
    pinned: np.ndarray
    body_digest: str

    @classmethod
    def of(cls, template: GarmentTemplate, body: Body) -> GarmentGraph:
        """Graph of a template; ``ValueError`` when it was built on another body."""
        if template.body_digest != body.digest:
            raise ValueError(
                f"garment {template.name}: it was built on body {template.body_name} ({template.body_digest}), "
                f"not on body {body.name} ({body.digest})"
            )
        gap = closest_surface(template.vertices, body.vertices, body.faces).distance
        rows = [template.vertices - body.joints[0], vertex_normals(template.vertices, template.faces)]
        rows.append(np.clip(gap, -LOOSE, LOOSE)[:, None])
        weight = np.zeros((len(template.vertices), JOINTS), dtype=np.float32)
        np.add.at(weight, (np.arange(len(weight))[:, None], template.skin_index), template.skin_weight)
        place = np.concatenate(rows, axis=1).astype(np.float32)
        mesh = (template.name, template.vertices, template.topology)
        return cls(*mesh, place, weight, template.pinned, template.body_digest)

    def permuted(self, order: np.ndarray) -> GarmentGraph:
        """The same garment with its vertices in another order: new vertex i is old vertex ``order[i]``."""
        place = np.argsort(order)
        topology = MeshTopology.from_faces(place[self.topology.faces], len(order))
        rows = (self.place[order], self.skin_weight[order], place[self.pinned])
        return GarmentGraph(self.name, self.vertices[order], topology, *rows, self.body_digest)

    @cached_property
    def rest_lengths(self) -> Tensor:
        """Edge lengths of the template [m], shape [E]."""
        return torch.as_tensor(edge_lengths(self.vertices, self.topology.edges).astype(np.float32))

    @cached_property
    def edges(self) -> Tensor:
        """Ends of the edges, shape [E, 2] int64."""
        return torch.as_tensor(self.topology.edges.astype(np.int64))

    @cached_property
    def faces(self) -> Tensor:
        """Corners of the triangles, shape [F, 3] int64."""
        return torch.as_tensor(self.topology.faces.astype(np.int64))

    @cached_property
    def laplacian(self) -> Tensor:
        """``normalized_laplacian`` as a sparse tensor [N, N]."""
        return sparse_tensor(normalized_laplacian(self.topology))

    @cached_property
    def neighbours(self) -> Tensor:
        """``I - L_n``, what neighbours hand on to a vertex, as a sparse tensor [N, N]."""
        matrix = (sp.identity(len(self.vertices)) - normalized_laplacian(self.topology)).tocsr()
        matrix.eliminate_zeros()
        return sparse_tensor(matrix)

    @cached_property
    def rows(self) -> Tensor:
        """``place`` as a tensor [N, 7]."""
        return torch.as_tensor(self.place)

    @cached_property
    def weights(self) -> Tensor:
        """``skin_weight`` as a tensor [N, 24]."""
        return torch.as_tensor(self.skin_weight)

    @cached_property
    def rest(self) -> Tensor:
        """``vertices`` as a tensor [N, 3]."""
        return torch.as_tensor(self.vertices)

    @cached_property
    def skin(self) -> Tensor:
        """Weighted homogeneous rest positions, shape [N, 96]: times stacked transforms they are skinned vertices."""
        index = np.broadcast_to(np.arange(JOINTS), self.skin_weight.shape)
        return torch.as_tensor(skin_matrix(self.vertices, index, self.skin_weight))


def normalized_laplacian(topology: MeshTopology) -> sp.csr_matrix:
    """``L_n``: 1 on the diagonal, ``-1 / sqrt(d_i d_j)`` between neighbours of degrees d (Peng 2023, Eq. 3)."""
    adjacency = topology.adjacency()
    degree = np.maximum(np.asarray(adjacency.sum(axis=1)).ravel(), 1.0)
    root = sp.diags(1.0 / np.sqrt(degree))
    return (sp.identity(topology.vertex_count) - root @ adjacency @ root).tocsr()


def sparse_tensor(matrix: sp.csr_matrix) -> Tensor:
    """A SciPy matrix as a float32 CSR tensor."""
    parts = (matrix.indptr.astype(np.int64), matrix.indices.astype(np.int64), matrix.data.astype(np.float32))
    with warnings.catch_warnings():  # torch calls the format a beta, once a process
        warnings.simplefilter("ignore", UserWarning)
        return torch.sparse_csr_tensor(*map(torch.as_tensor, parts), size=matrix.shape, check_invariants=False)


class _Propagate(torch.autograd.Function):
    """Product with a symmetric sparse matrix; its gradient is the product with the same matrix."""

    @staticmethod
    def forward(ctx, matrix: Tensor, rows: Tensor) -> Tensor:
        ctx.matrix = matrix
        return matrix @ rows

    @staticmethod
    def backward(ctx, gradient: Tensor) -> tuple[None, Tensor]:
        return None, ctx.matrix @ gradient.contiguous()


def propagate(matrix: Tensor, rows: Tensor) -> Tensor:
    """A symmetric sparse matrix [N, N] times ``rows [N, ...]``."""
    return _Propagate.apply(matrix, rows.flatten(1).contiguous()).view_as(rows)


def material_row(parameters: Mapping[str, float], names: Many[str]) -> np.ndarray:
    """Values [P] float32 of the named intrinsic parameters; those that span decades as their logarithm.

    Raises:
        ValueError: One is missing, not finite, or has no logarithm.
    """
    row = []
    for name in names:
        if name not in parameters:
            raise ValueError(f"material: parameter {name!r} is needed, but is not given")
        value, logarithmic = float(parameters[name]), parameter(name).logarithmic
        if not np.isfinite(value) or (logarithmic and value <= 0.0):
            raise ValueError(
                f"material: parameter {name!r} must be {'above 0' if logarithmic else 'finite'}, got {value}"
            )
        row.append(np.log(value) if logarithmic else value)
    return np.array(row, dtype=np.float32)
