"""Motion-invariant encoding: what a garment is made of, apart from how its wearer moves (Wang 2019, section 3.4).

In: shape descriptors S, motion signatures M (joint positions of the current and the past frames in the character's
frame) and the number phi of the parameter set that each frame was simulated with. Out: ``z = F_E(S | M)`` and
``S' = F_D(z | M)``, where frames of one phi are meant to share one z.

Dimensions: N frames of a data set, B frames of a batch, C descriptor, D signature, Z latent, W width of the U-blocks,
K sub-networks of a U-block.

    M_D = M_E(M) / sum M_E(M)                      motion encoder, softplus at its end
    U(x) = psi(sum_i M_D[i] L_i(x))                U-block, K linear maps L_i
    loss = Var(z) + lambda ||S - F_D(z | M)||      all frames of a batch share phi

The paper's loss never decodes the z of one frame with the motion of another, although that is what the network is for.
The variant "cross" does so within the same-phi batch. All variants and their loss weights: ``VARIANTS``.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
import torch
from torch import Tensor, nn

from models.checkpoint import load_model, save_model
from models.same_phi import IntrinsicFrames, SamePhiBatches
from models.training import Progress, TrainingSettings, array_digest, prepare, train

KIND = "motion_invariant"
_EVALUATION_BATCH = 1024
_TINY = 1e-12


@dataclass(frozen=True)
class Variant:
    """How a network is built and which terms its loss weighs.

    Attributes:
        network: "u-blocks" (paper), "concatenate" (motion descriptor beside the input of plain layers: the paper's
            comparison in Fig. 11) or "motion-only" (z is zero: the control without any intrinsic information).
        variance: Weight of Var(z).
        own: Weight of the reconstruction with the frame's own motion; the paper's lambda.
        cross: Weight of the reconstruction from the z of another frame of the batch.
    """

    network: str
    variance: float
    own: float
    cross: float


VARIANTS: dict[str, Variant] = {
    "paper": Variant("u-blocks", variance=1.0, own=0.1, cross=0.0),
    "cross": Variant("u-blocks", variance=0.1, own=0.2, cross=1.0),
    "concatenate": Variant("concatenate", variance=1.0, own=0.1, cross=0.0),
    "concatenate-cross": Variant("concatenate", variance=0.1, own=0.2, cross=1.0),
    "motion-only": Variant("motion-only", variance=0.0, own=1.0, cross=0.0),
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
        motion_batch_norm: Batch norm in the motion encoder's blocks, as in the paper.
        batch: Frames of a step, all of one phi.
    """

    variant: str = "paper"
    latent: int = 100
    width: int = 100
    blocks: int = 5
    subnetworks: int = 30
    motion_hidden: tuple[int, ...] = (1200, 600, 120)
    motion_batch_norm: bool = True
    batch: int = 32

    def __post_init__(self) -> None:
        object.__setattr__(self, "motion_hidden", tuple(self.motion_hidden))
        if self.variant not in VARIANTS:
            raise ValueError(f"motion-invariant variant: {self.variant!r} is not one of {', '.join(VARIANTS)}")
        if min(self.latent, self.width, self.blocks, self.subnetworks, *self.motion_hidden) < 1 or self.batch < 4:
            raise ValueError("motion-invariant network: sizes must be at least 1 and batch at least 4")


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
        self.layers = nn.Sequential(*layers, nn.Linear(last, config.subnetworks), nn.Softplus())

    def forward(self, signature: Tensor) -> Tensor:
        positive = self.layers(signature) + 1e-6
        return positive / positive.sum(1, keepdim=True)


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


