"""ACTOR, the baseline with one latent vector a sequence (Petrovich 2021, "Action-Conditioned 3D Human Motion Synthesis
with Transformer VAE"); a compact implementation of our own.

In: poses in the 6-D form and a label. Out: a Gaussian over one latent vector a sequence, and poses of any length.

Encoder: two learned tokens a label are put in front of the pose embeddings; their outputs are mean and log standard
deviation. Decoder: Transformer *decoder* layers whose queries are the sinusoidal time codes alone; what they attend to
is a single token, the latent vector plus a learned bias a label. The published loss is that of ``SequenceCVAE``: poses,
vertices and 1e-5 KL. Ours has ReLU for GELU.

Dimensions: N clips, T frames, d width, C labels.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor, nn

from models.motion_generator import POSE_SIZE, SequenceCVAE, checked_labels
from models.transformer import DecoderLayer, EncoderLayer, sinusoidal_positions


@dataclass(frozen=True)
class ActorConfig:
    """Sizes and loss weights; the defaults are the published ones.

    Attributes:
        labels: Names of the motion labels.
        width: Embedding and latent size d.
        layers: Transformer layers, in the encoder and again in the decoder.
        heads, feed_forward, dropout: Of each layer.
        kl_weight, vertex_weight: Weights of the loss.
    """

    labels: tuple[str, ...]
    width: int = 256
    layers: int = 8
    heads: int = 4
    feed_forward: int = 1024
    dropout: float = 0.1
    kl_weight: float = 1.0e-5
    vertex_weight: float = 1.0

    def __post_init__(self) -> None:
        object.__setattr__(self, "labels", checked_labels(self.labels))


class Actor(SequenceCVAE):
    """Transformer encoder and decoder around one latent vector."""

    def __init__(self, config: ActorConfig) -> None:
        super().__init__(config, config.width)
        d, count = config.width, len(config.labels)
        sizes = (d, config.heads, config.feed_forward, config.dropout)
        self.label_tokens = nn.Parameter(torch.randn(count, 2, d))
        self.pose_in = nn.Linear(POSE_SIZE, d)
        self.encoder = nn.ModuleList(EncoderLayer(*sizes) for _ in range(config.layers))
        self.label_bias = nn.Parameter(torch.randn(count, d))
        self.decoder = nn.ModuleList(DecoderLayer(*sizes) for _ in range(config.layers))
        self.pose_out = nn.Linear(d, POSE_SIZE)

    def encode(self, pose6d: Tensor, labels: Tensor) -> tuple[Tensor, Tensor]:
        x = torch.cat([self.label_tokens[labels], self.pose_in(self.scaled(pose6d))], dim=1)  # [N, 2 + T, d]
        x = x + sinusoidal_positions(x.shape[1], x.shape[2], x.device)
        for layer in self.encoder:
            x = layer(x)
        return x[:, 0], x[:, 1]

    def decode(self, latent: Tensor, labels: Tensor, frames: int) -> Tensor:
        memory = (latent + self.label_bias[labels])[:, None]  # [N, 1, d]
        x = sinusoidal_positions(frames, latent.shape[1], latent.device).expand(len(latent), -1, -1)
        for layer in self.decoder:
            x = layer(x, memory, None, None)
        return self.unscaled(self.pose_out(x))
