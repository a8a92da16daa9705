"""Our own motion generator: dense layers on the control points of a spline, and a density of the latent vectors.

In: poses in the 6-D form and a label. Out: poses of the length that it was trained on, or of another one.

A clip of fixed length is 144 smooth curves: a least-squares cubic B-spline with a control point every few frames loses
some millimetres. Encoder and decoder are dense layers from and to these control points, told the label; on a CPU they
learn in a minute what a Transformer of the same cost does not in ten. Two more things differ from Shi 2023:

- The prior is a Gaussian a label, with learned mean and spread, instead of one for all labels.
- After training, new latent vectors are drawn from a density that is fitted to those of the training clips (Ghosh 2020,
  "From variational to deterministic autoencoders", section 4): those of a motion's timing lie on curves, which no
  Gaussian prior fits. It is a smoothed bootstrap (Silverman 1986, section 6.4): the latent vector of a training clip of
  the label, drawn to the label's mean, plus noise with the label's covariance, such that mean and covariance stay those
  of the label. ``kernel_width`` 1 is a Gaussian a label, 0 the training clips themselves.

Beyond the trained length time runs back and forth, which is smooth: the curves are mirrored at their ends.

Dimensions: N clips, T frames, K control points, d latent size, C labels.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import torch
from torch import Tensor, nn

from models.motion_generator import POSE_SIZE, SequenceCVAE, checked_labels


@dataclass(frozen=True)
class DenseMotionConfig:
    """Sizes and loss weights.

    Attributes:
        labels: Names of the motion labels.
        frames: Length of the training clips.
        clips: Number of the training clips.
        latent: Latent size d.
        hidden: Widths of the encoder's layers; the decoder has them in reverse.
        spacing: Frames from one control point to the next.
        kernel_width: Of the density of the latent vectors, in standard deviations of a label.
        kl_weight, vertex_weight: Weights of the loss (``SequenceCVAE.loss``).
    """

    labels: tuple[str, ...]
    frames: int
    clips: int
    latent: int = 16
    hidden: tuple[int, ...] = (384, 384)
    spacing: int = 5
    kernel_width: float = 0.5
    kl_weight: float = 1.0e-5
    vertex_weight: float = 1.0

    def __post_init__(self) -> None:
        object.__setattr__(self, "labels", checked_labels(self.labels))
        object.__setattr__(self, "hidden", tuple(self.hidden))
        for name in ("frames", "clips", "latent", "spacing"):
            if getattr(self, name) < 1:
                raise ValueError(f"dense motion CVAE: {name} must be at least 1, got {getattr(self, name)}")
        if not 0.0 <= self.kernel_width <= 1.0:
            raise ValueError(f"dense motion CVAE: kernel_width is from 0 to 1, got {self.kernel_width}")


class DenseMotionCVAE(SequenceCVAE):
    """Dense encoder and decoder of control points, a prior a label, and the latent vectors of the training clips."""

    def __init__(self, config: DenseMotionConfig) -> None:
        super().__init__(config, config.latent)
        count, d = len(config.labels), config.latent
        spline = spline_basis(config.frames, config.spacing)
        self.register_buffer("spline", spline, persistent=False)
        self.register_buffer("control_points", torch.linalg.pinv(spline), persistent=False)
        points = spline.shape[1] * POSE_SIZE
        self.encoder = _dense(points + count, *config.hidden, 2 * d)
        self.decoder = _dense(d + count, *config.hidden[::-1], points)
        self.prior_mean = nn.Parameter(torch.zeros(count, d))
        self.prior_log_deviation = nn.Parameter(torch.zeros(count, d))
        # The density: latent vectors of the training clips in the order of their labels, and moments a label.
        self.register_buffer("known", torch.zeros(config.clips, d))
        self.register_buffer("known_first", torch.zeros(count, dtype=torch.long))
        self.register_buffer("known_count", torch.zeros(count, dtype=torch.long))
        self.register_buffer("label_mean", torch.zeros(count, d))
        self.register_buffer("label_factor", torch.eye(d).repeat(count, 1, 1))

    def encode(self, pose6d: Tensor, labels: Tensor) -> tuple[Tensor, Tensor]:
        """See ``SequenceCVAE``; ``ValueError`` for a motion longer than the training clips."""
        scaled = self.scaled(pose6d)
        if scaled.shape[1] > self.config.frames:
            raise ValueError(
                f"dense motion CVAE: it was trained on {self.config.frames} frames and cannot encode {scaled.shape[1]}"
            )
        if scaled.shape[1] < self.config.frames:
            scaled = scaled[:, mirrored(self.config.frames, scaled.shape[1]).to(scaled.device)]
        points = (self.control_points @ scaled).flatten(1)
        mean, log_deviation = self.encoder(torch.cat([points, self.one_hot(labels)], dim=1)).chunk(2, dim=1)
        return mean, log_deviation

    def decode(self, latent: Tensor, labels: Tensor, frames: int) -> Tensor:
        points = self.decoder(torch.cat([latent, self.one_hot(labels)], dim=1)).float()
        curves = self.spline @ points.unflatten(1, (-1, POSE_SIZE))
        if frames != self.config.frames:
            curves = curves[:, mirrored(frames, self.config.frames).to(curves.device)]
        return self.unscaled(curves)

    def prior(self, labels: Tensor) -> tuple[Tensor, Tensor]:
        return self.prior_mean[labels], self.prior_log_deviation[labels]

    def draw(self, labels: Tensor, frames: int, generator: torch.Generator) -> Tensor:
        width = self.config.kernel_width
        noise = torch.randn(len(labels), self.latent_size, generator=generator)
        spread = (self.label_factor[labels] @ noise[..., None])[..., 0]
        chance = torch.rand(len(labels), generator=generator)
        count = self.known_count[labels]
        member = self.known_first[labels] + (chance * count).long().clamp_max((count - 1).clamp_min(0))
        centre = self.label_mean[labels]
        # A label without training clips has its prior alone.
        kernel = torch.where(count > 0, width, 1.0)[:, None]
        drawn = (self.known[member.clamp_max(len(self.known) - 1)] - centre) * (1.0 - kernel.square()).sqrt()
        return self.decode(centre + drawn + kernel * spread, labels, frames)

    @torch.no_grad()
    def finish(self, pose6d: Tensor, labels: Tensor) -> None:
        """Fit the density of the latent vectors to the training clips."""
        order = torch.argsort(labels, stable=True)
        mean, log_deviation = self.encode(pose6d[order], labels[order])
        self.known.copy_(mean)
        self.known_count.copy_(torch.bincount(labels, minlength=len(self.config.labels)))
        self.known_first.copy_(self.known_count.cumsum(0) - self.known_count)
        own, noise = labels[order], (2.0 * log_deviation).exp()
        apart = mean - torch.stack([mean[own == number].mean(0) for number in own])
        shared = apart.T @ apart / len(own)
        for number in range(len(self.config.labels)):
            members = mean[own == number]
            if len(members) == 0:
                self.label_mean[number] = self.prior_mean[number]
                self.label_factor[number] = self.prior_log_deviation[number].exp().diag()
                continue
            self.label_mean[number] = members.mean(0)
            apart = members - self.label_mean[number]
            # Few clips tell little about a covariance: as one clip's worth, that of all labels counts.
            covariance = (apart.T @ apart + shared) / len(members) + noise[own == number].mean(0).diag()
            self.label_factor[number] = torch.linalg.cholesky(covariance)


def _dense(*widths: int) -> nn.Sequential:
    layers: list[nn.Module] = []
    for inside, outside in pairwise(widths):
        layers += [nn.Linear(inside, outside), nn.SiLU()]
    return nn.Sequential(*layers[:-1])


def mirrored(frames: int, length: int) -> Tensor:
    """Frame numbers 0 .. ``length`` - 1, there and back again until there are ``frames`` of them."""
    if length == 1:
        return torch.zeros(frames, dtype=torch.long)
    time = torch.arange(frames) % (2 * length - 2)
    return torch.minimum(time, 2 * length - 2 - time)


def spline_basis(frames: int, spacing: int) -> Tensor:
    """Matrix [frames, K] from control points every ``spacing`` frames to frames: uniform cubic B-splines (C2)."""
    last = (frames - 1) // spacing
    time = torch.arange(frames, dtype=torch.float32) / spacing
    segment = time.long().clamp_max(last)
    f = time - segment
    weights = torch.stack([(1 - f) ** 3, 3 * f**3 - 6 * f**2 + 4, -3 * f**3 + 3 * f**2 + 3 * f + 1, f**3], dim=1) / 6.0
    return torch.zeros(frames, last + 4).scatter_(1, segment[:, None] + torch.arange(4), weights)
