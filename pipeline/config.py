"""The run configuration: strict YAML, one closed schema, one clear sentence for whatever is wrong.

In: YAML files, the later laid over the earlier (as Snakemake does with ``--configfile``). Out: a checked dictionary.
Every complaint names the file, the key, what was found and what is allowed.
"""

from __future__ import annotations

import difflib
import math
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path
from typing import Any

import yaml
from jsonschema import Draft202012Validator
from jsonschema.exceptions import ValidationError, best_match

from garments.mesh_file import MESH_FILES
from garments.spec import MEASURES, VERTEX_LIMITS
from pipeline.spec import MATERIAL_KEYS, worn_name
from pipeline.wardrobe_checks import wardrobe_faults
from sim.fabrics import FABRICS, base_values
from sim.parameters import PARAMETER_NAMES, base_parameters, parameter

SCHEMA_FILE = Path(__file__).resolve().parent.parent / "configs" / "schema.yaml"


Layer = tuple[str, Mapping[str, Any]]
"""A configuration file and its own content."""


class ConfigError(ValueError):
    """A mistake in a configuration file, in one sentence."""


class _StrictLoader(yaml.SafeLoader):
    """Refuses duplicate keys, where plain YAML silently keeps the last."""

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


def load_config(paths: Iterable[str | Path]) -> dict[str, Any]:
    """Lay the files over each other, in order, and check the result."""
    layers = read_layers(paths)
    config: dict[str, Any] = {}
    for _, layer in layers:
        config = overlaid(config, layer)
    check_config(config, layers)
    return config


def read_layers(paths: Iterable[str | Path]) -> list[Layer]:
    """Each file with its own content, to name the file that set a refused value, from here if it lies below."""
    here = Path.cwd()
    named = [Path(path).relative_to(here) if Path(path).is_relative_to(here) else Path(path) for path in paths]
    return [(str(path), read_yaml(path)) for path in named]


def overlaid(below: Mapping[str, Any], above: Mapping[str, Any]) -> dict[str, Any]:
    """Deep merge: mappings are merged, everything else is replaced."""
    merged = dict(below)
    for key, value in above.items():
        both = isinstance(value, Mapping) and isinstance(merged.get(key), Mapping)
        merged[key] = overlaid(merged[key], value) if both else value
    return merged


def check_config(config: Mapping[str, Any], layers: Sequence[Layer]) -> None:
    """Check the schema, then what a schema cannot say; ``ConfigError`` names the file that set the value."""
    error = best_match(Draft202012Validator(read_yaml(SCHEMA_FILE)).iter_errors(config))
    if error is not None:
        _refuse_schema_error(error, layers)
    _check_finite((), config, layers)
    _check_parameters(config, layers)
    _check_garments(config, layers)
    _check_ranges(config, layers)
    _check_motions(config, layers)
    _check_data(config, layers)
    _check_clothing_layers(config, layers)
    _check_wardrobe(config, layers)
    _check_models(config, layers)


def _check_finite(key: tuple, node: Any, layers: Sequence[Layer]) -> None:
    """YAML can write .nan and .inf, which pass every limit of a schema."""
    if isinstance(node, float) and not math.isfinite(node):
        raise _error(layers, key, f"found {node}", "allowed are finite numbers")
    children = node.items() if isinstance(node, Mapping) else enumerate(node) if isinstance(node, list) else ()
    for name, child in children:
        _check_finite((*key, name), child, layers)


def _check_parameters(config: Mapping[str, Any], layers: Sequence[Layer]) -> None:
    for garment, settings in config["garments"].items():
        place = ("garments", garment)
        _check_material(place, settings, layers)
        for name, bounds in settings.get("ranges", {}).items():
            _check_interval((*place, "ranges", name), name, bounds, layers)


def _check_material(place: tuple, settings: Mapping[str, Any], layers: Sequence[Layer]) -> None:
    if "fabric" in settings:
        _check_fabric((*place, "fabric"), settings["fabric"], layers)
    for name, value in settings.get("base", {}).items():
        _check_parameter((*place, "base", name), name, value, layers)


def _check_interval(key: tuple, name: str, bounds: Mapping[str, float], layers: Sequence[Layer]) -> None:
    for end in ("min", "max"):
        _check_parameter((*key, end), name, bounds[end], layers)
    if bounds["min"] > bounds["max"]:
        found = f"min {bounds['min']:g} is above max {bounds['max']:g}"
        raise _error(layers, key, found, "min must not be above max")


