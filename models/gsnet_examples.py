"""What networks that dress any garment are trained on, as tensors: garments worn on motions, and on them in the mirror.

In: garments with simulated motions, on one body. Out: for each step some motions of one garment, and the body under
them where contact is looked at. A garment in the mirror is a garment too: its vertices, normals and skinning weights
exchange left and right, and the simulated cloth with them, exactly and for nothing. So each simulation teaches two
motions on two templates; only networks of single garments, which know a vertex by its number, cannot have that.

Dimensions: B sequences, T wanted frames, N garment vertices, P material parameters.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import torch
from scipy.spatial import cKDTree
from torch import Tensor

from body.model import Body
from body.skeleton import mirrored_joint_order
from geometry.topology import MeshTopology, vertex_normals
from models.garment_animator import Animator, Motion, Worn
from models.garment_graph import GarmentGraph
from models.motion_features import MotionTrack
from models.training import array_digest
from motions.mirror import mirror_motion

REFLECTION = np.float32([-1.0, 1.0, 1.0])
"""At the plane x = 0 of the bind pose, and of the pelvis frame."""


@dataclass(frozen=True)
class WardrobeExample:
    """A motion and a garment simulated on it.

    Attributes:
        graph: The garment.
        material: What it is made of, as ``material_row`` gives it, shape [P].
        track: The motion with its lead-in.
        vertices: Canonical garment vertices [m] of the wanted frames, shape [T, N, 3] float32.
    """

    graph: GarmentGraph
    material: np.ndarray
    track: MotionTrack
    vertices: np.ndarray

    def __post_init__(self) -> None:
        wanted = (self.track.frames, len(self.graph.vertices), 3)
        if self.vertices.shape != wanted:
            raise ValueError(
                f"garment {self.graph.name}: expected vertices {list(wanted)}, got {list(self.vertices.shape)}"
            )


class TrainingData:
    """Training data as tensors: each motion once, however many garments are worn on it.

    Args:
        examples: Training split, of one length.
        body: That of all motions.
        contact_frames: Frames of every clip, evenly spread, at which the body is looked at.
        mirror: Whether half of the draws are in the mirror.
    """

    def __init__(self, examples: Sequence[WardrobeExample], body: Body, contact_frames: int, mirror: bool) -> None:
        self.body, self.examples, self.mirror = body, examples, mirror
        keys = [array_digest(e.track.pose, e.track.joints) for e in examples]
        number = {key: i for i, key in enumerate(dict.fromkeys(keys))}
        self.clip = np.array([number[key] for key in keys])
        tracks = {number[key]: e.track for key, e in zip(keys, examples, strict=True)}
        self.tracks = [tracks[i] for i in range(len(tracks))]
        self.motion = Motion.of(self.tracks, body)
        frames = self.motion.frames
        self.contact = np.unique((2 * np.arange(contact_frames) + 1) * frames // (2 * contact_frames))
        self._surfaces: dict[int, list[tuple[np.ndarray, np.ndarray, cKDTree]]] = {}
        members: dict[int, list[int]] = {}
        for i, e in enumerate(examples):
            members.setdefault(id(e.graph), []).append(i)
        self.graphs = [examples[m[0]].graph for m in members.values()]
        self.alike = [part for m in members.values() for part in self._by_material(np.array(m)) if len(part)]
        self._mirrored = {id(graph): mirrored_graph(graph) for graph in self.graphs} if mirror else {}

    def _by_material(self, members: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Examples of one garment in its commonest material, and the others."""
        rows = np.stack([self.examples[i].material for i in members])
        _, kind, count = np.unique(rows, axis=0, return_inverse=True, return_counts=True)
        common = kind.reshape(-1) == count.argmax()
        return members[common], members[~common]

    @cached_property
    def mirrored_motion(self) -> Motion:
        """All motions with left and right exchanged."""
        return Motion.of([mirrored_track(track) for track in self.tracks], self.body)

    def scale(self, animator: Animator) -> None:
        """Give a network the means and spreads of what it is trained on."""
        graphs, features = list(self.graphs), [self.motion.features]
        if self.mirror:
            graphs += self._mirrored.values()
            features.append(self.mirrored_motion.features)
        animator.set_scaling(graphs, np.stack([e.material for e in self.examples]), torch.cat(features))

    def batches(self, size: int, garments: int, generator: np.random.Generator) -> Iterator[list[np.ndarray]]:
        """Numbers of the examples, at most ``size``, of each of ``garments`` garments in a step.

        Every example comes once an epoch, beside others of its garment: those in the garment's commonest material
        among themselves, for they share one encoding, which costs as much as dressing a hundred frames.
        """
        groups = []
        for members in self.alike:
            groups += np.array_split(generator.permutation(members), -(-len(members) // size))
        order = generator.permutation(len(groups))
        for start in range(0, len(order), garments):
            yield [groups[k] for k in order[start : start + garments]]

    def worn(self, animator: Animator, rows: np.ndarray) -> Worn:
        """Some examples of one garment, as tensors, half of the times in the mirror."""
        some = [self.examples[i] for i in rows]
        rows_of = np.stack([e.material for e in some])
        # Sequences of one material share their encoding.
        materials = torch.as_tensor(rows_of[:1] if (rows_of == rows_of[0]).all() else rows_of)
        truth = torch.as_tensor(np.stack([e.vertices for e in some]))
        graph, motion = some[0].graph, self.motion
        if self.mirror and float(torch.rand(1)) < 0.5:
            graph, motion = self._mirrored[id(graph)], self.mirrored_motion
            truth = truth * torch.as_tensor(REFLECTION)
        encoding = animator.encode(graph, materials)
        return Worn(graph, encoding, motion.take(torch.as_tensor(self.clip[rows])), truth)

    def some_frames(self, count: int, known: int) -> Tensor:
        """Wanted frames of a step, ``count`` of them, at random; at about ``known`` of these the body is known."""
        count = min(count, self.motion.frames)
        chosen = torch.as_tensor(self.contact)[torch.randperm(len(self.contact))[:known]]
        others = torch.randperm(self.motion.frames)[: count - len(chosen)]
        return torch.cat([chosen, others]).unique()

    def nearest(
        self, graph: GarmentGraph, clip: int, contact: int, vertices: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray]:
        """Nearest body vertices to ``vertices [N, 3]`` at a contact frame of a clip, and their normals, [N, 3] each.

        For the ``graph`` of ``worn``: under a garment in the mirror is the body in the mirror.
        """
        if clip not in self._surfaces:
            self._surfaces[clip] = body_surfaces(self.tracks[clip], self.body, self.contact)
        points, normals, tree = self._surfaces[clip][contact]
        side = REFLECTION if any(graph is g for g in self._mirrored.values()) else np.ones(3, np.float32)
        index = tree.query(vertices * side)[1]
        return points[index] * side, normals[index] * side


def mirrored_graph(graph: GarmentGraph) -> GarmentGraph:
    """The garment with left and right exchanged, vertex by vertex, its triangles turned to face outwards."""
    place = graph.place.copy()
    place[:, [0, 3]] *= -1.0
    topology = MeshTopology.from_faces(graph.topology.faces[:, ::-1], len(place))
    weight = graph.skin_weight[:, mirrored_joint_order()]
    return GarmentGraph(
        graph.name, graph.vertices * REFLECTION, topology, place, weight, graph.pinned, graph.body_digest
    )


def mirrored_track(track: MotionTrack) -> MotionTrack:
    """The motion with left and right exchanged."""
    pose, _ = mirror_motion(track.pose, np.zeros((len(track.pose), 3)))
    joints = track.joints[:, mirrored_joint_order()] * REFLECTION
    return MotionTrack(pose.astype(track.pose.dtype), joints.astype(track.joints.dtype), track.lead, track.fps)


def body_surfaces(track: MotionTrack, body: Body, frames: np.ndarray) -> list[tuple[np.ndarray, np.ndarray, cKDTree]]:
    """Canonical body vertices [m] and normals, [B, 3] each, with a search tree, at wanted frames of a track."""
    rotation, position = (x[track.lead :][frames] for x in track.pelvis_frames())
    world = body.posed(track.pose[track.lead :][frames], position - body.joints[0])
    points = np.matmul(world - position[:, None], rotation).astype(np.float32)
    return [(p, n, cKDTree(p)) for p, n in zip(points, vertex_normals(points, body.faces), strict=True)]
