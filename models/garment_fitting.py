"""Training, storing and loading of garment regressors (Shi 2023, sections 3.3 and 4.2).

In: motions with their simulated garment. Out: a trained regressor and its log. The order is the paper's: scale and
shape code from the training split; the start token's network against the last frame, then frozen; the regressor.
The window variant learns blends of two frames and is then corrected by what it left over of the simulated examples;
mirrored ones are less exact. The batch size grows while training, as published.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from models.checkpoint import load_model, save_model
from models.garment_regressor import Regressor, RegressorConfig
from models.motion_features import MotionTrack, track_features
from models.recurrent_regressor import RecurrentRegressor
from models.sequence_regressor import SequenceRegressor
from models.training import (
    Progress,
    TrainingLog,
    TrainingSettings,
    array_digest,
    prepare,
    shuffled_batches,
    train,
)
from models.window_regressor import WindowRegressor

KIND = "garment_regressor"
_NETWORKS: dict[str, type[Regressor]] = {
    "transformer": SequenceRegressor,
    "window": WindowRegressor,
    "gru": RecurrentRegressor,
}


@dataclass(frozen=True)
class GarmentExample:
    """A motion and the garment simulated on it.

    Attributes:
        track: The motion with its lead-in.
        vertices: Canonical garment vertices [m] of the wanted frames, shape [T, V, 3] float32.
        mirrored: Whether it was made from another one, with left and right exchanged, instead of simulated.
    """

    track: MotionTrack
    vertices: np.ndarray
    mirrored: bool = False

    def __post_init__(self) -> None:
        if self.vertices.ndim != 3 or self.vertices.shape[2] != 3 or len(self.vertices) != self.track.frames:
            raise ValueError(
                f"garment example: expected vertices [{self.track.frames}, V, 3], got {list(self.vertices.shape)}"
            )

    @classmethod
    def from_world(cls, track: MotionTrack, vertices: np.ndarray) -> GarmentExample:
        """Example of garment vertices in the world [T, V, 3] [m]."""
        rotation, position = (x[track.lead :] for x in track.pelvis_frames())
        return cls(track, np.matmul(vertices - position[:, None], rotation).astype(np.float32))


@dataclass(frozen=True)
class RegressorTraining:
    """How a regressor is trained.

    Attributes:
        training: Of the regressor itself; paper: Adam, 1e-3, 2000 epochs, plateau of 30 epochs.
        bos_epochs, bos_learning_rate: Of the start token's network, before it is frozen.
        batch: Sequences a batch at the start (paper: 10) - for the window variant, frames a batch.
        batch_growth, growth_every, largest_batch: ``batch_growth`` is added every ``growth_every`` epochs up to
            ``largest_batch`` (paper: 5, 200, 25).
        blend: Of the window variant: how far a frame is moved towards another one of its batch, motion and shape alike,
            0 = not, 1 = up to all the way (Zhang 2018, "mixup"). A network that cannot learn its frames by heart
            leaves over more that nearby motions have in common, which the correction then puts back.
    """

    training: TrainingSettings = field(
        default_factory=lambda: TrainingSettings(epochs=2000, learning_rate=1e-3, schedule="plateau")
    )
    bos_epochs: int = 200
    bos_learning_rate: float = 1.0e-3
    batch: int = 10
    batch_growth: int = 5
    growth_every: int = 200
    largest_batch: int = 25
    blend: float = 0.0

    def __post_init__(self) -> None:
        if not 0.0 <= self.blend <= 1.0:
            raise ValueError(f"regressor blend: must be in [0, 1], got {self.blend}")

    def batch_size(self, epoch: int) -> int:
        """Sequences (or frames) a batch in an epoch, counted from 0."""
        grown = self.batch + self.batch_growth * (epoch // max(1, self.growth_every))
        return max(self.batch, min(grown, self.largest_batch))


def build_regressor(config: RegressorConfig, faces: np.ndarray) -> Regressor:
    """Untrained regressor of the kind that ``config.decoder`` names, for a garment with ``faces [F, 3]``."""
    return _NETWORKS[config.decoder](config, faces)


def fit_garment_regressor(
    examples: Sequence[GarmentExample],
    faces: np.ndarray,
    config: RegressorConfig,
    settings: RegressorTraining,
    work_dir: Path | str,
    validation: Sequence[GarmentExample] = (),
    progress: Progress | None = None,
) -> tuple[Regressor, TrainingLog]:
    """Train a regressor on examples of one length; returns it on the CPU in eval mode, with its log.

    Args:
        examples: Training split.
        faces: Triangles of the garment, shape [F, 3].
        config: Sizes; ``variant_config`` makes one.
        settings: Epochs, batches, learning rates.
        work_dir: Folder of this run alone; a killed run continues there.
        validation: Held-out examples, decoded free-running; their error [mm] is logged and steers a plateau schedule.
        progress: Takes lines of text.

    Raises:
        ValueError: No examples, unequal lengths, or another number of vertices than the config's.
    """
    work_dir = Path(work_dir)
    lead = _check(examples, config)
    raw = np.stack([track_features(e.track, config.features) for e in examples])  # [N, L + T, D]
    vertices = np.stack([e.vertices for e in examples])  # [N, T, V, 3]
    device = prepare(settings.training)
    if config.decoder == "transformer" and not config.attention_window:
        config = replace(config, segment=vertices.shape[1])
    # The correction comes last, so that the network's checkpoints need not carry it.
    regressor = build_regressor(replace(config, centres=0), faces)
    regressor.set_feature_scaling(raw.reshape(-1, raw.shape[-1]))
    generator = np.random.default_rng(settings.training.seed)
    regressor.shape.fit(vertices.reshape(-1, *vertices.shape[2:]), generator)
    regressor.to(device)
    features = torch.stack([regressor.features(e.track) for e in examples])
    with torch.no_grad():
        # Example by example: all coordinates of all sequences at once would be held three times over.
        codes = torch.stack([regressor.shape.encode(torch.as_tensor(v, device=device)) for v in vertices])
    identity = f"{regressor.config} {settings} {array_digest(raw, vertices)}"
    if isinstance(regressor, SequenceRegressor):
        if regressor.bos is not None:
            _fit_start_token(regressor, features, codes, lead, settings, work_dir / "bos", identity)
        batches, loss = _sequence_training(regressor, features, codes, lead, settings)
    elif isinstance(regressor, RecurrentRegressor):
        batches, loss = _memory_training(regressor, features, codes, lead, settings)
    else:
        batches, loss = _frame_training(regressor, features, codes, lead, settings)

    def validate() -> dict[str, float]:
        dressed = regressor.dress_all([e.track for e in validation])
        mean_square = np.mean([np.square(d - e.vertices).sum(-1).mean() for d, e in zip(dressed, validation)])
        scale = float(regressor.shape.scale)
        return {"total": float(mean_square) / scale**2, "rmse_mm": 1000.0 * float(np.sqrt(mean_square))}

    log = train(
        regressor,
        batches,
        loss,
        settings.training,
        work_dir,
        validate=validate if validation else None,
        progress=progress,
        identity=identity,
    )
    if isinstance(regressor, WindowRegressor) and config.centres:
        simulated = [number for number, e in enumerate(examples) if not e.mirrored]
        _correct(regressor, features[simulated], codes[simulated], lead, config.centres)
        if validation and progress is not None:
            progress(f"corrected: validation rmse_mm {validate()['rmse_mm']:.5g}")
    return regressor.cpu(), log


def _check(examples: Sequence[GarmentExample], config: RegressorConfig) -> int:
    """Lead-in length that all examples share."""
    if not examples:
        raise ValueError("garment regressor: no training examples")
    shapes = {(e.track.lead, e.track.frames, e.vertices.shape[1]) for e in examples}
    if len(shapes) > 1:
        raise ValueError(f"garment regressor: examples differ in (lead-in, frames, vertices): {sorted(shapes)}")
    lead, _, vertices = shapes.pop()
    if vertices != config.vertices:
        raise ValueError(f"garment regressor: config says {config.vertices} vertices, the examples have {vertices}")
    return lead


def _fit_start_token(
    regressor: SequenceRegressor,
    features: Tensor,
    codes: Tensor,
    lead: int,
    settings: RegressorTraining,
    work_dir: Path,
    identity: str,
) -> None:
    """Train the BOS network against the last (paper) or first frame of each sequence, then freeze it."""
    target = codes[:, -1 if regressor.config.bos_target == "last" else 0]

    def loss(index: np.ndarray) -> dict[str, Tensor]:
        rows = torch.as_tensor(index)
        vertex, _ = regressor.shape.errors(regressor.first_token(features[rows], lead).float() - target[rows])
        return {"total": vertex}

    for name, parameter in regressor.named_parameters():
        parameter.requires_grad_(name.startswith("bos."))
    chosen = replace(
        settings.training,
        epochs=settings.bos_epochs,
        learning_rate=settings.bos_learning_rate,
        schedule="constant",
        checkpoint_every=settings.bos_epochs,
    )
    train(regressor, lambda _, g: shuffled_batches(len(features), 25, g), loss, chosen, work_dir, identity=identity)
    for name, parameter in regressor.named_parameters():
        parameter.requires_grad_(not name.startswith("bos."))


def _sequence_training(regressor, features, codes, lead, settings):
    """Batches of whole sequences, and the loss of Eq. 3 under teacher forcing or the model's own roll-outs."""
    config, epochs = regressor.config, settings.training.epochs
    spread = codes.flatten(0, 1).std(0)

    def batches(epoch: int, generator: np.random.Generator) -> Iterator[tuple[Tensor, float]]:
        # From nothing to the full share over the first half: the roll-outs of an untrained model teach nothing.
        share = config.rollout_share * min(1.0, 2.0 * epoch / max(1, epochs))
        for rows in shuffled_batches(len(features), settings.batch_size(epoch), generator):
            yield torch.as_tensor(rows), share

    def loss(batch: tuple[Tensor, float]) -> dict[str, Tensor]:
        rows, share = batch
        truth, motion = codes[rows], features[rows]
        past = truth[:, :-1]
        if share > 0.0:
            own = torch.rand(len(rows), device=truth.device) < share
            if own.any():
                with torch.no_grad():
                    past = past.clone()
                    past[own] = regressor.unroll(motion[own], lead)[:, :-1]
        if config.input_noise > 0.0:
            past = past + config.input_noise * spread * torch.randn_like(past)
        with torch.no_grad():
            start = regressor.first_token(motion, lead).float()[:, None]
        predicted = regressor.predict_all(motion, torch.cat([start, past], dim=1), lead)
        return _shape_loss(regressor, predicted - truth)

    return batches, loss


