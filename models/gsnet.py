"""GSNet: one network that dresses motions in garments of any topology (Peng 2023).

In: garment graphs, materials and motions. Out: canonical garment vertices [m]. Three parts, as published: a *garment
encoder* on the normalized Laplacian of the template's mesh; *deep skinning*, a graph of joints and vertices whose edges
come from the encoder and along which motion reaches the garment; a *physical regressor* that corrects the vertices
inside the body and learns without truth. ``published_gsnet`` has the paper's; this one is ours:

- ``L_n X`` takes away where a vertex is, so the encoder keeps X beside what the neighbours hand on.
- Vertices do not talk through dense layers in every frame: several edges lead from every joint to every vertex, the
  joints, which know the last second of the motion and a pooled memory of the garment, send a displacement along each,
  and a vertex adds up what arrives to its skinned place. All frames of all motions are then one matrix product.
- The published network sees the garment of the frame before, and is taught from true ones; in a roll-out its errors
  feed on themselves. Here the garment before may be a pooled, bounded memory of the joints, taught on the network's own
  roll-outs, from the lead-in or a noised true frame. The motion of the last second makes that memory superfluous: on a
  skirt and a T-shirt, new clips were 19 mm off with it and without after 300 steps of 20 frames a clip; after 1,800
  steps 10.9 mm without it, 12.4 mm with it on roll-outs of 8 frames, which took 1.6 times as long.
- What is linear in the motion may be had in closed form, before any step of training: see ``gsnet_anchor``.

Dimensions: B sequences, F = L + T frames, N garment vertices, J = 24 joints, K edges a vertex, P material parameters.
"""

from __future__ import annotations

from collections.abc import Sequence as Many
from dataclasses import dataclass
from itertools import pairwise

import torch
from torch import Tensor, nn

from models.garment_animator import Animator, Motion, Rehearsal, Worn, skinned
from models.garment_encoder import Encoding, GarmentEncoder, fully_connected
from models.garment_graph import JOINTS, PLACE, GarmentGraph
from models.physical_regressor import PhysicalRegressor

REACH = 0.1
"""Displacement that a joint sends along an edge of weight 1 for an output of 1 [m]."""

FULL = 4.0
"""Where the pooled memory levels off: ten times what garments reach."""


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
        linear: Whether the joints send a linear map of the motion beside what their network makes of it; ``anchor``
            sets it in closed form.
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
    linear: bool = False

    def __post_init__(self) -> None:
        # A config read back from a file holds lists where it held tuples.
        for name in ("materials", "hidden", "offsets"):
            object.__setattr__(self, name, tuple(getattr(self, name)))
        if self.offsets[0] != 0 or any(b <= a for a, b in pairwise(self.offsets)):
            raise ValueError(f"gsnet offsets: must rise from 0, got {list(self.offsets)}")


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
        self.linear = nn.Linear(self.motion.in_features, 3 * edges).requires_grad_(False) if config.linear else None
        self.regressor = PhysicalRegressor()
        for layer, scale in ((self.weights, 0.0), (self.joints[-1], 0.0 if config.linear else 0.1)):
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

    def past(self, motion: Motion, now: Tensor | None = None) -> Tensor:
        """The motion up to each frame as the joints know it, [B, S, D].

        ``now [S]`` are the frames, counted from the lead-in's first; all where None.
        """
        told = self.told(motion, *self._told)
        now = torch.arange(told.shape[1]) if now is None else now
        return told[:, (now[:, None] - torch.tensor(self.config.offsets)).clamp_min(0)].flatten(2)

    def drive(self, encoding: Encoding, motion: Motion, now: Tensor | None = None) -> Tensor:
        """All that the messages of some frames hang on but the memory: what the joints' network knows of the motion and
        the garment, and then, if there is a linear map, what that sends; [B, S, hidden (+ 3 K)].
        """
        past = self.past(motion, now)
        known = self.motion(past) + self.garment(encoding.code)[:, None]
        return known if self.linear is None else torch.cat([known, self.linear(past)], dim=2)

    def send(self, drive: Tensor, state: Tensor | None) -> Tensor:
        """Messages [..., K, 3] of the joints by what ``drive`` says of their frames and a memory [..., K, 3]."""
        known, linear = drive.tensor_split([self.motion.out_features], dim=-1)
        if self.memory is not None and state is not None:
            known = known + self.memory(FULL * torch.tanh(state.flatten(-2) / FULL))
        sent = self.joints(nn.functional.gelu(known))
        return (sent if self.linear is None else sent + linear).unflatten(-1, (-1, 3))

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
