"""The run configuration: strict YAML, one closed schema, one clear sentence for whatever is wrong.

In: YAML files, the later laid over the earlier (as Snakemake does with ``--configfile``); null takes out what the files
below hold. Out: a checked dictionary.
Every complaint names the file, the key, what was found and what is allowed.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

from pipeline.config.data import check_clothing_layers, check_data, check_motions
from pipeline.config.garments import check_garments, check_systems, check_wardrobe
from pipeline.config.layers import ConfigError, Layer, overlaid, read_layers, without_nulls
from pipeline.config.materials import check_materials, check_ranges
from pipeline.config.models import check_models
from pipeline.config.schema import check_schema

__all__ = ["ConfigError", "check_config", "load_config", "read_layers", "without_nulls"]


def load_config(paths: Iterable[str | Path]) -> dict[str, Any]:
    """Lay the files over each other, in order, and check the result."""
    layers = read_layers(paths)
    config: dict[str, Any] = {}
    for _, layer in layers:
        config = overlaid(config, layer)
    check_config(config, layers)
    return config


def check_config(config: Mapping[str, Any], layers: Sequence[Layer]) -> None:
    """Check the schema, then what a schema cannot say; ``ConfigError`` names the file that set the value."""
    check_schema(config, layers)
    check_materials(config, layers)
    check_garments(config, layers)
    check_ranges(config, layers)
    check_motions(config, layers)
    check_data(config, layers)
    check_clothing_layers(config, layers)
    check_wardrobe(config, layers)
    check_models(config, layers)
    check_systems(config, layers)
