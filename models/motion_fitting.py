"""Training, storing and loading of the motion generators and of the recognition network.

In: 6-D poses and label names as plain arrays. Out: trained modules on the CPU in eval mode, with their logs.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, fields
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from body.model import Body
from models.action2motion import Action2Motion, Action2MotionConfig
from models.actor import Actor, ActorConfig
from models.body_layer import BodyLayer
from models.checkpoint import load_model, save_model
from models.dense_motion_cvae import DenseMotionConfig, DenseMotionCVAE
from models.motion_cvae import MotionCVAE, MotionCVAEConfig
from models.motion_generator import MotionGenerator
from models.recognition import RecognitionConfig, RecognitionNetwork, recognition_loss
from models.training import Progress, TrainingLog, TrainingSettings, array_digest, prepare, shuffled_batches, train

CVAE_KIND = "motion_cvae"
RECOGNITION_KIND = "recognition"

GENERATORS: dict[str, tuple[type[MotionGenerator], type]] = {
    "motion_cvae": (MotionCVAE, MotionCVAEConfig),
    "dense": (DenseMotionCVAE, DenseMotionConfig),
    "actor": (Actor, ActorConfig),
    "action2motion": (Action2Motion, Action2MotionConfig),
}
"""Kinds of motion generators: network and settings."""
Motions = tuple[np.ndarray, Sequence[str]] | tuple[np.ndarray, Sequence[str], np.ndarray]
GeneratorConfig = MotionCVAEConfig | DenseMotionConfig | ActorConfig | Action2MotionConfig

PAPER_CVAE_TRAINING = TrainingSettings(epochs=5000, learning_rate=1e-4, schedule="plateau")
PAPER_CVAE_BATCH = 20


_VARIANTS = {"paper": "motion_cvae", "paper-no-vertex-loss": "motion_cvae", "dense-no-vertex-loss": "dense"}


def variant_config(variant: str, labels: Sequence[str], pose6d: np.ndarray, **values: Any) -> GeneratorConfig:
    """Settings of a variant of the configuration, for training poses [N, T, 24, 6]; ``values`` are its own.

    Raises:
        ValueError: Unknown variant.
    """
    kind = _VARIANTS.get(variant, variant)
    if kind not in GENERATORS:
        raise ValueError(f"motion CVAE: unknown variant {variant!r}; known: {', '.join([*_VARIANTS, *GENERATORS])}")
    if kind == "dense":
        values |= {"frames": pose6d.shape[1], "clips": len(pose6d)}
    return GENERATORS[kind][1](labels=tuple(labels), **values)


def build_generator(config: GeneratorConfig) -> MotionGenerator:
    """An untrained generator of these settings."""
    return next(network(config) for network, settings in GENERATORS.values() if type(config) is settings)


def fit_motion_cvae(
    pose6d: np.ndarray,
    labels: Sequence[str],
    body: Body,
    config: GeneratorConfig,
    settings: TrainingSettings,
    batch: int,
    work_dir: Path | str,
    validation: Motions | None = None,
    progress: Progress | None = None,
    root: np.ndarray | None = None,
) -> tuple[MotionGenerator, TrainingLog]:
    """Train a motion generator (published: ``PAPER_CVAE_TRAINING``, batches of ``PAPER_CVAE_BATCH``).

    Args:
        pose6d: Training poses, shape [N, T, 24, 6].
        labels: Label name of each, N.
        body: Body of the vertex loss.
        config: Settings, whose kind chooses the network; its labels must cover ``labels``.
        settings, batch: Of the training loop.
        work_dir: Folder of this run alone; a killed run continues there.
        validation: Held-out poses and labels, with roots where the generator travels; their loss is logged and steers
            a plateau schedule.
        progress: Takes lines of text.
        root: Root translations [m], shape [N, T, 3]; only a generator that travels needs and looks at them.

    Raises:
        ValueError: Wrong shapes, no clips, a label that the config does not name, or no root where it is needed.
    """
    prepare(settings)
    model = build_generator(config)
    layer = BodyLayer(body)
    if model.travels and root is None:
        raise ValueError("motion CVAE: this generator also learns root translations, and none are given")
    motions = (pose6d, labels, root) if model.travels else (pose6d, labels)
    if validation is not None:
        validation = validation[: len(motions)]
    model, log = _fit(
        model,
        lambda rows: model.loss(layer, rows),
        motions,
        settings,
        batch,
        work_dir,
        validation,
        progress,
        layer,
    )
    model.finish(*_tensors(config.labels, pose6d, labels))
    return model, log


def fit_recognition(
    pose6d: np.ndarray,
    labels: Sequence[str],
    config: RecognitionConfig,
    settings: TrainingSettings,
    batch: int,
    work_dir: Path | str,
    validation: tuple[np.ndarray, Sequence[str]] | None = None,
    progress: Progress | None = None,
) -> tuple[RecognitionNetwork, TrainingLog]:
    """Train the recognition network; arguments as of ``fit_motion_cvae``."""
    prepare(settings)
    model = RecognitionNetwork(config)
    return _fit(
        model,
        lambda rows: recognition_loss(model, rows),
        (pose6d, labels),
        settings,
        batch,
        work_dir,
        validation,
        progress,
    )


def _fit(
    model: MotionGenerator | RecognitionNetwork,
    loss: Callable[[tuple[Tensor, ...]], dict[str, Tensor]],
    motions: Motions,
    settings: TrainingSettings,
    batch: int,
    work_dir: Path | str,
    validation: Motions | None,
    progress: Progress | None,
    beside: nn.Module | None = None,
):
    device = prepare(settings)
    data = _tensors(model.config.labels, *motions)
    model.set_scaling(data[0])
    if len(data) == 3:
        model.set_root_scaling(data[2])
    if beside is not None:
        beside.to(device)
    data = tuple(x.to(device) for x in data)
    held = None
    if validation is not None and len(validation[0]):
        held = tuple(x.to(device) for x in _tensors(model.config.labels, *validation))

    def batches(epoch: int, generator: np.random.Generator) -> Iterator[tuple[Tensor, ...]]:
        for rows in shuffled_batches(len(data[0]), batch, generator):
            chosen = torch.as_tensor(rows, device=device)
            yield tuple(x[chosen] for x in data)

    def validate() -> dict[str, float]:
        sums: dict[str, float] = {}
        for start in range(0, len(held[0]), 32):
            part = tuple(x[start : start + 32] for x in held)
            for name, value in loss(part).items():
                sums[name] = sums.get(name, 0.0) + float(value) * len(part[0]) / len(held[0])
        return sums

    log = train(
        model,
        batches,
        loss,
        settings,
        work_dir,
        validate=validate if held is not None else None,
        progress=progress,
        identity=f"{model.config} {batch} {array_digest(*(x.cpu().numpy() for x in data))}",
    )
    return model.cpu(), log


def _tensors(
    known: Sequence[str], pose6d: np.ndarray, labels: Sequence[str], root: np.ndarray | None = None
) -> tuple[Tensor, ...]:
    poses = np.asarray(pose6d, dtype=np.float32)
    if poses.ndim != 4 or poses.shape[2:] != (24, 6) or len(poses) == 0:
        raise ValueError(f"pose6d: expected shape [N, T, 24, 6] with N >= 1, got {list(poses.shape)}")
    if len(labels) != len(poses):
        raise ValueError(f"{len(poses)} pose sequences, but {len(labels)} labels")
    number = {name: n for n, name in enumerate(known)}
    for name in labels:
        if name not in number:
            raise ValueError(f"label {name!r} is not one of the model's: {', '.join(known)}")
    tensors = torch.as_tensor(poses), torch.tensor([number[name] for name in labels], dtype=torch.long)
    if root is None:
        return tensors
    root = np.asarray(root, dtype=np.float32)
    if root.shape != (*poses.shape[:2], 3):
        raise ValueError(f"root: expected shape {[*poses.shape[:2], 3]}, got {list(root.shape)}")
    return (*tensors, torch.as_tensor(root))


def save_motion_cvae(path: str | os.PathLike, model: MotionGenerator) -> None:
    """Write a trained motion generator of any kind to one file."""
    kind = next(kind for kind, (network, _) in GENERATORS.items() if type(model) is network)
    save_model(path, CVAE_KIND, {"kind": kind, **asdict(model.config)}, model)


def load_motion_cvae(path: str | os.PathLike) -> MotionGenerator:
    """Read what ``save_motion_cvae`` wrote; ``ValueError`` when the file is none."""
    stored = load_model(path, CVAE_KIND)
    kind = stored.config.pop("kind", None)
    if kind not in GENERATORS:
        raise ValueError(f"{path}: unknown motion generator {kind!r}; known: {', '.join(GENERATORS)}")
    network, settings = GENERATORS[kind]
    unknown = {field.name for field in fields(settings)} - set(stored.config)
    if unknown:
        raise ValueError(
            f"{path}: a generator of kind {kind} from before it had {', '.join(sorted(unknown))}; train it again"
        )
    try:
        model = network(settings(**stored.config))
    except TypeError as error:
        raise ValueError(f"{path}: settings do not fit a generator of kind {kind}: {error}") from None
    stored.into(model)
    return model


def save_recognition(path: str | os.PathLike, model: RecognitionNetwork) -> None:
    """Write a trained recognition network to one file."""
    save_model(path, RECOGNITION_KIND, asdict(model.config), model)


def load_recognition(path: str | os.PathLike) -> RecognitionNetwork:
    """Read what ``save_recognition`` wrote; ``ValueError`` when the file is none."""
    stored = load_model(path, RECOGNITION_KIND)
    model = RecognitionNetwork(RecognitionConfig(**stored.config))
    stored.into(model)
    return model
