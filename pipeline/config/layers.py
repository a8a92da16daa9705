"""Configuration files laid over each other, and the sentence that says which of them holds a mistake."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import yaml

Layer = tuple[str, Mapping[str, Any]]
"""A configuration file and its own content."""


class ConfigError(ValueError):
    """A mistake in a configuration file, in one sentence."""


class _StrictLoader(getattr(yaml, "CSafeLoader", yaml.SafeLoader)):
    """Refuses duplicate keys, where plain YAML silently keeps the last.

    With the parser written in C, where there is one: Snakemake reads every file each time it starts.
    """

    def construct_mapping(self, node: yaml.MappingNode, deep: bool = False) -> dict:
        seen = set()
        for key_node, _ in node.value:
            key = self.construct_object(key_node, deep=deep)
            if key in seen:
                raise ConfigError(f"line {key_node.start_mark.line + 1}: key {key!r} stands twice; keep one of them")
            seen.add(key)
        return super().construct_mapping(node, deep)


def read_yaml(path: str | Path) -> dict[str, Any]:
    """One YAML mapping; ``ConfigError`` when it is missing, malformed or repeats a key."""
    try:
        content = yaml.load(Path(path).read_text(encoding="utf-8"), Loader=_StrictLoader)
    except ConfigError as error:
        raise ConfigError(f"{path}: {error}") from None
    except (OSError, UnicodeDecodeError) as error:
        raise ConfigError(f"{path}: cannot be read ({error}); a YAML file is needed") from None
    except yaml.YAMLError as error:
        place = getattr(error, "problem_mark", None)
        where = f", line {place.line + 1}" if place else ""
        raise ConfigError(f"{path}{where}: not YAML ({getattr(error, 'problem', error)})") from None
    if not isinstance(content, dict):
        raise ConfigError(f"{path}: holds {type(content).__name__}; a mapping of keys to values is needed")
    return content


def read_layers(paths: Iterable[str | Path]) -> list[Layer]:
    """Each file with its own content, to name the file that set a refused value, from here if it lies below."""
    here = Path.cwd()
    named = [Path(path).relative_to(here) if Path(path).is_relative_to(here) else Path(path) for path in paths]
    return [(str(path), read_yaml(path)) for path in named]


def overlaid(below: Mapping[str, Any], above: Mapping[str, Any]) -> dict[str, Any]:
    """Deep merge: mappings are merged, everything else is replaced; what is null above is taken out."""
    merged = dict(below)
    for key, value in above.items():
        both = isinstance(value, Mapping) and isinstance(merged.get(key), Mapping)
        merged[key] = overlaid(merged[key], value) if both else value
    return without_nulls(merged)


def without_nulls(config: Mapping[str, Any]) -> dict[str, Any]:
    """The configuration without what a file took out with ``null``: a variant, a garment, a type of clothing."""
    return {
        key: without_nulls(value) if isinstance(value, Mapping) else value
        for key, value in config.items()
        if value is not None
    }


def fault(layers: Sequence[Layer], key: Sequence, found: str, allowed: str) -> ConfigError:
    """The sentence to raise: the file that set the key, the key, what was found and what is allowed."""
    return ConfigError(f"{_owner(layers, key)}: {'.'.join(map(str, key))}: {found}; {allowed}")


def _owner(layers: Sequence[Layer], key: Sequence) -> str:
    """The last file that sets the key, or its nearest parent."""
    for depth in range(len(key), -1, -1):
        for path, layer in reversed(layers):
            node: Any = layer
            for part in key[:depth]:
                node = node.get(part) if isinstance(node, Mapping) else None
                if node is None:
                    break
            if node is not None:
                return path
    return layers[-1][0] if layers else "configuration"