def _check_fabric(key: tuple, name: str, layers: Sequence[Layer]) -> None:
    if name not in FABRICS:
        close = difflib.get_close_matches(name, FABRICS, 1)
        hint = f" (did you mean {close[0]!r}?)" if close else ""
        raise _error(layers, key, f"unknown fabric {name!r}{hint}", f"allowed are {', '.join(FABRICS)}")


def _check_parameter(key: tuple, name: str, value: float, layers: Sequence[Layer]) -> None:
    _check_name(key, name, layers)
    p = parameter(name)
    low, high = p.allowed
    if not low <= value <= high:
        raise _error(layers, key, f"found {value:g}", f"allowed are {low:g} to {high:g} {_unit(p.unit)}")
    if p.integer and value != int(value):
        raise _error(layers, key, f"found {value:g}", "allowed are whole numbers")


def _check_name(key: tuple, name: str, layers: Sequence[Layer]) -> None:
    if name not in PARAMETER_NAMES:
        close = difflib.get_close_matches(name, PARAMETER_NAMES, 1)
        hint = f" (did you mean {close[0]!r}?)" if close else ""
        raise _error(layers, key, f"unknown parameter {name!r}{hint}", f"allowed are {', '.join(PARAMETER_NAMES)}")


def _check_garments(config: Mapping[str, Any], layers: Sequence[Layer]) -> None:
    for name, settings in config["garments"].items():
        place = ("garments", name)
        shape = {key: value for key, value in settings.items() if key not in MATERIAL_KEYS}
        if shape["kind"] == "outfit":
            _check_outfit(place, shape, config["garments"], layers)
        else:
            _check_shape(place, shape, layers)


def _check_shape(place: tuple, shape: Mapping[str, Any], layers: Sequence[Layer]) -> None:
    kind = shape["kind"]
    if kind == "mesh":
        _check_mesh_garment(place, shape, layers)
        return
    if kind not in MEASURES:
        known = ", ".join(sorted([*MEASURES, "mesh", "outfit"]))
        raise _error(layers, (*place, "kind"), f"unknown garment {kind!r}", f"allowed are {known}")
    if "vertices" not in shape:
        raise _error(layers, (*place, "vertices"), "the key is missing", f"garments of kind {kind} need it")
    limits = {measure: (m.low, m.high) for measure, m in MEASURES[kind].items()} | {"vertices": VERTEX_LIMITS[kind]}
    for measure in sorted(set(shape) - {"kind"}):
        if measure not in limits:
            known = ", ".join(MEASURES[kind])
            raise _error(layers, (*place, measure), f"a {kind} has no such measure", f"allowed are {known}")
        low, high = limits[measure]
        if not low <= shape[measure] <= high:
            unit = {"vertices": "vertices", "flare": "m/m"}.get(measure, "m")
            found = f"found {shape[measure]:g}"
            raise _error(layers, (*place, measure), found, f"allowed are {low:g} to {high:g} {unit} for a {kind}")


def _check_mesh_garment(place: tuple, shape: Mapping[str, Any], layers: Sequence[Layer]) -> None:
    """The file's content is an input of the workflow and checked where it is read."""
    known = ("file", "worn_as", "scale", "held")
    for key in sorted(set(shape) - {"kind"}):
        if key not in known:
            raise _error(layers, (*place, key), "a mesh has no such key", f"allowed are {', '.join(known)}")
    for key in known[:2]:
        if key not in shape:
            raise _error(layers, (*place, key), "the key is missing", "a mesh needs file and worn_as")
    path = Path(shape["file"])
    if path.suffix.lower() not in MESH_FILES:
        raise _error(layers, (*place, "file"), f"found {str(path)!r}", f"allowed are names in {', '.join(MESH_FILES)}")
    if not path.is_file():
        raise _error(layers, (*place, "file"), f"{str(path)!r} is no file", "name a mesh file, from where you stand")


def _check_outfit(place: tuple, shape: Mapping[str, Any], garments: Mapping[str, Any], layers: Sequence[Layer]) -> None:
    """Each garment worn is one of the configuration, by its name, or described here without a material of its own."""
    for key in sorted(set(shape) - {"kind", "worn"}):
        raise _error(layers, (*place, key), "an outfit has no such key", "allowed are worn, fabric, base, ranges")
    key = (*place, "worn")
    if "worn" not in shape:
        raise _error(layers, key, "the key is missing", "an outfit needs a list of garments, innermost first")
    for number, one in enumerate(shape["worn"]):
        if isinstance(one, str):
            single = [name for name, other in garments.items() if other["kind"] != "outfit"]
            if one not in single:
                raise _error(layers, (*key, number), f"found {one!r}", f"allowed are {', '.join(single)}")
            continue
        for extra in MATERIAL_KEYS:
            if extra in one:
                found = "a garment of an outfit has no material of its own"
                raise _error(layers, (*key, number, extra), found, "all its cloth takes that of the outfit")
        if one["kind"] == "outfit":
            raise _error(layers, (*key, number, "kind"), "found 'outfit'", "an outfit is worn over no other")
        _check_shape((*key, number), {k: v for k, v in one.items() if k != "name"}, layers)
    names = [worn_name(one) for one in shape["worn"]]
    twice = next((name for name in names if names.count(name) > 1), None)
    if twice is not None:
        raise _error(layers, key, f"two garments are called {twice!r}", "each needs a name of its own")


