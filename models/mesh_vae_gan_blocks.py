"""Parts of the conditional Mesh VAE-GAN: condition, encoder, generator and discriminator (Ma 2019, section 3.2).

In: features on the vertices of a level of the mesh [A, N, C], or codes [N, L]. A vertices of the level, N frames, C
channels, L length of z. ``laplacian`` gives the operator of a level; the parts of a network share them.
"""

from __future__ import annotations

import torch
from torch import Tensor, nn

from geometry.mesh_hierarchy import MeshHierarchy
from models.mesh_convolution import SLOPE, ChebyshevConvolution, MeshBlock, SparseOperator
from models.mesh_vae_gan_config import MeshVaeGanConfig

LOG_VARIANCE = (-12.0, 4.0)
QUIET = -5.0
"""Log variance of z before training: there is little noise to fight at first."""


class Condition(nn.Module):
    """Pose and type, each compressed by a small dense network (Ma 2019, "condition module")."""

    def __init__(self, features: int, types: int, config: MeshVaeGanConfig) -> None:
        super().__init__()
        self.pose = nn.Sequential(nn.Linear(features, 64), nn.LeakyReLU(SLOPE), nn.Linear(64, config.pose_code))
        self.kind = nn.Linear(types, config.type_code)

    def forward(self, pose: Tensor, types: Tensor) -> Tensor:
        return torch.cat([self.pose(pose), self.kind(types)], dim=1)


class Encoder(nn.Module):
    """From features [A, N, 3] to mean and log variance of z, [N, L] each."""

    def __init__(self, config: MeshVaeGanConfig, hierarchy: MeshHierarchy, laplacian) -> None:
        super().__init__()
        self.moves, self.blocks = nn.ModuleList(), nn.ModuleList()
        level, width = 0, 3
        for wanted, outputs in zip(config.levels, config.widths, strict=True):
            self.moves.append(_move(hierarchy, level, wanted))
            self.blocks.append(MeshBlock(laplacian(wanted), width, outputs, config.order, config.residual))
            level, width = wanted, outputs
        # A last step down keeps the dense layer small where the blocks stay on fine levels.
        self.inputs = len(hierarchy.levels[level]) * width
        self.dense = nn.Linear(self.inputs, 2 * config.latent)
        _quiet(self.dense, config)

    def forward(self, features: Tensor) -> tuple[Tensor, Tensor]:
        for move, block in zip(self.moves, self.blocks, strict=True):
            features = block(move(features))
        mean, spread = self.dense(flat(features)).chunk(2, dim=1)
        return mean, spread.clamp(*LOG_VARIANCE)


class Generator(nn.Module):
    """From codes, z and condition, [N, L + C], to features [A, N, 3]."""

    def __init__(self, config: MeshVaeGanConfig, hierarchy: MeshHierarchy, laplacian, inputs: int) -> None:
        super().__init__()
        self.count, self.width = len(hierarchy.levels[config.levels[-1]]), config.widths[-1]
        self.dense = nn.Linear(inputs, self.count * self.width)
        self.moves, self.blocks = nn.ModuleList(), nn.ModuleList()
        widths = [*config.widths[::-1][1:], config.widths[0]]
        levels = [*config.levels[::-1][1:], 0]
        width, level = self.width, config.levels[-1]
        for outputs, above in zip(widths, levels, strict=True):
            self.blocks.append(MeshBlock(laplacian(level), width, outputs, config.order, config.residual))
            self.moves.append(_move(hierarchy, level, above))
            width, level = outputs, above
        self.last = ChebyshevConvolution(laplacian(0), width, 3, config.order)
        if config.kind == "anchored":
            nn.init.zeros_(self.last.weight)

    def forward(self, code: Tensor) -> Tensor:
        features = self.dense(code).view(len(code), self.count, self.width).transpose(0, 1).contiguous()
        features = nn.functional.leaky_relu(features, SLOPE)
        for move, block in zip(self.moves, self.blocks, strict=True):
            features = move(block(features))
        return self.last(features)


class Discriminator(nn.Module):
    """Convolution and down-sampling repeated; every vertex of the last level gives a verdict on its patch."""

    def __init__(self, config: MeshVaeGanConfig, hierarchy: MeshHierarchy, laplacian, code: int) -> None:
        super().__init__()
        self.moves, self.layers = nn.ModuleList(), nn.ModuleList()
        level, width = 0, 3
        for wanted, outputs in zip(config.discriminator_levels, config.discriminator_widths, strict=True):
            self.moves.append(_move(hierarchy, level, wanted))
            self.layers.append(ChebyshevConvolution(laplacian(wanted), width, outputs, config.order))
            level, width = wanted, outputs
        # The condition is the same at every vertex: as channels of the input it would only add to the first layer.
        self.condition = nn.Linear(code, config.discriminator_widths[0]) if code else None
        self.last = ChebyshevConvolution(laplacian(level), width, 1, config.order)
        self.whole = nn.Linear(len(hierarchy.levels[level]), 1) if config.discriminator == "global" else None

    def forward(self, features: Tensor, code: Tensor | None) -> Tensor:
        for number, (move, layer) in enumerate(zip(self.moves, self.layers, strict=True)):
            features = layer(move(features))
            if number == 0 and code is not None:
                features = features + self.condition(code)
            features = nn.functional.leaky_relu(features, SLOPE)
        patches = self.last(features)[..., 0]
        return patches if self.whole is None else self.whole(patches.T).T


def _move(hierarchy: MeshHierarchy, start: int, end: int) -> nn.Module:
    return nn.Identity() if start == end else SparseOperator(hierarchy.between(start, end))


def _quiet(dense: nn.Linear, config: MeshVaeGanConfig) -> None:
    """Begin with little noise on z; beside principal components, with no word on its mean."""
    with torch.no_grad():
        dense.weight[config.latent :] = 0.0
        dense.bias[config.latent :] = QUIET
        if config.kind == "anchored":
            dense.weight[: config.latent] = 0.0
            dense.bias[: config.latent] = 0.0


def flat(features: Tensor) -> Tensor:
    """[A, N, C] as [N, A * C]."""
    return features.transpose(0, 1).flatten(1)


def unflat(rows: Tensor, like: Tensor) -> Tensor:
    """[N, A * C] as [A, N, C], with the A of ``like``."""
    return rows.view(len(rows), len(like), -1).transpose(0, 1)
