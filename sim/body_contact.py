"""The moving body as the cloth meets it: a skinned surface in parts, closest-point queries and cached contact planes.

In: a skinned body in its bind pose, the parts that a garment collides with and, for each query interval, the skinning
transforms at its end. Positions are relative to floating origins near the pelvis that the caller moves along.
"""

from __future__ import annotations

import numpy as np
import warp as wp

from sim.body_parts import ContactParts
from sim.kernels import contact as kernels
from sim.kernels import query
from sim.kernels.lanes import scalars, vectors
from sim.skeleton import Skeleton, Skin

LIMB_RADIUS = 0.05
"""Radius of the narrower limbs, knee and elbow [m]: sets how much coarse triangles stand off."""


TURNS = 8
"""A vertex whose world has a motion of its own is searched for exactly in one query of this many."""


class BodyContact:
    """Surfaces of a skinned body, one a motion, and the contacts of every lane's garment with its own."""

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
        beside: np.ndarray,
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
            reach: Distance up to which a vertex is followed [m].
            beside: Two neighbours of each vertex in the garment, shape [V, 2].
            device: Warp device.
        """
        self.device, self.skeleton, self.reach = device, skeleton, float(reach)
        self.count = len(parts.owned)
        width, motions = len(skeleton.lane_motion), skeleton.motions
        used_faces = np.unique(np.concatenate(parts.faces)) if parts.faces else np.zeros(0, dtype=np.int64)
        used = np.unique(faces[used_faces])
        renumber = np.full(len(vertices), -1, dtype=np.int32)
        renumber[used] = np.arange(len(used))
        part_faces = [renumber[faces[f]] for f in parts.faces]

        bind = np.asarray(vertices, dtype=np.float64)[used] - skeleton.centre
        self.skin = Skin(bind, index[used], weight[used], motions, device)
        first_corner, corners = corner_table(renumber[faces[used_faces]], len(used))
        self.first_corner = wp.array(first_corner, dtype=int, device=device)
        self.corners = wp.array(corners, dtype=wp.vec2i, device=device)
        self.normals_start = wp.zeros(motions * len(used), dtype=wp.vec3, device=device)
        self.normals_end = wp.zeros(motions * len(used), dtype=wp.vec3, device=device)

        # The parts of a motion share its points at the interval's end; the trees follow by a refit.
        self.skin.end.assign(np.tile(bind, (motions, 1)).astype(np.float32))
        self.meshes = [
            wp.Mesh(
                self.skin.end[m * len(used) : (m + 1) * len(used)],
                wp.array(f.ravel(), dtype=int, device=device),
                bvh_leaf_size=4,
            )
            for m in range(motions)
            for f in part_faces
        ]
        sizes = [len(f) for f in part_faces]
        offsets = np.concatenate([[0], np.cumsum(sizes)[:-1]]) if part_faces else np.zeros(0)
        stacked = np.concatenate(part_faces) if part_faces else np.zeros((0, 3), dtype=np.int32)
        across = [_neighbours(f) for f in part_faces]
        across = [np.where(a >= 0, a + int(o), -1) for a, o in zip(across, offsets)]
        self.faces = wp.array(stacked, dtype=wp.vec3i, device=device)
        surface = query.Surface()
        surface.meshes = wp.array([mesh.id for mesh in self.meshes], dtype=wp.uint64, device=device)
        surface.first_face = wp.array(offsets.astype(np.int32), dtype=int, device=device)
        surface.faces = self.faces
        surface.neighbours = wp.array(np.concatenate(across) if across else stacked, dtype=wp.vec3i, device=device)
        part = np.repeat(np.arange(len(sizes), dtype=np.int32), sizes)
        surface.part = wp.array(part, dtype=int, device=device)
        surface.points, surface.normals = self.skin.end, self.normals_end
        surface.part_count, surface.body_count = len(part_faces), len(used)
        self.surface = surface

        self.standoff = wp.array(np.asarray(standoff, dtype=np.float32), dtype=float, device=device)
        self.owned = wp.array(parts.owned, dtype=wp.vec4i, device=device)
        self.near = wp.zeros(self.count, dtype=int, device=device)
        self.face = wp.full(self.count * width, -1, dtype=int, device=device)
        self.barycentric = wp.zeros(self.count * width, dtype=wp.vec3, device=device)
        self.lean = wp.zeros(self.count * width, dtype=wp.vec3, device=device)
        self.clearance = wp.zeros(self.count, dtype=scalars(width), device=device)
        self.distance = wp.zeros(self.count, dtype=scalars(width), device=device)
        self.planes = [wp.zeros(self.count, dtype=vectors(width), device=device) for _ in range(4)]
        self.shared_motion = int(width > 1 and motions == 1)
        # The lanes of one motion learn from each other, so that fewer need to be searched for.
        self.turns = 2 * width if self.shared_motion else TURNS
        self.beside = wp.array(np.asarray(beside, dtype=np.int32), dtype=wp.vec2i, device=device)
        self._turn = 0

    def distances(self) -> np.ndarray:
        """Signed distance of each vertex to its body at the last query [m], [W, V]; out of reach a lower bound."""
        return self.distance.numpy().T

    def launch_motion(self) -> None:
        """Record: move the bodies to the end of the next interval and carry the contact planes along."""
        if not self.meshes:
            return
        skin = self.skin
        skin.launch(self.skeleton)
        inputs = [skin.count, self.first_corner, self.corners, skin.end]
        outputs = [self.normals_start, self.normals_end]
        wp.launch(kernels.smooth_normals, skin.motions * skin.count, inputs, outputs, device=self.device)
        inputs = [skin.count, self.skeleton.device_lane_motion, self.near, self.faces, self.face, self.barycentric]
        inputs += [skin.start, skin.end, self.normals_start, self.normals_end, self.lean]
        wp.launch(kernels.carry_planes, self.count, inputs, self.planes, device=self.device)

    def launch_solve(
        self, fraction: float, step: float, inverse_mass: wp.array, x_prev: wp.array, parameters: wp.array, x: wp.array
    ) -> None:
        """Record: contact and friction of one substep at ``fraction`` of the interval."""
        if not self.meshes:
            return
        inputs = [fraction, step, inverse_mass, self.near, self.clearance, *self.planes, x_prev, parameters]
        wp.launch(kernels.solve_contact, self.count, inputs, [x], device=self.device)

    def find(
        self,
        inverse_mass: wp.array,
        parameters: wp.array,
        v: wp.array,
        x: wp.array,
        steps: int = 0,
        passes: int = 3,
        reach: float | None = None,
    ) -> None:
        """Refit to the end of the interval, put vertices outside and cache their contacts. Never inside a graph.

        Args:
            inverse_mass: Of the vertices, 0 where pinned, shape [V].
            parameters: Constants of the worlds.
            v: Velocities [m/s], shape [V].
            x: Positions [m], shape [V]; moved where they are too deep.
            steps: Substeps since the last call.
            passes: How often a vertex is moved out at most; 0 only measures.
            reach: Distance up to which vertices are looked for [m] where it differs from that of the motion.
        """
        if not self.meshes:
            return
        for mesh in self.meshes:
            mesh.refit()
        self._turn = (self._turn + 1) % self.turns
        inputs = [self.reach if reach is None else reach, passes, self._turn, self.turns]
        inputs += [
            float(steps),
            self.skin.travel,
            self.skeleton.device_lane_motion,
            self.shared_motion,
            inverse_mass,
            self.standoff,
            self.owned,
            self.beside,
        ]
        inputs += [self.surface, parameters, v]
        outputs = [x, self.near, self.face, self.barycentric, self.lean, self.clearance, self.distance]
        wp.launch(query.find_contacts, self.count, inputs, outputs, device=self.device)

    def forget(self) -> None:
        """Drop the cached contacts, before the garment is put somewhere else."""
        self.near.zero_()
        self.face.fill_(-1)
        self.distance.zero_()
        self._turn = 0


def sag(edges: np.ndarray, edge_length: np.ndarray, vertex_count: int) -> np.ndarray:
    """How far triangles dip towards a limb between vertices that lie on it [m], shape [V]: ``L^2 / (8 r)``.

    Contact knows vertices only. So that the cloth itself keeps the thickness, its vertices keep this much more, with
    the mean length L of the edges around each.
    """
    ends = edges.ravel()
    total = np.bincount(ends, np.repeat(edge_length, 2), minlength=vertex_count)
    mean = total / np.maximum(np.bincount(ends, minlength=vertex_count), 1)
    return mean**2 / (8.0 * LIMB_RADIUS)


def two_neighbours(edges: np.ndarray, vertex_count: int) -> np.ndarray:
    """Two neighbours of each vertex, opposite as far as its list of edges goes, shape [V, 2]."""
    both = np.concatenate([edges, edges[:, ::-1]])
    both = both[np.argsort(both[:, 0], kind="stable")]
    counts = np.bincount(both[:, 0], minlength=vertex_count)
    first = np.concatenate([[0], np.cumsum(counts)[:-1]])
    return np.stack([both[first, 1], both[first + counts // 2, 1]], axis=1).astype(np.int32)


def corner_table(faces: np.ndarray, vertex_count: int) -> tuple[np.ndarray, np.ndarray]:
    """For each vertex the (next, last) vertices of its faces in face order: offsets [B + 1] and pairs [3 F, 2]."""
    pairs = np.stack([faces[:, [1, 2]], faces[:, [2, 0]], faces[:, [0, 1]]], axis=1).reshape(-1, 2)
    order = np.argsort(faces.ravel(), kind="stable")
    counts = np.bincount(faces.ravel(), minlength=vertex_count)
    return np.concatenate([[0], np.cumsum(counts)]).astype(np.int32), pairs[order].astype(np.int32)


def _neighbours(faces: np.ndarray) -> np.ndarray:
    """The face across the edge opposite to each corner, -1 at a rim, shape [F, 3]."""
    edges = np.stack([faces[:, [1, 2]], faces[:, [2, 0]], faces[:, [0, 1]]], axis=1).reshape(-1, 2)
    keys = np.sort(edges, axis=1).astype(np.int64)
    key = keys[:, 0] * (int(faces.max(initial=0)) + 1) + keys[:, 1]
    order = np.argsort(key, kind="stable")
    twin = np.full(len(key), -1, dtype=np.int64)
    same = np.flatnonzero(key[order][1:] == key[order][:-1])
    twin[order[same]], twin[order[same + 1]] = order[same + 1], order[same]
    return np.where(twin >= 0, twin // 3, -1).reshape(-1, 3).astype(np.int32)
