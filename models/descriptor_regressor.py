"""Garment regressor in the space of Wang's shape descriptor (variant ``descriptor-space``).

In: scaled motion features. Out: descriptors S, which the frozen decoder ``N_D`` of Wang 2019 (section 3.3) turns into
vertices. Features, window and network are those of the variant ``window``: the two differ in the space alone that they
predict in, so their rows tell what the learned 50 numbers gain or lose against principal coefficients.

Dimensions: B frames of a batch, V garment vertices, C descriptor.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np
import torch
from torch import Tensor, nn

from models.checkpoint import load_model, save_model
from models.frame_fitting import CodedExamples, error_terms, fit_frames
from models.garment_fitting import GarmentExample, RegressorTraining
from models.garment_regressor import Regressor, RegressorConfig
from models.motion_features import MotionTrack, track_features
from models.shape_descriptor import (
    PaperDescriptor,
    ResidualPcaDescriptor,
    ShapeDescriptor,
    ShapeDescriptorConfig,
)
from models.training import Progress, prepare

KIND = "descriptor_regressor"


class DescriptorCode(nn.Module):
    """A frozen shape descriptor where a regressor has its ``ShapeCode``: codes are standardised descriptors.

    Buffers: ``mean [C]``; ``scale []``, by which a root mean square of codes is about one of vertices [m]: the
    vertices' own spread.
    """

    def __init__(self, descriptor: ShapeDescriptor) -> None:
        super().__init__()
        self.descriptor = descriptor.eval().requires_grad_(False)
        self.size = descriptor.config.code
        self.register_buffer("mean", torch.zeros(self.size))
        self.register_buffer("unit", torch.ones(()))
        self.register_buffer("scale", torch.ones(()))

    def train(self, mode: bool = True) -> DescriptorCode:
        """The descriptor stays as it is: its batch norms must not learn from predicted shapes."""
        return super().train(False)

    def fit(self, codes: np.ndarray, vertex_spread: float) -> None:
        """Take mean and spread of training descriptors [N, C]; ``vertex_spread`` [m] is that of the shapes."""
        deviation = codes.std(axis=0, dtype=np.float64)
        self.mean.copy_(torch.as_tensor(codes.mean(axis=0, dtype=np.float64)))
        # One unit for all numbers: distances between descriptors are nearly those between shapes.
        self.unit.fill_(max(float(np.sqrt(np.square(deviation).sum())), 1e-9))
        self.scale.fill_(max(vertex_spread, 1e-6))

    def standardised(self, descriptors: Tensor) -> Tensor:
        """Codes [..., C] of descriptors [..., C]."""
        return (descriptors - self.mean) / self.unit

    def encode(self, vertices: Tensor) -> Tensor:
        """Codes [..., C] of canonical vertices [..., V, 3] [m]."""
        flat = self.descriptor.encode(vertices.flatten(0, -3) if vertices.ndim > 3 else vertices)
        return self.standardised(flat).unflatten(0, vertices.shape[:-2])

    def decode(self, code: Tensor) -> Tensor:
        """Canonical vertices [..., V, 3] [m] of codes [..., C]."""
        vertices = self.descriptor.decode((code * self.unit + self.mean).flatten(0, -2))
        return vertices.unflatten(0, code.shape[:-1])

    def errors(self, difference: Tensor) -> tuple[Tensor, Tensor]:
        """Mean squared distance of codes [..., C], which stands for that of vertices, and no Laplacian term."""
        square = difference.square().sum(-1).mean()
        return square, torch.zeros_like(square)


class DescriptorRegressor(Regressor):
    """Fully connected network from a window of past motion to the codes of a shape descriptor."""

    def __init__(self, config: RegressorConfig, descriptor: ShapeDescriptor) -> None:
        if descriptor.vertex_count != config.vertices:
            raise ValueError(
                f"garment regressor: config says {config.vertices} vertices, the descriptor has "
                f"{descriptor.vertex_count}"
            )
        # A shape code of one component is the smallest there is; it is replaced at once.
        super().__init__(replace(config, components=1), descriptor.faces.numpy())
        self.shape = DescriptorCode(descriptor)
        self.network = self.direct_network()

    def unroll(self, features: Tensor, lead: int) -> Tensor:
        """Codes [B, T, C] of scaled features [B, L + T, D]."""
        return self.network(self.windows(features)[:, lead:]).float()


def fit_descriptor_regressor(
    tracks: Sequence[MotionTrack],
    descriptors: np.ndarray,
    descriptor: ShapeDescriptor,
    config: RegressorConfig,
    settings: RegressorTraining,
    work_dir: str | Path,
    validation: Sequence[GarmentExample] = (),
    progress: Progress | None = None,
) -> DescriptorRegressor:
    """Train on motions and the descriptors of their garments; returns the regressor on the CPU in eval mode.

    Args:
        tracks: Motions with their lead-in, N of one length.
        descriptors: Of their frames, shape [N, T, C], made by ``descriptor``.
        descriptor: Trained; it becomes part of the regressor and is not trained further.
        config: Of the variant ``window``, as ``variant_config`` makes it; its ``components`` do not matter.
        settings: Epochs, learning rates, frames a batch.
        work_dir: Folder of this run alone; a killed run continues there.
        validation: Held-out examples whose vertex error [mm] is logged.
        progress: Takes lines of text.
    """
    device = prepare(settings.training)
    regressor = DescriptorRegressor(config, descriptor)
    raw = np.concatenate([track_features(t, config.features) for t in tracks]) if tracks else np.zeros((1, 1))
    flat = descriptors.reshape(-1, descriptors.shape[-1])
    if tracks:
        regressor.set_feature_scaling(raw)
        regressor.shape.fit(flat, _vertex_spread(descriptor, flat))
    regressor.to(device)
    codes = regressor.shape.standardised(torch.as_tensor(descriptors, device=device)).cpu().numpy()

    def validate() -> dict[str, float]:
        dressed = regressor.dress_all([e.track for e in validation])
        return error_terms(regressor, [np.square(d - e.vertices).sum(-1).mean() for d, e in zip(dressed, validation)])

    fit_frames(
        regressor,
        lambda windows, _: regressor.network(windows),
        CodedExamples(tracks, codes, np.zeros((len(tracks), 0), np.float32)),
        settings,
        work_dir,
        validate if validation else None,
        progress,
        f"{KIND} {descriptor.config}",
    )
    return regressor


def save_descriptor_regressor(path: str | os.PathLike, regressor: DescriptorRegressor) -> None:
    """Write a trained regressor, its descriptor with it, to one file."""
    described = regressor.shape.descriptor
    config = {"regressor": asdict(regressor.config), "descriptor": asdict(described.config)}
    save_model(path, KIND, config, regressor)


def load_descriptor_regressor(path: str | os.PathLike) -> DescriptorRegressor:
    """Read a regressor written by ``save_descriptor_regressor``; ``ValueError`` when the file is none."""
    stored = load_model(path, KIND)
    prefix = "shape.descriptor."
    state = {name.removeprefix(prefix): value for name, value in stored.state.items() if name.startswith(prefix)}
    if not {"faces", "mean"} <= set(state) or not {"regressor", "descriptor"} <= set(stored.config):
        raise ValueError(f"{path} is damaged: it lacks its shape descriptor")
    descriptor = _empty_descriptor(ShapeDescriptorConfig(**stored.config["descriptor"]), state)
    regressor = DescriptorRegressor(RegressorConfig(**stored.config["regressor"]), descriptor)
    stored.into(regressor)
    return regressor


def _empty_descriptor(config: ShapeDescriptorConfig, state: Mapping[str, Tensor]) -> ShapeDescriptor:
    """A descriptor of the sizes that a stored state has."""
    faces, count = state["faces"].numpy(), len(state["mean"]) // 3
    if config.variant == "paper":
        return PaperDescriptor(config, faces, count)
    return ResidualPcaDescriptor(config, faces, count, len(state.get("deviations", ())))


@torch.no_grad()
def _vertex_spread(descriptor: ShapeDescriptor, descriptors: np.ndarray, most: int = 512) -> float:
    """Root mean square distance [m] of decoded vertices from their mean, over descriptors spread evenly."""
    rows = np.unique(np.linspace(0, len(descriptors) - 1, min(most, len(descriptors))).astype(int))
    vertices = descriptor.decode(torch.as_tensor(descriptors[rows]))
    return float((vertices - vertices.mean(0)).square().sum(-1).mean().sqrt())
