"""Motion generator: a Transformer variational autoencoder conditioned on a motion label (Shi 2023, section 3.2).

In: poses in the 6-D form and a label. Out: a Gaussian over one latent vector a sequence; from a latent vector and a
label, a pose sequence of any length. Poses alone are generated; ``motions.grounding`` derives the root translation.

Encoder: the label's one-hot vector gives two class tokens by an MLP; they are put in front of the T pose embeddings,
sinusoidal positions are added, and of the output of the encoder layers the first two tokens are mean and log standard
deviation; the rest is discarded. Decoder: the latent vector plus a learned bias a label is added to every position
code, and the sums are query, key and value at once of further *encoder* layers (this is where the paper departs from
ACTOR), projected to 24 x 6 numbers.

Loss (Eqs. 1, 2): pose + vertices + ``kl_weight`` KL. The squared errors are averaged over components and frames, as in
the code of ACTOR that the paper builds on: under plain sums the published weight 1e-5 of the KL term would vanish
against 20,670 vertex coordinates, and no latent vector drawn from the prior would decode to a motion.

Dimensions: N clips, T frames, d width, C labels.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor, nn

from models.body_layer import BodyLayer, rotation_from_6d
from models.transformer import EncoderLayer, sinusoidal_positions

JOINTS = 24
POSE_SIZE = JOINTS * 6


@dataclass(frozen=True)
class MotionCVAEConfig:
    """Sizes and loss weights; the defaults are the paper's.

    Attributes:
        labels: Names of the motion labels (paper: 66).
        width: Embedding and latent size d.
        layers: Transformer encoder layers N, in the encoder and again in the decoder.
        heads, feed_forward, dropout: Of each layer.
        label_hidden: Hidden width of the label MLP.
        frames_per_token: Frames that share a token (paper: 1). Above 1 the decoder's tokens are the control points of
            uniform cubic B-splines, so that no seam shows. Motion at 30 Hz is smooth, and a quarter of the tokens
            trains three times as fast on a CPU.
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
    frames_per_token: int = 1
    kl_weight: float = 1.0e-5
    vertex_weight: float = 1.0

    def __post_init__(self) -> None:
        object.__setattr__(self, "labels", tuple(self.labels))
        if not self.labels or len(set(self.labels)) != len(self.labels):
            raise ValueError(f"motion CVAE: labels must be non-empty and different, got {list(self.labels)}")
        if self.frames_per_token < 1:
            raise ValueError(f"motion CVAE: frames_per_token must be at least 1, got {self.frames_per_token}")


