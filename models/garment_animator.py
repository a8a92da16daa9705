"""What every network that dresses motions in any garment shares: scaling, skinning, and dressing a motion.

In: garment graphs, materials and motions. Out: canonical garment vertices [m] (the pelvis frame of each frame). A
template is encoded once for each material it is made of; the encoding serves every frame of every motion.

Dimensions: B sequences, L lead-in and T wanted frames, F = L + T, N garment vertices, P material parameters.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence as Many
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from body.model import Body
from models.garment_graph import PLACE, GarmentGraph
from models.motion_features import FEATURE_KINDS, MotionTrack, track_features

POSE = (6, 144)
"""Those of the ``pose`` features that do not say where north is: all joints but the pelvis."""

STILL, MOTION = 72, FEATURE_KINDS["motion"]
"""The first of the ``motion`` features, joints and gravity, belong to one frame; the rest are velocities."""

FEATURES = MOTION + POSE[1] - POSE[0]


@dataclass(frozen=True)
class Motion:
    """Motions of one length, as networks take them.

    Attributes:
        features: Of each frame: ``motion`` features, then the joints' rotations; shape [B, F, 216].
        transforms: Skinning transforms from the bind pose to the pelvis frame of each frame, stacked, [B, F, 96, 3].
        lead: Frames L before the first wanted one.
    """

    features: Tensor
    transforms: Tensor
    lead: int

    @property
    def frames(self) -> int:
        """Number of wanted frames T."""
        return self.features.shape[1] - self.lead

    @classmethod
    def of(cls, tracks: Many[MotionTrack], body: Body) -> Motion:
        """Motions of the run's body; ``ValueError`` when their lengths differ."""
        if len({(len(t.pose), t.lead) for t in tracks}) != 1:
            raise ValueError(f"motions: expected one length and lead-in, got {len(tracks)} tracks of several")
        features = [np.concatenate([track_features(t, "motion"), _rotations(t)], axis=1) for t in tracks]
        transforms = [canonical_transforms(t, body) for t in tracks]
        return cls(torch.as_tensor(np.stack(features)), torch.as_tensor(np.stack(transforms)), tracks[0].lead)

    def take(self, rows: Tensor) -> Motion:
        """Those of the given numbers."""
        return Motion(self.features[rows], self.transforms[rows], self.lead)

    def wanted(self, frames: Tensor | None = None) -> Motion:
        """The wanted frames without the lead-in, or those of them that are numbered."""
        features, transforms = self.features[:, self.lead :], self.transforms[:, self.lead :]
        return (
            Motion(features, transforms, 0) if frames is None else Motion(features[:, frames], transforms[:, frames], 0)
        )


def canonical_transforms(track: MotionTrack, body: Body) -> np.ndarray:
    """Stacked transforms [F, 96, 3] float32 that carry bind-space points to the pelvis frame of each frame."""
    rotation, position = track.pelvis_frames()
    world = body.joint_transforms(track.pose, position - body.joints[0])[:, :, :3]  # [F, 24, 3, 4]
    world[..., 3] -= position[:, None]
    turned = np.einsum("fcd,fjck->fjkd", rotation, world)
    return turned.reshape(len(turned), -1, 3).astype(np.float32)


def _rotations(track: MotionTrack) -> np.ndarray:
    return track_features(track, "pose")[:, slice(*POSE)]


def skinned(skin: Tensor, transforms: Tensor) -> Tensor:
    """A matrix of every vertex times columns of every frame, as one product: linear blend skinning is such a one.

    Args:
        skin: Shape [N, M], or [B, N, M], or [1, N, M] for all B.
        transforms: Shape [B, T, M, C].

    Returns:
        Shape [B, T, N, C].
    """
    batch, frames, _, size = transforms.shape
    if skin.dim() == 2 or len(skin) == 1:
        columns = transforms.permute(2, 0, 1, 3).flatten(1)
        return (skin.reshape(skin.shape[-2:]) @ columns).unflatten(1, (batch, frames, size)).permute(1, 2, 0, 3)
    columns = transforms.permute(0, 2, 1, 3).flatten(2)  # [B, M, T C]
    return (skin @ columns).unflatten(2, (frames, size)).transpose(1, 2)


@dataclass(frozen=True)
class Worn:
    """A garment on B motions of a training step.

    Attributes:
        graph, encoding: The garment, and what the network made of it in B materials.
        motion: The motions.
        truth: Simulated canonical vertices [m], shape [B, T, N, 3].
    """

    graph: GarmentGraph
    encoding: Any
    motion: Motion
    truth: Tensor


@dataclass(frozen=True)
class Rehearsal:
    """Predictions of a training step.

    Attributes:
        vertices: Canonical vertices [m], shape [B, S, N, 3].
        frames: Numbers of their wanted frames, shape [S].
        terms: Further losses of the network's own.
    """

    vertices: Tensor
    frames: Tensor
    terms: dict[str, Tensor] = field(default_factory=dict)


