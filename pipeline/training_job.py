"""How a training stage turns its spec into settings, and says how far it is."""

from __future__ import annotations

import re
import time
from collections.abc import Mapping
from dataclasses import fields
from pathlib import Path
from typing import Any

from models.training import TrainingSettings
from pipeline.stage import Job


def values_of(kind: type, values: Mapping[str, Any]) -> dict[str, Any]:
    """Those of a config section's values that a settings dataclass has fields for, lists as tuples."""
    names = {f.name for f in fields(kind)} - {"training"}
    return {k: tuple(v) if isinstance(v, list) else v for k, v in values.items() if k in names}


def settings_of(kind: type, values: Mapping[str, Any], **more: Any) -> Any:
    """A settings dataclass from a config section, with further fields that do not stand in the section as they are."""
    return kind(**(values_of(kind, values) | more))


def training_settings(job: Job, model: Mapping[str, Any]) -> TrainingSettings:
    """How the config's ``training`` section trains on this job's device and threads."""
    return TrainingSettings(**model["training"], seed=job.spec["seed"], device=job.device, threads=job.threads)


def work_dir(losses: str) -> Path:
    """Folder of a training: where its losses go, its checkpoint lies beside."""
    return Path(losses).parent


class TrainingProgress:
    """Prints the training loop's lines with the name of the job and the time that is left."""

    def __init__(self, job: str):
        self._job = job
        self._start: tuple[float, int] | None = None

    def __call__(self, line: str) -> None:
        left = ""
        match = re.search(r"epoch (\d+)/(\d+)", line)
        if match:
            epoch, epochs = map(int, match.groups())
            now = time.monotonic()
            if self._start is None:
                self._start = (now, epoch)
            elif epoch > self._start[1]:
                rate = (epoch - self._start[1]) / max(now - self._start[0], 1e-9)
                left = f", {rate:.3g} epochs/s, {(epochs - epoch) / rate:.0f} s left"
        print(f"[{self._job}] {line}{left}", flush=True)
