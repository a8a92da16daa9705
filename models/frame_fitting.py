"""Training of regressors that take single frames, in any space of codes and under any conditions.

In: motions, codes of the garments simulated on them and, for regressors that take them, the conditions of each
simulation. Out: the regressor, trained in place. ``models.garment_fitting`` does the same for regressors whose codes
are principal coefficients fitted to the same examples; here the codes may come from elsewhere, and the vertices of a
large data set need never be in memory at once.

Dimensions: N sequences, L lead-in and T wanted frames, D features, K code size, C conditions.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from models.garment_fitting import RegressorTraining
from models.garment_regressor import Regressor
from models.motion_features import MotionTrack
from models.training import Progress, array_digest, shuffled_batches, train


@dataclass(frozen=True)
class CodedExamples:
    """Training data of a frame regressor.

    Attributes:
        tracks: Motions with their lead-in, all of one length.
        codes: Codes of the wanted frames in the regressor's own space, shape [N, T, K] float32.
        conditions: What a regressor is told beside the motion, as it takes it, shape [N, C] float32; C may be 0.
    """

    tracks: Sequence[MotionTrack]
    codes: np.ndarray
    conditions: np.ndarray

    def __post_init__(self) -> None:
        if not self.tracks:
            raise ValueError("garment regressor: no training examples")
        lengths = sorted({(t.lead, t.frames) for t in self.tracks})
        if len(lengths) > 1:
            raise ValueError(f"garment regressor: examples differ in (lead-in, frames): {lengths}")
        frames = lengths[0][1]
        if self.codes.ndim != 3 or self.codes.shape[:2] != (len(self.tracks), frames):
            raise ValueError(
                f"garment regressor: expected codes [{len(self.tracks)}, {frames}, K], got {list(self.codes.shape)}"
            )
        if self.conditions.ndim != 2 or len(self.conditions) != len(self.tracks):
            raise ValueError(
                f"garment regressor: expected conditions [{len(self.tracks)}, C], got {list(self.conditions.shape)}"
            )


def fit_frames(
    regressor: Regressor,
    predict: Callable[[Tensor, Tensor], Tensor],
    examples: CodedExamples,
    settings: RegressorTraining,
    work_dir: str | Path,
    validate: Callable[[], dict[str, float]] | None = None,
    progress: Progress | None = None,
    identity: str = "",
) -> None:
    """Train on batches of single frames from anywhere with the loss of Shi 2023, Eq. 3; ends on the CPU in eval mode.

    Args:
        regressor: With its features' scaling and its code set, on the device that it is to be trained on.
        predict: Codes [B, K] of windows [B, offsets * D] and conditions [B, C].
        examples: Training split.
        settings: Epochs, learning rates, frames a batch.
        work_dir: Folder of this run alone; a killed run continues there.
        validate: Named errors on held-out data; "total" steers a plateau schedule.
        progress: Takes lines of text.
        identity: What else the run depends on, beside its settings and its data.
    """
    device = regressor.feature_mean.device
    features = torch.stack([regressor.features(track) for track in examples.tracks])
    codes = torch.as_tensor(examples.codes, device=device)
    conditions = torch.as_tensor(examples.conditions, device=device)
    offsets = torch.tensor(regressor.config.window_offsets, device=device)
    lead, frames = examples.tracks[0].lead, codes.shape[1]

    def batches(epoch: int, generator: np.random.Generator) -> Iterator[Tensor]:
        for rows in shuffled_batches(len(codes) * frames, settings.batch_size(epoch), generator):
            yield torch.as_tensor(rows, device=device)

    def loss(rows: Tensor) -> dict[str, Tensor]:
        sequence, frame = rows // frames, rows % frames
        window = (lead + frame[:, None] - offsets).clamp_min(0)
        inputs = features[sequence[:, None], window].flatten(1)
        difference = predict(inputs, conditions[sequence]).float() - codes[sequence, frame]
        vertex, laplacian = regressor.shape.errors(difference)
        total = vertex + regressor.config.laplacian_weight * laplacian
        rmse = 1000.0 * regressor.shape.scale * vertex.detach().sqrt()
        return {"total": total, "laplacian": laplacian.detach(), "rmse_mm": rmse}

    digest = array_digest(features.cpu().numpy(), examples.codes, examples.conditions)
    said = f"{identity} {regressor.config} {settings} {digest}"
    train(regressor, batches, loss, settings.training, work_dir, validate=validate, progress=progress, identity=said)
    regressor.cpu().eval()


def error_terms(regressor: Regressor, errors: Sequence[float]) -> dict[str, float]:
    """Validation terms of the mean square vertex errors [m^2] of held-out sequences."""
    mean_square = float(np.mean(errors))
    return {"total": mean_square / float(regressor.shape.scale) ** 2, "rmse_mm": 1000.0 * mean_square**0.5}
