"""What the schema refuses, in the project's sentence."""

from __future__ import annotations

import difflib
import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from jsonschema import Draft202012Validator
from jsonschema.exceptions import ValidationError, best_match

from pipeline.config.layers import Layer, fault, read_yaml

SCHEMA_FILE = Path(__file__).resolve().parents[2] / "configs" / "schema.yaml"


def read_schema() -> dict[str, Any]:
    """The schema of every configuration, configs/schema.yaml."""
    return read_yaml(SCHEMA_FILE)


def check_schema(config: Mapping[str, Any], layers: Sequence[Layer]) -> None:
    """Refuse what the schema refuses, and numbers that no limit catches."""
    error = best_match(Draft202012Validator(read_schema()).iter_errors(config))
    if error is not None:
        _refuse(error, layers)
    _check_finite((), config, layers)


def _refuse(error: ValidationError, layers: Sequence[Layer]) -> None:
    """Turn the schema's complaint into the project's sentence."""
    while error.context:  # descend into oneOf: the most relevant branch says what is wrong
        error = best_match(iter(error.context)) or error.context[0]
    key = tuple(error.absolute_path)
    schema, found = error.schema, error.instance
    if error.validator == "additionalProperties":
        allowed = sorted(schema.get("properties", {}))
        unknown = next(k for k in found if k not in allowed)
        close = difflib.get_close_matches(str(unknown), allowed, 1)
        hint = f" (did you mean {close[0]!r}?)" if close else ""
        raise fault(layers, (*key, unknown), f"unknown key{hint}", f"allowed are {', '.join(allowed)}")
    if error.validator == "required":
        missing = next(k for k in error.validator_value if k not in found)
        raise fault(layers, (*key, missing), "the key is missing", f"needed are {', '.join(error.validator_value)}")
    raise fault(layers, key, f"found {found!r}", _allowed(error, schema))


def _allowed(error: ValidationError, schema: Mapping[str, Any]) -> str:
    unit = unit_text(schema.get("unit", ""))
    if error.validator == "enum":
        return f"allowed are {', '.join(map(str, schema['enum']))}"
    if error.validator in ("minimum", "maximum", "exclusiveMinimum", "type") and schema.get("type") in (
        "number",
        "integer",
    ):
        low = schema.get("minimum", schema.get("exclusiveMinimum"))
        above = "above " if "exclusiveMinimum" in schema else ""
        kind = "a whole number" if schema["type"] == "integer" else "a number"
        limits = f" from {above}{low:g} to {schema['maximum']:g}" if low is not None else ""
        return f"allowed is {kind}{limits} {unit}".rstrip()
    if error.validator == "type":
        return f"allowed is {schema['type']}"
    return error.message


def unit_text(unit: str) -> str:
    return "" if unit == "1" else unit


def _check_finite(key: tuple, node: Any, layers: Sequence[Layer]) -> None:
    """YAML can write .nan and .inf, which pass every limit of a schema."""
    if isinstance(node, float) and not math.isfinite(node):
        raise fault(layers, key, f"found {node}", "allowed are finite numbers")
    children = node.items() if isinstance(node, Mapping) else enumerate(node) if isinstance(node, list) else ()
    for name, child in children:
        _check_finite((*key, name), child, layers)
