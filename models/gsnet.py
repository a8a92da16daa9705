"""GSNet: one network that dresses motions in garments of any topology (Peng 2023).

In: garment graphs, materials and motions. Out: canonical garment vertices [m]. Three parts, as published: a *garment
encoder* on the normalized Laplacian of the template's mesh; *deep skinning*, a graph of joints and vertices whose edges
come from the encoder and along which motion reaches the garment; a *physical regressor* that corrects the vertices
inside the body and learns without truth. Two networks:

- ``PublishedGSNet`` follows the paper layer by layer. The joint graph gets loops (a vertex keeps what it knows):
  between two sets without them, three convolutions would end at the vertices having seen the joints alone.
- ``GSNet`` is ours. ``L_n X`` takes away where a vertex is, so its encoder keeps X beside what the neighbours hand on.
  Vertices do not talk through dense layers in every frame: several edges lead from every joint to every vertex, the
  joints, which know the last second of the motion and a pooled memory of the garment, send a displacement along each,
  and a vertex adds up what arrives to its skinned place. All frames of all motions are then one matrix product.

The published network sees the garment of the frame before, and is taught from true ones; in a roll-out its errors feed
on themselves. ``GSNet`` may have the garment before as a pooled, bounded memory of the joints, and is then taught on
its own roll-outs, from the lead-in or a noised true frame. The motion of the last second makes that memory superfluous:
on a skirt and a T-shirt, new clips were 19 mm off with it and without after 300 steps of 20 frames a clip; after 1,800
steps 10.9 mm without it, 12.4 mm with it on roll-outs of 8 frames, which took 1.6 times as long.

Dimensions: B sequences, F = L + T frames, N garment vertices, J = 24 joints, K edges a vertex, P material parameters.
"""

from __future__ import annotations

from collections.abc import Callable
from collections.abc import Sequence as Many
from dataclasses import dataclass, fields
from itertools import pairwise

import numpy as np
import torch
from torch import Tensor, nn

from models.garment_animator import Animator, Motion, Rehearsal, Worn, skinned
from models.garment_graph import JOINTS, PLACE, GarmentGraph, propagate
from models.gsnet_losses import heights

REACH = 0.1
"""Displacement that a joint sends along an edge of weight 1 for an output of 1 [m]."""

FULL = 4.0
"""Where the pooled memory levels off: ten times what garments reach."""

Correction = Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray]
"""From vertices, nearest body points and unit normals there, [N, 3] each [m], to corrected vertices [N, 3]."""


@dataclass(frozen=True)
class GSNetConfig:
    """Sizes and switches.

    Attributes:
        materials: Names of the intrinsic parameters that are among the vertex features.
        body: Digest of the body that all templates sit on.
        width: Of the encoder's graph convolutions (paper: 128).
        heads: Edges from each joint to each vertex (paper: 1).
        hidden: Widths of the joints' network.
        offsets: Frames into the past whose motion the joints know; (0,) = the pose alone.
        garment_state: Whether they know the garment of the frame before.
        rotations: Whether they know the joints' rotations beside their places.
        segment: Frames of the roll-outs in training; 0 = the whole sequence with its lead-in. A segment begins at a
            true frame, or with the lead-in.
        noise: On the memory of the true frame that a segment begins at, as a fraction of the memory's spread.
    """

    materials: tuple[str, ...]
    body: str
    width: int = 128
    heads: int = 8
    hidden: tuple[int, ...] = (512, 512)
    offsets: tuple[int, ...] = (0, 1, 2, 3, 5, 8, 12, 20)
    garment_state: bool = True
    rotations: bool = False
    segment: int = 0
    noise: float = 0.2

    def __post_init__(self) -> None:
        # A config read back from a file holds lists where it held tuples.
        for name in ("materials", "hidden", "offsets"):
            object.__setattr__(self, name, tuple(getattr(self, name)))
        if self.offsets[0] != 0 or any(b <= a for a, b in pairwise(self.offsets)):
            raise ValueError(f"gsnet offsets: must rise from 0, got {list(self.offsets)}")


