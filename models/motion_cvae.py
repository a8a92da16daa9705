"""Motion generator: a Transformer variational autoencoder conditioned on a motion label (Shi 2023, section 3.2).

In: poses in the 6-D form and a label. Out: a Gaussian over one latent vector a sequence; from a latent vector and a
label, a pose sequence of any length.

Encoder: the label's one-hot vector gives two class tokens by an MLP; they are put in front of the T pose embeddings,
sinusoidal positions are added, and of the output of the encoder layers the first two tokens are mean and log standard
deviation; the rest is discarded. Decoder: the latent vector plus a learned bias a label is added to every position
code, and the sums are query, key and value at once of further *encoder* layers (this is where the paper departs from
ACTOR), projected to 24 x 6 numbers. The loss is that of ``SequenceCVAE``.

Dimensions: N clips, T frames, d width, C labels.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor, nn

from models.motion_generator import POSE_SIZE, SequenceCVAE, checked_labels
from models.transformer import EncoderLayer, sinusoidal_positions


@dataclass(frozen=True)
class MotionCVAEConfig:
    """Sizes and loss weights; the defaults are the paper's.

    Attributes:
        labels: Names of the motion labels (paper: 66).
        width: Embedding and latent size d.
        layers: Transformer encoder layers N, in the encoder and again in the decoder.
        heads, feed_forward, dropout: Of each layer.
        label_hidden: Hidden width of the label MLP.
        kl_weight: Weight of the KL term (lambda_KL).
        vertex_weight: Weight of the vertex term; 0 trains without it (Table 8).
    """

    labels: tuple[str, ...]
    width: int = 256
    layers: int = 8
    heads: int = 4
    feed_forward: int = 1024
    dropout: float = 0.1
    label_hidden: int = 128
    kl_weight: float = 1.0e-5
    vertex_weight: float = 1.0

    def __post_init__(self) -> None:
        object.__setattr__(self, "labels", checked_labels(self.labels))


class MotionCVAE(SequenceCVAE):
    """Encoder, decoder and label biases."""

    def __init__(self, config: MotionCVAEConfig) -> None:
        super().__init__(config, config.width)
        d, count = config.width, len(config.labels)
        self.label_tokens = nn.Sequential(
            nn.Linear(count, config.label_hidden), nn.ReLU(), nn.Linear(config.label_hidden, 2 * d)
        )
        self.pose_in = nn.Linear(POSE_SIZE, d)
        self.encoder = nn.ModuleList(self._layer() for _ in range(config.layers))
        self.label_bias = nn.Parameter(torch.randn(count, d))
        self.decoder = nn.ModuleList(self._layer() for _ in range(config.layers))
        self.pose_out = nn.Linear(d, POSE_SIZE)

    def _layer(self) -> EncoderLayer:
        c = self.config
        return EncoderLayer(c.width, c.heads, c.feed_forward, c.dropout)

    def encode(self, pose6d: Tensor, labels: Tensor) -> tuple[Tensor, Tensor]:
        tokens = self.label_tokens(self.one_hot(labels)).unflatten(-1, (2, self.config.width))
        x = torch.cat([tokens, self.pose_in(self.scaled(pose6d))], dim=1)  # [N, 2 + T, d]
        x = x + sinusoidal_positions(x.shape[1], x.shape[2], x.device)
        for layer in self.encoder:
            x = layer(x)
        return x[:, 0], x[:, 1]

    def decode(self, latent: Tensor, labels: Tensor, frames: int) -> Tensor:
        token = latent + self.label_bias[labels]
        x = sinusoidal_positions(frames, token.shape[1], token.device)[None] + token[:, None]  # [N, T, d]
        for layer in self.decoder:
            x = layer(x)
        return self.unscaled(self.pose_out(x))