def _check_ranges(config: Mapping[str, Any], layers: Sequence[Layer]) -> None:
    search = config["ranges"]
    for key in ("parameters", "free", "limits"):
        for name in search[key]:
            _check_name(("ranges", key, name), name, layers)
    for name in search["free"]:
        if name in search["parameters"]:
            key = ("ranges", "free", name)
            raise _error(layers, key, "the parameter is searched too", "it may stand in one of the two lists")
    for name, ends in search["limits"].items():
        key = ("ranges", "limits", name)
        _check_interval(key, name, ends, layers)
        for garment, settings in config["garments"].items():
            value = base_parameters(base_values(settings))[name]
            if name in search["parameters"] and not ends["min"] <= value <= ends["max"]:
                found = f"found {ends['min']:g} to {ends['max']:g}"
                raise _error(layers, key, found, f"the base value {value:g} of {garment} must lie between")


def _check_motions(config: Mapping[str, Any], layers: Sequence[Layer]) -> None:
    from pipeline.plan import plan_clips

    motions = config["motions"]
    key = ("motions", motions["source"])
    try:
        clips = plan_clips(motions)
    except (ValueError, OSError) as error:
        raise _error(layers, key, str(error), "correct the source of the motions") from None
    rule = config["data"]["splits"]["takes_every"]
    for plan in ("materials", "bodies"):
        wanted = config["data"][plan]["clips"]
        if wanted > len(clips):
            allowed = f"the motions give {len(clips)} clips at most"
            raise _error(layers, ("data", plan, "clips"), f"found {wanted}", allowed)
    takes = 1 + max(c.take_index for c in clips)
    if takes < rule:
        raise _error(
            layers,
            ("data", "splits", "takes_every"),
            f"found {rule} with {takes} takes",
            f"at most {takes}, or no motion is held out",
        )


def _check_data(config: Mapping[str, Any], layers: Sequence[Layer]) -> None:
    for plan, rule, what in (("materials", "parameters_every", "set"), ("bodies", "bodies_every", "body")):
        settings, every = config["data"][plan], config["data"]["splits"][rule]
        samples, size = settings["samples"], settings["samples_per_shard"]
        key, found = ("data", plan, "samples"), f"found {samples}"
        if 0 < samples < every:
            none = ", or 0 for no such data" if plan == "bodies" else ""
            raise _error(layers, key, found, f"at least {rule} = {every}, or no {what} is held out{none}")
        if samples % size:
            # A shard that is not full would change when samples are added, and be simulated again.
            raise _error(layers, key, found, f"allowed are multiples of samples_per_shard = {size}")


def _check_clothing_layers(config: Mapping[str, Any], layers: Sequence[Layer]) -> None:
    """The outfits that are layers on the body mesh, and what the networks on its levels ask for."""
    settings, place = config["data"]["layers"], ("data", "layers")
    _check_fabric((*place, "fabric"), settings["fabric"], layers)
    for name, value in settings["base"].items():
        _check_parameter((*place, "base", name), name, value, layers)
    if settings["bodies"] < settings["bodies_every"]:
        allowed = f"at least bodies_every = {settings['bodies_every']}, or no body is held out"
        raise _error(layers, (*place, "bodies"), f"found {settings['bodies']}", allowed)
    variants = config["models"]["mesh_vae_gan"]["variants"]
    complete = [name for name, one in variants.items() if "like" not in one]
    for variant, one in variants.items():
        key = ("models", "mesh_vae_gan", "variants", variant)
        if "like" in one and one["like"] not in complete:
            raise _error(layers, (*key, "like"), f"found {one['like']!r}", f"allowed are {', '.join(complete)}")
        for name in ("levels", "discriminator_levels"):
            if max(one.get(name, [0])) >= settings["levels"]:
                allowed = f"data.layers.levels gives 0 to {settings['levels'] - 1}"
                raise _error(layers, (*key, name), f"found {max(one[name])}", allowed)
        for ends in ("", "discriminator_"):
            own = variants[one["like"]] | one if "like" in one else one
            widths, places = own.get(f"{ends}widths"), own.get(f"{ends}levels")
            if widths and places and len(widths) != len(places):
                found = f"found {len(places)} for {len(widths)} {ends}widths"
                raise _error(layers, (*key, f"{ends}levels"), found, "each block needs its level")