@dataclass(frozen=True)
class Encoding:
    """A garment in B materials, as it is kept for all frames.

    Attributes:
        skin: Of linear blend skinning, shape [B, N, 96].
        weight: The weights in it, shape [B, N, 24].
        edges: Weights of the edges from the joints, shape [B, N, K]; in ``PublishedGSNet`` K = 24.
        gram: What a message along the edges leaves in the pooled memory, shape [B, K, K].
        code: Of the whole garment, shape [B, width].
        local: What the physical regressor knows of each vertex, shape [B, N, 16].
    """

    skin: Tensor
    weight: Tensor
    edges: Tensor
    gram: Tensor
    code: Tensor
    local: Tensor

    def repeat(self, times: int) -> Encoding:
        """Each material ``times`` times in a row."""
        return Encoding(*(getattr(self, f.name).repeat_interleave(times, dim=0) for f in fields(self)))


class GarmentEncoder(nn.Module):
    """Three graph convolutions ``sigma(L_n X W + b)`` and the maximum over the vertices beside each (Peng 2023, 3.2).

    Args:
        inputs: Features of a vertex.
        width: Of each convolution.
        keep: Whether a vertex keeps its own features beside what the neighbours hand on: ``sigma(X V + (I - L_n) X W +
            b)``, the same span of operators. Without, as published, a feature that is the same everywhere is lost.
    """

    def __init__(self, inputs: int, width: int, keep: bool) -> None:
        super().__init__()
        self.keep = keep
        sizes = (inputs, width, width, width)
        self.layers = nn.ModuleList(nn.Linear(2 * a if keep else a, b) for a, b in pairwise(sizes))

    def forward(self, graph: GarmentGraph, rows: Tensor) -> Tensor:
        """Features [N, B, 2 width] of vertex features [N, B, inputs]."""
        for layer in self.layers:
            if self.keep:
                rows = torch.cat([rows, propagate(graph.neighbours, rows)], dim=2)
            else:
                rows = propagate(graph.laplacian, rows)
            rows = nn.functional.gelu(layer(rows))
        return torch.cat([rows, rows.amax(0, keepdim=True).expand_as(rows)], dim=2)


class PhysicalRegressor(nn.Module):
    """Corrects the vertices inside the body (Peng 2023, section 3.4).

    They form a graph with the joints, along the garment's skinning weights: joints gather what the vertices inside know
    and hand it on to them. It starts as the projection on the body and learns, without truth, what stretches and bends
    the garment less.
    """

    def __init__(self, width: int = 32) -> None:
        super().__init__()
        self.gather = nn.Linear(16 + 4, width)
        self.joints = nn.Linear(width, width)
        self.out = nn.Sequential(nn.Linear(2 * width, width), nn.GELU(), nn.Linear(width, 4))
        nn.init.zeros_(self.out[-1].weight)
        nn.init.zeros_(self.out[-1].bias)

    def forward(
        self, encoding: Encoding, rows: Tensor, vertices: Tensor, points: Tensor, normals: Tensor, margin: float
    ):
        """Corrected vertices [S, N, 3] [m] of S frames; those outside stay where they are.

        Args:
            encoding: Of the garment.
            rows: Which of its materials each frame is in, shape [S]; of one alone, it makes no difference.
            vertices: Canonical garment vertices [m], shape [S, N, 3].
            points, normals: Nearest body points and unit normals, shape [S, N, 3].
            margin: Distance from the body that is aimed at [m].
        """
        height = heights(vertices, points, normals)
        frame, vertex = torch.nonzero(height < 0.0, as_tuple=True)
        if len(frame) == 0:
            return vertices
        row, depth, normal = rows[frame] % len(encoding.local), height[frame, vertex], normals[frame, vertex]
        known = torch.cat([encoding.local[row, vertex], normal, depth[:, None] / REACH], dim=1)
        own, weight = nn.functional.gelu(self.gather(known)), encoding.weight[row, vertex]
        sent = (weight[:, :, None] * own[:, None, :]).flatten(1)
        gathered = sent.new_zeros(len(vertices), sent.shape[1]).index_add(0, frame, sent).unflatten(1, (JOINTS, -1))
        share = weight.new_zeros(len(vertices), JOINTS).index_add(0, frame, weight)
        joints = nn.functional.gelu(self.joints(gathered / (share[..., None] + 1.0)))
        back = (weight[:, None, :] @ joints[frame])[:, 0]
        attributes = self.out(torch.cat([own, back], dim=1))
        push = ((margin - depth) * (1.0 + attributes[:, 0]))[:, None] * normal
        # Not deeper in than it was, nor aside farther than it is pushed out.
        aside = torch.tanh(attributes[:, 1:]) * (margin - depth)[:, None]
        return vertices.index_put((frame, vertex), vertices[frame, vertex] + push + aside)


