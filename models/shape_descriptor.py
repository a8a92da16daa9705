"""Shape descriptor: garment vertices to a short code and back (Wang 2019, section 3.3).

In: garment vertices in the canonical frame of their own frame (pelvis frame). Out: ``S = N_E(V)`` and ``V' = N_D(S)``.

Dimensions: B frames of a batch, N frames of a data set, V garment vertices, F faces, C code length, K components.

Two variants behind one API:

- ``paper``: linear blocks 3V-5000-2000-600-200-C (linear, PReLU, batch norm), ReLU6 on the code, symmetric decoder.
- ``residual-pca`` (ours): C principal coefficients, corrected on the way in and out by two small networks that see and
  correct K principal coefficients. It starts as the PCA of the same dimension and trains in coefficient space, where a
  step costs nothing per vertex: components are orthonormal, so the vertex error is the coefficient error.
"""

from __future__ import annotations

import os
from abc import ABC, abstractmethod
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np
import torch
from torch import Tensor, nn

from geometry.topology import MeshTopology
from models.checkpoint import load_model, save_model
from models.pca import Pca, fit_pca
from models.training import Progress, TrainingSettings, array_digest, prepare, shuffled_batches, train

KIND = "shape_descriptor"
VARIANTS = ("paper", "residual-pca")
_EVALUATION_BATCH = 256
_TINY = 1e-12


@dataclass(frozen=True)
class ShapeDescriptorConfig:
    """Sizes and loss of a shape descriptor; the defaults are the paper's.

    Attributes:
        variant: "paper" or "residual-pca".
        code: Length C of the descriptor.
        hidden: Widths of the encoder's blocks before the code; the decoder has them in reverse.
        laplacian_weight: alpha of the loss (the paper gives no number).
        batch: Frames of a step.
        components: K, for "residual-pca" only; fewer where the data have fewer.
    """

    variant: str = "paper"
    code: int = 50
    hidden: tuple[int, ...] = (5000, 2000, 600, 200)
    laplacian_weight: float = 1.0
    batch: int = 64
    components: int = 256

    def __post_init__(self) -> None:
        object.__setattr__(self, "hidden", tuple(self.hidden))
        if self.variant not in VARIANTS:
            raise ValueError(f"shape descriptor variant: {self.variant!r} is not one of {', '.join(VARIANTS)}")
        if self.code < 1 or self.batch < 2 or not self.hidden or min(self.hidden) < 1:
            raise ValueError("shape descriptor: code and hidden widths must be at least 1 and batch at least 2")
        if self.laplacian_weight < 0:
            raise ValueError(f"shape descriptor laplacian_weight: must not be negative, got {self.laplacian_weight}")


class ShapeDescriptor(nn.Module, ABC):
    """What both variants share: the faces, the Laplacian of the loss and the calls.

    Buffers: ``faces [F, 3]``, ``mean [3V]`` [m], and the Laplacian [V, V], which is made from the faces.
    """

    def __init__(self, config: ShapeDescriptorConfig, faces: np.ndarray, vertex_count: int) -> None:
        super().__init__()
        self.config = config
        self.vertex_count = vertex_count
        matrix = MeshTopology.from_faces(faces, vertex_count).uniform_laplacian().tocoo()
        index = torch.from_numpy(np.stack([matrix.row, matrix.col]).astype(np.int64))
        value = torch.from_numpy(matrix.data.astype(np.float32))
        laplacian = torch.sparse_coo_tensor(index, value, (vertex_count, vertex_count), check_invariants=True)
        self.register_buffer("laplacian", laplacian, persistent=False)
        self.register_buffer("faces", torch.from_numpy(np.asarray(faces, dtype=np.int64).copy()))
        self.register_buffer("mean", torch.zeros(3 * vertex_count))

    def encode(self, vertices: Tensor) -> Tensor:
        """Descriptor S [B, C] of ``vertices [B, V, 3]`` [m] in the canonical frame."""
        if vertices.ndim != 3 or vertices.shape[1:] != (self.vertex_count, 3):
            raise ValueError(f"garment: expected shape [B, {self.vertex_count}, 3], got {list(vertices.shape)}")
        return self.encode_flat(vertices.flatten(1) - self.mean)

    def decode(self, code: Tensor) -> Tensor:
        """Vertices [B, V, 3] [m] in the canonical frame of ``code [B, C]``."""
        if code.ndim != 2 or code.shape[1] != self.config.code:
            raise ValueError(f"descriptor: expected shape [B, {self.config.code}], got {list(code.shape)}")
        return (self.decode_flat(code) + self.mean).unflatten(1, (self.vertex_count, 3))

    def forward(self, vertices: Tensor) -> Tensor:
        """Reconstruction ``N_D(N_E(V))`` [B, V, 3]."""
        return self.decode(self.encode(vertices))

    @abstractmethod
    def encode_flat(self, centred: Tensor) -> Tensor:
        """Descriptor [B, C] of centred coordinates [B, 3V]."""

    @abstractmethod
    def decode_flat(self, code: Tensor) -> Tensor:
        """Centred coordinates [B, 3V] of a descriptor [B, C]."""