def _check_wardrobe(config: Mapping[str, Any], layers: Sequence[Layer]) -> None:
    wardrobe = config["wardrobe"]
    for name, ends in wardrobe["ranges"].items():
        _check_interval(("wardrobe", "ranges", name), name, ends, layers)
    for category, settings in wardrobe["garments"].items():
        _check_material(("wardrobe", "garments", category), settings, layers)
    for key, found, allowed in wardrobe_faults(wardrobe):
        raise _error(layers, ("wardrobe", *key), found, allowed)


def _check_models(config: Mapping[str, Any], layers: Sequence[Layer]) -> None:
    for model, settings in config["models"].items():
        if "use" in settings and settings["use"] not in settings["variants"]:
            raise _error(
                layers,
                ("models", model, "use"),
                f"found {settings['use']!r}",
                f"allowed are the variants that are configured: {', '.join(settings['variants'])}",
            )
        for variant in settings.get("seeds", {}):
            if variant not in settings["variants"]:
                allowed = f"allowed are the variants that are configured: {', '.join(settings['variants'])}"
                raise _error(layers, ("models", model, "seeds", variant), "no such variant", allowed)
    descriptor = config["models"]["shape_descriptor"]
    for variant, settings in descriptor["variants"].items():
        codes = {("variants", variant, "code"): settings["code"]}
        if variant == descriptor["use"]:
            codes |= {("curve", "codes", k): code for k, code in enumerate(descriptor["curve"]["codes"])}
        for key, code in codes.items():
            if code > settings.get("components", code):
                allowed = f"allowed are up to its components = {settings['components']}"
                raise _error(layers, ("models", "shape_descriptor", *key), f"found {code}", allowed)
    kinds = read_yaml(SCHEMA_FILE)["$defs"]["motion_invariant"]["properties"]["kind"]["enum"]
    variants = config["models"]["motion_invariant"]["variants"]
    complete = [name for name, settings in variants.items() if "like" not in settings]
    for variant, settings in variants.items():
        key = ("models", "motion_invariant", "variants", variant)
        if "like" in settings and settings["like"] not in complete:
            found, allowed = f"found {settings['like']!r}", f"allowed are {', '.join(complete)}"
            raise _error(layers, (*key, "like"), found, allowed)
        if "kind" not in settings and "like" not in settings and variant not in kinds:
            raise _error(layers, key, "found no kind", f"a variant of a name of its own needs kind: {', '.join(kinds)}")
    variants = config["models"]["gsnet"]["variants"]
    complete = [name for name, settings in variants.items() if "like" not in settings]
    for variant, settings in variants.items():
        if "like" in settings and settings["like"] not in complete:
            found, allowed = f"found {settings['like']!r}", f"allowed are {', '.join(complete)}"
            raise _error(layers, ("models", "gsnet", "variants", variant, "like"), found, allowed)
    for variant, cvae in config["models"]["motion_cvae"]["variants"].items():
        if "heads" in cvae and cvae["width"] % cvae["heads"]:
            key, found = ("models", "motion_cvae", "variants", variant, "heads"), f"found {cvae['heads']}"
            raise _error(layers, key, found, f"allowed are divisors of width = {cvae['width']}")
        if "heads" in cvae and cvae["width"] % 2:
            key, found = ("models", "motion_cvae", "variants", variant, "width"), f"found {cvae['width']}"
            raise _error(layers, key, found, "allowed are even numbers, for the codes of time")


def _refuse_schema_error(error: ValidationError, layers: Sequence[Layer]) -> None:
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
        raise _error(layers, (*key, unknown), f"unknown key{hint}", f"allowed are {', '.join(allowed)}")
    if error.validator == "required":
        missing = next(k for k in error.validator_value if k not in found)
        raise _error(layers, (*key, missing), "the key is missing", f"needed are {', '.join(error.validator_value)}")
    raise _error(layers, key, f"found {found!r}", _allowed(error, schema))


def _allowed(error: ValidationError, schema: Mapping[str, Any]) -> str:
    unit = _unit(schema.get("unit", ""))
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


def _unit(unit: str) -> str:
    return "" if unit == "1" else unit


def _error(layers: Sequence[Layer], key: Sequence, found: str, allowed: str) -> ConfigError:
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
