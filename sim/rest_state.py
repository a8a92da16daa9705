"""Rest state of a garment: per-triangle 2-D coordinates, masses and flat hinges.

In: vertices [V, 3] [m] of the garment as sewn (on the bind-pose body), faces [F, 3], pinned vertex indices. Out: the
constants of the two cloth energies, for unit density and unit stiffness, so that one rest state serves every set of
intrinsic parameters:

- Membrane (Baraff & Witkin 1998, section 4.2): ``w_u = dx1 du1 + dx2 du2``, ``w_v = dx1 dv1 + dx2 dv2`` with
  ``dx1 = x1 - x0``, ``dx2 = x2 - x0`` and the inverse of the rest matrix of the triangle.
- Bending (Bergou et al. 2006, isometric): ``E = k/2 |sum_i K_i x_i|^2 / (A0 + A1)`` with cotangent weights ``K``. The
  paper's factor 3 is left out: with it, cylindrical bending comes out about three times too stiff.

The module is free of Warp, so that every solver and every test reads the same constants.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from geometry.mesh_check import check_mesh
from geometry.topology import MeshTopology, face_normals, normalized

# Above this |cosine| between a triangle's normal and the vertical, the vertical has no usable direction in its plane.
_HORIZONTAL_COSINE = 0.98


@dataclass(frozen=True)
class RestState:
    """Constants of a garment's energies.

    Attributes:
        vertices: Rest positions [m], shape [V, 3], float64.
        topology: Edges and hinges.
        pinned: Indices of kinematic vertices, shape [P].
        area: Rest areas of the triangles [m^2], shape [F].
        inverse: ``[[du1, dv1], [du2, dv2]]`` [1/m], shape [F, 2, 2]: deformation gradient columns are
            ``[dx1 dx2] @ inverse``.
        vertex_area: A third of the areas around each vertex [m^2], shape [V]; times density it is the mass.
        inverse_mass: ``1 / vertex_area`` [1/m^2] and 0 for pinned vertices, shape [V].
        hinges: Vertices ``(i, j, k, l)`` of each hinge, shape [H, 4].
        hinge_weights: Cotangent weights ``K / sqrt(A0 + A1)`` [1/m], shape [H, 4], so that the bending energy is
            ``k/2 |sum_i weight_i x_i|^2``.
        hinge_curvature: The length of ``sum_i weight_i x_i`` of a hinge bent to a curvature of 1/m across its edge [m],
            shape [H].
        edge_length: Rest lengths of the edges [m], shape [E].
    """

    vertices: np.ndarray
    topology: MeshTopology
    pinned: np.ndarray
    area: np.ndarray
    inverse: np.ndarray
    vertex_area: np.ndarray
    inverse_mass: np.ndarray
    hinges: np.ndarray
    hinge_weights: np.ndarray
    hinge_curvature: np.ndarray
    edge_length: np.ndarray

    @classmethod
    def from_mesh(
        cls, vertices: np.ndarray, faces: np.ndarray, pinned: np.ndarray | None = None, pieces: int = 1
    ) -> RestState:
        """Measure a mesh.

        Args:
            vertices: Positions of the garment as sewn [m], shape [V, 3].
            faces: Triangles, shape [F, 3].
            pinned: Indices of kinematic vertices, none by default.
            pieces: Connected pieces that the mesh may have; more than 1 for garments worn in layers.

        Raises:
            ValueError: Anything that ``geometry.mesh_check`` refuses, or pins out of range.
        """
        check_mesh("garment", vertices, faces, pieces)
        vertices = np.asarray(vertices, dtype=np.float64)
        topology = MeshTopology.from_faces(faces, len(vertices))
        pinned = np.zeros(0, dtype=np.int32) if pinned is None else np.unique(np.asarray(pinned, dtype=np.int32))
        if len(pinned) and (pinned[0] < 0 or pinned[-1] >= len(vertices)):
            raise ValueError(f"pinned vertices: {pinned[0]} to {pinned[-1]} lie outside the {len(vertices)} vertices")

        inverse, area = material_coordinates(vertices, topology.faces)
        vertex_area = np.bincount(topology.faces.ravel(), np.repeat(area / 3.0, 3), minlength=len(vertices))
        inverse_mass = 1.0 / vertex_area
        inverse_mass[pinned] = 0.0
        ends = vertices[topology.edges]
        return cls(
            vertices=vertices,
            topology=topology,
            pinned=pinned,
            area=area,
            inverse=inverse,
            vertex_area=vertex_area,
            inverse_mass=inverse_mass,
            hinges=topology.hinges,
            hinge_weights=isometric_hinge_weights(vertices, topology.hinges),
            # An angle t over an edge e gives the length e t / sqrt(A0 + A1), and the curvature t over the distance
            # 2 (A0 + A1) / (3 e) between the middles of the wings.
            hinge_curvature=np.sqrt(_wing_areas(vertices, topology.hinges)) * (2.0 / 3.0),
            edge_length=np.linalg.norm(ends[:, 0] - ends[:, 1], axis=-1),
        )

    def edge_strain(self, vertices: np.ndarray) -> np.ndarray:
        """Relative change of edge length against rest, shape [..., E] for ``vertices [..., V, 3]``."""
        i, j = self.topology.edges.T
        length = np.linalg.norm(vertices[..., i, :] - vertices[..., j, :], axis=-1)
        return length / self.edge_length - 1.0


def material_coordinates(vertices: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Inverse rest matrices [1/m], shape [F, 2, 2], and areas [m^2], shape [F], of triangles that are not degenerate.

    v (warp) is the vertical projected into the triangle, u (weft) is at right angles to it in the plane. A triangle
    that lies flat takes the front-back direction z for v, so that a horizontal sheet has one direction throughout.
    """
    normal = face_normals(vertices, faces)
    up = np.tile([0.0, 1.0, 0.0], (len(faces), 1))
    up[np.abs(normal[:, 1]) > _HORIZONTAL_COSINE] = (0.0, 0.0, 1.0)
    v = normalized(up - (up * normal).sum(-1, keepdims=True) * normal)
    u = np.cross(v, normal)
    corners = vertices[faces]
    d1, d2 = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    rest = np.empty((len(faces), 2, 2))  # columns: the two rest edges in (u, v)
    rest[:, 0, 0], rest[:, 0, 1] = (d1 * u).sum(-1), (d2 * u).sum(-1)
    rest[:, 1, 0], rest[:, 1, 1] = (d1 * v).sum(-1), (d2 * v).sum(-1)
    return np.linalg.inv(rest), 0.5 * np.abs(np.linalg.det(rest))


