"""The moving body as the cloth meets it: a skinned surface in parts, closest-point queries and cached contact planes.

In: a skinned body in its bind pose, the parts that a garment collides with and, for each query interval, the skinning
transforms at its end. Positions are relative to floating origins near the pelvis that the caller moves along.
"""

from __future__ import annotations

import numpy as np
import warp as wp

from geometry.topology import corner_table
from sim.body_parts import ContactParts
from sim.body_seeds import age, pieces, spread_seeds
from sim.kernels import contact as kernels
from sim.kernels import kept_contacts, pokes, query, surface_walk
from sim.kernels.lanes import launch, scalars, vectors
from sim.kernels.parameters import THICKNESS
from sim.kernels.seeds import plant_seeds
from sim.skeleton import Skeleton, Skin

LIMB_RADIUS = 0.05
"""Radius of the narrower limbs, knee and elbow [m]: sets how much coarse triangles stand off."""

TURNS = 8
"""A vertex looks for a nearer place on its own limb in one query of this many, a power of two."""


class BodyContact:
    """Surfaces of a skinned body, one a motion, and the contacts of every lane's garment with its own.

    Attributes:
        pinched: 1 where a vertex of a lane is pinched by the body, else 0; shape [V], a scalar in every lane.
    """

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
        edges: np.ndarray,
        edge_length: np.ndarray,
        device: str,
    ):
        """Copy the body to the device and spread seeds over it.

        Args:
            vertices: Bind-pose body [m], shape [B, 3].
            faces: Its triangles, outward, shape [F, 3].
            index: Joints of each body vertex, shape [B, k].
            weight: Their weights, shape [B, k].
            parts: Faces of each part and the parts of each garment vertex.
            standoff: Distance that each vertex keeps besides the thickness [m], shape [V]; see :func:`sag`.
            skeleton: Transforms that move the body.
            reach: Distance up to which a resting vertex is in contact [m].
            edges: Edges of the garment, shape [E, 2].
            edge_length: Their lengths at rest [m], shape [E].
            device: Warp device.
        """
        self.device, self.skeleton, self.reach = device, skeleton, float(reach)
        self.count = len(parts.owned)
        self.width = width = len(skeleton.lane_motion)
        motions = skeleton.motions
        bind = np.asarray(vertices, dtype=np.float64) - skeleton.centre
        self.skin = Skin(bind, index, weight, motions, device)
        first_corner, corners = corner_table(faces, len(vertices))
        self.first_corner = wp.array(first_corner, dtype=int, device=device)
        self.corners = wp.array(corners, dtype=wp.vec2i, device=device)
        self.normals_start = wp.zeros(motions * len(vertices), dtype=wp.vec3, device=device)
        self.normals_end = wp.zeros(motions * len(vertices), dtype=wp.vec3, device=device)
        self.skin.end.assign(np.tile(bind, (motions, 1)).astype(np.float32))

        regions = pieces(bind[faces].mean(axis=1), parts.regions)
        labels = parts.face_bits() | (regions << 16)
        self.faces = wp.array(np.column_stack([faces, labels]).astype(np.int32), dtype=wp.vec4i, device=device)
        surface = surface_walk.Surface()
        surface.faces = self.faces
        across = _neighbours(faces)
        surface.neighbours = wp.array(across, dtype=wp.vec3i, device=device)
        surface.joined = wp.array(_borders(regions, across), dtype=int, device=device)
        surface.start, surface.points, surface.normals = self.skin.start, self.skin.end, self.normals_end
        surface.body_count = len(vertices)
        self.surface = surface
        self.seeds = spread_seeds(bind, faces, regions, motions, device)

        self.standoff = wp.array(np.asarray(standoff, dtype=np.float32), dtype=float, device=device)
        self.owned = wp.array(parts.owned_bits(), dtype=int, device=device)
        self.near = wp.zeros(self.count, dtype=int, device=device)
        self.face, self.own_face, self.other_face = (
            wp.full(self.count * width, -1, dtype=int, device=device) for _ in range(3)
        )
        self.barycentric = wp.zeros(self.count * width, dtype=wp.vec3, device=device)
        self.lean = wp.zeros(self.count * width, dtype=wp.vec3, device=device)
        self.clearance, self.distance, self.pinched, self.floor, self.kept, self.keepable = (
            wp.zeros(self.count, dtype=scalars(width), device=device) for _ in range(6)
        )
        self.direction = wp.zeros(self.count, dtype=vectors(width), device=device)
        self.let_go = wp.zeros(self.count * width, dtype=int, device=device)
        self.neighbours = _neighbour_lists(edges, edge_length, self.count, device)
        self.edges = wp.array(np.asarray(edges, dtype=np.int32), dtype=wp.vec2i, device=device)
        self.planes = [wp.zeros(self.count, dtype=vectors(width), device=device) for _ in range(4)]
        self._turn = 0

    def distances(self) -> np.ndarray:
        """Signed distance of each vertex to its body at the last query [m], [W, V]; out of reach a lower bound."""
        return self.distance.numpy().T

    def launch_motion(self) -> None:
        """Record: move the bodies to the end of the next interval and carry the contact planes along."""
        skin = self.skin
        skin.launch(self.skeleton)
        inputs = [skin.count, self.first_corner, self.corners, skin.end]
        outputs = [self.normals_start, self.normals_end]
        wp.launch(kernels.smooth_normals, skin.motions * skin.count, inputs, outputs, device=self.device)
        skeleton = self.skeleton
        inputs = [skin.count, skeleton.device_lane_motion, skeleton.shift, self.faces, self.face]
        inputs += [self.barycentric, skin.end, self.normals_end, self.lean]
        launch(kernels.carry_planes, self.width, self.count, inputs, self.planes, self.device)

    def launch_solve(
        self, fraction: float, step: float, inverse_mass: wp.array, x_prev: wp.array, parameters: wp.array, x: wp.array
    ) -> None:
        """Record: contact and friction of one substep at ``fraction`` of the interval."""
        inputs = [fraction, step, inverse_mass, self.near, self.clearance, *self.planes, x_prev, parameters]
        launch(kernels.solve_contact, self.width, self.count, inputs, [x], self.device)

    def find(
        self,
        inverse_mass: wp.array,
        parameters: wp.array,
        v: wp.array,
        x: wp.array,
        steps: int = 0,
        passes: int = 3,
    ) -> None:
        """At the end of an interval: put vertices outside and cache their contacts. Never inside a graph.

        Args:
            inverse_mass: Of the vertices, 0 where pinned, shape [V].
            parameters: Constants of the worlds.
            v: Velocities [m/s], shape [V].
            x: Positions [m], shape [V]; moved where they are too deep.
            steps: Substeps since the last call.
            passes: How often a vertex is moved out at most; 0 only measures.
        """
        skin, seeds, width = self.skin, self.seeds, self.width
        age(seeds)
        inputs = [self.faces, skin.count, skin.end, self.normals_end]
        wp.launch(plant_seeds, skin.motions * seeds.count, [*inputs, seeds], device=self.device)
        self._turn = (self._turn + 1) % TURNS
        point, travel, normal, turn = self.planes
        inputs = [self.reach, float(steps), inverse_mass, self.standoff, parameters, v, self.keepable, travel, turn]
        outputs = [x, point, normal, self.direction, self.clearance, self.distance, self.pinched, self.floor, self.kept]
        launch(kept_contacts.keep_contacts, width, self.count, inputs, outputs, self.device)
        inputs = [self.reach, passes, self._turn, TURNS, float(steps), self.skeleton.device_lane_motion]
        inputs += [inverse_mass, self.standoff, self.owned, *self.neighbours, self.surface, seeds, parameters, v]
        inputs += [self.kept]
        outputs = [x, self.near, self.own_face, self.other_face, self.let_go, self.face, self.barycentric]
        outputs += [self.lean, self.clearance, self.distance, self.pinched, point, normal, self.direction]
        outputs += [self.keepable, self.floor]
        launch(query.find_contacts, width, self.count, inputs, outputs, self.device)
        if passes:
            self._lift(inverse_mass, parameters, x)

    def _lift(self, inverse_mass: wp.array, parameters: wp.array, x: wp.array) -> None:
        """Lift triangles that the body pokes through off it."""
        thickness = parameters[int(THICKNESS) : int(THICKNESS) + 1]
        inputs = [self.edges, self.near, inverse_mass, self.clearance, self.distance, self.direction, x, thickness]
        launch(pokes.raise_floors, self.width, len(self.edges), inputs, [self.floor], self.device)
        inputs = [self.near, inverse_mass, self.direction, self.floor]
        outputs = [self.clearance, self.distance, x]
        launch(pokes.lift_to_floors, self.width, self.count, inputs, outputs, self.device)

    def forget(self) -> None:
        """Drop the cached contacts, before the garment is put somewhere else."""
        self.near.zero_()
        for face in (self.face, self.own_face, self.other_face):
            face.fill_(-1)
        self.distance.zero_()
        self.floor.zero_()
        self.keepable.zero_()
        self.let_go.zero_()
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


def _neighbour_lists(edges: np.ndarray, length: np.ndarray, count: int, device: str) -> list[wp.array]:
    """Where the list of each vertex begins, the neighbours, and how far they are at rest [m]."""
    here, there = np.concatenate([edges, edges[:, ::-1]]).T
    order = np.argsort(here, kind="stable")
    first = np.concatenate([[0], np.cumsum(np.bincount(here, minlength=count))])
    return [
        wp.array(first.astype(np.int32), dtype=int, device=device),
        wp.array(there[order].astype(np.int32), dtype=int, device=device),
        wp.array(np.tile(length, 2)[order].astype(np.float32), dtype=float, device=device),
    ]


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


def _borders(regions: np.ndarray, across: np.ndarray) -> np.ndarray:
    """For each region, itself and those that it shares an edge with, as bits."""
    count = int(regions.max()) + 1
    joined = np.eye(count, dtype=bool)
    here, there = np.repeat(regions, 3), regions[np.maximum(across, 0).ravel()]
    inner = across.ravel() >= 0
    joined[here[inner], there[inner]] = True
    return (joined @ (1 << np.arange(count))).astype(np.int32)