class Animator(nn.Module, ABC):
    """Base of all networks; ``config`` has ``materials`` (names of the P parameters) and ``body`` (its digest).

    Buffers hold the scaling of a vertex's place, of materials and of motion features.
    """

    kind = ""
    """Name in configurations and model files."""

    def __init__(self, config: Any) -> None:
        super().__init__()
        self.config = config
        self.regressor: nn.Module | None = None  # physical regressor, of the networks that have one
        sizes = {"place": len(PLACE), "material": len(config.materials), "motion": FEATURES}
        for name, size in sizes.items():
            self.register_buffer(f"{name}_mean", torch.zeros(size))
            self.register_buffer(f"{name}_scale", torch.ones(size))

    def set_scaling(self, graphs: Many[GarmentGraph], materials: np.ndarray, features: Tensor) -> None:
        """Take means and spreads of training templates, ``materials [n, P]`` and motion features [..., 216]."""
        place = torch.cat([g.rows for g in graphs])
        rows = {"place": place, "material": torch.as_tensor(materials), "motion": features.flatten(0, -2)}
        for name, values in rows.items():
            getattr(self, f"{name}_mean").copy_(values.mean(0))
            getattr(self, f"{name}_scale").copy_(values.std(0, unbiased=False).clamp_min(0.02))

    def vertex_features(self, graph: GarmentGraph, materials: Tensor) -> Tensor:
        """Scaled features [N, B, 7 + P] of a garment in ``materials [B, P]``.

        Raises:
            ValueError: A garment on another body, or materials with another number of parameters.
        """
        if graph.body_digest != self.config.body:
            raise ValueError(
                f"garment {graph.name} sits on body {graph.body_digest}, this {self.kind} was trained on body "
                f"{self.config.body}"
            )
        if materials.shape[-1] != len(self.config.materials):
            raise ValueError(
                f"garment {graph.name}: {materials.shape[-1]} material parameters are given, this {self.kind} takes "
                f"{len(self.config.materials)} ({', '.join(self.config.materials) or 'none'})"
            )
        place = (graph.rows.to(self.place_mean.device) - self.place_mean) / self.place_scale
        # Beyond 3 spreads there was no training data: held there, rather than extrapolated.
        material = ((materials - self.material_mean) / self.material_scale).clamp(-3.0, 3.0)
        count, batch = len(place), len(material)
        return torch.cat([place[:, None].expand(-1, batch, -1), material[None].expand(count, -1, -1)], dim=2)

    def told(self, motion: Motion, velocities: bool = True, rotations: bool = True) -> Tensor:
        """Scaled motion features [B, F, .] of each frame, with or without the pelvis' velocities, joints' rotations."""
        # Beyond 6 spreads there was no training data either.
        scaled = ((motion.features - self.motion_mean) / self.motion_scale).clamp(-6.0, 6.0)
        parts = [scaled[..., :STILL]]
        parts += [scaled[..., STILL:MOTION]] * velocities + [scaled[..., MOTION:]] * rotations
        return torch.cat(parts, dim=-1)

    @staticmethod
    def told_size(velocities: bool = True, rotations: bool = True) -> int:
        """Length of what ``told`` gives."""
        return STILL + (MOTION - STILL) * velocities + (FEATURES - MOTION) * rotations

    def knows(self, garment: str) -> bool:
        """Whether it can dress the garment of that name: any, but for networks of single garments."""
        return True

    @abstractmethod
    def encode(self, graph: GarmentGraph, materials: Tensor) -> Any:
        """What is computed once for a garment in ``materials [B, P]``."""

    @abstractmethod
    def unroll(self, encoding: Any, motion: Motion) -> Tensor:
        """Free-running canonical vertices [B, T, N, 3] [m]; the encoding is of B materials, or of one for all."""

    def rehearse(self, worn: Many[Worn], frames: Tensor) -> list[Rehearsal]:
        """What a training step compares, for each garment: by default the roll-outs, all frames of them."""
        return [Rehearsal(self.unroll(w.encoding, w.motion), torch.arange(w.motion.frames)) for w in worn]

    @torch.no_grad()
    def dress(self, graph: GarmentGraph, material: np.ndarray, track: MotionTrack, body: Body) -> np.ndarray:
        """Canonical vertices [T, N, 3] float32 [m] of a garment of one material on one motion of the body."""
        return self.dress_all(graph, [material], [track], body)[0]

    @torch.no_grad()
    def dress_all(
        self, graph: GarmentGraph, materials: Many[np.ndarray], tracks: Many[MotionTrack], body: Body
    ) -> list[np.ndarray]:
        """``dress`` for many motions of one length, side by side."""
        if body.digest != self.config.body:
            raise ValueError(f"{self.kind}: trained on body {self.config.body}, asked for body {body.digest}")
        was_training = self.training
        self.eval()
        rows = np.stack(materials)
        same = (rows == rows[0]).all()
        encoding = self.encode(graph, torch.as_tensor(rows[:1] if same else rows))
        vertices = self.unroll(encoding, Motion.of(tracks, body))
        self.train(was_training)
        return list(vertices.numpy())
