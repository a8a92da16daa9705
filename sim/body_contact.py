"""The moving body as the cloth meets it: a skinned surface in parts, closest-point queries and cached contact planes.

In: a skinned body in its bind pose, the parts that a garment collides with and, for each query interval, the skinning
transforms at its end. Positions are relative to a floating origin near the pelvis that the caller moves along.
"""

from __future__ import annotations

import numpy as np
import warp as wp

from sim.body_parts import ContactParts
from sim.kernels import contact as kernels

LIMB_RADIUS = 0.05
"""Radius of the narrower limbs, knee and elbow [m]: sets how much coarse triangles stand off."""


class Skin:
    """Points that follow a skeleton by linear blend skinning, at the start and the end of a query interval.

    Attributes:
        start: Positions at the start of the interval [m], shape [N].
        end: Positions at its end [m], shape [N].
    """

    def __init__(self, bind: np.ndarray, index: np.ndarray, weight: np.ndarray, device: str):
        index, weight = _four_joints(index, weight)
        self.device = device
        self.count = len(bind)
        self.bind = wp.array(bind.astype(np.float32), dtype=wp.vec3, device=device)
        self.index = wp.array(index, dtype=wp.vec4i, device=device)
        self.weight = wp.array(weight, dtype=wp.vec4, device=device)
        self.start = wp.zeros(self.count, dtype=wp.vec3, device=device)
        self.end = wp.zeros(self.count, dtype=wp.vec3, device=device)

    def launch(self, skeleton: Skeleton) -> None:
        """Begin an interval: the end becomes the start, a new end is skinned."""
        if self.count:
            inputs = [self.bind, self.index, self.weight, skeleton.rotation, skeleton.translation, skeleton.shift]
            wp.launch(kernels.skin_points, self.count, inputs, [self.start, self.end], device=self.device)


class Skeleton:
    """Skinning transforms on the device, relative to the floating origin.

    The bind pose is taken relative to ``centre``, so that float32 rounding acts on lengths around a metre.

    Attributes:
        origin: Floating origin of the last interval [m], shape [3], float64.
    """

    def __init__(self, joint_count: int, centre: np.ndarray, device: str):
        self.centre = np.asarray(centre, dtype=np.float64)
        self.origin = np.zeros(3)
        self.rotation = wp.zeros(joint_count, dtype=wp.mat33, device=device)
        self.translation = wp.zeros(joint_count, dtype=wp.vec3, device=device)
        self.shift = wp.zeros(1, dtype=wp.vec3, device=device)

    def set(self, transforms: np.ndarray, origin: np.ndarray) -> None:
        """Transforms [J, 4, 4] of bind to world points at the end of the interval, and the origin for it [m]."""
        rotation = transforms[:, :3, :3].astype(np.float64)
        translation = transforms[:, :3, 3] + rotation @ self.centre - origin
        self.rotation.assign(np.ascontiguousarray(rotation, dtype=np.float32))
        self.translation.assign(translation.astype(np.float32))
        self.shift.assign((self.origin - origin).astype(np.float32)[None])
        self.origin = np.array(origin, dtype=np.float64)


