"""Shape descriptor: garment vertices to a short code and back (Wang 2019, section 3.3).

In: garment vertices in the canonical frame of their own frame (pelvis frame). Out: ``S = N_E(V)`` and ``V' = N_D(S)``.
One architecture for any garment and resolution: only its outermost layers know V, and a file of one garment is refused
for another. Training: ``models/descriptor_fitting.py``.

Dimensions: B frames of a batch, N frames of a data set, V garment vertices, F faces, C code length, K components.

Two variants behind one API:

- ``paper``: linear blocks 3V-5000-2000-600-200-C (linear, PReLU, batch norm), ReLU6 on the code, symmetric decoder.
- ``residual-pca`` (ours): C principal coefficients, corrected on the way in and out by two small networks that see and
  correct K principal coefficients. It starts as the PCA of the same dimension and trains in coefficient space, where a
  step costs nothing per vertex: components are orthonormal, so the vertex error is the coefficient error. A code is
  the encoder's guess after two steps down the decoder's error.
"""

from __future__ import annotations

import os
from abc import ABC, abstractmethod
from dataclasses import asdict, dataclass
from itertools import pairwise

import numpy as np
import torch
from torch import Tensor, nn

from geometry.topology import MeshTopology
from models.checkpoint import load_model, save_model

KIND = "shape_descriptor"
VARIANTS = ("paper", "residual-pca")
_EVALUATION_BATCH = 256
_TINY = 1e-12
_REACH = 6.0
"""Standard deviations at which the networks' inputs end: what no training frame held must not drive them anywhere."""
_STEPS, _STEP = 2, 0.5
"""Steps of the encoding down the error, and their length: the decoder is nearly the identity, 1 would be Newton's."""


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
    whitened, so that a distance between descriptors is nearly a distance between shapes. The networks see coefficients
    that are half whitened, each over the root of its deviation: whitened ones hide which of them matter, and unwhitened
    ones drown the small ones, which are most of them.
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
        """The encoder's guess, brought nearer to the frame by a few steps down the error of the decoder.

        On frames unlike those of the training the guess is what generalizes worst: two steps take 2 to 3% off the
        error, more take no more. A step that does not lower a frame's error is not taken.
        """
        target = centred @ self.components.T
        best = self.code_of(target).detach()
        least = torch.full_like(best[:, 0], torch.inf)
        code = best
        unit = self.deviations[0]
        with torch.enable_grad():
            for step in range(_STEPS + 1):
                code = code.detach().requires_grad_()
                errors = (self.coefficients_of(code) - target).square().sum(1)
                better = errors.detach() < least
                best = torch.where(better[:, None], code.detach(), best)
                least = torch.where(better, errors.detach(), least)
                if step < _STEPS:
                    (slope,) = torch.autograd.grad(0.5 * errors.sum(), code)
                    code = code - _STEP * slope / unit**2
        return best

    def decode_flat(self, code: Tensor) -> Tensor:
        return self.coefficients_of(code) @ self.components

    def code_of(self, coefficients: Tensor) -> Tensor:
        """First guess of the descriptor [B, C] of principal coefficients [B, K] [m]; the loss trains this one."""
        count, limit = self.config.code, _REACH * self.deviations
        scale = self._scale()
        correction = self.encoder(torch.minimum(torch.maximum(coefficients, -limit), limit) / scale)
        return (coefficients[:, :count] + correction * scale[:count]) / self.deviations[0]

    def coefficients_of(self, code: Tensor) -> Tensor:
        """Principal coefficients [B, K] [m] of a descriptor [B, C]."""
        count, scale = self.config.code, self._scale()
        first = code * self.deviations[0]
        correction = self.decoder(first / scale[:count]) * scale
        return torch.cat([first + correction[:, :count], correction[:, count:]], dim=1)

    def _scale(self) -> Tensor:
        return (self.deviations * self.deviations[0]).sqrt()


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


@torch.no_grad()
def reconstruction_terms(module: ShapeDescriptor, vertices: np.ndarray) -> dict[str, float]:
    """Loss terms of ``vertices [N, V, 3]`` [m], mean over the frames."""
    sums: dict[str, float] = {}
    for start in range(0, len(vertices), _EVALUATION_BATCH):
        block = on_device(module, vertices[start : start + _EVALUATION_BATCH])
        for name, value in descriptor_loss(module, module(block), block).items():
            sums[name] = sums.get(name, 0.0) + float(value) * len(block)
    return {name: value / len(vertices) for name, value in sums.items()}


@torch.no_grad()
def encode_all(module: ShapeDescriptor, vertices: np.ndarray) -> np.ndarray:
    """Descriptors [N, C] float32 of ``vertices [N, V, 3]`` [m], batch by batch."""
    starts = range(0, len(vertices), _EVALUATION_BATCH)
    blocks = [module.encode(on_device(module, vertices[i : i + _EVALUATION_BATCH])).cpu() for i in starts]
    return torch.cat(blocks).numpy() if blocks else np.zeros((0, module.config.code), np.float32)


@torch.no_grad()
def decode_all(module: ShapeDescriptor, codes: np.ndarray) -> np.ndarray:
    """Vertices [N, V, 3] float32 [m] of ``codes [N, C]``, batch by batch."""
    starts = range(0, len(codes), _EVALUATION_BATCH)
    blocks = [module.decode(on_device(module, codes[i : i + _EVALUATION_BATCH])).cpu() for i in starts]
    return torch.cat(blocks).numpy() if blocks else np.zeros((0, module.vertex_count, 3), np.float32)


def save_shape_descriptor(path: str | os.PathLike, module: ShapeDescriptor) -> None:
    """Write a descriptor to a model file."""
    save_model(path, KIND, asdict(module.config), module)


def load_shape_descriptor(path: str | os.PathLike, faces: np.ndarray | None = None) -> ShapeDescriptor:
    """Read a descriptor, on the CPU in eval mode.

    Raises ``ValueError`` when the file is not one, or is of a garment of another topology than ``faces [F, 3]``.
    """
    stored = load_model(path, KIND)
    config = ShapeDescriptorConfig(**stored.config)
    own, mean = stored.state["faces"].numpy(), stored.state["mean"]
    count = len(mean) // 3
    if faces is not None and not np.array_equal(own, faces):
        other = f"{int(np.max(faces)) + 1} vertices and {len(faces)} triangles"
        raise ValueError(
            f"{path} describes a garment of {count} vertices and {len(own)} triangles, not this one of {other}"
            f"{', connected otherwise' if own.shape == np.shape(faces) else ''}: train a descriptor for it"
        )
    if config.variant == "paper":
        module: ShapeDescriptor = PaperDescriptor(config, own, count)
    else:
        module = ResidualPcaDescriptor(config, own, count, len(stored.state["deviations"]))
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


def on_device(module: ShapeDescriptor, array: np.ndarray) -> Tensor:
    """An array as float32 where the module is."""
    return torch.from_numpy(np.ascontiguousarray(array, dtype=np.float32)).to(module.mean.device)
