"""Files of trained models: one format for all, loaded without running code from the file.

In: a module with its configuration. Out: one file, whole or absent. The reader refuses a file of another kind, format
or version with one sentence, and never unpickles anything but tensors and plain values.
"""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor, nn

from datasets.atomic import atomic_path

FORMAT = "drapeline-model"
VERSION = 1


@dataclass(frozen=True)
class StoredModel:
    """Content of a model file.

    Attributes:
        kind: Which model, for example "shape_descriptor".
        config: Plain values from which the module is built again.
        state: The module's parameters and buffers by name (data scaling is among the buffers).
        extra: Tensors beside the module.
    """

    kind: str
    config: dict[str, Any]
    state: dict[str, Tensor]
    extra: dict[str, Tensor]

    def into(self, module: nn.Module) -> nn.Module:
        """Fill a freshly built module and put it in eval mode; raises ``ValueError`` where names or shapes differ."""
        try:
            module.load_state_dict(self.state)
        except RuntimeError as error:
            detail = " ".join(str(error).split())
            raise ValueError(f"model file of kind {self.kind} does not fit its module: {detail}") from error
        return module.eval()


def save_model(
    path: str | os.PathLike,
    kind: str,
    config: Mapping[str, Any],
    module: nn.Module,
    extra: Mapping[str, Tensor] | None = None,
) -> None:
    """Write a module with its configuration (plain numbers, strings, booleans, lists and dicts) to one file."""
    content = {
        "format": FORMAT,
        "version": VERSION,
        "kind": kind,
        "config": _plain(config, kind),
        "state": {name: value.detach().cpu() for name, value in module.state_dict().items()},
        "extra": {name: value.detach().cpu() for name, value in (extra or {}).items()},
    }
    # Through a stream: a file's own name, here of the moment, would become part of its content.
    with atomic_path(path) as temporary, open(temporary, "wb") as stream:
        torch.save(content, stream)


def load_model(path: str | os.PathLike, kind: str) -> StoredModel:
    """Read a model file onto the CPU; raises ``ValueError`` when it is not a model file of this kind and version."""
    try:
        content = torch.load(path, map_location="cpu", weights_only=True)
    except FileNotFoundError:
        raise ValueError(f"model file {path} does not exist") from None
    except Exception as error:  # torch raises many kinds for a file that is not its own
        raise ValueError(f"{path} is not a readable model file ({type(error).__name__})") from error
    if not isinstance(content, dict) or content.get("format") != FORMAT:
        raise ValueError(f"{path} is not a {FORMAT} file")
    if content.get("version") != VERSION:
        raise ValueError(f"{path} has version {content.get('version')}, this program reads version {VERSION}")
    if content.get("kind") != kind:
        raise ValueError(f"{path} holds a model of kind {content.get('kind')!r}, expected {kind!r}")
    missing = [name for name in ("config", "state", "extra") if not isinstance(content.get(name), dict)]
    if missing:
        raise ValueError(f"{path} is damaged: it lacks {', '.join(missing)}")
    return StoredModel(kind, content["config"], content["state"], content["extra"])


def _plain(value: Any, name: str) -> Any:
    """Tuples become lists; anything that a safe load would refuse is named now rather than when it is read."""
    if isinstance(value, Mapping):
        return {str(key): _plain(item, f"{name}.{key}") for key, item in value.items()}
    if isinstance(value, (list, tuple)):
        return [_plain(item, f"{name}[{i}]") for i, item in enumerate(value)]
    if value is None or type(value) in (bool, int, float, str):
        return value
    raise ValueError(f"config value {name} is a {type(value).__name__}; a model file takes plain values only")
