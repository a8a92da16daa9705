"""Training, use and storage of the motion-invariant networks (Wang 2019, section 3.4).

Dimensions: N frames of a data set, B frames of a step, G batches of a step, C descriptor, D signature, Z latent.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import asdict, dataclass, replace
from itertools import islice
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from models.checkpoint import load_model, save_model
from models.motion_invariant import VARIANTS, MotionInvariantConfig, MotionInvariantNetwork, PaperNetwork
from models.pooled_latent import PooledNetwork
from models.same_phi import IntrinsicFrames, SamePhiBatches
from models.training import Progress, TrainingSettings, array_digest, prepare, shuffled_batches, train

KIND = "motion_invariant"
EMBEDDING_SHARE = 0.4
"""Share of the epochs in which the encoder of the alternative "embedding" is trained; the decoder has the rest."""
SOURCE_SHARES = (0.04, 0.15, 0.5, 1.0)
"""Shares of a half batch that z is taken from, drawn batch by batch: from one frame to all."""
_EVALUATION_BATCH = 1024
_SCALING_ROWS = 4096
_TINY = 1e-8


@dataclass(frozen=True)
class SamePhiStep:
    """Frames of one step: ``G`` batches one after another, each of one phi.

    Attributes:
        descriptor, signature, parameters: Of each frame, [B, C], [B, D], [B, P].
        partners: Number of another frame of the same batch and of another clip, [B].
        group: Number of the batch, [B].
        half: 0 or 1, no clip is in both halves of a batch, [B].
        source: 1 where z may be taken from the frame, else 0, [B].
    """

    descriptor: Tensor
    signature: Tensor
    parameters: Tensor
    partners: Tensor
    group: Tensor
    half: Tensor
    source: Tensor


def build_motion_invariant(
    config: MotionInvariantConfig, descriptor: int, signature: int, parameters: int
) -> MotionInvariantNetwork:
    """The untrained network of a variant for descriptors, signatures and parameters of the given sizes."""
    kind = VARIANTS[config.variant].network
    network = PaperNetwork if kind in ("u-blocks", "concatenate") else PooledNetwork
    return network(config, descriptor, signature, parameters)


def motion_invariant_loss(module: MotionInvariantNetwork, step: SamePhiStep) -> dict[str, Tensor]:
    """Weighted loss of a step, with its terms; the weights are those of the variant.

    "own", "cross" and "known" are ``||S - S'||`` a frame as RMS over the descriptor's numbers in ``unit``, mean over
    the frames, from z of the frame itself, of other clips, and of the true parameters. "variance" is the mean over z's
    numbers of their variance within a batch, over the batches. "match" is the mean square of z's distance from that of
    the true parameters, in units of the latter's variance in the step.
    """
    weights, context = module.weights, module.context(step.signature)
    terms = (_pooled_terms if weights.network == "pooled" else _frame_terms)(module, step, context)
    return {"total": sum(getattr(weights, name) * term for name, term in terms.items()), **terms}


def _frame_terms(module: MotionInvariantNetwork, step: SamePhiStep, context: tuple[Tensor, ...]) -> dict[str, Tensor]:
    """Each frame has its own z."""
    weights, latent = module.weights, module.encode(step.descriptor, context, step.parameters)
    terms: dict[str, Tensor] = {}
    if weights.own:
        terms["own"] = _relative_rms(module, module.decode(latent, context), step.descriptor)
    if weights.variance:
        groups = [latent[step.group == g] for g in range(int(step.group[-1]) + 1)]
        terms["variance"] = torch.stack([z.var(dim=0, unbiased=False).mean() for z in groups]).mean()
    if weights.cross:
        terms["cross"] = _relative_rms(module, module.decode(latent[step.partners], context), step.descriptor)
    return terms


def _pooled_terms(module: PooledNetwork, step: SamePhiStep, context: tuple[Tensor, ...]) -> dict[str, Tensor]:
    """The decoder is taught by the true parameters, the encoder by the decoder as it is."""
    fixed = tuple(part.detach() for part in context)
    value, weight = module.evidence(step.descriptor, fixed, step.parameters)
    sources, place = weight * step.source.unsqueeze(1), 2 * step.group + step.half
    total = weight.new_zeros(2 * (int(step.group[-1]) + 1), weight.shape[1])
    latents = total.index_add(0, place, value * sources) / (total.index_add(0, place, sources) + module.prior)
    other, known = latents[2 * step.group + 1 - step.half], module.known_latent(step.parameters)
    target = known.detach()
    spread = target.var(dim=0, unbiased=False).mean() + 1e-3  # not zero where no parameter varies
    terms = {
        "known": _relative_rms(module, module.decode(known, context), step.descriptor),
        "cross": _relative_rms(module, module.decode_fixed(other, context), step.descriptor),
        "match": (other - target).square().mean() / spread,
    }
    if step.parameters.shape[1]:
        wrong = module.read_parameters(other) - module.scaled_parameters(step.parameters)
        terms["parameters"] = wrong.square().mean()
    return terms


def embedding_loss(
    module: MotionInvariantNetwork, descriptor: Tensor, signature: Tensor, parameters: Tensor
) -> dict[str, Tensor]:
    """Squared difference of distances in z and in parameters, over the pairs of a batch of *mixed* phi (Wang 2019,

    section 4 (ii), the alternative training strategy). Distances are over the root of their numbers' count.
    """
    latent = module.encode(descriptor, module.context(signature), parameters)
    wanted = module.scaled_parameters(parameters)
    pairs = [torch.pdist(x) / x.shape[1] ** 0.5 for x in (latent, wanted)]
    return {"total": (pairs[0] - pairs[1]).square().mean()}


def fit_motion_invariant(
    frames: IntrinsicFrames,
    config: MotionInvariantConfig,
    settings: TrainingSettings,
    work_dir: Path | str,
    validation: IntrinsicFrames | None = None,
    progress: Progress | None = None,
) -> MotionInvariantNetwork:
    """Train on ``frames``; the network is left in eval mode. Validation is measured with the same loss.

    Raises ``ValueError`` when a phi has a single frame, or the alternative "embedding" has no parameters to embed.
    """
    device = prepare(settings)
    sizes = frames.descriptors.shape[1], frames.signatures.shape[1], frames.parameters.shape[1]
    module = build_motion_invariant(config, *sizes)
    _set_scaling(module, frames)
    module.to(device)
    sampler = SamePhiBatches(frames.phi, frames.clip, config.batch)
    digest = array_digest(frames.descriptors, frames.phi, frames.clip, frames.parameters, *_ends(frames))
    identity = f"{KIND} {asdict(config)} {digest}"

    def epoch_batches(epoch: int, generator: np.random.Generator) -> Iterator[SamePhiStep]:
        return _steps(frames, sampler, config.batches_a_step, generator, device)

    def loss(step: SamePhiStep) -> dict[str, Tensor]:
        return motion_invariant_loss(module, step)

    def validate() -> dict[str, float]:
        return _mean_loss(module, validation)

    if module.weights.embedding:
        first = max(1, round(EMBEDDING_SHARE * settings.epochs))
        _fit_embedding(module, frames, replace(settings, epochs=first), Path(work_dir) / "encoder", identity, progress)
        settings = replace(settings, epochs=max(1, settings.epochs - first))
    check = None if validation is None else validate
    train(module, epoch_batches, loss, settings, work_dir, check, progress, identity)
    return module


def _fit_embedding(
    module: MotionInvariantNetwork,
    frames: IntrinsicFrames,
    settings: TrainingSettings,
    work_dir: Path,
    identity: str,
    progress: Progress | None,
) -> None:
    """Train the encoder alone and fix it; batches mix the parameter sets, or there would be no distances."""
    if not frames.parameters.shape[1]:
        raise ValueError("motion-invariant embedding: no parameter varies, so there are no distances to keep")
    device, batch = module.unit.device, module.config.batch * module.config.batches_a_step
    module.decoder.requires_grad_(False)
    module.decoder_motion.requires_grad_(False)

    def epoch_batches(epoch: int, generator: np.random.Generator) -> Iterator[tuple[Tensor, ...]]:
        for index in shuffled_batches(len(frames.descriptors), max(batch, 4), generator):
            rows = (frames.descriptors[index], frames.signatures[index], frames.parameters[index])
            yield tuple(_tensor(a).to(device) for a in rows)

    train(
        module, epoch_batches, lambda rows: embedding_loss(module, *rows), settings, work_dir, None, progress, identity
    )
    module.requires_grad_(False)
    module.decoder.requires_grad_(True)
    module.decoder_motion.requires_grad_(True)


@torch.no_grad()
def frame_evidence(module: MotionInvariantNetwork, frames: IntrinsicFrames) -> tuple[np.ndarray, np.ndarray]:
    """What each frame says of z and how sure it is: values and weights, [N, Z] float32, batch by batch."""
    device, parts = module.unit.device, []
    for start in range(0, len(frames.descriptors), _EVALUATION_BATCH):
        rows = slice(start, start + _EVALUATION_BATCH)
        s, m, p = (_tensor(a[rows]).to(device) for a in (frames.descriptors, frames.signatures, frames.parameters))
        parts.append(torch.stack(module.evidence(s, module.context(m), p)).cpu())
    return tuple(torch.cat(parts, dim=1).numpy())


def pooled(module: MotionInvariantNetwork, values: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """One z [Z] of the evidence of several frames, [n, Z] each."""
    return module.pool(torch.from_numpy(values), torch.from_numpy(weights)).numpy()


def encode_frames(module: MotionInvariantNetwork, frames: IntrinsicFrames) -> np.ndarray:
    """z [N, Z] float32 of each frame alone."""
    values, weights = frame_evidence(module, frames)
    return module.pool(torch.from_numpy(values[None]), torch.from_numpy(weights[None])).numpy()


@torch.no_grad()
def decode_frames(module: MotionInvariantNetwork, latents: np.ndarray, signatures: np.ndarray) -> np.ndarray:
    """Descriptors [N, C] float32 of latents [N, Z] (or one for all, [Z]) under signatures [N, D], batch by batch."""
    if latents.ndim == 1:
        latents = np.broadcast_to(latents, (len(signatures), len(latents)))
    device, blocks = module.unit.device, []
    for start in range(0, len(latents), _EVALUATION_BATCH):
        rows = slice(start, start + _EVALUATION_BATCH)
        z, m = (_tensor(a[rows]).to(device) for a in (latents, signatures))
        blocks.append(module.decode(z, module.context(m)).cpu())
    return torch.cat(blocks).numpy()


@dataclass(frozen=True)
class TrainedOn:
    """What a network belongs to: descriptors of equal length mean other shapes elsewhere.

    Attributes:
        garment: Name of the garment.
        descriptor: Digest of the model file of the shape descriptor (``datasets.codes.file_digest``).
    """

    garment: str
    descriptor: str


def save_motion_invariant(path: str | os.PathLike, module: MotionInvariantNetwork, trained_on: TrainedOn) -> None:
    """Write a network to a model file, with what it was trained on."""
    save_model(path, KIND, asdict(module.config) | {"trained_on": asdict(trained_on)}, module)


def load_motion_invariant(path: str | os.PathLike, wanted: TrainedOn | None = None) -> MotionInvariantNetwork:
    """Read a network, on the CPU in eval mode.

    Args:
        path: The model file.
        wanted: What it has to be trained on. Files of earlier versions do not say; they are taken as they are.

    Raises:
        ValueError: The file is not one, or is of another garment or another descriptor.
    """
    stored = load_model(path, KIND)
    config, sizes = dict(stored.config), ("descriptor", "signature", "parameter")
    found = config.pop("trained_on", None)
    if wanted is not None and found is not None:
        _check_trained_on(path, found, wanted)
    try:
        module = build_motion_invariant(
            MotionInvariantConfig(**config), *(len(stored.state[f"{name}_mean"]) for name in sizes)
        )
    except (KeyError, TypeError) as error:
        raise ValueError(f"{path} is damaged, or of another version of this program ({error})") from None
    stored.into(module)
    return module


def _check_trained_on(path: str | os.PathLike, found: object, wanted: TrainedOn) -> None:
    known = found if isinstance(found, dict) else {}
    garment = known.get("garment")
    if garment != wanted.garment:
        raise ValueError(
            f"{path} was trained on the garment '{garment}', not on '{wanted.garment}'; run `snakemake all`"
        )
    if known.get("descriptor") != wanted.descriptor:
        raise ValueError(
            f"{path} was trained on another shape descriptor of '{wanted.garment}' than the run has; "
            "run `snakemake all`"
        )


def _set_scaling(module: MotionInvariantNetwork, frames: IntrinsicFrames) -> None:
    """Standardising buffers; numbers that hardly vary (the pelvis in its own frame) are not blown up."""
    deviation = frames.descriptors.std(axis=0)
    unit = max(float(np.sqrt(np.mean(deviation**2))), 1e-9)
    module.unit.fill_(unit)
    module.descriptor_mean.copy_(_tensor(frames.descriptors.mean(axis=0)))
    module.descriptor_deviation.copy_(_tensor(np.maximum(deviation, 1e-3 * unit)))
    rows = np.unique(np.linspace(0, len(frames.phi) - 1, _SCALING_ROWS).astype(np.int64))
    signatures = frames.signatures[rows]
    module.signature_mean.copy_(_tensor(signatures.mean(axis=0)))
    module.signature_deviation.copy_(_tensor(np.maximum(signatures.std(axis=0), 1e-3)))
    # A parameter set counts once, however many frames it has.
    sets = frames.parameters[np.unique(frames.phi, return_index=True)[1]]
    module.parameter_mean.copy_(_tensor(sets.mean(axis=0)))
    module.parameter_deviation.copy_(_tensor(np.maximum(sets.std(axis=0), 1e-6)))


def _steps(
    frames: IntrinsicFrames, sampler: SamePhiBatches, together: int, generator: np.random.Generator, device
) -> Iterator[SamePhiStep]:
    waiting: list[tuple[np.ndarray, np.ndarray]] = []
    batches = sampler.epoch(generator)
    while waiting := list(islice(batches, together)):
        chosen = np.concatenate([index for index, _ in waiting])
        starts = np.cumsum([0] + [len(index) for index, _ in waiting[:-1]])
        share = generator.choice(SOURCE_SHARES, len(waiting))
        source = np.concatenate([_some(len(i), s, generator) for (i, _), s in zip(waiting, share)])
        numbers = (
            np.concatenate([start + partners for start, (_, partners) in zip(starts, waiting)]),
            np.repeat(np.arange(len(waiting)), [len(index) for index, _ in waiting]),
            np.concatenate([sampler.halves(index, generator) for index, _ in waiting]),
        )
        rows = (frames.descriptors[chosen], frames.signatures[chosen], frames.parameters[chosen])
        yield SamePhiStep(
            *(_tensor(a).to(device) for a in rows),
            *(torch.from_numpy(a).to(device) for a in numbers),
            _tensor(source).to(device),
        )


def _some(count: int, share: float, generator: np.random.Generator) -> np.ndarray:
    return (generator.random(count) < share).astype(np.float32)


@torch.no_grad()
def _mean_loss(module: MotionInvariantNetwork, frames: IntrinsicFrames) -> dict[str, float]:
    config, sums = module.config, {}
    sampler = SamePhiBatches(frames.phi, frames.clip, config.batch)
    # Always the same batches, so that epochs compare.
    for step in _steps(frames, sampler, config.batches_a_step, np.random.default_rng(0), module.unit.device):
        for name, value in motion_invariant_loss(module, step).items():
            sums[name] = sums.get(name, 0.0) + float(value) * len(step.group)
    return {name: value / len(frames.descriptors) for name, value in sums.items()}


def _relative_rms(module: MotionInvariantNetwork, predicted: Tensor, target: Tensor) -> Tensor:
    return (((predicted - target) / module.unit).square().mean(1) + _TINY).sqrt().mean()


def _ends(frames: IntrinsicFrames) -> list[np.ndarray]:
    """Some signatures, to tell one data set from another without making all of them."""
    return [frames.signatures[:: max(1, len(frames.phi) // 64)]]


def _tensor(array: np.ndarray) -> Tensor:
    return torch.from_numpy(np.array(array, dtype=np.float32))
