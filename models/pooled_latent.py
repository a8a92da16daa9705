"""Ours: a latent that many frames agree upon, decoded as a correction of what the motion alone tells.

Five things differ from the paper's network (``models.motion_invariant``), each because without it z held the frame and
not the material:

- The motion gives a shape by itself, ``S_0(M)``, and z only corrects it: ``F_D(z | M) = S_0(M) + U(...U(z | M) | M)``.
  The encoder sees ``S - S_0(M)``. So the many clips of the one base material teach the motion, and z need not.
- A frame gives a value and a weight for each number of z, and frames are put together as independent evidence beside a
  prior: ``z = sum w_t v_t / (1 + sum w_t)``. A frame in which the material does not show weighs little, and the z of
  few frames stays near zero.
- In training the parameters are known, and ``z_phi = E(phi)`` has no noise. The decoder learns from ``z_phi`` alone: a
  decoder that learns from what frames tell learns to make little of it, since frames tell it with noise. The encoder
  learns to find ``z_phi`` in frames: near it, and as good for the decoder, which it does not move.
- Each batch (one phi) falls into two halves of different clips; z comes from some frames of one half and is decoded
  with the motions of the other.
- The parameters are to be read from z by a linear map.

Controls with the same decoder: no z at all ("motion-only"), z from the true parameters ("true-parameters").
"""

from __future__ import annotations

from itertools import pairwise

import torch
from torch import Tensor, nn

from models.motion_invariant import (
    MotionInvariantConfig,
    MotionInvariantNetwork,
    UBlock,
    blending_weights,
    block_stack,
)

_ENCODER_GAIN = 5.0
"""What the motion leaves unexplained is about a fifth of the shapes' deviation."""
_FIRST_LOG_WEIGHT = -3.0
"""A frame weighs a twentieth of the prior at the start."""


class PooledNetwork(MotionInvariantNetwork):
    """Motion base, correcting decoder and pooled encoder; see the module."""

    prior = 1.0

    def __init__(self, config: MotionInvariantConfig, descriptor: int, signature: int, parameters: int) -> None:
        super().__init__(config, descriptor, signature, parameters)
        kind = self.weights.network
        layers: list[nn.Module] = []
        for before, after in pairwise([signature, *config.motion_hidden]):
            layers += [nn.Linear(before, after), nn.GELU(), nn.Dropout(config.motion_dropout)]
        self.motion_encoder = nn.Sequential(*layers)
        self.base = nn.Linear(config.motion_hidden[-1], descriptor)
        if kind == "motion-only":
            return
        inner = [config.width] * (config.blocks - 1)
        self.blend = nn.Linear(config.motion_hidden[-1], config.subnetworks)
        self.decoder = block_stack(UBlock, [config.latent, *inner, descriptor], config.subnetworks)
        self.embedding = nn.Sequential(
            nn.Linear(parameters, config.width), nn.GELU(), nn.Linear(config.width, config.latent)
        )
        if kind == "parameters":
            return
        self.encoder = block_stack(UBlock, [descriptor, *inner, 2 * config.latent], config.subnetworks)
        self.head = nn.Linear(config.latent, parameters)

    def motion(self, scaled: Tensor) -> tuple[Tensor, ...]:
        """Shape of the motion alone [B, C] in units, and blending weights [B, K]."""
        hidden = self.motion_encoder(scaled)
        if self.weights.network == "motion-only":
            return (self.base(hidden),)
        return self.base(hidden), blending_weights(self.blend(hidden))

    def evidence(self, descriptor: Tensor, context: tuple[Tensor, ...], parameters: Tensor) -> tuple[Tensor, Tensor]:
        if self.weights.network == "motion-only":
            zero = descriptor.new_zeros(len(descriptor), self.config.latent)
            return zero, zero
        if self.weights.network == "parameters":
            # Known, not inferred: far heavier than the prior.
            value = self.known_latent(parameters)
            return value, torch.full_like(value, 1e6)
        base, blend = context
        x = _ENCODER_GAIN * ((descriptor - self.descriptor_mean) / self.unit_length - base)
        for block in self.encoder:
            x = block(x, blend)
        value, log_weight = x.chunk(2, dim=1)
        return value, torch.exp(log_weight.clamp(-6.0, 6.0) + _FIRST_LOG_WEIGHT)

    def decode(self, latent: Tensor, context: tuple[Tensor, ...]) -> Tensor:
        x = context[0]
        if self.weights.network != "motion-only":
            correction = latent
            for block in self.decoder:
                correction = block(correction, context[1])
            x = x + correction
        return x * self.unit_length + self.descriptor_mean

    def decode_fixed(self, latent: Tensor, context: tuple[Tensor, ...]) -> Tensor:
        """``decode`` whose gradient reaches the latent alone."""
        self.decoder.requires_grad_(False)
        try:
            return self.decode(latent, tuple(part.detach() for part in context))
        finally:
            self.decoder.requires_grad_(True)

    def known_latent(self, parameters: Tensor) -> Tensor:
        """z [B, Z] that the true parameters [B, P] have."""
        return self.embedding(self.scaled_parameters(parameters))

    @property
    def unit_length(self) -> Tensor:
        """Root of the summed variance of the descriptor's numbers: a distance in these units is one between shapes."""
        return self.unit * len(self.descriptor_mean) ** 0.5

    def read_parameters(self, latent: Tensor) -> Tensor:
        """Scaled parameters [B, P] of ``latent [B, Z]``."""
        return self.head(latent)