class MotionInvariantNetwork(nn.Module):
    """Encoder ``F_E(S | M)``, decoder ``F_D(z | M)`` and the motion encoder ``M_E`` that steers both.

    Buffers: mean and deviation of descriptors [C] and of signatures [D]; ``unit []``, the RMS deviation of descriptors,
    in which the loss is measured.
    """

    def __init__(self, config: MotionInvariantConfig, descriptor_size: int, signature_size: int) -> None:
        super().__init__()
        self.config = config
        self.register_buffer("descriptor_mean", torch.zeros(descriptor_size))
        self.register_buffer("descriptor_deviation", torch.ones(descriptor_size))
        self.register_buffer("unit", torch.ones(()))
        self.register_buffer("signature_mean", torch.zeros(signature_size))
        self.register_buffer("signature_deviation", torch.ones(signature_size))
        block = ConcatenationBlock if VARIANTS[config.variant].network == "concatenate" else UBlock
        inner = [config.width] * (config.blocks - 1)
        self.motion_encoder = MotionEncoder(signature_size, config)
        self.encoder = _stack(block, [descriptor_size, *inner, config.latent], config.subnetworks)
        self.decoder = _stack(block, [config.latent, *inner, descriptor_size], config.subnetworks)
        if VARIANTS[config.variant].network == "motion-only":
            self.encoder.requires_grad_(False)

    def blend(self, signature: Tensor) -> Tensor:
        """Motion descriptor M_D [B, K] of ``signature [B, D]`` [m]."""
        if signature.ndim != 2 or signature.shape[1] != len(self.signature_mean):
            raise ValueError(
                f"motion signature: expected shape [B, {len(self.signature_mean)}], got {list(signature.shape)}"
            )
        return self.motion_encoder((signature - self.signature_mean) / self.signature_deviation)

    def encode(self, descriptor: Tensor, blend: Tensor) -> Tensor:
        """Latent z [B, Z] of ``descriptor [B, C]`` under ``blend [B, K]``."""
        if VARIANTS[self.config.variant].network == "motion-only":
            return descriptor.new_zeros(len(descriptor), self.config.latent)
        x = (descriptor - self.descriptor_mean) / self.descriptor_deviation
        for block in self.encoder:
            x = block(x, blend)
        return x

    def decode(self, latent: Tensor, blend: Tensor) -> Tensor:
        """Descriptor [B, C] of ``latent [B, Z]`` under ``blend [B, K]``."""
        x = latent
        for block in self.decoder:
            x = block(x, blend)
        return x * self.descriptor_deviation + self.descriptor_mean

    def forward(self, descriptor: Tensor, signature: Tensor) -> tuple[Tensor, Tensor]:
        """``(z [B, Z], S' [B, C])`` of frames with their own motion."""
        blend = self.blend(signature)
        latent = self.encode(descriptor, blend)
        return latent, self.decode(latent, blend)


def motion_invariant_loss(
    module: MotionInvariantNetwork, descriptor: Tensor, signature: Tensor, partners: Tensor
) -> dict[str, Tensor]:
    """Weighted loss of a same-phi batch, with its terms.

    Var(z) is the mean over the latent's numbers of their variance in the batch; a reconstruction is
    ``||S - S'||`` a frame as RMS over the descriptor's numbers in ``unit``, mean over the batch.
    """
    weights = VARIANTS[module.config.variant]
    blend = module.blend(signature)
    latent = module.encode(descriptor, blend)
    variance = latent.var(dim=0, unbiased=False).mean()
    own = _relative_rms(module, module.decode(latent, blend), descriptor)
    terms = {"variance": variance, "own": own}
    total = weights.variance * variance + weights.own * own
    if weights.cross:
        terms["cross"] = _relative_rms(module, module.decode(latent[partners], blend), descriptor)
        total = total + weights.cross * terms["cross"]
    return {"total": total, **terms}


def fit_motion_invariant(
    frames: IntrinsicFrames,
    config: MotionInvariantConfig,
    settings: TrainingSettings,
    work_dir: Path | str,
    validation: IntrinsicFrames | None = None,
    progress: Progress | None = None,
) -> MotionInvariantNetwork:
    """Train on ``frames``; the network is left in eval mode. Validation is measured with the same loss.

    Raises ``ValueError`` when a phi has a single frame.
    """
    device = prepare(settings)
    module = MotionInvariantNetwork(config, frames.descriptors.shape[1], frames.signatures.shape[1])
    _set_scaling(module, frames)
    descriptors, signatures = (_tensor(a).to(device) for a in (frames.descriptors, frames.signatures))
    sampler = SamePhiBatches(frames.phi, frames.clip, config.batch)

    def epoch_batches(epoch: int, generator: np.random.Generator) -> Iterator[tuple[Tensor, Tensor, Tensor]]:
        for chosen, partners in sampler.epoch(generator):
            index = torch.from_numpy(chosen).to(device)
            yield descriptors[index], signatures[index], torch.from_numpy(partners).to(device)

    def loss(batch: tuple[Tensor, Tensor, Tensor]) -> dict[str, Tensor]:
        return motion_invariant_loss(module, *batch)

    def validate() -> dict[str, float]:
        return _mean_loss(module, validation, config.batch)

    identity = f"{KIND} {asdict(config)} " + array_digest(
        frames.descriptors, frames.signatures, np.asarray(frames.phi), np.asarray(frames.clip)
    )
    check = None if validation is None else validate
    train(module, epoch_batches, loss, settings, work_dir, check, progress, identity)
    return module


