"""What GSNet is compared with (Peng 2023, Tables 1 and 2), compact and after their papers' ideas, not their code.

In: garment graphs, materials and motions. Out: canonical garment vertices [m]. All skin a template that is deformed by
the pose; none of them knows the frame before:

- ``Skinning``: the template's own weights, no deformation, nothing to learn.
- ``DeepPSD``: DeePSD (Bertiche 2021b): a graph network gives each vertex its skinning weights and a matrix that turns a
  code of the pose into its deformation; any topology, seen or unseen.
- ``PhysicsPSD``: PBNS (Bertiche 2021a): for each garment of its own a matrix of deformations, taught by energies alone.
- ``FrequencySplit``: TailorNet (Patel 2020): for each garment of its own smooth deformations, and a mixture of detailed
  ones that prototypes of the pose choose between.

The latter two know the garments that they were made for, by name, and no others.

Dimensions: B sequences, T wanted frames, N garment vertices, Q numbers of a pose's code, P material parameters.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping
from collections.abc import Sequence as Many
from dataclasses import dataclass

import torch
from torch import Tensor, nn

from models.garment_animator import Animator, Motion, Rehearsal, Worn, skinned
from models.garment_encoder import GarmentEncoder, fully_connected
from models.garment_graph import JOINTS, PLACE, GarmentGraph, propagate
from models.gsnet_losses import data_loss

DEFORMATION = 0.1
"""Deformation for an output of 1 [m]."""

SMOOTHING = 20
"""Smoothing steps between a garment and its low frequencies."""


@dataclass(frozen=True)
class BaselineConfig:
    """Sizes.

    Attributes:
        materials: Names of the intrinsic parameters that are among the vertex features.
        body: Digest of the body that all templates sit on.
        garments: Vertices of each garment by name, of networks of single garments.
        width: Of the graph convolutions.
        hidden: Widths of the network that makes the pose's code.
        code: Its length Q.
        prototypes: Of the pose, that ``FrequencySplit`` mixes.
    """

    materials: tuple[str, ...]
    body: str
    garments: Mapping[str, int] = ()
    width: int = 64
    hidden: tuple[int, ...] = (256, 256)
    code: int = 64
    prototypes: int = 4

    def __post_init__(self) -> None:
        for name in ("materials", "hidden"):
            object.__setattr__(self, name, tuple(getattr(self, name)))
        object.__setattr__(self, "garments", dict(self.garments))


@dataclass(frozen=True)
class SkinnedEncoding:
    """A garment in B materials.

    Attributes:
        rest: Rest positions [m], shape [N, 3].
        weight: Skinning weights, shape [B, N, 24].
        deformations: Of each vertex for each number of the pose's code, shape [B, Q, 3 N]; None: none.
        name: Of the garment.
    """

    rest: Tensor
    weight: Tensor
    deformations: Tensor | None
    name: str


def deformed(encoding: SkinnedEncoding, offsets: Tensor, transforms: Tensor) -> Tensor:
    """Skinned vertices [B, T, N, 3] of a template deformed by ``offsets [B, T, N, 3]`` in the bind pose."""
    columns = transforms.unflatten(2, (JOINTS, 4)).flatten(3)  # [B, T, 24, 12]
    blended = skinned(encoding.weight, columns).unflatten(3, (4, 3))  # [B, T, N, 4, 3]
    place = encoding.rest + offsets
    turned = (place[..., None] * blended[..., :3, :]).sum(-2)
    return turned + blended[..., 3, :]


class Skinning(Animator):
    """Linear blend skinning by the template's own weights."""

    kind = "skinning"

    def encode(self, graph: GarmentGraph, materials: Tensor) -> Tensor:
        """Skin matrix [N, 96]."""
        self.vertex_features(graph, materials)
        return graph.skin

    def unroll(self, encoding: Tensor, motion: Motion) -> Tensor:
        """Canonical vertices [B, T, N, 3] [m]."""
        return skinned(encoding, motion.transforms[:, motion.lead :])