def _memory_training(regressor, features, codes, lead, settings):
    """Batches of whole sequences for a network that sees the motion alone, and the loss of Eq. 3."""

    def batches(epoch: int, generator: np.random.Generator) -> Iterator[Tensor]:
        for rows in shuffled_batches(len(features), settings.batch_size(epoch), generator):
            yield torch.as_tensor(rows, device=features.device)

    def loss(rows: Tensor) -> dict[str, Tensor]:
        return _shape_loss(regressor, regressor.unroll(features[rows], lead) - codes[rows])

    return batches, loss


def _frame_training(regressor, features, codes, lead, settings):
    """Batches of single frames from anywhere, blended as the settings say, and the loss of Eq. 3."""
    frames = codes.shape[1]

    def batches(epoch: int, generator: np.random.Generator) -> Iterator[tuple[Tensor, Tensor, Tensor]]:
        for rows in shuffled_batches(codes.shape[0] * frames, settings.batch_size(epoch), generator):
            share = settings.blend * generator.random((len(rows), 1), dtype=np.float32)
            others = generator.permutation(rows)
            yield tuple(torch.as_tensor(part, device=features.device) for part in (rows, others, share))

    def examples(rows: Tensor) -> tuple[Tensor, Tensor]:
        sequence, frame = rows // frames, rows % frames
        return _window_inputs(regressor, features, lead, sequence, frame), codes[sequence, frame]

    def loss(batch: tuple[Tensor, Tensor, Tensor]) -> dict[str, Tensor]:
        rows, others, share = batch
        inputs, truth = examples(rows)
        if settings.blend > 0.0:
            other_inputs, other_truth = examples(others)
            inputs, truth = torch.lerp(inputs, other_inputs, share), torch.lerp(truth, other_truth, share)
        return _shape_loss(regressor, regressor.network(inputs).float() - truth)

    return batches, loss


