"""The training loop that every model uses.

In: a module, a function that gives the batches of an epoch, a function that gives the named losses of a batch.
Out: the trained module (in place), ``checkpoint.pt`` and ``losses.csv`` in the run's own folder.

The batches of epoch e depend on (seed, e) alone and a checkpoint holds everything else that a step depends on, so a
run that was killed and started again ends with the same weights, bit for bit on the same machine, as one that was not.
"""

from __future__ import annotations

import csv
import hashlib
import io
import json
import math
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor, nn

from datasets.atomic import atomic_path, write_text
from models.optimizers import SGD, AdamW, RMSprop

CHECKPOINT_NAME = "checkpoint.pt"
LOSSES_NAME = "losses.csv"
# Where and how often, not what: these may differ between a run and its continuation.
_NOT_IN_IDENTITY = ("device", "threads", "checkpoint_every")

OPTIMIZERS = ("adam", "sgd", "rmsprop")
SCHEDULES = ("constant", "cosine", "plateau")
# Ours -> torch's word for how float32 matrix products are computed.
PRECISIONS = {"float32": "highest", "high": "high", "medium": "medium", "bfloat16": "highest"}


@dataclass(frozen=True)
class TrainingSettings:
    """How a module is trained; the batch size is the caller's, who makes the batches.

    Attributes:
        epochs: Passes over the data.
        learning_rate: Step size before the schedule.
        optimizer: "adam", "sgd" or "rmsprop".
        momentum: Momentum of "sgd" and "rmsprop"; "adam" ignores it.
        weight_decay: L2 penalty of "sgd" and "rmsprop", decoupled (AdamW) for "adam".
        schedule: "constant"; "cosine" (to 1% of the learning rate at the last epoch); "plateau" (times
            ``plateau_factor`` after ``plateau_patience`` epochs without a lower loss: the validation's "total" where
            there is one, else the training's).
        warmup_steps: Optimizer steps over which the learning rate rises from zero.
        gradient_clip: Largest norm of the gradient of all parameters; 0 = no clipping.
        precision: Of the matrix products in training steps: "float32"; "high" (oneDNN, on the CPU 2 times as fast and
            still float32 where there is no TF32); "medium" (factors rounded to bfloat16, sums and all else float32;
            4 to 5 times as fast on a CPU with bfloat16 instructions); "bfloat16" (autocast of the loss function).
            Validation and the finished model always compute in float32.
        checkpoint_every: Epochs between checkpoints.
        validate_every: Epochs between validations; the last epoch is always validated.
        seed: Of weights, dropout and batches.
        device: "auto" (CUDA where there is one), "cpu" or "cuda".
        threads: CPU threads of torch; 0 leaves torch's own choice.
    """

    epochs: int = 100
    learning_rate: float = 1e-3
    optimizer: str = "adam"
    momentum: float = 0.9
    weight_decay: float = 0.0
    schedule: str = "constant"
    plateau_factor: float = 0.1
    plateau_patience: int = 30
    warmup_steps: int = 0
    gradient_clip: float = 0.0
    precision: str = "float32"
    checkpoint_every: int = 1
    validate_every: int = 1
    seed: int = 0
    device: str = "auto"
    threads: int = 1

    def __post_init__(self) -> None:
        for name, allowed in (("optimizer", OPTIMIZERS), ("schedule", SCHEDULES), ("precision", PRECISIONS)):
            if getattr(self, name) not in allowed:
                raise ValueError(f"training {name}: {getattr(self, name)!r} is not one of {', '.join(allowed)}")
        for name in ("epochs", "checkpoint_every", "validate_every"):
            if getattr(self, name) < 1:
                raise ValueError(f"training {name}: must be at least 1, got {getattr(self, name)}")
        if not (math.isfinite(self.learning_rate) and self.learning_rate > 0):
            raise ValueError(f"training learning_rate: must be above 0, got {self.learning_rate}")


@dataclass
class TrainingLog:
    """What happened: one row an epoch and split (epoch, split, losses..., seconds, learning_rate); epoch 0 = before."""

    rows: list[dict[str, Any]] = field(default_factory=list)
    resumed_at: int = 0
    """Epochs that were already done when this call began."""

    def last(self, split: str = "train") -> dict[str, Any]:
        """Newest row of a split ("train" or "validation"); an empty dict when there is none."""
        return next((row for row in reversed(self.rows) if row["split"] == split), {})