class _PoseSpace(Animator, ABC):
    """Skinned templates whose deformation is linear in a code of the current pose."""

    @abstractmethod
    def offsets(self, encoding: SkinnedEncoding, motion: Motion) -> Tensor:
        """Deformation in the bind pose [m], [B, T, N, 3], in the wanted frames."""

    def unroll(self, encoding: SkinnedEncoding, motion: Motion) -> Tensor:
        """Canonical vertices [B, T, N, 3] [m]."""
        wanted = motion.wanted()
        return deformed(encoding, self.offsets(encoding, wanted), wanted.transforms)

    def rehearse(self, worn: Many[Worn], frames: Tensor) -> list[Rehearsal]:
        """The frames asked for alone: they have nothing to do with each other."""
        wanted = [w.motion.wanted(frames) for w in worn]
        return [
            Rehearsal(deformed(w.encoding, self.offsets(w.encoding, m), m.transforms), frames)
            for w, m in zip(worn, wanted, strict=True)
        ]


class DeepPSD(_PoseSpace):
    """Skinning weights and deformations from the template (after DeePSD, Bertiche 2021b)."""

    kind = "deepsd"

    def __init__(self, config: BaselineConfig) -> None:
        super().__init__(config)
        width = config.width
        self.encoder = GarmentEncoder(len(PLACE) + len(config.materials), width, keep=True)
        self.weights = fully_connected(2 * width, (width,), JOINTS)
        self.matrices = fully_connected(2 * width, (2 * width,), 3 * config.code)
        self.pose = fully_connected(self.told_size(velocities=False), config.hidden, config.code)

    def encode(self, graph: GarmentGraph, materials: Tensor) -> SkinnedEncoding:
        """Encoding of a garment in ``materials [B, P]``."""
        features = self.encoder(graph, self.vertex_features(graph, materials))  # [N, B, 2 width]
        weight = (graph.weights[:, None].clamp_min(1e-4).log() + self.weights(features)).softmax(2).transpose(0, 1)
        matrices = self.matrices(features).unflatten(2, (-1, 3))  # [N, B, Q, 3]
        scale = DEFORMATION * self.config.code**-0.5
        return SkinnedEncoding(graph.rest, weight, scale * matrices.permute(1, 2, 0, 3).flatten(2), graph.name)

    def offsets(self, encoding: SkinnedEncoding, motion: Motion) -> Tensor:
        """Deformation in the bind pose [m], [B, T, N, 3]."""
        code = self.pose(self.told(motion, velocities=False))
        return (code @ encoding.deformations).unflatten(2, (-1, 3))


class PerGarment(_PoseSpace):
    """What the networks of single garments share: a part of the module for each, by its name."""

    def knows(self, garment: str) -> bool:
        """Whether it was made for that garment."""
        return garment in self.config.garments

    def part(self, name: str) -> nn.ModuleDict:
        """Networks of a garment; ``ValueError`` for one that there are none for."""
        if not self.knows(name):
            known = ", ".join(self.config.garments)
            raise ValueError(f"{self.kind}: made for the garments {known}; it cannot dress {name!r}")
        return self.parts[name]

    def encode(self, graph: GarmentGraph, materials: Tensor) -> SkinnedEncoding:
        """Encoding of one of its garments; the material makes no difference."""
        self.vertex_features(graph, materials)
        self.part(graph.name)
        if len(graph.rest) != self.config.garments[graph.name]:
            raise ValueError(
                f"{self.kind}: garment {graph.name} had {self.config.garments[graph.name]} vertices, this one has "
                f"{len(graph.rest)}"
            )
        return SkinnedEncoding(graph.rest, graph.weights[None], None, graph.name)


