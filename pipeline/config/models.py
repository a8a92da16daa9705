"""What a schema cannot say of the models: variants that name each other, and sizes that must fit."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from pipeline.config.layers import Layer, fault
from pipeline.config.schema import read_schema


def check_models(config: Mapping[str, Any], layers: Sequence[Layer]) -> None:
    """Names of variants first: what comes after looks them up."""
    for model, settings in config["models"].items():
        _check_names(model, settings, layers)
    _check_descriptors(config["models"]["shape_descriptor"], layers)
    _check_motion_invariant(config["models"]["motion_invariant"]["variants"], layers)
    _check_motion_cvae(config["models"]["motion_cvae"]["variants"], layers)
    _check_mesh_vae_gan(config["models"]["mesh_vae_gan"]["variants"], config["data"]["layers"]["levels"], layers)


def _check_names(model: str, settings: Mapping[str, Any], layers: Sequence[Layer]) -> None:
    """The variants that are in use, trained from several seeds, and repeated by others."""
    variants = settings.get("variants", {})
    configured = f"allowed are the variants that are configured: {', '.join(variants)}"
    if "use" in settings and settings["use"] not in variants:
        raise fault(layers, ("models", model, "use"), f"found {settings['use']!r}", configured)
    for variant in settings.get("seeds", {}):
        if variant not in variants:
            raise fault(layers, ("models", model, "seeds", variant), "no such variant", configured)
    complete = [name for name, one in variants.items() if "like" not in one]
    for variant, one in variants.items():
        if "like" in one and one["like"] not in complete:
            key = ("models", model, "variants", variant, "like")
            raise fault(layers, key, f"found {one['like']!r}", f"allowed are {', '.join(complete)}")


def _check_descriptors(settings: Mapping[str, Any], layers: Sequence[Layer]) -> None:
    for variant, descriptor in settings["variants"].items():
        _check_codes({("variants", variant, "code"): descriptor["code"]}, descriptor, layers)
    curve, used = settings["curve"], settings["variants"][settings["use"]]
    _check_codes({("curve", "codes", k): code for k, code in enumerate(curve["codes"])}, used | curve, layers)


def _check_codes(codes: Mapping[tuple, int], descriptor: Mapping[str, Any], layers: Sequence[Layer]) -> None:
    for key, code in codes.items():
        if code > descriptor.get("components", code):
            allowed = f"allowed are up to its components = {descriptor['components']}"
            raise fault(layers, ("models", "shape_descriptor", *key), f"found {code}", allowed)


def _check_motion_invariant(variants: Mapping[str, Any], layers: Sequence[Layer]) -> None:
    kinds = read_schema()["$defs"]["motion_invariant"]["properties"]["kind"]["enum"]
    for variant, settings in variants.items():
        if "kind" not in settings and "like" not in settings and variant not in kinds:
            key, allowed = ("models", "motion_invariant", "variants", variant), ", ".join(kinds)
            raise fault(layers, key, "found no kind", f"a variant of a name of its own needs kind: {allowed}")


def _check_motion_cvae(variants: Mapping[str, Any], layers: Sequence[Layer]) -> None:
    for variant, cvae in variants.items():
        if "heads" in cvae and cvae["width"] % cvae["heads"]:
            key, found = ("models", "motion_cvae", "variants", variant, "heads"), f"found {cvae['heads']}"
            raise fault(layers, key, found, f"allowed are divisors of width = {cvae['width']}")
        if "heads" in cvae and cvae["width"] % 2:
            key, found = ("models", "motion_cvae", "variants", variant, "width"), f"found {cvae['width']}"
            raise fault(layers, key, found, "allowed are even numbers, for the codes of time")


def _check_mesh_vae_gan(variants: Mapping[str, Any], levels: int, layers: Sequence[Layer]) -> None:
    """Blocks work on levels that the body mesh has, each block on one."""
    for variant, settings in variants.items():
        key = ("models", "mesh_vae_gan", "variants", variant)
        for name in ("levels", "discriminator_levels"):
            if max(settings.get(name, [0])) >= levels:
                allowed = f"data.layers.levels gives 0 to {levels - 1}"
                raise fault(layers, (*key, name), f"found {max(settings[name])}", allowed)
        whole = variants[settings["like"]] | settings if "like" in settings else settings
        for part in ("", "discriminator_"):
            widths, places = whole.get(f"{part}widths"), whole.get(f"{part}levels")
            if widths and places and len(widths) != len(places):
                found = f"found {len(places)} for {len(widths)} {part}widths"
                raise fault(layers, (*key, f"{part}levels"), found, "each block needs its level")
