"""Action recognition network, whose features measure generated motions (Action2Motion, Guo 2020; Shi 2023, Table 4).

In: poses in the 6-D form. Out: 30-d features and class scores. A two-layer GRU of width 128, a 30-d tanh layer and a
linear classifier. The published networks draw the GRU's initial state at random even in evaluation, which makes the
figures unstable; here it is zero. The network must be trained on the training split of the data that it judges.

Dimensions: N clips, T frames, C labels.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
import torch.nn.functional as F
from torch import Tensor, nn

POSE_SIZE = 144


@dataclass(frozen=True)
class RecognitionConfig:
    """Sizes of the network.

    Attributes:
        labels: Names of the classes, in the order of the class scores.
        width, layers: Size of the GRU; published: 128, 2.
        features: Size of the penultimate tanh layer; published: 30.
        dropout: Between the GRU layers and before the classifier; our own, because our data are few.
        pose_noise: Standard deviation of the noise added to the 6-D poses in training; our own, for the same reason.
    """

    labels: tuple[str, ...]
    width: int = 128
    layers: int = 2
    features: int = 30
    dropout: float = 0.1
    pose_noise: float = 0.05


class RecognitionNetwork(nn.Module):
    """Two-layer GRU classifier of pose sequences."""

    def __init__(self, config: RecognitionConfig) -> None:
        super().__init__()
        self.config = config
        self.register_buffer("pose_mean", torch.zeros(POSE_SIZE))
        self.register_buffer("pose_scale", torch.ones(POSE_SIZE))
        between = config.dropout if config.layers > 1 else 0.0
        self.recurrent = nn.GRU(POSE_SIZE, config.width, config.layers, batch_first=True, dropout=between)
        self.feature = nn.Linear(config.width, config.features)
        self.classifier = nn.Linear(config.features, len(config.labels))
        self.dropout = nn.Dropout(config.dropout)

    def set_scaling(self, pose6d: Tensor) -> None:
        """Take mean and spread from training poses [N, T, 24, 6]; joints that never move keep a floor of 0.05."""
        flat = pose6d.reshape(-1, POSE_SIZE)
        self.pose_mean.copy_(flat.mean(0))
        self.pose_scale.copy_(flat.std(0).clamp_min(0.05))

    def features(self, pose6d: Tensor) -> Tensor:
        """Penultimate features in (-1, 1), shape [N, features], of ``pose6d [N, T, 24, 6]``."""
        x = (pose6d.flatten(2) - self.pose_mean) / self.pose_scale
        _, state = self.recurrent(x)  # no initial state given: zeros
        return torch.tanh(self.feature(self.dropout(state[-1])))

    def forward(self, pose6d: Tensor) -> Tensor:
        """Class scores [N, C] of ``pose6d [N, T, 24, 6]``."""
        return self.classifier(self.features(pose6d))

    @torch.no_grad()
    def describe(self, pose6d: np.ndarray, batch: int = 64) -> tuple[np.ndarray, np.ndarray]:
        """Features [N, 30] and most likely class numbers [N] of poses [N, T, 24, 6], in evaluation mode."""
        was_training = self.training
        self.eval()
        features, classes = [], []
        for start in range(0, len(pose6d), batch):
            chunk = torch.as_tensor(np.asarray(pose6d[start : start + batch], dtype=np.float32))
            feature = self.features(chunk)
            features.append(feature.numpy())
            classes.append(self.classifier(feature).argmax(1).numpy())
        self.train(was_training)
        return np.concatenate(features), np.concatenate(classes)


def recognition_loss(network: RecognitionNetwork, batch: tuple[Tensor, Tensor]) -> dict[str, Tensor]:
    """Cross-entropy of poses [N, T, 24, 6] (noisy in training) and class numbers [N]."""
    pose6d, labels = batch
    if network.training:
        pose6d = pose6d + network.config.pose_noise * torch.randn_like(pose6d)
    scores = network(pose6d)
    accuracy = (scores.argmax(1) == labels).float().mean()
    return {"total": F.cross_entropy(scores, labels), "accuracy": accuracy.detach()}