def _correct(regressor: WindowRegressor, features: Tensor, codes: Tensor, lead: int, most: int) -> None:
    """Correct a trained window regressor at no more than ``most`` training frames, evenly spread."""
    sequences, frames = codes.shape[:2]
    count = min(most, sequences * frames)
    rows = torch.arange(count, device=codes.device) * (sequences * frames) // count
    inputs = _window_inputs(regressor, features, lead, rows // frames, rows % frames)
    regressor.correct(inputs, codes.flatten(0, 1)[rows])


def _window_inputs(regressor: Regressor, features: Tensor, lead: int, sequence: Tensor, frame: Tensor) -> Tensor:
    """Windows [n, W] of single wanted frames of scaled features [N, L + T, D]."""
    offsets = torch.tensor(regressor.config.window_offsets, device=features.device)
    window = (lead + frame[:, None] - offsets[None, :]).clamp_min(0)
    return features[sequence[:, None], window].flatten(1)


def _shape_loss(regressor: Regressor, difference: Tensor) -> dict[str, Tensor]:
    vertex, laplacian = regressor.shape.errors(difference)
    rmse = 1000.0 * regressor.shape.scale * vertex.detach().sqrt()
    total = vertex + regressor.config.laplacian_weight * laplacian
    return {"total": total, "laplacian": laplacian.detach(), "rmse_mm": rmse}


def save_regressor(path: str | os.PathLike, regressor: Regressor) -> None:
    """Write a trained regressor to one file."""
    save_model(path, KIND, asdict(regressor.config), regressor)


def load_regressor(path: str | os.PathLike) -> Regressor:
    """Read a regressor written by ``save_regressor``; ``ValueError`` when the file is none."""
    stored = load_model(path, KIND)
    if "shape.faces" not in stored.state:
        raise ValueError(f"{path} is damaged: it lacks the garment's faces")
    regressor = build_regressor(RegressorConfig(**stored.config), stored.state["shape.faces"].numpy())
    stored.into(regressor)
    return regressor
