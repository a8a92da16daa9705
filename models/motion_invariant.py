"""Motion-invariant encoding: what a garment is made of, apart from how its wearer moves (Wang 2019, section 3.4).

In: shape descriptors S and motion signatures M. Out: ``z = F_E(S | M)`` and ``S' = F_D(z | M)``, where frames of one
parameter set phi are meant to share one z. This module holds the configuration, what all networks have in common, and
the paper's network with its alternatives; ``models.pooled_latent`` holds ours, ``models.intrinsic_fitting`` trains and
stores all of them.

Dimensions: N frames of a data set, B frames of a batch, C descriptor, D signature, P parameters, Z latent, W width of
the U-blocks, K sub-networks of a U-block.

    M_D = M_E(M) / sum M_E(M)                      motion encoder, softplus at its end
    U(x) = psi(sum_i M_D[i] L_i(x))                U-block, K linear maps L_i
    loss = Var(z) + lambda ||S - F_D(z | M)||      all frames of a batch share phi

The paper's loss never decodes the z of one frame with the motion of another, although that is what the network is for.
The variants "cross" and "pooled" do so within the same-phi batch; "pooled" also teaches the decoder by the parameters.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import torch
from torch import Tensor, nn


@dataclass(frozen=True)
class Variant:
    """How a network is built and which terms its loss weighs.

    Attributes:
        network: "u-blocks" (paper), "concatenate" (motion descriptor beside the input of plain layers), "pooled" (ours;
            see ``models.pooled_latent``), or with its decoder "motion-only" (no z) and "parameters" (z from the true
            parameters).
        variance: Weight of Var(z).
        own: Weight of the reconstruction with the frame's own motion; the paper's lambda.
        cross: Weight of the reconstruction from a z that was taken from another motion of the batch.
        parameters: Weight of reading the parameters from z.
        known: Weight of the reconstruction from the z that the true parameters have; the decoder learns from it alone.
        match: Weight of the distance of z from the one that the true parameters have.
        embedding: The encoder is trained before the decoder, so that distances of z are those of the parameters.
        signature: Kind of motion signature, see ``models.motion_history``.
    """

    network: str
    variance: float = 0.0
    own: float = 1.0
    cross: float = 0.0
    parameters: float = 0.0
    known: float = 0.0
    match: float = 0.0
    embedding: bool = False
    signature: str = "joints"


VARIANTS: dict[str, Variant] = {
    "paper": Variant("u-blocks", variance=1.0, own=0.1),
    "cross": Variant("u-blocks", variance=0.1, own=0.2, cross=1.0),
    # The two alternatives of Wang 2019, Fig. 11 (left).
    "concatenate": Variant("concatenate", variance=1.0, own=0.1),
    "embedding": Variant("u-blocks", embedding=True),
    "pooled": Variant("pooled", own=0.0, cross=0.3, parameters=0.1, known=1.0, match=1.0, signature="features"),
    # Controls: the decoder of "pooled" without z, and with the true parameters in its place.
    "motion-only": Variant("motion-only", signature="features"),
    "true-parameters": Variant("parameters", signature="features"),
}


@dataclass(frozen=True)
class MotionInvariantConfig:
    """Sizes of the network; the defaults are the paper's.

    Attributes:
        variant: A key of ``VARIANTS``.
        latent: Length Z of z.
        width: Width of the U-blocks.
        blocks: U-blocks of the encoder, and of the decoder.
        subnetworks: K, and the length of the motion descriptor.
        motion_hidden: Widths of the motion encoder before its last layer.
        motion_batch_norm: Batch norm in the paper's motion encoder.
        motion_dropout: Dropout in the motion encoder of "pooled" and its controls.
        window: Frames W of motion history.
        batch: Frames of a batch, all of one phi.
        batches_a_step: Batches, each of one phi of its own, whose gradients make a step.
    """

    variant: str = "paper"
    latent: int = 100
    width: int = 100
    blocks: int = 5
    subnetworks: int = 30
    motion_hidden: tuple[int, ...] = (1200, 600, 120)
    motion_batch_norm: bool = True
    motion_dropout: float = 0.1
    window: int = 100
    batch: int = 32
    batches_a_step: int = 1

    def __post_init__(self) -> None:
        object.__setattr__(self, "motion_hidden", tuple(self.motion_hidden))
        if self.variant not in VARIANTS:
            raise ValueError(f"motion-invariant variant: {self.variant!r} is not one of {', '.join(VARIANTS)}")
        sizes = (self.latent, self.width, self.blocks, self.subnetworks, *self.motion_hidden, self.batches_a_step)
        if min(sizes) < 1 or self.batch < 4 or self.window < 0:
            raise ValueError("motion-invariant network: sizes must be at least 1, batch at least 4, window at least 0")

    @property
    def signature(self) -> str:
        """Kind of motion signature that the network is driven by."""
        return VARIANTS[self.variant].signature


class UBlock(nn.Module):
    """``psi(sum_i M_D[i] L_i(x))``: K linear maps, blended by the motion descriptor (Wang 2019, equation of U)."""

    def __init__(self, before: int, after: int, subnetworks: int, last: bool = False) -> None:
        super().__init__()
        # K independent random maps average to one of 1/sqrt(K) the size, and ten such blocks in a row to nothing: so
        # half of the variance is common to the K maps at the start.
        bound = np.sqrt(6.0 / before) / np.sqrt(2.0)
        common = torch.empty(1, before, after).uniform_(-bound, bound)
        own = torch.empty(subnetworks, before, after).uniform_(-bound, bound)
        self.weight = nn.Parameter(common + own)
        self.bias = nn.Parameter(torch.zeros(subnetworks, after))
        self.activation = nn.Identity() if last else nn.PReLU()

    def forward(self, x: Tensor, blend: Tensor) -> Tensor:
        """Output [B, after] of ``x [B, before]`` and ``blend [B, K]``."""
        # sum_i m_i (x W_i) = (m outer x) W: one matrix product for all K maps and all frames of the batch.
        outer = (blend.unsqueeze(2) * x.unsqueeze(1)).flatten(1)
        return self.activation(torch.addmm(blend @ self.bias, outer, self.weight.flatten(0, 1)))


class ConcatenationBlock(nn.Module):
    """A plain layer that has the motion descriptor beside its input."""

    def __init__(self, before: int, after: int, subnetworks: int, last: bool = False) -> None:
        super().__init__()
        self.linear = nn.Linear(before + subnetworks, after)
        nn.init.kaiming_uniform_(self.linear.weight, nonlinearity="relu")
        nn.init.zeros_(self.linear.bias)
        self.activation = nn.Identity() if last else nn.PReLU()

    def forward(self, x: Tensor, blend: Tensor) -> Tensor:
        # Blending weights are about 1/K each; times K they are of the size of the other inputs.
        return self.activation(self.linear(torch.cat([x, blend * blend.shape[1]], dim=1)))


class MotionEncoder(nn.Module):
    """Motion signature [B, D] to blending weights [B, K]: not negative, sum one."""

    def __init__(self, size: int, config: MotionInvariantConfig) -> None:
        super().__init__()
        layers: list[nn.Module] = []
        for before, after in pairwise([size, *config.motion_hidden]):
            layers += [nn.Linear(before, after), nn.PReLU()]
            if config.motion_batch_norm:
                layers.append(nn.BatchNorm1d(after))
        last = config.motion_hidden[-1] if config.motion_hidden else size
        self.layers = nn.Sequential(*layers, nn.Linear(last, config.subnetworks))

    def forward(self, signature: Tensor) -> Tensor:
        return blending_weights(self.layers(signature))


def blending_weights(raw: Tensor) -> Tensor:
    """Softplus, divided by its sum."""
    positive = nn.functional.softplus(raw) + 1e-6
    return positive / positive.sum(1, keepdim=True)


def block_stack(block: type[nn.Module], widths: list[int], subnetworks: int) -> nn.ModuleList:
    """Blocks from each width to the next; the last has no activation."""
    last = len(widths) - 2
    return nn.ModuleList(block(a, b, subnetworks, last=i == last) for i, (a, b) in enumerate(pairwise(widths)))


class MotionInvariantNetwork(nn.Module, ABC):
    """What all networks share: scaling, and the calls by which they are trained and evaluated.

    Buffers: mean and deviation of descriptors [C], signatures [D] and parameters [P]; ``unit []``, the RMS deviation of
    descriptors, in which the loss is measured.
    """

    prior = 0.0
    """Weight of the latent zero where the evidence of several frames is put together."""

    def __init__(self, config: MotionInvariantConfig, descriptor: int, signature: int, parameters: int) -> None:
        super().__init__()
        self.config = config
        self.weights = VARIANTS[config.variant]
        sizes = {"descriptor": descriptor, "signature": signature, "parameter": parameters}
        for name, size in sizes.items():
            self.register_buffer(f"{name}_mean", torch.zeros(size))
            self.register_buffer(f"{name}_deviation", torch.ones(size))
        self.register_buffer("unit", torch.ones(()))

    def context(self, signature: Tensor) -> tuple[Tensor, ...]:
        """What encoder and decoder need of the motion ``signature [B, D]``."""
        if signature.ndim != 2 or signature.shape[1] != len(self.signature_mean):
            raise ValueError(
                f"motion signature: expected shape [B, {len(self.signature_mean)}], got {list(signature.shape)}"
            )
        return self.motion((signature - self.signature_mean) / self.signature_deviation)

    @abstractmethod
    def motion(self, scaled: Tensor) -> tuple[Tensor, ...]:
        """``context`` of scaled signatures."""

    @abstractmethod
    def evidence(self, descriptor: Tensor, context: tuple[Tensor, ...], parameters: Tensor) -> tuple[Tensor, Tensor]:
        """What each frame says of z, and how sure it is: value and weight, both [B, Z]."""

    @abstractmethod
    def decode(self, latent: Tensor, context: tuple[Tensor, ...]) -> Tensor:
        """Descriptor [B, C] of ``latent [B, Z]`` under a motion."""

    def pool(self, value: Tensor, weight: Tensor, dim: int = 0) -> Tensor:
        """One z of the evidence of several frames along ``dim``; of a single frame its own z."""
        return (value * weight).sum(dim) / (weight.sum(dim) + self.prior)

    def encode(self, descriptor: Tensor, context: tuple[Tensor, ...], parameters: Tensor) -> Tensor:
        """z [B, Z] of each frame alone."""
        value, weight = self.evidence(descriptor, context, parameters)
        return self.pool(value.unsqueeze(0), weight.unsqueeze(0))

    def scaled(self, descriptor: Tensor) -> Tensor:
        """Descriptor in units of its deviation, number by number."""
        return (descriptor - self.descriptor_mean) / self.descriptor_deviation

    def scaled_parameters(self, parameters: Tensor) -> Tensor:
        """Parameters in units of their deviation; a base value far outside of the sampled ranges is cut off."""
        return ((parameters - self.parameter_mean) / self.parameter_deviation).clamp(-3.0, 3.0)


class PaperNetwork(MotionInvariantNetwork):
    """Encoder, decoder and motion encoder of the paper, or with plain layers (its alternative "concatenate")."""

    def __init__(self, config: MotionInvariantConfig, descriptor: int, signature: int, parameters: int) -> None:
        super().__init__(config, descriptor, signature, parameters)
        block = ConcatenationBlock if self.weights.network == "concatenate" else UBlock
        inner = [config.width] * (config.blocks - 1)
        self.motion_encoder = MotionEncoder(signature, config)
        # An encoder that is fixed before the decoder is trained fixes its motion encoder with it.
        self.decoder_motion = MotionEncoder(signature, config) if self.weights.embedding else None
        self.encoder = block_stack(block, [descriptor, *inner, config.latent], config.subnetworks)
        self.decoder = block_stack(block, [config.latent, *inner, descriptor], config.subnetworks)

    def motion(self, scaled: Tensor) -> tuple[Tensor, ...]:
        """Motion descriptor M_D [B, K] of the encoder and that of the decoder, usually the same."""
        blend = self.motion_encoder(scaled)
        return blend, blend if self.decoder_motion is None else self.decoder_motion(scaled)

    def evidence(self, descriptor: Tensor, context: tuple[Tensor, ...], parameters: Tensor) -> tuple[Tensor, Tensor]:
        x = self.scaled(descriptor)
        for block in self.encoder:
            x = block(x, context[0])
        return x, torch.ones_like(x)

    def decode(self, latent: Tensor, context: tuple[Tensor, ...]) -> Tensor:
        x = latent
        for block in self.decoder:
            x = block(x, context[1])
        return x * self.descriptor_deviation + self.descriptor_mean
