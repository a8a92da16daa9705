"""Training of shape descriptors (Wang 2019, section 3.3).

In: garment frames in the canonical frame [m]. Out: a trained ``ShapeDescriptor``.

The ``residual-pca`` variant trains on principal coefficients. They are found once and can serve several descriptors:
the curve of the error against the length of the code (Fig. 7) and the comparison without the Laplacian term (Fig. 6).

Dimensions: N frames, V garment vertices, F faces, K components.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from geometry.topology import MeshTopology
from models.pca import Pca, fit_pca
from models.shape_descriptor import (
    KIND,
    PaperDescriptor,
    ResidualPcaDescriptor,
    ShapeDescriptor,
    ShapeDescriptorConfig,
    descriptor_loss,
    reconstruction_terms,
)
from models.training import Progress, TrainingSettings, array_digest, prepare, shuffled_batches, train

_BLOCK = 4096
_TINY = 1e-12
_MOST_FRAMES = 12_000
"""Frames, spread evenly over all, that principal components are found from: neighbouring frames are alike. A quarter of
44,000 costs a quarter of the time, and leaves 0.5 to 1.3% more outside of 200 to 512 components."""


@dataclass(frozen=True)
class PrincipalFrames:
    """Frames as principal coefficients, and what the loss on vertices needs beside them.

    Attributes:
        pca: Mean, components and deviations.
        coefficients: Of each frame [m], shape [N, K].
        rest: Squared length [m^2] of what lies outside of the components, shape [N].
        laplacian_factor: R with ``|c R| = |Lap B^T c|`` for coefficients c of the components B, shape [K, K].
        digest: Of the frames and faces.
    """

    pca: Pca
    coefficients: Tensor
    rest: Tensor
    laplacian_factor: Tensor
    digest: str

    @classmethod
    def of(cls, vertices: np.ndarray, faces: np.ndarray, components: int, seed: int) -> PrincipalFrames:
        """Of frames [N, V, 3] [m]; fewer components where the frames have fewer."""
        flat = _checked(vertices)
        chosen = flat[:: -(-len(flat) // _MOST_FRAMES)]
        pca = fit_pca(chosen, min(components, len(chosen) - 1, flat.shape[1]), seed)
        basis, mean = torch.from_numpy(pca.components), torch.from_numpy(pca.mean)
        coefficients, rest = [], []
        for start in range(0, len(flat), _BLOCK):
            centred = torch.from_numpy(flat[start : start + _BLOCK]) - mean
            coefficients.append(centred @ basis.T)
            # Vertex term: |V - V'|^2 = |c - c'|^2 + rest, for the components are orthonormal.
            rest.append((centred.square().sum(1) - coefficients[-1].square().sum(1)).clamp(min=0.0))
        laplacian = MeshTopology.from_faces(faces, vertices.shape[1]).uniform_laplacian()
        fields = pca.components.reshape(len(basis), vertices.shape[1], 3).transpose(1, 2, 0)
        bent = (laplacian @ fields.reshape(len(fields), -1)).reshape(3 * len(fields), len(basis))
        factor = np.linalg.qr(bent, mode="r").T.astype(np.float32)
        digest = array_digest(flat, np.asarray(faces))
        return cls(
            pca, torch.cat(coefficients), torch.cat(rest), torch.from_numpy(np.ascontiguousarray(factor)), digest
        )

    def first(self, components: int) -> PrincipalFrames:
        """The same frames in the first components alone; all where there are no more."""
        pca, dropped = self.pca, self.coefficients[:, components:]
        return replace(
            self,
            pca=replace(pca, components=pca.components[:components], deviations=pca.deviations[:components]),
            coefficients=self.coefficients[:, :components].contiguous(),
            rest=self.rest + dropped.square().sum(1),
            laplacian_factor=self.laplacian_factor[:components].contiguous(),
        )


def fit_shape_descriptor(
    vertices: np.ndarray,
    faces: np.ndarray,
    config: ShapeDescriptorConfig,
    settings: TrainingSettings,
    work_dir: Path | str,
    validation: np.ndarray | None = None,
    progress: Progress | None = None,
    frames: PrincipalFrames | None = None,
) -> ShapeDescriptor:
    """Train a descriptor on ``vertices [N, V, 3]`` float32 [m] in the canonical frame; it is left in eval mode.

    ``validation [M, V, 3]`` is measured after the epochs that the settings name. ``frames`` are the same vertices as
    principal coefficients, where several descriptors share them. Raises ``ValueError`` on bad shapes.
    """
    flat = _checked(vertices)
    count = vertices.shape[1]
    device = prepare(settings)
    if config.variant == "paper":
        module = PaperDescriptor(config, faces, count)
        module.mean.copy_(torch.from_numpy(flat.mean(axis=0)))
        module.scale.fill_(max(float(np.sqrt(np.mean(flat.var(axis=0)))), 1e-6))
        epoch_batches, loss = _paper_training(module, flat, device)
        digest = array_digest(flat, np.asarray(faces))
    else:
        frames = frames or PrincipalFrames.of(vertices, faces, config.components, settings.seed)
        module = ResidualPcaDescriptor(config, faces, count, len(frames.pca.deviations))
        set_components(module, frames.pca)
        epoch_batches, loss = _coefficient_training(module, frames, device)
        digest = frames.digest

    def validate() -> dict[str, float]:
        return reconstruction_terms(module, validation)

    identity = f"{KIND} {asdict(config)} {digest}"
    check = None if validation is None else validate
    train(module, epoch_batches, loss, settings, work_dir, check, progress, identity)
    return module


def set_components(module: ResidualPcaDescriptor, pca: Pca) -> None:
    """Put fitted components into the buffers; deviations get a floor, so that noise is not blown up by whitening."""
    module.mean.copy_(torch.from_numpy(pca.mean))
    module.components.copy_(torch.from_numpy(pca.components))
    floor = max(1e-4 * float(pca.deviations[0]), 1e-9)
    module.deviations.copy_(torch.from_numpy(np.maximum(pca.deviations, floor)))


def _checked(vertices: np.ndarray) -> np.ndarray:
    """Frames as rows of coordinates [N, 3V]."""
    if vertices.ndim != 3 or vertices.shape[2] != 3 or len(vertices) < 2:
        raise ValueError(f"garment frames: expected shape [N >= 2, V, 3], got {list(vertices.shape)}")
    return np.ascontiguousarray(vertices, dtype=np.float32).reshape(len(vertices), -1)


def _paper_training(module: PaperDescriptor, flat: np.ndarray, device: torch.device):
    data = torch.from_numpy(flat).unflatten(1, (-1, 3)).to(device)

    def epoch_batches(epoch: int, generator: np.random.Generator) -> Iterator[Tensor]:
        for index in shuffled_batches(len(data), module.config.batch, generator):
            yield data[torch.from_numpy(index).to(device)]

    return epoch_batches, lambda batch: descriptor_loss(module, module(batch), batch)


def _coefficient_training(module: ResidualPcaDescriptor, frames: PrincipalFrames, device: torch.device):
    """Batches and loss on principal coefficients: the loss on vertices, at no cost a vertex."""
    coefficients, rest = frames.coefficients.to(device), frames.rest.to(device)
    factor = frames.laplacian_factor.to(device)
    count = module.vertex_count
    alpha = module.config.laplacian_weight

    def epoch_batches(epoch: int, generator: np.random.Generator) -> Iterator[tuple[Tensor, Tensor]]:
        for index in shuffled_batches(len(coefficients), module.config.batch, generator):
            chosen = torch.from_numpy(index).to(device)
            yield coefficients[chosen], rest[chosen]

    def loss(batch: tuple[Tensor, Tensor]) -> dict[str, Tensor]:
        target, outside = batch
        difference = module.coefficients_of(module.code_of(target)) - target
        vertex = ((difference.square().sum(1) + outside) / count + _TINY).sqrt()
        laplacian = ((difference @ factor).square().sum(1) / count + _TINY).sqrt()
        total = vertex + alpha * laplacian
        return {"total": total.mean(), "vertex_rmse_m": vertex.mean(), "laplacian_rmse_m": laplacian.mean()}

    return epoch_batches, loss