@torch.no_grad()
def encode_frames(module: MotionInvariantNetwork, descriptors: np.ndarray, signatures: np.ndarray) -> np.ndarray:
    """z [N, Z] float32 of descriptors [N, C] under signatures [N, D], batch by batch."""
    return _by_blocks(lambda s, m: module.encode(s, module.blend(m)), module, descriptors, signatures)


@torch.no_grad()
def decode_frames(module: MotionInvariantNetwork, latents: np.ndarray, signatures: np.ndarray) -> np.ndarray:
    """Descriptors [N, C] float32 of latents [N, Z] (or one for all, [Z]) under signatures [N, D], batch by batch."""
    if latents.ndim == 1:
        latents = np.broadcast_to(latents, (len(signatures), len(latents)))
    return _by_blocks(lambda z, m: module.decode(z, module.blend(m)), module, latents, signatures)


def save_motion_invariant(path: str | os.PathLike, module: MotionInvariantNetwork) -> None:
    """Write a network to a model file."""
    save_model(path, KIND, asdict(module.config), module)


def load_motion_invariant(path: str | os.PathLike) -> MotionInvariantNetwork:
    """Read a network, on the CPU in eval mode; raises ``ValueError`` when the file is not one."""
    stored = load_model(path, KIND)
    sizes = (len(stored.state[f"{name}_mean"]) for name in ("descriptor", "signature"))
    module = MotionInvariantNetwork(MotionInvariantConfig(**stored.config), *sizes)
    stored.into(module)
    return module


def _set_scaling(module: MotionInvariantNetwork, frames: IntrinsicFrames) -> None:
    """Standardising buffers; numbers that hardly vary (the pelvis in its own frame) are not blown up."""
    deviation = frames.descriptors.std(axis=0)
    unit = max(float(np.sqrt(np.mean(deviation**2))), 1e-9)
    module.unit.fill_(unit)
    module.descriptor_mean.copy_(_tensor(frames.descriptors.mean(axis=0)))
    module.descriptor_deviation.copy_(_tensor(np.maximum(deviation, 1e-3 * unit)))
    module.signature_mean.copy_(_tensor(frames.signatures.mean(axis=0)))
    module.signature_deviation.copy_(_tensor(np.maximum(frames.signatures.std(axis=0), 1e-3)))


@torch.no_grad()
def _mean_loss(module: MotionInvariantNetwork, frames: IntrinsicFrames, batch: int) -> dict[str, float]:
    sums: dict[str, float] = {}
    # Always the same batches, so that epochs compare.
    for chosen, partners in SamePhiBatches(frames.phi, frames.clip, batch).epoch(np.random.default_rng(0)):
        device = module.unit.device
        rows = (_tensor(a[chosen]).to(device) for a in (frames.descriptors, frames.signatures))
        terms = motion_invariant_loss(module, *rows, torch.from_numpy(partners).to(device))
        for name, value in terms.items():
            sums[name] = sums.get(name, 0.0) + float(value) * len(chosen)
    return {name: value / len(frames.descriptors) for name, value in sums.items()}


def _stack(block: type[nn.Module], widths: list[int], subnetworks: int) -> nn.ModuleList:
    last = len(widths) - 2
    return nn.ModuleList(block(a, b, subnetworks, last=i == last) for i, (a, b) in enumerate(pairwise(widths)))


def _relative_rms(module: MotionInvariantNetwork, predicted: Tensor, target: Tensor) -> Tensor:
    return (((predicted - target) / module.unit).square().mean(1) + _TINY).sqrt().mean()


def _by_blocks(function, module: MotionInvariantNetwork, *arrays: np.ndarray) -> np.ndarray:
    device, count = module.unit.device, len(arrays[0])
    blocks = []
    for start in range(0, count, _EVALUATION_BATCH):
        blocks.append(function(*(_tensor(a[start : start + _EVALUATION_BATCH]).to(device) for a in arrays)).cpu())
    return torch.cat(blocks).numpy()


def _tensor(array: np.ndarray) -> Tensor:
    return torch.from_numpy(np.array(array, dtype=np.float32))