class PaperDescriptor(ShapeDescriptor):
    """The autoencoder of the paper; ``scale`` [m] brings its input to about unit size."""

    def __init__(self, config: ShapeDescriptorConfig, faces: np.ndarray, vertex_count: int) -> None:
        super().__init__(config, faces, vertex_count)
        self.register_buffer("scale", torch.ones(()))
        widths = [3 * vertex_count, *config.hidden, config.code]
        self.encoder = nn.Sequential(*_linear_blocks(widths), nn.ReLU6())
        # ReLU6 keeps 0..6; starting in its middle leaves no code number dead from the start.
        nn.init.constant_(self.encoder[-2].bias, 3.0)
        back = widths[::-1]
        self.decoder = nn.Sequential(*_linear_blocks(back[:-1]), nn.Linear(back[-2], back[-1]))

    def encode_flat(self, centred: Tensor) -> Tensor:
        return self.encoder(centred / self.scale)

    def decode_flat(self, code: Tensor) -> Tensor:
        return self.decoder(code) * self.scale


class ResidualPcaDescriptor(ShapeDescriptor):
    """Principal coefficients with learned corrections; at the start exactly the PCA of dimension C.

    Buffers: ``components [K, 3V]``, ``deviations [K]`` [m]. The descriptor is in units of the first deviation and not
    whitened, so that a distance between descriptors is nearly a distance between shapes.
    """

    def __init__(self, config: ShapeDescriptorConfig, faces: np.ndarray, vertex_count: int, components: int) -> None:
        super().__init__(config, faces, vertex_count)
        if components < config.code:
            raise ValueError(
                f"shape descriptor: code {config.code} is longer than the {components} components there are"
            )
        self.register_buffer("components", torch.zeros(components, 3 * vertex_count))
        self.register_buffer("deviations", torch.ones(components))
        self.encoder = _residual_network([components, *config.hidden, config.code])
        self.decoder = _residual_network([config.code, *config.hidden[::-1], components])

    def encode_flat(self, centred: Tensor) -> Tensor:
        return self.code_of(centred @ self.components.T)

    def decode_flat(self, code: Tensor) -> Tensor:
        return self.coefficients_of(code) @ self.components

    def code_of(self, coefficients: Tensor) -> Tensor:
        """Descriptor [B, C] of principal coefficients [B, K] [m]."""
        whitened = coefficients / self.deviations
        kept = whitened[:, : self.config.code] + self.encoder(whitened)
        return kept * (self.deviations[: self.config.code] / self.deviations[0])

    def coefficients_of(self, code: Tensor) -> Tensor:
        """Principal coefficients [B, K] [m] of a descriptor [B, C]."""
        count = self.config.code
        whitened = code / (self.deviations[:count] / self.deviations[0])
        correction = self.decoder(whitened)
        first = whitened + correction[:, :count]
        return torch.cat([first, correction[:, count:]], dim=1) * self.deviations


