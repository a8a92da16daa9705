"""GSNet as published, layer by layer (Peng 2023, section 3).

In: garment graphs, materials and motions. Out: canonical garment vertices [m]. The joint graph gets loops (a vertex
keeps what it knows): between two sets without them, three convolutions would end at the vertices having seen the joints
alone. It sees the garment of the frame before, and is taught from true ones.

Dimensions: B sequences, T frames, N garment vertices, J = 24 joints, P material parameters.
"""

from __future__ import annotations

from collections.abc import Sequence as Many
from itertools import pairwise

import torch
from torch import Tensor, nn

from models.garment_animator import Animator, Motion, Rehearsal, Worn, skinned
from models.garment_encoder import Encoding, GarmentEncoder, fully_connected
from models.garment_graph import JOINTS, PLACE, GarmentGraph
from models.gsnet import GSNetConfig
from models.physical_regressor import PhysicalRegressor

REACH = 0.1
"""Place of the frame before that counts as 1 [m]."""


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