Progress = Callable[[str], None]


def prepare(settings: TrainingSettings) -> torch.device:
    """Set threads and seed; returns the device. Call it before the module is built: its weights are drawn here."""
    if settings.threads:
        torch.set_num_threads(settings.threads)
    torch.manual_seed(settings.seed)
    return resolve_device(settings.device)


def resolve_device(name: str) -> torch.device:
    """Device for "auto", "cpu" or "cuda"; raises ``ValueError`` for another name or when there is no CUDA device."""
    if name not in ("auto", "cpu", "cuda"):
        raise ValueError(f"device: {name!r} is not one of auto, cpu, cuda")
    if name == "cuda" and not torch.cuda.is_available():
        raise ValueError("device: cuda was asked for, but torch finds no CUDA device; use auto or cpu")
    return torch.device("cpu" if name == "cpu" or not torch.cuda.is_available() else "cuda")


def epoch_generator(seed: int, epoch: int) -> np.random.Generator:
    """Generator of an epoch's batches, the same whether or not the run was interrupted before it."""
    return np.random.default_rng([seed, epoch])


def shuffled_batches(count: int, batch_size: int, generator: np.random.Generator) -> Iterator[np.ndarray]:
    """Index arrays that cover 0..count-1 once, of nearly equal length <= batch_size.

    Equal lengths, so that no batch of one sample is left over, which batch norm cannot take.
    """
    if count < 1 or batch_size < 1:
        raise ValueError(f"batches: need at least one sample and a batch size >= 1, got {count} and {batch_size}")
    yield from np.array_split(generator.permutation(count), math.ceil(count / batch_size))


def array_digest(*arrays: np.ndarray) -> str:
    """Short digest of array contents, for the ``identity`` of a run: other data must not continue an old checkpoint."""
    digest = hashlib.sha256()
    for array in arrays:
        array = np.ascontiguousarray(array)
        digest.update(f"{array.dtype}{array.shape}".encode())
        digest.update(memoryview(array.reshape(-1).view(np.uint8)))
    return digest.hexdigest()[:16]