def descriptor_loss(module: ShapeDescriptor, predicted: Tensor, target: Tensor) -> dict[str, Tensor]:
    """``||V - V'||_2 + alpha ||Lap V - Lap V'||_2`` of ``[B, V, 3]``, the norms as RMS over vertices [m].

    The norms are not squared, as in the paper; the RMS makes alpha independent of the vertex count.
    """
    difference = predicted - target
    vertex = _rms(difference)
    columns = difference.transpose(0, 1).flatten(1)
    bent = torch.sparse.mm(module.laplacian, columns).unflatten(1, (len(difference), 3)).transpose(0, 1)
    laplacian = _rms(bent)
    total = vertex + module.config.laplacian_weight * laplacian
    return {"total": total.mean(), "vertex_rmse_m": vertex.mean(), "laplacian_rmse_m": laplacian.mean()}


def fit_shape_descriptor(
    vertices: np.ndarray,
    faces: np.ndarray,
    config: ShapeDescriptorConfig,
    settings: TrainingSettings,
    work_dir: Path | str,
    validation: np.ndarray | None = None,
    progress: Progress | None = None,
) -> ShapeDescriptor:
    """Train a descriptor on ``vertices [N, V, 3]`` float32 [m] in the canonical frame; it is left in eval mode.

    ``validation [M, V, 3]`` is measured after the epochs that the settings name. Raises ``ValueError`` on bad shapes.
    """
    if vertices.ndim != 3 or vertices.shape[2] != 3 or len(vertices) < 2:
        raise ValueError(f"garment frames: expected shape [N >= 2, V, 3], got {list(vertices.shape)}")
    count = vertices.shape[1]
    flat = np.ascontiguousarray(vertices, dtype=np.float32).reshape(len(vertices), 3 * count)
    device = prepare(settings)
    if config.variant == "paper":
        module = PaperDescriptor(config, faces, count)
        module.mean.copy_(torch.from_numpy(flat.mean(axis=0)))
        module.scale.fill_(max(float(np.sqrt(np.mean(flat.var(axis=0)))), 1e-6))
        epoch_batches, loss = _paper_training(module, flat, device)
    else:
        most = min(len(flat) - 1, flat.shape[1])
        pca = fit_pca(flat, min(config.components, most), settings.seed)
        module = ResidualPcaDescriptor(config, faces, count, len(pca.deviations))
        set_components(module, pca)
        epoch_batches, loss = _coefficient_training(module, flat, device)

    def validate() -> dict[str, float]:
        return reconstruction_terms(module, validation)

    identity = f"{KIND} {asdict(config)} {array_digest(flat, np.asarray(faces))}"
    check = None if validation is None else validate
    train(module, epoch_batches, loss, settings, work_dir, check, progress, identity)
    return module


def set_components(module: ResidualPcaDescriptor, pca: Pca) -> None:
    """Put fitted components into the buffers; deviations get a floor, so that noise is not blown up by whitening."""
    module.mean.copy_(torch.from_numpy(pca.mean))
    module.components.copy_(torch.from_numpy(pca.components))
    floor = max(1e-4 * float(pca.deviations[0]), 1e-9)
    module.deviations.copy_(torch.from_numpy(np.maximum(pca.deviations, floor)))


def _paper_training(module: PaperDescriptor, flat: np.ndarray, device: torch.device):
    data = torch.from_numpy(flat).unflatten(1, (-1, 3)).to(device)

    def epoch_batches(epoch: int, generator: np.random.Generator) -> Iterator[Tensor]:
        for index in shuffled_batches(len(data), module.config.batch, generator):
            yield data[torch.from_numpy(index).to(device)]

    return epoch_batches, lambda batch: descriptor_loss(module, module(batch), batch)


def _coefficient_training(module: ResidualPcaDescriptor, flat: np.ndarray, device: torch.device):
    """Batches and loss on principal coefficients.

    Vertex term: ``|V - V'|^2 = |c - c'|^2 + rest``, where the rest of a frame lies outside of the components. Laplacian
    term: ``|Lap B^T (c - c')|`` inside of the components, by the Cholesky-like factor of ``B Lap^T Lap B^T``.
    """
    basis = module.components
    columns = basis.unflatten(1, (-1, 3)).transpose(0, 1).flatten(1)
    bent = torch.sparse.mm(module.laplacian, columns).unflatten(1, (len(basis), 3)).transpose(0, 1).flatten(1).double()
    values, vectors = torch.linalg.eigh(bent @ bent.T)
    factor = (vectors * values.clamp(min=0.0).sqrt()).float().to(device)
    centred = [torch.from_numpy(flat[i : i + 4096]) - module.mean for i in range(0, len(flat), 4096)]
    coefficients = torch.cat([block @ basis.T for block in centred])
    energy = torch.cat([block.square().sum(1) for block in centred])
    del centred
    rest = (energy - coefficients.square().sum(1)).clamp(min=0.0).to(device)
    coefficients = coefficients.to(device)
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


