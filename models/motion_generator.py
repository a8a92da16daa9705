"""What every motion generator shares: labels, scaling of the poses, sampling and reconstruction.

In: poses in the 6-D form and a label. Out: a pose sequence of that label. A generator that travels makes the root
translation too; for the others ``motions.grounding`` derives it. Generators are variational autoencoders conditioned on
the label: with one latent vector a sequence (``SequenceCVAE``: ``models.motion_cvae``, ``models.dense_motion_cvae``,
``models.actor``) or one a frame (``models.action2motion``).

Dimensions: N clips, T frames, d width, C labels.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from models.body_layer import BodyLayer, rotation_from_6d

JOINTS = 24
POSE_SIZE = JOINTS * 6


def checked_labels(labels: Sequence[str]) -> tuple[str, ...]:
    """The labels of a generator as a tuple; ``ValueError`` unless there is one and all differ."""
    labels = tuple(labels)
    if not labels or len(set(labels)) != len(labels):
        raise ValueError(f"motion CVAE: labels must be non-empty and different, got {list(labels)}")
    return labels


class MotionGenerator(nn.Module, ABC):
    """A generator of labelled motions; poses are scaled by the mean and spread of the training split.

    Attributes:
        config: Settings dataclass of the generator; its ``labels`` are the names of the classes.
        latent_size: Size of a latent vector.
        travels: Whether root translations are generated too; the batches of ``loss`` then hold them.
    """

    travels = False

    def __init__(self, config: Any, latent_size: int) -> None:
        super().__init__()
        self.config = config
        self.latent_size = latent_size
        self.register_buffer("pose_mean", torch.zeros(POSE_SIZE))
        self.register_buffer("pose_scale", torch.ones(POSE_SIZE))

    @abstractmethod
    def draw(self, labels: Tensor, frames: int, generator: torch.Generator) -> Tensor:
        """6-D poses [N, T, 24, 6] (not yet orthonormal) of class numbers [N], with latent vectors of the prior."""

    @abstractmethod
    def rebuild(self, pose6d: Tensor, labels: Tensor) -> Tensor:
        """6-D poses of motions [N, T, 24, 6] that went through the mean of their latent vectors, the same shape."""

    @abstractmethod
    def loss(self, body: BodyLayer, batch: tuple[Tensor, ...]) -> dict[str, Tensor]:
        """Training loss ("total") and its parts for poses [N, T, 24, 6], class numbers [N] and, where the generator
        travels, root translations [N, T, 3] [m]."""

    def draw_motion(self, labels: Tensor, frames: int, generator: torch.Generator) -> tuple[Tensor, Tensor | None]:
        """As ``draw``, with the root translations [N, T, 3] [m] of a generator that travels."""
        return self.draw(labels, frames, generator), None

    def finish(self, pose6d: Tensor, labels: Tensor) -> None:
        """Called once after training, with its poses [N, T, 24, 6] and class numbers [N]; most have nothing to do."""

    def set_scaling(self, pose6d: Tensor) -> None:
        """Take mean and spread from training poses [N, T, 24, 6]; joints that hardly move keep a floor of 0.05."""
        flat = pose6d.reshape(-1, POSE_SIZE)
        self.pose_mean.copy_(flat.mean(0))
        self.pose_scale.copy_(flat.std(0).clamp_min(0.05))

    def scaled(self, pose6d: Tensor) -> Tensor:
        """Network input [N, T, 144] of poses [N, T, 24, 6]; ``ValueError`` for another shape."""
        if pose6d.ndim != 4 or pose6d.shape[2:] != (JOINTS, 6):
            raise ValueError(f"pose6d: expected shape [N, T, {JOINTS}, 6], got {list(pose6d.shape)}")
        return (pose6d.flatten(2) - self.pose_mean) / self.pose_scale

    def unscaled(self, output: Tensor) -> Tensor:
        """Poses [N, T, 24, 6] of network output [N, T, 144]."""
        return (output.float() * self.pose_scale + self.pose_mean).unflatten(-1, (JOINTS, 6))

    def one_hot(self, labels: Tensor) -> Tensor:
        """One-hot vectors [N, C] of class numbers [N]."""
        return nn.functional.one_hot(labels, len(self.config.labels)).to(self.pose_mean.dtype)

    def label_numbers(self, labels: Sequence[str]) -> Tensor:
        """Class numbers [N] of label names; ``ValueError`` names an unknown one."""
        known = {name: number for number, name in enumerate(self.config.labels)}
        for name in labels:
            if name not in known:
                raise ValueError(f"motion CVAE: label {name!r} was not trained; known: {', '.join(known)}")
        return torch.tensor([known[name] for name in labels], dtype=torch.long)

    def sample(self, labels: Sequence[str], frames: int, generator: torch.Generator) -> np.ndarray:
        """The poses alone of what ``sample_motions`` generates, shape [N, T, 24, 6]."""
        return self.sample_motions(labels, frames, generator)[0]

    @torch.no_grad()
    def sample_motions(
        self, labels: Sequence[str], frames: int, generator: torch.Generator
    ) -> tuple[np.ndarray, np.ndarray | None]:
        """Generate one motion a label, with latent vectors drawn from the prior.

        Args:
            labels: Label names, one a wanted motion.
            frames: Length T of the motions, at least 1.
            generator: Source of randomness: the same state gives the same motions.

        Returns:
            Orthonormal 6-D poses, shape [N, T, 24, 6] float32, and root translations [m], shape [N, T, 3] float32, that
            start over the origin; None from a generator of poses alone.

        Raises:
            ValueError: An unknown label or no frames.
        """
        if frames < 1:
            raise ValueError(f"motion CVAE: a motion needs at least 1 frame, got {frames}")
        numbers = self.label_numbers(labels)
        with self._evaluating():
            pose6d, root = self.draw_motion(numbers, frames, generator)
        return orthonormal_6d(pose6d).numpy(), None if root is None else root.numpy()

    @torch.no_grad()
    def reconstruct(self, pose6d: np.ndarray, labels: Sequence[str]) -> np.ndarray:
        """Encode and decode motions [N, T, 24, 6] through the mean of their latent vectors; same shape."""
        numbers = self.label_numbers(labels)
        poses = torch.as_tensor(np.asarray(pose6d, dtype=np.float32))
        with self._evaluating():
            return orthonormal_6d(self.rebuild(poses, numbers)).numpy()

    @contextmanager
    def _evaluating(self) -> Iterator[None]:
        """Without dropout."""
        was_training = self.training
        self.eval()
        try:
            yield
        finally:
            self.train(was_training)


class SequenceCVAE(MotionGenerator):
    """Generators with one latent vector a sequence.

    ``config`` has ``kl_weight`` and ``vertex_weight``.
    """

    @abstractmethod
    def encode(self, pose6d: Tensor, labels: Tensor) -> tuple[Tensor, Tensor]:
        """Mean and log standard deviation [N, d] of the latent vector of ``pose6d [N, T, 24, 6]``, ``labels [N]``."""

    @abstractmethod
    def decode(self, latent: Tensor, labels: Tensor, frames: int) -> Tensor:
        """6-D poses [N, T, 24, 6] (not yet orthonormal) of latent vectors [N, d] and class numbers [N]."""

    def prior(self, labels: Tensor) -> tuple[Tensor, Tensor]:
        """Mean and log standard deviation [N, d] of the prior of class numbers [N]: standard normal."""
        rest = self.pose_mean.new_zeros(len(labels), self.latent_size)
        return rest, rest

    def draw(self, labels: Tensor, frames: int, generator: torch.Generator) -> Tensor:
        return self.decode(torch.randn(len(labels), self.latent_size, generator=generator), labels, frames)

    def rebuild(self, pose6d: Tensor, labels: Tensor) -> Tensor:
        return self.decode(self.encode(pose6d, labels)[0], labels, pose6d.shape[1])

    def loss(self, body: BodyLayer, batch: tuple[Tensor, Tensor]) -> dict[str, Tensor]:
        """Loss of Shi 2023, Eq. 2, which is that of ACTOR, and its parts for poses [N, T, 24, 6] and classes [N].

        ``pose``: mean squared error of the 6-D components. ``vertex``: mean squared error of the vertex coordinates
        [m^2], root at rest, by the closed form. ``kl``: divergence from the prior, summed over the latent size.

        The squared errors are averaged over components and frames, as in the code of ACTOR that the paper builds on:
        under plain sums the published weight 1e-5 of the KL term would vanish against 20,670 vertex coordinates, and
        no latent vector drawn from the prior would decode to a motion.
        """
        pose6d, labels = batch
        latent, kl = self._posterior(pose6d, labels)
        return self._pose_loss(body, self.decode(latent, labels, pose6d.shape[1]), pose6d, kl)[0]

    def _posterior(self, pose6d: Tensor, labels: Tensor) -> tuple[Tensor, Tensor]:
        """Latent vectors [N, d], with noise while training, and the mean of their divergence from the prior."""
        mean, log_deviation = (x.float() for x in self.encode(pose6d, labels))
        noise = torch.randn_like(mean) if self.training else torch.zeros_like(mean)
        return mean + noise * log_deviation.exp(), gaussian_kl(mean, log_deviation, *self.prior(labels)).mean()

    def _pose_loss(
        self, body: BodyLayer, predicted: Tensor, pose6d: Tensor, kl: Tensor, chained: bool = False
    ) -> tuple[dict[str, Tensor], tuple[Tensor, Tensor] | None]:
        """The loss, and what ``rotation_chain`` gives of both poses, where it needs them or they are asked for."""
        pose = (predicted - pose6d).square().mean()
        loss = pose + self.config.kl_weight * kl
        parts = {"pose": pose.detach(), "kl": kl.detach()}
        if self.config.vertex_weight == 0.0 and not chained:
            return {"total": loss, **parts}, None
        with torch.no_grad():
            target = body.rotation_chain(pose6d)
        chains = body.rotation_chain(predicted), target
        if self.config.vertex_weight > 0.0:
            vertex = body.mean_squared_pose_error(*chains) / 3.0
            loss = loss + self.config.vertex_weight * vertex
            parts["vertex"] = vertex.detach()
        return {"total": loss, **parts}, chains


def gaussian_kl(mean: Tensor, log_deviation: Tensor, prior_mean: Tensor, prior_log_deviation: Tensor) -> Tensor:
    """KL divergence of a diagonal Gaussian from another, summed over the last axis."""
    ratio = log_deviation - prior_log_deviation
    apart = (mean - prior_mean) * (-prior_log_deviation).exp()
    return 0.5 * ((2.0 * ratio).exp() + apart.square() - 1.0 - 2.0 * ratio).sum(-1)


def orthonormal_6d(six: Tensor) -> Tensor:
    """Orthonormal 6-D forms (Gram-Schmidt) of predicted ones, same shape [..., 6]."""
    rotation = rotation_from_6d(six)
    return torch.cat([rotation[..., 0], rotation[..., 1]], dim=-1)
