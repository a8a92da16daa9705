"""Action2Motion, the frame-level baseline (Guo 2020, "Action2Motion: Conditioned Generation of 3D Human Motions"); a
compact implementation of our own, without the Lie algebra: poses are in the 6-D form as those of the other generators.

In: poses in the 6-D form and a label. Out: poses frame by frame, each from a latent vector of its own.

Three recurrent networks (GRU) are told the label and how much of the motion has passed. The *prior* gives a Gaussian
over the latent vector of frame t from the frames before it, the *posterior* one from the frames up to it. The
*generator* makes frame t from the frame before it and the latent vector, of the posterior in training and of the prior
when motions are invented. In training the frame before it is the true one for a share of the batches (teacher forcing)
and the generator's own for the others; afterwards always its own.

Loss: mean squared error of the 6-D components + ``kl_weight`` KL(posterior | prior), both averaged over frames.

Dimensions: N clips, T frames, C labels.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor, nn

from models.body_layer import BodyLayer
from models.motion_generator import POSE_SIZE, MotionGenerator, checked_labels, gaussian_kl


@dataclass(frozen=True)
class Action2MotionConfig:
    """Sizes and loss weights; the defaults are the published ones.

    Attributes:
        labels: Names of the motion labels.
        width: Of the recurrent networks.
        latent: Size of a frame's latent vector.
        layers: Recurrent layers of the generator; prior and posterior have one.
        teacher_forcing: Share of the batches that see the true frame before.
        kl_weight: Weight of the KL term.
    """

    labels: tuple[str, ...]
    width: int = 128
    latent: int = 30
    layers: int = 2
    teacher_forcing: float = 0.6
    kl_weight: float = 1.0e-3

    def __post_init__(self) -> None:
        object.__setattr__(self, "labels", checked_labels(self.labels))
        if not 0.0 <= self.teacher_forcing <= 1.0:
            raise ValueError(f"Action2Motion: teacher_forcing is a share from 0 to 1, got {self.teacher_forcing}")


class _Recurrent(nn.Module):
    """Linear embedding, GRU layers and a linear map to the output."""

    def __init__(self, inputs: int, width: int, outputs: int, layers: int = 1) -> None:
        super().__init__()
        self.embed = nn.Linear(inputs, width)
        self.gru = nn.GRU(width, width, layers, batch_first=True)
        self.out = nn.Linear(width, outputs)

    def forward(self, x: Tensor, state: Tensor | None = None) -> tuple[Tensor, Tensor]:
        """Outputs [N, T, outputs] and the state after the last frame of inputs [N, T, inputs]."""
        hidden, state = self.gru(self.embed(x), state)
        return self.out(hidden), state


class Action2Motion(MotionGenerator):
    """Prior, posterior and generator."""

    def __init__(self, config: Action2MotionConfig) -> None:
        super().__init__(config, config.latent)
        told = POSE_SIZE + len(config.labels) + 1
        self.prior = _Recurrent(told, config.width, 2 * config.latent)
        self.posterior = _Recurrent(told, config.width, 2 * config.latent)
        self.generator = _Recurrent(told + config.latent, config.width, POSE_SIZE, config.layers)

    def draw(self, labels: Tensor, frames: int, generator: torch.Generator) -> Tensor:
        def latent(_: int, mean: Tensor, log_deviation: Tensor) -> Tensor:
            return mean + log_deviation.exp() * torch.randn(mean.shape, generator=generator)

        return self.unscaled(self._roll_out(self._condition(labels, frames), latent)[0])

    def rebuild(self, pose6d: Tensor, labels: Tensor) -> Tensor:
        condition = self._condition(labels, pose6d.shape[1])
        means = self._posterior(self.scaled(pose6d), condition)[0]
        return self.unscaled(self._roll_out(condition, lambda t, *_: means[:, t])[0])

    def loss(self, body: BodyLayer, batch: tuple[Tensor, Tensor]) -> dict[str, Tensor]:
        """``pose``: mean squared error of the 6-D components; ``kl``: of a frame, summed over the latent size.

        It has no vertex term, as published; ``body`` is not looked at.
        """
        pose6d, labels = batch
        truth, condition = self.scaled(pose6d), self._condition(labels, pose6d.shape[1])
        mean, log_deviation = self._posterior(truth, condition)
        noise = torch.randn_like(mean) if self.training else torch.zeros_like(mean)
        latent = mean + noise * log_deviation.exp()
        if self.training and bool(torch.rand(()) < self.config.teacher_forcing):
            before = torch.cat([torch.zeros_like(truth[:, :1]), truth[:, :-1]], dim=1)
            told = torch.cat([before, condition], dim=-1)
            prior = self.prior(told)[0].float()
            output = self.generator(torch.cat([told, latent], dim=-1))[0]
        else:
            output, prior = self._roll_out(condition, lambda t, *_: latent[:, t])
        pose = (self.unscaled(output) - pose6d).square().mean()
        kl = gaussian_kl(mean, log_deviation, *prior.chunk(2, dim=-1)).mean()
        return {"total": pose + self.config.kl_weight * kl, "pose": pose.detach(), "kl": kl.detach()}

    def _condition(self, labels: Tensor, frames: int) -> Tensor:
        """Label and passed share of the motion, shape [N, T, C + 1]."""
        passed = torch.arange(frames, dtype=torch.float32, device=self.pose_mean.device) / frames
        told = self.one_hot(labels)[:, None].expand(-1, frames, -1)
        return torch.cat([told, passed[None, :, None].expand(len(told), -1, -1)], dim=-1)

    def _posterior(self, truth: Tensor, condition: Tensor) -> tuple[Tensor, Tensor]:
        """Means and log standard deviations [N, T, latent], each from the frames up to its own."""
        mean, log_deviation = self.posterior(torch.cat([truth, condition], dim=-1))[0].float().chunk(2, dim=-1)
        return mean, log_deviation

    def _roll_out(self, condition: Tensor, latent_of: Callable[[int, Tensor, Tensor], Tensor]) -> tuple[Tensor, Tensor]:
        """Let the generator go on from its own frames, the first from the mean pose.

        Args:
            condition: Label and time, shape [N, T, C + 1].
            latent_of: ``(t, mean, log standard deviation) -> latent vectors [N, latent]`` of frame t; the Gaussian is
                the prior's.

        Returns:
            Scaled poses [N, T, 144], and mean and log standard deviation of the prior [N, T, 2 latent].
        """
        before = condition.new_zeros(len(condition), 1, POSE_SIZE)
        prior_state = state = None
        poses, priors = [], []
        for t in range(condition.shape[1]):
            told = torch.cat([before, condition[:, t : t + 1]], dim=-1)
            prior, prior_state = self.prior(told, prior_state)
            latent = latent_of(t, *prior[:, 0].float().chunk(2, dim=-1))
            before, state = self.generator(torch.cat([told, latent[:, None]], dim=-1), state)
            poses.append(before)
            priors.append(prior)
        return torch.cat(poses, dim=1), torch.cat(priors, dim=1).float()
