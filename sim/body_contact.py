"""The moving body as the cloth meets it: a skinned surface in parts, closest-point queries and cached contact planes.

In: a skinned body in its bind pose, the parts that a garment collides with and, for each query interval, the skinning
transforms at its end. Positions are relative to floating origins near the pelvis that the caller moves along.
"""

from __future__ import annotations

import numpy as np
import warp as wp
from scipy.spatial import cKDTree

from sim.body_parts import ContactParts
from sim.kernels import contact as kernels
from sim.kernels import pokes, query
from sim.kernels.lanes import scalars, vectors
from sim.kernels.parameters import THICKNESS
from sim.kernels.seeds import CELL, SEED_BITS, STAMPS, Seeds, plant_seeds
from sim.skeleton import Skeleton, Skin

LIMB_RADIUS = 0.05
"""Radius of the narrower limbs, knee and elbow [m]: sets how much coarse triangles stand off."""

SEED_SPACING = 0.025
"""Distance between seeds on the body in its bind pose [m], more where they would be too many."""

LONGEST_PIECE = 0.5
"""Extent of the pieces that seeds are told apart by [m]."""

TURNS = 8
"""A vertex looks for a nearer place on its own limb in one query of this many."""


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
        width, motions = len(skeleton.lane_motion), skeleton.motions
        bind = np.asarray(vertices, dtype=np.float64) - skeleton.centre
        self.skin = Skin(bind, index, weight, motions, device)
        first_corner, corners = corner_table(faces, len(vertices))
        self.first_corner = wp.array(first_corner, dtype=int, device=device)
        self.corners = wp.array(corners, dtype=wp.vec2i, device=device)
        self.normals_start = wp.zeros(motions * len(vertices), dtype=wp.vec3, device=device)
        self.normals_end = wp.zeros(motions * len(vertices), dtype=wp.vec3, device=device)
        self.skin.end.assign(np.tile(bind, (motions, 1)).astype(np.float32))

        regions = _pieces(bind[faces].mean(axis=1), parts.regions)
        labels = parts.face_bits() | (regions << 16)
        self.faces = wp.array(np.column_stack([faces, labels]).astype(np.int32), dtype=wp.vec4i, device=device)
        surface = query.Surface()
        surface.faces = self.faces
        across = _neighbours(faces)
        surface.neighbours = wp.array(across, dtype=wp.vec3i, device=device)
        surface.joined = wp.array(_borders(regions, across), dtype=int, device=device)
        surface.start, surface.points, surface.normals = self.skin.start, self.skin.end, self.normals_end
        surface.body_count = len(vertices)
        self.surface = surface
        self.seeds = _plant(bind, faces, regions, motions, device)

        self.standoff = wp.array(np.asarray(standoff, dtype=np.float32), dtype=float, device=device)
        self.owned = wp.array(parts.owned_bits(), dtype=int, device=device)
        self.near = wp.zeros(self.count, dtype=int, device=device)
        self.face, self.own_face, self.other_face = (
            wp.full(self.count * width, -1, dtype=int, device=device) for _ in range(3)
        )
        self.barycentric = wp.zeros(self.count * width, dtype=wp.vec3, device=device)
        self.lean = wp.zeros(self.count * width, dtype=wp.vec3, device=device)
        self.clearance, self.distance, self.pinched, self.floor = (
            wp.zeros(self.count, dtype=scalars(width), device=device) for _ in range(4)
        )
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
        inputs = [skin.count, skeleton.device_lane_motion, skeleton.shift, self.near, self.faces, self.face]
        inputs += [self.barycentric, skin.end, self.normals_end, self.lean]
        wp.launch(kernels.carry_planes, self.count, inputs, self.planes, device=self.device)

    def launch_solve(
        self, fraction: float, step: float, inverse_mass: wp.array, x_prev: wp.array, parameters: wp.array, x: wp.array
    ) -> None:
        """Record: contact and friction of one substep at ``fraction`` of the interval."""
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
        skin, seeds = self.skin, self.seeds
        if seeds.stamp == 1:
            seeds.grid.fill_(_NO_ENTRY)
            seeds.stamp = STAMPS
        else:
            seeds.stamp -= 1
        inputs = [self.faces, skin.count, skin.end]
        wp.launch(plant_seeds, skin.motions * seeds.count, [*inputs, seeds], device=self.device)
        self._turn = (self._turn + 1) % TURNS
        inputs = [self.reach, passes, self._turn, TURNS, float(steps), self.skeleton.device_lane_motion]
        inputs += [inverse_mass, self.standoff, self.owned, *self.neighbours, self.surface, seeds, parameters, v]
        outputs = [x, self.near, self.own_face, self.other_face, self.let_go, self.face, self.barycentric]
        outputs += [self.lean, self.clearance, self.distance, self.pinched, self.planes[0], self.planes[2], self.floor]
        wp.launch(query.find_contacts, self.count, inputs, outputs, device=self.device)
        if passes:
            self._lift(inverse_mass, parameters, x)

    def _lift(self, inverse_mass: wp.array, parameters: wp.array, x: wp.array) -> None:
        """Lift triangles that the body pokes through off it."""
        point = self.planes[0]
        thickness = parameters[int(THICKNESS) : int(THICKNESS) + 1]
        inputs = [self.edges, self.near, inverse_mass, self.clearance, self.distance, point, x, thickness]
        wp.launch(pokes.raise_floors, len(self.edges), inputs, [self.floor], device=self.device)
        inputs = [self.near, inverse_mass, point, self.floor]
        outputs = [self.clearance, self.distance, x]
        wp.launch(pokes.lift_to_floors, self.count, inputs, outputs, device=self.device)

    def forget(self) -> None:
        """Drop the cached contacts, before the garment is put somewhere else."""
        self.near.zero_()
        for face in (self.face, self.own_face, self.other_face):
            face.fill_(-1)
        self.distance.zero_()
        self.floor.zero_()
        self.let_go.zero_()
        self._turn = 0


