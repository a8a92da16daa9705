"""Our own motion generator: dense layers on the control points of a spline, and a density of the latent vectors.

In: poses in the 6-D form and a label. Out: poses and root translations of the length that it was trained on, or of
another one.

A clip of fixed length is 144 smooth curves of the poses and three of the root: a least-squares cubic B-spline with a
control point every few frames loses some millimetres. Encoder and decoder are dense layers from and to these control
points, told the label; on a CPU they learn in a minute what a Transformer of the same cost does not in ten. Three more
things differ from Shi 2023:

- The prior is a Gaussian a label, with learned mean and spread, instead of one for all labels.
- The root is read from the decoded poses by a network of its own, which learns the root's position and the steps of the
  feet from frame to frame: an error of the root makes a foot slide, and a foot that stands has steps of length zero.
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

from body.skeleton import JOINT_INDEX
from models.body_layer import BodyLayer
from models.motion_generator import POSE_SIZE, SequenceCVAE, checked_labels

FOOT_JOINTS = tuple(JOINT_INDEX[name] for name in ("left_ankle", "left_foot", "right_ankle", "right_foot"))


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
        root_weight, step_weight: Of the mean squared errors of the root [m^2] and of the feet's steps [m^2].
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
    root_weight: float = 0.5
    step_weight: float = 10.0

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

    travels = True

    def __init__(self, config: DenseMotionConfig) -> None:
        super().__init__(config, config.latent)
        count, d = len(config.labels), config.latent
        spline = spline_basis(config.frames, config.spacing)
        self.register_buffer("spline", spline, persistent=False)
        self.register_buffer("control_points", torch.linalg.pinv(spline), persistent=False)
        points = spline.shape[1]
        self.encoder = _dense(points * POSE_SIZE + count, *config.hidden, 2 * d)
        self.decoder = _dense(d + count, *config.hidden[::-1], points * POSE_SIZE)
        self.register_buffer("root_mean", torch.zeros(3))
        self.register_buffer("root_scale", torch.ones(3))
        self.prior_mean = nn.Parameter(torch.zeros(count, d))
        self.prior_log_deviation = nn.Parameter(torch.zeros(count, d))
        self.traveller = _dense(points * POSE_SIZE + count, config.hidden[-1] // 2, points * 3)
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
        return self.decode_motion(latent, labels, frames)[0]

    def decode_motion(self, latent: Tensor, labels: Tensor, frames: int) -> tuple[Tensor, Tensor]:
        """6-D poses [N, T, 24, 6] (not yet orthonormal) and root translations [N, T, 3] [m], first over the origin."""
        points = self.decoder(torch.cat([latent, self.one_hot(labels)], dim=1)).float()
        # No gradient: for the sake of the root, poses would be learned less well.
        root_points = self.traveller(torch.cat([points.detach(), self.one_hot(labels)], dim=1)).float()
        curves, root = (self.spline @ part.unflatten(1, (-1, n)) for part, n in ((points, POSE_SIZE), (root_points, 3)))
        if frames != self.config.frames:
            time = mirrored(frames, self.config.frames).to(curves.device)
            curves, root = curves[:, time], root[:, time]
        return self.unscaled(curves), from_origin(root * self.root_scale + self.root_mean)

    def set_root_scaling(self, root: Tensor) -> None:
        """Take mean and spread from training roots [N, T, 3]; a direction hardly moved in keeps a floor of 0.02 m."""
        flat = from_origin(root).reshape(-1, 3)
        self.root_mean.copy_(flat.mean(0))
        self.root_scale.copy_(flat.std(0).clamp_min(0.02))

    def loss(self, body: BodyLayer, batch: tuple[Tensor, ...]) -> dict[str, Tensor]:
        """As ``SequenceCVAE.loss``; ``root`` and ``step`` are the mean squared errors of the root's coordinates [m^2]
        and of the movement of ankles and balls of the feet from frame to frame [m^2]."""
        pose6d, labels, true_root = batch
        true_root = from_origin(true_root)
        latent, kl = self._posterior(pose6d, labels)
        predicted, root = self.decode_motion(latent, labels, pose6d.shape[1])
        parts, chains = self._pose_loss(body, predicted, pose6d, kl, chained=True)
        parts["root"] = (root - true_root).square().mean()
        apart = body.joints_of_chain((chains[0] - chains[1]).detach(), FOOT_JOINTS)
        apart = apart.unflatten(2, root.shape[:2])  # [J, 3, N, T]
        step = (apart + (root - true_root).permute(2, 0, 1)).diff(dim=3)
        parts["step"] = step.square().mean() if step.shape[3] else root.new_zeros(())
        weighted = self.config.root_weight * parts["root"] + self.config.step_weight * parts["step"]
        return {name: part.detach() for name, part in parts.items()} | {"total": parts["total"] + weighted}

    def prior(self, labels: Tensor) -> tuple[Tensor, Tensor]:
        return self.prior_mean[labels], self.prior_log_deviation[labels]

    def draw(self, labels: Tensor, frames: int, generator: torch.Generator) -> Tensor:
        return self.draw_motion(labels, frames, generator)[0]

    def draw_motion(self, labels: Tensor, frames: int, generator: torch.Generator) -> tuple[Tensor, Tensor]:
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
        return self.decode_motion(centre + drawn + kernel * spread, labels, frames)

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


def from_origin(root: Tensor) -> Tensor:
    """Root translations [N, T, 3] moved along the ground so that they start over the origin."""
    return root - root[:, :1] * root.new_tensor([1.0, 0.0, 1.0])


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