@torch.no_grad()
def reconstruction_terms(module: ShapeDescriptor, vertices: np.ndarray) -> dict[str, float]:
    """Loss terms of ``vertices [N, V, 3]`` [m], mean over the frames."""
    sums: dict[str, float] = {}
    for start in range(0, len(vertices), _EVALUATION_BATCH):
        block = _on_device(module, vertices[start : start + _EVALUATION_BATCH])
        for name, value in descriptor_loss(module, module(block), block).items():
            sums[name] = sums.get(name, 0.0) + float(value) * len(block)
    return {name: value / len(vertices) for name, value in sums.items()}


@torch.no_grad()
def encode_all(module: ShapeDescriptor, vertices: np.ndarray) -> np.ndarray:
    """Descriptors [N, C] float32 of ``vertices [N, V, 3]`` [m], batch by batch."""
    starts = range(0, len(vertices), _EVALUATION_BATCH)
    blocks = [module.encode(_on_device(module, vertices[i : i + _EVALUATION_BATCH])).cpu() for i in starts]
    return torch.cat(blocks).numpy() if blocks else np.zeros((0, module.config.code), np.float32)


@torch.no_grad()
def decode_all(module: ShapeDescriptor, codes: np.ndarray) -> np.ndarray:
    """Vertices [N, V, 3] float32 [m] of ``codes [N, C]``, batch by batch."""
    starts = range(0, len(codes), _EVALUATION_BATCH)
    blocks = [module.decode(_on_device(module, codes[i : i + _EVALUATION_BATCH])).cpu() for i in starts]
    return torch.cat(blocks).numpy() if blocks else np.zeros((0, module.vertex_count, 3), np.float32)


def save_shape_descriptor(path: str | os.PathLike, module: ShapeDescriptor) -> None:
    """Write a descriptor to a model file."""
    save_model(path, KIND, asdict(module.config), module)


def load_shape_descriptor(path: str | os.PathLike) -> ShapeDescriptor:
    """Read a descriptor, on the CPU in eval mode; raises ``ValueError`` when the file is not one."""
    stored = load_model(path, KIND)
    config = ShapeDescriptorConfig(**stored.config)
    faces, mean = stored.state["faces"].numpy(), stored.state["mean"]
    if config.variant == "paper":
        module: ShapeDescriptor = PaperDescriptor(config, faces, len(mean) // 3)
    else:
        module = ResidualPcaDescriptor(config, faces, len(mean) // 3, len(stored.state["deviations"]))
    stored.into(module)
    return module


def _linear_blocks(widths: list[int]) -> list[nn.Module]:
    """Linear, PReLU, batch norm for each pair of widths (Wang 2019, section 3.6)."""
    layers: list[nn.Module] = []
    for before, after in pairwise(widths):
        layers += [nn.Linear(before, after), nn.PReLU(), nn.BatchNorm1d(after)]
    return layers


def _residual_network(widths: list[int]) -> nn.Sequential:
    """Plain layers whose output is zero at the start, so that the whole starts as what it corrects."""
    layers: list[nn.Module] = []
    for before, after in pairwise(widths[:-1]):
        layers += [nn.Linear(before, after), nn.PReLU()]
    last = nn.Linear(widths[-2], widths[-1])
    nn.init.zeros_(last.weight)
    nn.init.zeros_(last.bias)
    return nn.Sequential(*layers, last)


def _rms(difference: Tensor) -> Tensor:
    """Root of the mean squared length over the vertices, [B] for [B, V, 3]; finite slope at zero."""
    return (difference.square().sum(-1).mean(-1) + _TINY).sqrt()


def _on_device(module: ShapeDescriptor, array: np.ndarray) -> Tensor:
    return torch.from_numpy(np.ascontiguousarray(array, dtype=np.float32)).to(module.mean.device)
