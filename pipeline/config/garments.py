"""What a schema cannot say of garments: kinds, their measures, meshes and outfits; and of the wardrobe."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from garments.mesh_file import MESH_FILES
from garments.spec import MEASURES, VERTEX_LIMITS
from pipeline.config.layers import Layer, fault
from pipeline.config.materials import check_interval, check_material
from pipeline.spec import MATERIAL_KEYS, worn_name
from pipeline.wardrobe_checks import wardrobe_faults


def check_garments(config: Mapping[str, Any], layers: Sequence[Layer]) -> None:
    """Each garment has the measures of its kind, between their limits."""
    for name, settings in config["garments"].items():
        place = ("garments", name)
        shape = {key: value for key, value in settings.items() if key not in MATERIAL_KEYS}
        if shape["kind"] == "outfit":
            _check_outfit(place, shape, config["garments"], layers)
        else:
            _check_shape(place, shape, layers)


def check_wardrobe(config: Mapping[str, Any], layers: Sequence[Layer]) -> None:
    """Materials, ranges and measures of the wardrobe."""
    wardrobe = config["wardrobe"]
    for name, ends in wardrobe["ranges"].items():
        check_interval(("wardrobe", "ranges", name), name, ends, layers)
    for category, settings in wardrobe["garments"].items():
        check_material(("wardrobe", "garments", category), settings, layers)
    for key, found, allowed in wardrobe_faults(wardrobe):
        raise fault(layers, ("wardrobe", *key), found, allowed)


def check_systems(config: Mapping[str, Any], layers: Sequence[Layer]) -> None:
    """The garment that all systems are compared on: the layers of the Mesh VAE-GAN know T-shirts, and no other top."""
    name, key = config["systems"]["garment"], ("systems", "garment")
    known = [garment for garment, settings in config["garments"].items() if settings["kind"] == "tshirt"]
    if name and name not in known:
        allowed = f"{', '.join(known)} or ''" if known else "''"
        raise fault(layers, key, f"found {name!r}", f"allowed are the garments of kind tshirt: {allowed}")


def _check_shape(place: tuple, shape: Mapping[str, Any], layers: Sequence[Layer]) -> None:
    kind = shape["kind"]
    if kind == "mesh":
        _check_mesh_garment(place, shape, layers)
        return
    if kind not in MEASURES:
        known = ", ".join(sorted([*MEASURES, "mesh", "outfit"]))
        raise fault(layers, (*place, "kind"), f"unknown garment {kind!r}", f"allowed are {known}")
    if "vertices" not in shape:
        raise fault(layers, (*place, "vertices"), "the key is missing", f"garments of kind {kind} need it")
    limits = {measure: (m.low, m.high) for measure, m in MEASURES[kind].items()} | {"vertices": VERTEX_LIMITS[kind]}
    for measure in sorted(set(shape) - {"kind"}):
        if measure not in limits:
            known = ", ".join(MEASURES[kind])
            raise fault(layers, (*place, measure), f"a {kind} has no such measure", f"allowed are {known}")
        low, high = limits[measure]
        if not low <= shape[measure] <= high:
            unit = {"vertices": "vertices", "flare": "m/m"}.get(measure, "m")
            found = f"found {shape[measure]:g}"
            raise fault(layers, (*place, measure), found, f"allowed are {low:g} to {high:g} {unit} for a {kind}")


def _check_mesh_garment(place: tuple, shape: Mapping[str, Any], layers: Sequence[Layer]) -> None:
    """The file's content is an input of the workflow and checked where it is read."""
    known = ("file", "worn_as", "scale", "held")
    for key in sorted(set(shape) - {"kind"}):
        if key not in known:
            raise fault(layers, (*place, key), "a mesh has no such key", f"allowed are {', '.join(known)}")
    for key in known[:2]:
        if key not in shape:
            raise fault(layers, (*place, key), "the key is missing", "a mesh needs file and worn_as")
    path = Path(shape["file"])
    if path.suffix.lower() not in MESH_FILES:
        raise fault(layers, (*place, "file"), f"found {str(path)!r}", f"allowed are names in {', '.join(MESH_FILES)}")
    if not path.is_file():
        raise fault(layers, (*place, "file"), f"{str(path)!r} is no file", "name a mesh file, from where you stand")


def _check_outfit(place: tuple, shape: Mapping[str, Any], garments: Mapping[str, Any], layers: Sequence[Layer]) -> None:
    """Each garment worn is one of the configuration, by its name, or described here without a material of its own."""
    for key in sorted(set(shape) - {"kind", "worn"}):
        raise fault(layers, (*place, key), "an outfit has no such key", "allowed are worn, fabric, base, ranges")
    key = (*place, "worn")
    if "worn" not in shape:
        raise fault(layers, key, "the key is missing", "an outfit needs a list of garments, innermost first")
    for number, one in enumerate(shape["worn"]):
        if isinstance(one, str):
            single = [name for name, other in garments.items() if other["kind"] != "outfit"]
            if one not in single:
                raise fault(layers, (*key, number), f"found {one!r}", f"allowed are {', '.join(single)}")
            continue
        for extra in MATERIAL_KEYS:
            if extra in one:
                found = "a garment of an outfit has no material of its own"
                raise fault(layers, (*key, number, extra), found, "all its cloth takes that of the outfit")
        if one["kind"] == "outfit":
            raise fault(layers, (*key, number, "kind"), "found 'outfit'", "an outfit is worn over no other")
        _check_shape((*key, number), {k: v for k, v in one.items() if k != "name"}, layers)
    names = [worn_name(one) for one in shape["worn"]]
    twice = next((name for name in names if names.count(name) > 1), None)
    if twice is not None:
        raise fault(layers, key, f"two garments are called {twice!r}", "each needs a name of its own")