class BodyContact:
    """Surface of a skinned body and the contacts of ``vertex_count`` garment vertices with it."""

    def __init__(
        self,
        vertices: np.ndarray,
        faces: np.ndarray,
        index: np.ndarray,
        weight: np.ndarray,
        parts: ContactParts,
        standoff: np.ndarray,
        skeleton: Skeleton,
        reach: float,
        device: str,
    ):
        """Keep the part of the body that the garment can meet.

        Args:
            vertices: Bind-pose body [m], shape [B, 3].
            faces: Its triangles, outward, shape [F, 3].
            index: Joints of each body vertex, shape [B, k].
            weight: Their weights, shape [B, k].
            parts: Faces of each part and the parts of each garment vertex.
            standoff: Distance that each vertex keeps besides the thickness [m], shape [V]; see :func:`sag`.
            skeleton: Transforms that move the body.
            reach: Radius of the closest-point query [m].
            device: Warp device.
        """
        self.device, self.skeleton, self.reach = device, skeleton, float(reach)
        count = len(parts.owned)
        used_faces = np.unique(np.concatenate(parts.faces)) if parts.faces else np.zeros(0, dtype=np.int64)
        used = np.unique(faces[used_faces])
        renumber = np.full(len(vertices), -1, dtype=np.int32)
        renumber[used] = np.arange(len(used))
        part_faces = [renumber[faces[f]] for f in parts.faces]

        self.skin = Skin(
            np.asarray(vertices, dtype=np.float64)[used] - skeleton.centre, index[used], weight[used], device
        )
        first_corner, corners = _corner_table(renumber[faces[used_faces]], len(used))
        self.first_corner = wp.array(first_corner, dtype=int, device=device)
        self.corners = wp.array(corners, dtype=wp.vec2i, device=device)
        self.normals_start = wp.zeros(len(used), dtype=wp.vec3, device=device)
        self.normals_end = wp.zeros(len(used), dtype=wp.vec3, device=device)
        # All parts share the points of the interval's end; the trees follow by a refit.
        self.skin.end.assign((np.asarray(vertices)[used] - skeleton.centre).astype(np.float32))
        self.meshes = [wp.Mesh(self.skin.end, wp.array(f.ravel(), dtype=int, device=device)) for f in part_faces]
        self.mesh_ids = wp.array([mesh.id for mesh in self.meshes], dtype=wp.uint64, device=device)
        offsets = np.concatenate([[0], np.cumsum([len(f) for f in part_faces])[:-1]]) if part_faces else np.zeros(0)
        self.first_face = wp.array(offsets.astype(np.int32), dtype=int, device=device)
        stacked = np.concatenate(part_faces) if part_faces else np.zeros((0, 3), dtype=np.int32)
        self.faces = wp.array(stacked, dtype=wp.vec3i, device=device)

        self.standoff = wp.array(np.asarray(standoff, dtype=np.float32), dtype=float, device=device)
        self.owned = wp.array(parts.owned, dtype=wp.vec4i, device=device)
        self.corner = wp.full(count, wp.vec3i(-1, -1, -1), dtype=wp.vec3i, device=device)
        self.barycentric = wp.zeros(count, dtype=wp.vec3, device=device)
        self.lean = wp.zeros(count, dtype=wp.vec3, device=device)
        self.clearance = wp.zeros(count, dtype=float, device=device)
        self.distance = wp.full(count, self.reach, dtype=float, device=device)
        self.plane_point = wp.zeros(count, dtype=wp.vec3, device=device)
        self.plane_travel = wp.zeros(count, dtype=wp.vec3, device=device)
        self.plane_normal = wp.zeros(count, dtype=wp.vec3, device=device)
        self.plane_turn = wp.zeros(count, dtype=wp.vec3, device=device)
        self.count = count

    def launch_motion(self) -> None:
        """Record: move the body to the end of the next interval and carry the contact planes along."""
        if not self.meshes:
            return
        self.skin.launch(self.skeleton)
        inputs = [self.first_corner, self.corners, self.skin.end]
        outputs = [self.normals_start, self.normals_end]
        wp.launch(kernels.smooth_normals, self.skin.count, inputs, outputs, device=self.device)
        inputs = [self.corner, self.barycentric, self.skin.start, self.skin.end]
        inputs += [self.normals_start, self.normals_end, self.lean]
        outputs = [self.plane_point, self.plane_travel, self.plane_normal, self.plane_turn]
        wp.launch(kernels.carry_planes, self.count, inputs, outputs, device=self.device)

    def launch_solve(
        self, fraction: float, step: float, inverse_mass: wp.array, x_prev: wp.array, parameters: wp.array, x: wp.array
    ) -> None:
        """Record: contact and friction of one substep at ``fraction`` of the interval."""
        if not self.meshes:
            return
        inputs = [fraction, step, inverse_mass, self.corner, self.clearance, self.plane_point, self.plane_travel]
        inputs += [self.plane_normal, self.plane_turn, x_prev, parameters]
        wp.launch(kernels.solve_contact, self.count, inputs, [x], device=self.device)

    def find(
        self, inverse_mass: wp.array, parameters: wp.array, x: wp.array, passes: int = 3, reach: float | None = None
    ) -> None:
        """Refit to the end of the interval, put vertices outside and cache their contacts. Never inside a graph."""
        if not self.meshes:
            return
        for mesh in self.meshes:
            mesh.refit()
        inputs = [
            self.reach if reach is None else reach,
            passes,
            inverse_mass,
            self.standoff,
            self.owned,
            self.mesh_ids,
            self.first_face,
            self.faces,
        ]
        inputs += [self.skin.end, self.normals_end, parameters]
        outputs = [x, self.corner, self.barycentric, self.lean, self.clearance, self.distance]
        wp.launch(kernels.find_contacts, self.count, inputs, outputs, device=self.device)

    def forget(self) -> None:
        """Drop the cached contacts, before the garment is put somewhere else."""
        self.corner.fill_(wp.vec3i(-1, -1, -1))


def sag(edges: np.ndarray, edge_length: np.ndarray, vertex_count: int) -> np.ndarray:
    """How far triangles dip towards a limb between vertices that lie on it [m], shape [V]: ``L^2 / (8 r)``.

    Contact knows vertices only. So that the cloth itself keeps the thickness, its vertices keep this much more, with
    the mean length L of the edges around each.
    """
    ends = edges.ravel()
    total = np.bincount(ends, np.repeat(edge_length, 2), minlength=vertex_count)
    mean = total / np.maximum(np.bincount(ends, minlength=vertex_count), 1)
    return mean**2 / (8.0 * LIMB_RADIUS)


def _four_joints(index: np.ndarray, weight: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The four heaviest joints of each point, weights summing to one."""
    order = np.argsort(-weight, axis=1, kind="stable")[:, :4]
    index, weight = np.take_along_axis(index, order, axis=1), np.take_along_axis(weight, order, axis=1)
    missing = 4 - index.shape[1]
    index = np.pad(index, ((0, 0), (0, missing))).astype(np.int32)
    weight = np.pad(weight, ((0, 0), (0, missing))).astype(np.float32)
    return index, weight / np.maximum(weight.sum(axis=1, keepdims=True), 1e-12)


def _corner_table(faces: np.ndarray, vertex_count: int) -> tuple[np.ndarray, np.ndarray]:
    """For each vertex the (next, last) vertices of its faces in face order: offsets [B + 1] and pairs [3 F, 2]."""
    pairs = np.stack([faces[:, [1, 2]], faces[:, [2, 0]], faces[:, [0, 1]]], axis=1).reshape(-1, 2)
    order = np.argsort(faces.ravel(), kind="stable")
    counts = np.bincount(faces.ravel(), minlength=vertex_count)
    return np.concatenate([[0], np.cumsum(counts)]).astype(np.int32), pairs[order].astype(np.int32)