_NO_ENTRY = 2**31 - 1


def _plant(bind: np.ndarray, faces: np.ndarray, regions: np.ndarray, motions: int, device: str) -> Seeds:
    """Seeds spread evenly over the body, and an empty grid for them."""
    face, weight = _spread(bind, faces, 0.5 * SEED_SPACING)
    spots = np.einsum("sk,skc->sc", weight, bind[faces[face]])
    spacing = SEED_SPACING
    chosen = _thinned(spots, spacing)
    while len(chosen) > 2**SEED_BITS:
        spacing *= 1.2
        chosen = chosen[_thinned(spots[chosen], spacing)]
    face, weight = face[chosen], weight[chosen]
    count = int(regions.max()) + 1
    extent = max(np.ptp(bind[faces[regions == r]].reshape(-1, 3), axis=0).max() for r in range(count))
    seeds = Seeds()
    seeds.face = wp.array(face.astype(np.int32), dtype=int, device=device)
    seeds.region = wp.array(regions[face].astype(np.int32), dtype=int, device=device)
    seeds.weight = wp.array(weight.astype(np.float32), dtype=wp.vec3, device=device)
    seeds.point = wp.zeros(motions * len(face), dtype=wp.vec3, device=device)
    seeds.count, seeds.regions, seeds.stamp = len(face), count, STAMPS
    seeds.cells = 2 ** int(np.ceil(np.log2(max(1.5 * extent / CELL, 8.0))))
    seeds.grid = wp.full(motions * seeds.cells**3 * seeds.regions, _NO_ENTRY, dtype=int, device=device)
    return seeds


def _pieces(centres: np.ndarray, regions: np.ndarray) -> np.ndarray:
    """Limbs cut where they are long and the trunk down the middle, for a walk does not cross clefts, shape [F]."""
    pieces = []
    waiting = [np.flatnonzero(regions == r) for r in np.unique(regions)]
    while waiting:
        faces = waiting.pop()
        low, high = centres[faces].min(axis=0), centres[faces].max(axis=0)
        axis, middle = int(np.argmax(high - low)), 0.5 * (low + high)
        if low[0] < -0.05 and high[0] > 0.05:
            axis, middle[0] = 0, 0.0
        elif high[axis] - low[axis] < LONGEST_PIECE:
            pieces.append(faces)
            continue
        beyond = centres[faces, axis] > middle[axis]
        waiting += [faces[beyond], faces[~beyond]]
    if len(pieces) > 31:  # a bit each
        return regions
    label = np.zeros(len(regions), dtype=np.int32)
    for number, faces in enumerate(pieces):
        label[faces] = number
    return label


def _spread(points: np.ndarray, faces: np.ndarray, spacing: float) -> tuple[np.ndarray, np.ndarray]:
    """Faces and weights of points that lie on every face, at most ``spacing`` apart on it."""
    corner = points[faces]
    longest = np.linalg.norm(corner - np.roll(corner, 1, axis=1), axis=2).max(axis=1)
    pieces = np.clip(np.ceil(longest / spacing), 1, 64).astype(int)
    which, weights = [], []
    for n in np.unique(pieces):
        i, j = np.meshgrid(np.arange(n), np.arange(n), indexing="ij")
        i, j = i[i + j < n], j[i + j < n]
        grid = np.stack([i, j, n - 1 - i - j], axis=1) + 1.0 / 3.0
        members = np.flatnonzero(pieces == n)
        which.append(np.repeat(members, len(grid)))
        weights.append(np.tile(grid / n, (len(members), 1)))
    return np.concatenate(which), np.concatenate(weights)


def _thinned(points: np.ndarray, spacing: float) -> np.ndarray:
    """Points of which no two are nearer than ``spacing``, the first ones first."""
    tree = cKDTree(points)
    alive = np.ones(len(points), dtype=bool)
    for i in range(len(points)):
        if alive[i]:
            near = tree.query_ball_point(points[i], spacing)
            alive[near] = False
            alive[i] = True
    return np.flatnonzero(alive)


def sag(edges: np.ndarray, edge_length: np.ndarray, vertex_count: int) -> np.ndarray:
    """How far triangles dip towards a limb between vertices that lie on it [m], shape [V]: ``L^2 / (8 r)``.

    Contact knows vertices only. So that the cloth itself keeps the thickness, its vertices keep this much more, with
    the mean length L of the edges around each.
    """
    ends = edges.ravel()
    total = np.bincount(ends, np.repeat(edge_length, 2), minlength=vertex_count)
    mean = total / np.maximum(np.bincount(ends, minlength=vertex_count), 1)
    return mean**2 / (8.0 * LIMB_RADIUS)


def corner_table(faces: np.ndarray, vertex_count: int) -> tuple[np.ndarray, np.ndarray]:
    """For each vertex the (next, last) vertices of its faces in face order: offsets [B + 1] and pairs [3 F, 2]."""
    pairs = np.stack([faces[:, [1, 2]], faces[:, [2, 0]], faces[:, [0, 1]]], axis=1).reshape(-1, 2)
    order = np.argsort(faces.ravel(), kind="stable")
    counts = np.bincount(faces.ravel(), minlength=vertex_count)
    return np.concatenate([[0], np.cumsum(counts)]).astype(np.int32), pairs[order].astype(np.int32)


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