def train(
    module: nn.Module,
    epoch_batches: Callable[[int, np.random.Generator], Iterable[Any]],
    loss: Callable[[Any], dict[str, Tensor]],
    settings: TrainingSettings,
    work_dir: Path | str,
    validate: Callable[[], dict[str, float]] | None = None,
    progress: Progress | None = None,
    identity: str = "",
    begin: Callable[[], dict[str, float]] | None = None,
) -> TrainingLog:
    """Train ``module`` in place; it is left in eval mode on the settings' device.

    Args:
        module: What is trained. Parameters with ``requires_grad=False`` stay as they are.
        epoch_batches: ``(epoch, generator) -> batches``, epoch from 0; every random choice comes from the generator.
        loss: ``batch -> {name: scalar tensor}``; "total" is minimised, the others are logged. It moves the batch to
            the module's device where that is needed.
        settings: See ``TrainingSettings``.
        work_dir: Folder of this run alone, for ``checkpoint.pt`` and ``losses.csv``; a checkpoint found there is
            continued.
        validate: ``() -> {name: number}``, called in eval mode without gradients; "total" steers the plateau schedule.
        progress: Takes a line of text.
        identity: Model configuration and data digest. A checkpoint of another identity, architecture or settings is
            not continued: the run starts anew and says so.
        begin: ``() -> {name: number}``, called before the first epoch of a run that is not continued: what is set in
            closed form. Its numbers and seconds are the row of epoch 0 and split "begin".

    Raises:
        ValueError: a loss that is not finite (with its epoch and batch), no batches, or a loss without "total".
    """
    work_dir = Path(work_dir)
    work_dir.mkdir(parents=True, exist_ok=True)
    say = progress or (lambda line: None)
    device = prepare(settings)
    module.to(device)
    parameters = [p for p in module.parameters() if p.requires_grad]
    optimizer = _make_optimizer(parameters, settings)
    fingerprint = _fingerprint(module, settings, identity)
    state: dict[str, Any] = {"epoch": 0, "step": 0, "scale": 1.0, "best": math.inf, "waited": 0}
    log = TrainingLog()

    saved = _load_checkpoint(work_dir / CHECKPOINT_NAME, fingerprint, device, say)
    if saved is not None:
        module.load_state_dict(saved["module"])
        optimizer.load_state_dict(saved["optimizer"])
        state, log.rows = saved["state"], saved["rows"]
        log.resumed_at = state["epoch"]
        _set_random_state(saved["random"], device)
        say(f"continuing after epoch {state['epoch']} of {settings.epochs}")
    elif begin is not None:
        start = time.perf_counter()
        found = {name: float(value) for name, value in begin().items()}
        seconds = round(time.perf_counter() - start, 4)
        log.rows.append({"epoch": 0, "split": "begin", **found, "seconds": seconds})
        say(f"begun in {seconds:.1f} s: {' '.join(f'{name} {value:.5g}' for name, value in found.items())}")

    say_every = math.ceil(settings.epochs / 40)
    for epoch in range(state["epoch"], settings.epochs):
        start = time.perf_counter()
        module.train()
        sums: dict[str, Tensor] = {}
        count = 0
        if settings.schedule == "cosine":
            state["scale"] = 0.01 + 0.99 * 0.5 * (1.0 + math.cos(math.pi * epoch / settings.epochs))
        for batch in epoch_batches(epoch, epoch_generator(settings.seed, epoch)):
            warm = min(1.0, (state["step"] + 1) / max(1, settings.warmup_steps))
            rate = settings.learning_rate * state["scale"] * warm
            for group in optimizer.param_groups:
                group["lr"] = rate
            with _matmul_precision(settings.precision):
                with torch.autocast(device.type, torch.bfloat16, enabled=settings.precision == "bfloat16"):
                    terms = loss(batch)
                _check_terms(terms, epoch, count)
                optimizer.zero_grad(set_to_none=True)
                terms["total"].backward()
            if settings.gradient_clip:
                nn.utils.clip_grad_norm_(parameters, settings.gradient_clip)
            optimizer.step()
            state["step"] += 1
            count += 1
            for name, value in terms.items():
                sums[name] = sums.get(name, 0.0) + value.detach()
        if count == 0:
            raise ValueError(f"training: epoch {epoch + 1} has no batches")

        means = {name: float(value) / count for name, value in sums.items()}
        seconds = time.perf_counter() - start
        row = {"epoch": epoch + 1, "split": "train", **means, "seconds": round(seconds, 4), "learning_rate": rate}
        log.rows.append(row)
        last = epoch + 1 == settings.epochs
        monitored = means["total"] if validate is None else None
        if validate is not None and (last or (epoch + 1) % settings.validate_every == 0):
            start = time.perf_counter()
            module.eval()
            with torch.no_grad():
                found = {name: float(value) for name, value in validate().items()}
            seconds = time.perf_counter() - start
            log.rows.append(
                {
                    "epoch": epoch + 1,
                    "split": "validation",
                    **found,
                    "seconds": round(seconds, 4),
                    "learning_rate": rate,
                }
            )
            monitored = found.get("total", means["total"])
        if settings.schedule == "plateau" and monitored is not None:
            _plateau(state, monitored, settings)
        state["epoch"] = epoch + 1
        if last or (epoch + 1) % settings.checkpoint_every == 0:
            _save_checkpoint(work_dir, module, optimizer, state, log.rows, fingerprint, device)
        if last or epoch % say_every == 0:
            say(_line(log, epoch + 1, settings.epochs))
    # The table is made from the checkpoint's rows, so what a killed run wrote past its checkpoint is gone.
    _write_losses(work_dir / LOSSES_NAME, log.rows)
    module.eval()
    return log


@contextmanager
def _matmul_precision(name: str) -> Iterator[None]:
    """Set torch's global matrix product precision for the body, then put the earlier one back."""
    earlier = torch.get_float32_matmul_precision()
    torch.set_float32_matmul_precision(PRECISIONS[name])
    try:
        yield
    finally:
        torch.set_float32_matmul_precision(earlier)


def _check_terms(terms: dict[str, Tensor], epoch: int, batch: int) -> None:
    if "total" not in terms:
        raise ValueError(f'loss: needs a term "total", got {", ".join(terms)}')
    if not torch.isfinite(terms["total"]).item():
        parts = ", ".join(f"{name} {float(value.detach()):g}" for name, value in terms.items())
        raise ValueError(f"training diverged at epoch {epoch + 1}, batch {batch + 1}: {parts}; lower the learning rate")


