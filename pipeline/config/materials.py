"""What a schema cannot say of materials: names and limits of fabrics, intrinsic parameters and their ranges."""

from __future__ import annotations

import difflib
from collections.abc import Mapping, Sequence
from typing import Any

from pipeline.config.layers import Layer, fault
from pipeline.config.schema import unit_text
from sim.fabrics import FABRICS, base_values
from sim.parameters import PARAMETER_NAMES, base_parameters, parameter


def check_materials(config: Mapping[str, Any], layers: Sequence[Layer]) -> None:
    """Fabric, base values and ranges of each garment."""
    for garment, settings in config["garments"].items():
        place = ("garments", garment)
        check_material(place, settings, layers)
        for name, bounds in settings.get("ranges", {}).items():
            check_interval((*place, "ranges", name), name, bounds, layers)


def check_ranges(config: Mapping[str, Any], layers: Sequence[Layer]) -> None:
    """What the range finder searches, and between what."""
    search = config["ranges"]
    for key in ("parameters", "free", "limits"):
        for name in search[key]:
            check_name(("ranges", key, name), name, layers)
    for name in search["free"]:
        if name in search["parameters"]:
            key = ("ranges", "free", name)
            raise fault(layers, key, "the parameter is searched too", "it may stand in one of the two lists")
    for name, ends in search["limits"].items():
        key = ("ranges", "limits", name)
        check_interval(key, name, ends, layers)
        for garment, settings in config["garments"].items():
            value = base_parameters(base_values(settings))[name]
            if name in search["parameters"] and not ends["min"] <= value <= ends["max"]:
                found = f"found {ends['min']:g} to {ends['max']:g}"
                raise fault(layers, key, found, f"the base value {value:g} of {garment} must lie between")


def check_material(place: tuple, settings: Mapping[str, Any], layers: Sequence[Layer]) -> None:
    """The fabric and the values over it, of the garment at ``place``."""
    if "fabric" in settings:
        check_fabric((*place, "fabric"), settings["fabric"], layers)
    for name, value in settings.get("base", {}).items():
        check_parameter((*place, "base", name), name, value, layers)


def check_interval(key: tuple, name: str, bounds: Mapping[str, float], layers: Sequence[Layer]) -> None:
    """Both ends of a range, in order."""
    for end in ("min", "max"):
        check_parameter((*key, end), name, bounds[end], layers)
    if bounds["min"] > bounds["max"]:
        found = f"min {bounds['min']:g} is above max {bounds['max']:g}"
        raise fault(layers, key, found, "min must not be above max")


def check_fabric(key: tuple, name: str, layers: Sequence[Layer]) -> None:
    """A name of sim/fabrics.py."""
    if name not in FABRICS:
        close = difflib.get_close_matches(name, FABRICS, 1)
        hint = f" (did you mean {close[0]!r}?)" if close else ""
        raise fault(layers, key, f"unknown fabric {name!r}{hint}", f"allowed are {', '.join(FABRICS)}")


def check_parameter(key: tuple, name: str, value: float, layers: Sequence[Layer]) -> None:
    """An intrinsic parameter between its limits."""
    check_name(key, name, layers)
    p = parameter(name)
    low, high = p.allowed
    if not low <= value <= high:
        raise fault(layers, key, f"found {value:g}", f"allowed are {low:g} to {high:g} {unit_text(p.unit)}")
    if p.integer and value != int(value):
        raise fault(layers, key, f"found {value:g}", "allowed are whole numbers")


def check_name(key: tuple, name: str, layers: Sequence[Layer]) -> None:
    if name not in PARAMETER_NAMES:
        close = difflib.get_close_matches(name, PARAMETER_NAMES, 1)
        hint = f" (did you mean {close[0]!r}?)" if close else ""
        raise fault(layers, key, f"unknown parameter {name!r}{hint}", f"allowed are {', '.join(PARAMETER_NAMES)}")