class PhysicsPSD(PerGarment):
    """Deformations of each garment for a code of the pose, to be taught by energies (after PBNS, Bertiche 2021a)."""

    kind = "pbns"

    def __init__(self, config: BaselineConfig) -> None:
        super().__init__(config)
        self.parts = nn.ModuleDict(
            {
                name: nn.ModuleDict(
                    {
                        "pose": fully_connected(self.told_size(velocities=False), config.hidden, config.code),
                        "matrix": _linear(config.code, 3 * count),
                    }
                )
                for name, count in config.garments.items()
            }
        )

    def offsets(self, encoding: SkinnedEncoding, motion: Motion) -> Tensor:
        """Deformation in the bind pose [m], [B, T, N, 3]."""
        part = self.part(encoding.name)
        code = nn.functional.gelu(part["pose"](self.told(motion, velocities=False)))
        return DEFORMATION * part["matrix"](code).unflatten(2, (-1, 3))


class FrequencySplit(PerGarment):
    """Smooth deformations and a mixture of detailed ones (after TailorNet, Patel 2020)."""

    kind = "tailornet"

    def __init__(self, config: BaselineConfig) -> None:
        super().__init__(config)
        size = self.told_size(velocities=False)
        self.parts = nn.ModuleDict(
            {
                name: nn.ModuleDict(
                    {
                        "low": nn.Sequential(
                            fully_connected(size, config.hidden, config.code),
                            nn.GELU(),
                            _linear(config.code, 3 * count),
                        ),
                        "nearness": nn.Linear(size, config.prototypes),
                        "high": nn.ModuleList(
                            fully_connected(size, config.hidden[:1], config.code) for _ in range(config.prototypes)
                        ),
                        "detail": _linear(config.code, 3 * count),
                    }
                )
                for name, count in config.garments.items()
            }
        )

    def parted(self, encoding: SkinnedEncoding, motion: Motion) -> tuple[Tensor, Tensor]:
        """Smooth and detailed deformation in the bind pose [m], [B, T, N, 3] each."""
        part, pose = self.part(encoding.name), self.told(motion, velocities=False)
        near = part["nearness"](pose).softmax(-1)
        codes = torch.stack([network(pose) for network in part["high"]], dim=-1)
        mixed = (codes * near[..., None, :]).sum(-1)
        low, high = part["low"](pose), part["detail"](mixed)
        return DEFORMATION * low.unflatten(2, (-1, 3)), DEFORMATION * high.unflatten(2, (-1, 3))

    def offsets(self, encoding: SkinnedEncoding, motion: Motion) -> Tensor:
        """Deformation in the bind pose [m], [B, T, N, 3]."""
        low, high = self.parted(encoding, motion)
        return low + high

    def rehearse(self, worn: Many[Worn], frames: Tensor) -> list[Rehearsal]:
        """The frames asked for; the smooth part is held against the smoothed truth."""
        found = []
        for w in worn:
            motion = w.motion.wanted(frames)
            low, high = self.parted(w.encoding, motion)
            whole, smooth = (deformed(w.encoding, x, motion.transforms) for x in (low + high, low))
            term = data_loss(smooth, smoothed(w.graph, w.truth[:, frames], SMOOTHING))
            found.append(Rehearsal(whole, frames, {"smooth": term}))
        return found


def smoothed(graph: GarmentGraph, vertices: Tensor, steps: int) -> Tensor:
    """Low frequencies of ``vertices [..., N, 3]``: each step goes half the way to the neighbours' mean."""
    rows = vertices.reshape(-1, *vertices.shape[-2:]).transpose(0, 1)
    share = propagate(graph.neighbours, torch.ones(len(rows), 1))
    for _ in range(steps):
        rows = 0.5 * (rows + propagate(graph.neighbours, rows) / share[:, :, None])
    return rows.transpose(0, 1).reshape(vertices.shape)


def _linear(inputs: int, outputs: int) -> nn.Linear:
    """A linear layer that begins with little."""
    layer = nn.Linear(inputs, outputs)
    nn.init.normal_(layer.weight, std=0.1 * inputs**-0.5)
    nn.init.zeros_(layer.bias)
    return layer


BASELINES: dict[str, type[Animator]] = {c.kind: c for c in (Skinning, DeepPSD, PhysicsPSD, FrequencySplit)}