def isometric_hinge_weights(vertices: np.ndarray, hinges: np.ndarray) -> np.ndarray:
    """Cotangent weights of flat hinges over ``sqrt(A0 + A1)`` [1/m], shape [H, 4], from the triangles' own geometry.

    Each triangle's angles are measured in 3-D, so that a curved garment gets the weights of its unfolded hinges, whose
    energy vanishes when flat.
    """
    xi, xj, xk, xl = (vertices[hinges[:, c]] for c in range(4))
    cot_ik, cot_jk = _cotangent(xi, xj, xk), _cotangent(xj, xi, xk)  # at i and j, in the first triangle
    cot_il, cot_jl = _cotangent(xi, xj, xl), _cotangent(xj, xi, xl)  # in the second triangle
    weights = np.stack([cot_jk + cot_jl, cot_ik + cot_il, -cot_ik - cot_jk, -cot_il - cot_jl], axis=1)
    return weights / np.sqrt(_wing_areas(vertices, hinges))[:, None]


def _wing_areas(vertices: np.ndarray, hinges: np.ndarray) -> np.ndarray:
    """Area of the two triangles of each hinge [m^2], shape [H]."""
    xi, xj, xk, xl = (vertices[hinges[:, c]] for c in range(4))
    area = 0.5 * np.linalg.norm(np.cross(xj - xi, xk - xi), axis=-1)
    return area + 0.5 * np.linalg.norm(np.cross(xj - xi, xl - xi), axis=-1)


def _cotangent(apex: np.ndarray, first: np.ndarray, second: np.ndarray) -> np.ndarray:
    a, b = first - apex, second - apex
    return (a * b).sum(-1) / np.linalg.norm(np.cross(a, b), axis=-1)