class GSNet(Animator):
    """Ours: displacements sent along several edges from every joint to every vertex, on top of skinning."""

    kind = "gsnet"

    def __init__(self, config: GSNetConfig) -> None:
        super().__init__(config)
        width, edges = config.width, JOINTS * config.heads
        self.encoder = GarmentEncoder(len(PLACE) + len(config.materials), width, keep=True)
        self.edges = fully_connected(2 * width, (width, width), edges)
        self.weights = nn.Linear(2 * width, JOINTS)
        self.local = nn.Linear(2 * width, 16)
        first, *rest = config.hidden
        self.motion = nn.Linear(self.told_size(*self._told) * len(config.offsets), first)
        self.garment = nn.Linear(width, first)
        self.memory = nn.Linear(3 * edges, first, bias=False) if config.garment_state else None
        self.joints = fully_connected(first, rest, 3 * edges)
        self.regressor = PhysicalRegressor()
        for layer, scale in ((self.weights, 0.0), (self.joints[-1], 0.1)):
            nn.init.normal_(layer.weight, std=scale * layer.in_features**-0.5)
            nn.init.zeros_(layer.bias)

    @property
    def _told(self) -> tuple[bool, bool]:
        """Without a past, no velocities either."""
        return len(self.config.offsets) > 1, self.config.rotations

    def encode(self, graph: GarmentGraph, materials: Tensor) -> Encoding:
        """Encoding of a garment in ``materials [B, P]``."""
        features = self.encoder(graph, self.vertex_features(graph, materials))  # [N, B, 2 width]
        weight = (graph.weights[:, None].clamp_min(1e-4).log() + self.weights(features)).softmax(2).transpose(0, 1)
        rest = torch.cat([graph.rest, torch.ones(len(graph.rest), 1)], dim=1)
        skin = (weight[..., None] * rest[None, :, None, :]).flatten(2)
        edges = (self.edges(features) * self.edge_scale).transpose(0, 1)
        gram = edges.transpose(1, 2) @ edges * self.pooling(edges)
        return Encoding(
            skin, weight, edges, gram, features[0, :, self.config.width :], self.local(features).transpose(0, 1)
        )

    @property
    def edge_scale(self) -> float:
        """Of the edges, so that what arrives at a vertex is as large as what one joint sends."""
        return (JOINTS * self.config.heads) ** -0.5

    @staticmethod
    def pooling(edges: Tensor) -> float:
        """Factor of the sum over the vertices in the pooled memory."""
        return edges.shape[2] / edges.shape[1]

    def drive(self, encoding: Encoding, motion: Motion, now: Tensor | None = None) -> Tensor:
        """What the joints know beside their memory, [B, S, hidden]: the motion up to each frame, and the garment.

        ``now [S]`` are the frames, counted from the lead-in's first; all where None.
        """
        told = self.told(motion, *self._told)
        now = torch.arange(told.shape[1]) if now is None else now
        past = (now[:, None] - torch.tensor(self.config.offsets)).clamp_min(0)
        return self.motion(told[:, past].flatten(2)) + self.garment(encoding.code)[:, None]

    def send(self, drive: Tensor, state: Tensor | None) -> Tensor:
        """Messages [..., K, 3] of the joints that know ``drive [..., hidden]`` and a memory [..., K, 3]."""
        if self.memory is not None and state is not None:
            drive = drive + self.memory(FULL * torch.tanh(state.flatten(-2) / FULL))
        return self.joints(nn.functional.gelu(drive)).unflatten(-1, (-1, 3))

    def messages(self, drive: Tensor, gram: Tensor, lead: int, state: Tensor | None = None) -> Tensor:
        """Messages [B, T, K, 3] of the frames after the lead-in; the memory [B, K, 3] begins empty where None."""
        if self.memory is None:
            return self.send(drive[:, lead:], None)
        sent = []
        for frame in range(drive.shape[1]):
            sent.append(self.send(drive[:, frame], state))
            state = gram @ sent[-1]
        return torch.stack(sent[lead:], dim=1)

    def unroll(self, encoding: Encoding, motion: Motion) -> Tensor:
        """Free-running canonical vertices [B, T, N, 3] [m]."""
        sent = self.messages(self.drive(encoding, motion), encoding.gram, motion.lead)
        return self.arrive(encoding, motion.transforms[:, motion.lead :], sent)

    def rehearse(self, worn: Many[Worn], frames: Tensor) -> list[Rehearsal]:
        """Roll-outs, the joints of all garments side by side; without a memory, the frames asked for."""
        if self.memory is None:
            return [self._rehearse_frames(w, frames) for w in worn]
        motion, state, length = worn[0].motion, None, self.config.segment or worn[0].motion.frames
        first = int(torch.randint(0, max(1, motion.frames - length + 1), (1,)))
        if float(torch.rand(1)) < length / motion.frames:  # beginnings are as frequent as any other part
            first = 0
        wanted = torch.arange(first, min(first + length, motion.frames))
        before = motion.lead if first == 0 else 0
        now = torch.arange(motion.lead + first - before, motion.lead + len(wanted) + first)
        drive = torch.cat([self.drive(w.encoding, w.motion, now) for w in worn])
        if first > 0:
            with torch.no_grad():
                last = motion.lead + first - 1
                state = torch.cat([self.remembered(w.encoding, w.motion, last, w.truth[:, first - 1]) for w in worn])
                state = state + self.config.noise * state.std() * torch.randn_like(state)
        gram = torch.cat([w.encoding.gram.expand(len(w.truth), -1, -1) for w in worn])
        sent = self.messages(drive, gram, before, state)
        parts = sent.split([len(w.truth) for w in worn])
        return [
            Rehearsal(self.arrive(w.encoding, w.motion.transforms[:, motion.lead + wanted], part), wanted)
            for w, part in zip(worn, parts, strict=True)
        ]

    def _rehearse_frames(self, worn: Worn, frames: Tensor) -> Rehearsal:
        now = worn.motion.lead + frames
        sent = self.send(self.drive(worn.encoding, worn.motion, now), None)
        return Rehearsal(self.arrive(worn.encoding, worn.motion.transforms[:, now], sent), frames)

    def remembered(self, encoding: Encoding, motion: Motion, frame: int, vertices: Tensor) -> Tensor:
        """Pooled memory [B, K, 3] of vertices [B, N, 3] at a frame, counted from the lead-in's first."""
        moved = vertices - skinned(encoding.skin, motion.transforms[:, frame : frame + 1])[:, 0]
        return encoding.edges.transpose(1, 2) @ moved * (self.pooling(encoding.edges) / REACH)

    @staticmethod
    def arrive(encoding: Encoding, transforms: Tensor, sent: Tensor) -> Tensor:
        """Vertices [B, T, N, 3] [m] of transforms [B, T, 96, 3] and messages [B, T, K, 3].

        Skinning and messages are one product: joints' transforms and displacements along the garment's edges.
        """
        columns = torch.cat([transforms, REACH * sent], dim=2)
        return skinned(torch.cat([encoding.skin, encoding.edges], dim=2), columns)

    def step(self, encoding: Encoding, motion: Motion, frame: int, previous: Tensor | None = None) -> Tensor:
        """Vertices [B, N, 3] [m] of a frame (counted from the lead-in's first) from those of the frame before.

        Nothing of the future of the motion is looked at. Without a frame before, the memory is empty.
        """
        state = None
        if self.memory is not None and previous is not None and frame > 0:
            state = self.remembered(encoding, motion, frame - 1, previous)
        sent = self.send(self.drive(encoding, motion, torch.tensor([frame]))[:, 0], state)
        return self.arrive(encoding, motion.transforms[:, frame : frame + 1], sent[:, None])[:, 0]