class MotionCVAE(nn.Module):
    """Encoder, decoder and label biases; poses are scaled by the mean and spread of the training split."""

    def __init__(self, config: MotionCVAEConfig) -> None:
        super().__init__()
        self.config = config
        d, count = config.width, len(config.labels)
        self.register_buffer("pose_mean", torch.zeros(POSE_SIZE))
        self.register_buffer("pose_scale", torch.ones(POSE_SIZE))
        self.label_tokens = nn.Sequential(
            nn.Linear(count, config.label_hidden), nn.ReLU(), nn.Linear(config.label_hidden, 2 * d)
        )
        self.pose_in = nn.Linear(POSE_SIZE * config.frames_per_token, d)
        self.encoder = nn.ModuleList(self._layer() for _ in range(config.layers))
        self.label_bias = nn.Parameter(torch.randn(count, d))
        self.decoder = nn.ModuleList(self._layer() for _ in range(config.layers))
        self.pose_out = nn.Linear(d, POSE_SIZE)

    def _layer(self) -> EncoderLayer:
        c = self.config
        return EncoderLayer(c.width, c.heads, c.feed_forward, c.dropout)

    def set_scaling(self, pose6d: Tensor) -> None:
        """Take mean and spread from training poses [N, T, 24, 6]; joints that hardly move keep a floor of 0.05."""
        flat = pose6d.reshape(-1, POSE_SIZE)
        self.pose_mean.copy_(flat.mean(0))
        self.pose_scale.copy_(flat.std(0).clamp_min(0.05))

    def label_numbers(self, labels: Sequence[str]) -> Tensor:
        """Class numbers [N] of label names; ``ValueError`` names an unknown one."""
        known = {name: number for number, name in enumerate(self.config.labels)}
        for name in labels:
            if name not in known:
                raise ValueError(f"motion CVAE: label {name!r} was not trained; known: {', '.join(known)}")
        return torch.tensor([known[name] for name in labels], dtype=torch.long)

    def encode(self, pose6d: Tensor, labels: Tensor) -> tuple[Tensor, Tensor]:
        """Mean and log standard deviation [N, d] of the latent vector of ``pose6d [N, T, 24, 6]``, ``labels [N]``."""
        if pose6d.ndim != 4 or pose6d.shape[2:] != (JOINTS, 6):
            raise ValueError(f"pose6d: expected shape [N, T, {JOINTS}, 6], got {list(pose6d.shape)}")
        scaled = (pose6d.flatten(2) - self.pose_mean) / self.pose_scale
        one_hot = nn.functional.one_hot(labels, len(self.config.labels)).to(scaled.dtype)
        tokens = self.label_tokens(one_hot).unflatten(-1, (2, self.config.width))
        together = self.config.frames_per_token
        missing = -scaled.shape[1] % together
        scaled = torch.cat([scaled, scaled[:, -1:].expand(-1, missing, -1)], dim=1)  # the last pose is held
        grouped = scaled.reshape(len(scaled), -1, together * POSE_SIZE)
        x = torch.cat([tokens, self.pose_in(grouped)], dim=1)  # [N, 2 + T', d], T' = T where a frame is a token
        x = x + sinusoidal_positions(x.shape[1], x.shape[2], x.device)
        for layer in self.encoder:
            x = layer(x)
        return x[:, 0], x[:, 1]

    def decode(self, latent: Tensor, labels: Tensor, frames: int) -> Tensor:
        """6-D poses [N, T, 24, 6] (not yet orthonormal) of latent vectors [N, d] and class numbers [N]."""
        token = latent + self.label_bias[labels]
        spline = None
        if self.config.frames_per_token > 1:
            spline = spline_basis(frames, self.config.frames_per_token).to(token.device)
        count = frames if spline is None else spline.shape[1]
        x = sinusoidal_positions(count, token.shape[1], token.device)[None] + token[:, None]  # [N, T', d]
        for layer in self.decoder:
            x = layer(x)
        scaled = self.pose_out(x).float()
        if spline is not None:
            scaled = spline @ scaled
        return (scaled * self.pose_scale + self.pose_mean).unflatten(-1, (JOINTS, 6))

    @torch.no_grad()
    def sample(self, labels: Sequence[str], frames: int, generator: torch.Generator) -> np.ndarray:
        """Generate one motion a label, with latent vectors drawn from the prior.

        Args:
            labels: Label names, one a wanted motion.
            frames: Length T of the motions.
            generator: Source of randomness: the same state gives the same motions.

        Returns:
            Orthonormal 6-D poses, shape [N, T, 24, 6] float32.
        """
        numbers = self.label_numbers(labels)
        latent = torch.randn(len(numbers), self.config.width, generator=generator)
        return self._evaluated(lambda: self.decode(latent, numbers, frames))

    @torch.no_grad()
    def reconstruct(self, pose6d: np.ndarray, labels: Sequence[str]) -> np.ndarray:
        """Encode and decode motions [N, T, 24, 6] through the mean of their latent vectors; same shape."""
        numbers = self.label_numbers(labels)
        poses = torch.as_tensor(np.asarray(pose6d, dtype=np.float32))
        return self._evaluated(lambda: self.decode(self.encode(poses, numbers)[0], numbers, poses.shape[1]))

    def _evaluated(self, compute) -> np.ndarray:
        """Run without dropout and put the 6-D forms back onto rotations."""
        was_training = self.training
        self.eval()
        try:
            return orthonormal_6d(compute()).numpy()
        finally:
            self.train(was_training)


def spline_basis(frames: int, spacing: int) -> Tensor:
    """Matrix [frames, K] from control points every ``spacing`` frames to frames: uniform cubic B-splines (C2)."""
    last = (frames - 1) // spacing
    time = torch.arange(frames, dtype=torch.float32) / spacing
    segment = time.long().clamp_max(last)
    f = time - segment
    weights = torch.stack([(1 - f) ** 3, 3 * f**3 - 6 * f**2 + 4, -3 * f**3 + 3 * f**2 + 3 * f + 1, f**3], dim=1) / 6.0
    return torch.zeros(frames, last + 4).scatter_(1, segment[:, None] + torch.arange(4), weights)


def orthonormal_6d(six: Tensor) -> Tensor:
    """Orthonormal 6-D forms (Gram-Schmidt) of predicted ones, same shape [..., 6]."""
    rotation = rotation_from_6d(six)
    return torch.cat([rotation[..., 0], rotation[..., 1]], dim=-1)


def motion_cvae_loss(model: MotionCVAE, body: BodyLayer, batch: tuple[Tensor, Tensor]) -> dict[str, Tensor]:
    """Loss of Eq. 2 and its parts for poses [N, T, 24, 6] and class numbers [N].

    ``pose``: mean squared error of the 6-D components. ``vertex``: mean squared error of the vertex coordinates [m^2],
    root at rest, by the closed form. ``kl``: divergence from the standard normal prior, summed over the latent size.
    """
    pose6d, labels = batch
    mean, log_deviation = (x.float() for x in model.encode(pose6d, labels))
    noise = torch.randn_like(mean) if model.training else torch.zeros_like(mean)
    predicted = model.decode(mean + noise * log_deviation.exp(), labels, pose6d.shape[1])
    pose = (predicted - pose6d).square().mean()
    kl = -0.5 * (1.0 + 2.0 * log_deviation - mean.square() - (2.0 * log_deviation).exp()).sum(1).mean()
    loss = pose + model.config.kl_weight * kl
    parts = {"pose": pose.detach(), "kl": kl.detach()}
    if model.config.vertex_weight > 0.0:
        with torch.no_grad():
            target = body.transforms(pose6d)
        vertex = body.mean_squared_vertex_error(body.transforms(predicted), target).mean() / 3.0
        loss = loss + model.config.vertex_weight * vertex
        parts["vertex"] = vertex.detach()
    return {"total": loss, **parts}