def _make_optimizer(parameters: list[nn.Parameter], settings: TrainingSettings) -> torch.optim.Optimizer:
    if not parameters:
        raise ValueError("training: the module has no parameters to train")
    rate, decay = settings.learning_rate, settings.weight_decay
    if settings.optimizer == "adam":
        return AdamW(parameters, lr=rate, weight_decay=decay, fused=True)
    if settings.optimizer == "sgd":
        return SGD(parameters, lr=rate, momentum=settings.momentum, weight_decay=decay)
    return RMSprop(parameters, lr=rate, momentum=settings.momentum, weight_decay=decay)


def _plateau(state: dict[str, Any], value: float, settings: TrainingSettings) -> None:
    """Lower the learning rate after ``plateau_patience`` validations without a loss below the best by 0.01%."""
    if value < state["best"] * (1.0 - 1e-4):
        state["best"], state["waited"] = value, 0
        return
    state["waited"] += 1
    if state["waited"] > settings.plateau_patience:
        state["scale"], state["waited"] = state["scale"] * settings.plateau_factor, 0


def _fingerprint(module: nn.Module, settings: TrainingSettings, identity: str) -> str:
    chosen = {name: value for name, value in asdict(settings).items() if name not in _NOT_IN_IDENTITY}
    shapes = {name: [list(value.shape), str(value.dtype)] for name, value in module.state_dict().items()}
    trained = [name for name, value in module.named_parameters() if value.requires_grad]
    text = json.dumps([chosen, shapes, trained, identity], sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()


def _save_checkpoint(
    work_dir: Path,
    module: nn.Module,
    optimizer: torch.optim.Optimizer,
    state: dict[str, Any],
    rows: list[dict[str, Any]],
    fingerprint: str,
    device: torch.device,
) -> None:
    random = {"cpu": torch.get_rng_state()}
    if device.type == "cuda":
        random["cuda"] = torch.cuda.get_rng_state(device)
    content = {
        "fingerprint": fingerprint,
        "module": module.state_dict(),
        "optimizer": optimizer.state_dict(),
        "state": state,
        "rows": rows,
        "random": random,
    }
    with atomic_path(work_dir / CHECKPOINT_NAME) as temporary:
        torch.save(content, temporary)
    _write_losses(work_dir / LOSSES_NAME, rows)


def _load_checkpoint(path: Path, fingerprint: str, device: torch.device, say: Progress) -> dict[str, Any] | None:
    """Checkpoint to continue, or None (and why is said) when there is none that belongs to this run."""
    if not path.exists():
        return None
    try:
        saved = torch.load(path, map_location=device, weights_only=True)
        found = saved["fingerprint"]
    except Exception as error:  # torch raises many kinds for a file that is not, or no longer, a checkpoint
        say(f"{path} cannot be read ({type(error).__name__}): training starts anew")
        return None
    if found != fingerprint:
        say(f"{path} was made with other settings, data or another architecture: training starts anew")
        return None
    return saved


def _set_random_state(random: dict[str, Tensor], device: torch.device) -> None:
    torch.set_rng_state(random["cpu"].cpu())
    if device.type == "cuda" and "cuda" in random:
        torch.cuda.set_rng_state(random["cuda"].cpu(), device)


def _write_losses(path: Path, rows: list[dict[str, Any]]) -> None:
    names: dict[str, None] = {}
    for row in rows:
        names.update(dict.fromkeys(row))
    ends = ("seconds", "learning_rate")
    columns = [name for name in names if name not in ends] + list(ends)
    text = io.StringIO()
    writer = csv.DictWriter(text, columns, restval="", lineterminator="\n")
    writer.writeheader()
    writer.writerows(rows)
    write_text(path, text.getvalue())


def _line(log: TrainingLog, epoch: int, epochs: int) -> str:
    rows = [row for row in log.rows[-2:] if row["epoch"] == epoch]
    hidden = ("epoch", "split", "seconds", "learning_rate")
    parts = []
    for row in rows:
        values = " ".join(f"{name} {value:.5g}" for name, value in row.items() if name not in hidden)
        parts.append(f"{row['split']} {values}")
    return f"epoch {epoch}/{epochs}: {'; '.join(parts)}; {rows[0]['seconds']:.2f} s"