class PublishedGSNet(Animator):
    """The paper's network: dense layers and graph convolutions over vertices and joints, frame by frame."""

    kind = "gsnet_published"

    def __init__(self, config: GSNetConfig) -> None:
        super().__init__(config)
        width = config.width
        self.encoder = GarmentEncoder(len(PLACE) + len(config.materials), width, keep=False)
        self.edges = fully_connected(2 * width, (width, width // 2), JOINTS)
        self.local = nn.Linear(2 * width, 16)
        self.previous = fully_connected(3, (16,), 16)
        self.convolutions = nn.ModuleList(nn.Linear(a, b) for a, b in pairwise((16, width, width, width)))
        self.out = fully_connected(width, (width // 2, width // 4, 16), 16)
        self.place = nn.Linear(16, 3)
        self.regressor = PhysicalRegressor()

    def encode(self, graph: GarmentGraph, materials: Tensor) -> Encoding:
        """Encoding of a garment in ``materials [B, P]``."""
        features = self.encoder(graph, self.vertex_features(graph, materials))
        edges = self.edges(features).softmax(2).transpose(0, 1)
        batch = len(materials)
        return Encoding(
            graph.skin.expand(batch, -1, -1),
            graph.weights.expand(batch, -1, -1),
            edges,
            edges.new_zeros(batch, 0, 0),
            features[0, :, self.config.width :],
            self.local(features).transpose(0, 1),
        )

    def predict(self, encoding: Encoding, transforms: Tensor, previous: Tensor) -> Tensor:
        """Vertices [B, N, 3] [m] of transforms [B, 96, 3] and the vertices of the frame before [B, N, 3]."""
        rows = transforms.unflatten(1, (JOINTS, 4))
        homogeneous = torch.zeros_like(rows[..., :1])
        homogeneous[:, :, 3] = 1.0
        joints = torch.cat([rows, homogeneous], dim=3).flatten(2)  # [B, 24, 16]
        cloth = self.previous(previous / REACH)
        # Graph of degrees 1 + sum of the edges, loops included, normalized as in Eq. 2.
        of_joint = 1.0 + encoding.edges.sum(1)[:, :, None]
        across = encoding.edges / (2.0 * of_joint.transpose(1, 2)).sqrt()
        for layer in self.convolutions:
            to_cloth, to_joints = across @ joints, across.transpose(1, 2) @ cloth
            cloth = nn.functional.gelu(layer(cloth / 2.0 + to_cloth))
            joints = nn.functional.gelu(layer(joints / of_joint + to_joints))
        return self.place(nn.functional.gelu(self.out(cloth)))

    def rehearse(self, worn: Many[Worn], frames: Tensor) -> list[Rehearsal]:
        """The frames asked for, each from the true one before it: teacher forcing, as published."""
        frames = frames[frames > 0]
        found = []
        for w in worn:
            now = w.motion.wanted(frames).transforms.flatten(0, 1)
            encoding = w.encoding if len(w.encoding.edges) == 1 else w.encoding.repeat(len(frames))
            predicted = self.predict(encoding, now, w.truth[:, frames - 1].flatten(0, 1))
            found.append(Rehearsal(predicted.unflatten(0, (-1, len(frames))), frames))
        return found

    def unroll(self, encoding: Encoding, motion: Motion) -> Tensor:
        """Free-running canonical vertices [B, T, N, 3] [m], begun as the skinned template before the lead-in."""
        vertices, found = skinned(encoding.skin, motion.transforms[:, :1])[:, 0], []
        for frame in range(motion.transforms.shape[1]):
            vertices = self.predict(encoding, motion.transforms[:, frame], vertices)
            found.append(vertices)
        return torch.stack(found[motion.lead :], dim=1)


@torch.no_grad()
def corrector(animator: Animator, graph: GarmentGraph, material: np.ndarray, margin: float) -> Correction:
    """The physical regressor of a trained network for one garment of one material, frame by frame, in NumPy.

    Args:
        animator: With a regressor.
        graph, material: The garment and what it is made of.
        margin: Distance from the body that is aimed at [m].

    Raises:
        ValueError: The network has no physical regressor.
    """
    if animator.regressor is None:
        raise ValueError(f"{animator.kind}: it has no physical regressor")
    encoding, row = animator.encode(graph, torch.as_tensor(material)[None]), torch.zeros(1, dtype=torch.long)

    @torch.no_grad()
    def correct(vertices: np.ndarray, points: np.ndarray, normals: np.ndarray) -> np.ndarray:
        given = (torch.as_tensor(x.astype(np.float32))[None] for x in (vertices, points, normals))
        return animator.regressor(encoding, row, *given, margin)[0].numpy()

    return correct


def fully_connected(inputs: int, hidden: Many[int], outputs: int) -> nn.Sequential:
    """Linear layers with GELU between them."""
    sizes = (inputs, *hidden, outputs)
    layers: list[nn.Module] = []
    for before, after in pairwise(sizes):
        layers += [nn.Linear(before, after), nn.GELU()]
    return nn.Sequential(*layers[:-1])
