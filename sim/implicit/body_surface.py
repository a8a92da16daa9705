"""The moving body as the implicit solver sees it: closest points by body part, interval by interval.

A vertex of the garment meets only the body parts that it belongs to (``sim.body_parts``).
"""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp
import warp as wp

from geometry.topology import face_normals, normalized
from sim.body_parts import ContactParts
from sim.implicit.contact_kernels import find_closest, place_body


class BodySurface:
    """Trajectory of a closed triangle mesh and the closest-point query against it.

    Attributes:
        start, end: Body vertices [m] at the two ends of the current interval, shape [B].
        normal_start, normal_end: Smooth unit normals there.
        hit_face, hit_weights: Result of the last :meth:`query` for each garment vertex: body face (-1: none near) and
            barycentric weights.
    """

    def __init__(self, trajectory: np.ndarray, faces: np.ndarray, parts: ContactParts):
        """Prepare the surface.

        Args:
            trajectory: Body vertices at the ends of all intervals [m], shape [Q, B, 3].
            faces: Body faces, shape [G, 3], normals outward.
            parts: Faces of the body's parts and the parts that each garment vertex collides with.
        """
        trajectory = np.asarray(trajectory)
        if trajectory.ndim != 3 or trajectory.shape[2] != 3:
            raise ValueError(f"body trajectory: expected shape [Q, B, 3], got {list(trajectory.shape)}")
        if not np.isfinite(trajectory).all():
            sample = int(np.argmax(~np.isfinite(trajectory).all(axis=(1, 2))))
            raise ValueError(f"body trajectory: sample {sample} is not finite")
        face_groups, vertex_group = _face_groups(parts)
        count, vertex_count = trajectory.shape[1], len(vertex_group)
        self.trajectory = trajectory
        self._faces = np.asarray(faces, dtype=np.int32)
        corners = self._faces.ravel()
        owners = np.repeat(np.arange(len(self._faces)), 3)
        self._gather = sp.csr_matrix((np.ones(len(corners)), (corners, owners)), shape=(count, len(self._faces)))

        def array(values: np.ndarray, dtype: type) -> wp.array:
            return wp.array(values, dtype=dtype, device="cpu")

        self.faces = array(self._faces, wp.vec3i)
        self.start, self.end, self.normal_start, self.normal_end = (
            wp.zeros(count, dtype=wp.vec3d, device="cpu") for _ in range(4)
        )
        # All groups share the points; each has its own tree over its own faces.
        self._points = array(trajectory[0], wp.vec3f)
        self._meshes = [
            wp.Mesh(points=self._points, indices=array(self._faces[group].ravel(), wp.int32)) for group in face_groups
        ]
        self._mesh_ids = array(np.array([mesh.id for mesh in self._meshes], dtype=np.uint64), wp.uint64)
        offsets = np.concatenate([[0], np.cumsum([len(group) for group in face_groups])])
        self._face_offsets = array(offsets.astype(np.int32), wp.int32)
        self._face_numbers = array(np.concatenate(face_groups).astype(np.int32), wp.int32)
        self._vertex_group = array(vertex_group, wp.int32)
        self.hit_face = wp.full(vertex_count, -1, dtype=wp.int32, device="cpu")
        self.hit_weights = wp.zeros(vertex_count, dtype=wp.vec3d, device="cpu")
        self._shown = -1
        self.show(0)

    def show(self, sample: int) -> None:
        """Make a sample the end of the interval; the interval starts at the one shown before (or at itself, first)."""
        if self._shown >= 0:
            wp.copy(self.start, self.end)
            wp.copy(self.normal_start, self.normal_end)
        if sample != self._shown:
            vertices = self.trajectory[sample].astype(np.float64)
            self.end.assign(vertices)
            self.normal_end.assign(normalized(self._gather @ face_normals(vertices, self._faces, unit=False)))
        if self._shown < 0:
            wp.copy(self.start, self.end)
            wp.copy(self.normal_start, self.normal_end)
        self._shown = sample

    def query(
        self, positions: wp.array, velocities: wp.array, ahead: float, share: float, radius: float, near: float
    ) -> None:
        """Find the closest body points.

        Args:
            positions: Garment vertices [m], vec3d, shape [V].
            velocities: Their velocities [m/s].
            ahead: The points are sought for where the vertices will be after this time [s].
            share: Place of the body within the interval, 0 to 1.
            radius: Farthest body point of interest [m].
            near: Points this near always count, others only where the surface faces the vertex [m].
        """
        wp.launch(place_body, dim=len(self.start), inputs=[self.start, self.end, share, self._points], device="cpu")
        for mesh in self._meshes:
            mesh.refit()
        wp.launch(
            find_closest,
            dim=len(self.hit_face),
            inputs=[
                self._mesh_ids, self._face_offsets, self._face_numbers, self._vertex_group,
                positions, velocities, ahead, radius, near, self.faces, self._points,
                self.normal_start, self.normal_end, share, self.hit_face, self.hit_weights,
            ],
            device="cpu",
        )  # fmt: skip


def _face_groups(parts: ContactParts) -> tuple[list[np.ndarray], np.ndarray]:
    """One set of faces for every combination of parts that some vertex owns, and each vertex's set (int32)."""
    combinations, group = np.unique(np.sort(parts.owned, axis=1), axis=0, return_inverse=True)
    faces = [np.unique(np.concatenate([parts.faces[p] for p in row if p >= 0])) for row in combinations]
    return faces, group.reshape(-1).astype(np.int32)
