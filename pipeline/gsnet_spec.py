"""What determines the outputs of the rules about GSNet, as one canonical JSON string each (see ``pipeline.spec``)."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from evaluation.seeds import split_seed
from pipeline.canonical import canonical
from pipeline.spec import trained_variants, variant_settings
from pipeline.wardrobe_plan import category_and_number, wardrobe_learning, wardrobe_names
from sim.fabrics import base_values

Config = Mapping[str, Any]
MODEL = "gsnet"

OF_ONE_GARMENT = ("tailornet", "pbns")
"""Kinds that dress the templates they were made for, and no others."""


def train_gsnet_spec(config: Config, variant: str) -> str:
    """A trained variant; one may be a repetition from another seed, as ``trained_variants`` names it."""
    name, number = split_seed(variant)
    spec = _learning(config) | {"model": variant_settings(config["models"][MODEL]["variants"], name)}
    return canonical(spec | {"variant": variant, "seed": config["seed"] + number - 1})


def evaluate_gsnet_spec(config: Config) -> str:
    """The evaluation of all variants, and the garments with long simulations."""
    spec = _learning(config) | {"evaluation": {"frames_stride": config["evaluation"]["frames_stride"]}}
    spec |= {"refinement": config["models"]["refinement"], "use": config["models"][MODEL]["use"]}
    return canonical(spec | {"variants": trained_variants(config, MODEL), "long": sorted(config["garments"])})


def drawn_networks(config: Config) -> list[str]:
    """The network in use, then the trained ones of other kinds that can dress a template which they never saw."""
    settings = config["models"][MODEL]
    variants, use = settings["variants"], settings["use"]
    own = variant_settings(variants, use)["kind"]
    others = [v for v in variants if "like" not in variants[v] and variants[v]["kind"] not in (own, *OF_ONE_GARMENT)]
    return [use, *(v for v in others if v != use)]


def render_gsnet_spec(config: Config) -> str:
    """Pictures of unseen templates."""
    size = {name: config["report"][name] for name in ("width", "height")}
    return canonical(_learning(config) | {"networks": drawn_networks(config), "report": size})


def timed_templates(config: Config) -> list[str]:
    """Of each category the first template that is trained on; any where none is."""
    seen = [n for n in wardrobe_names(config) if category_and_number(n)[1] >= config["wardrobe"]["unseen"]]
    first: dict[str, str] = {}
    for name in seen or wardrobe_names(config):
        first.setdefault(category_and_number(name)[0], name)
    return list(first.values())


def time_gsnet_spec(config: Config) -> str:
    """The timing: base parameters of each timed template, settings of solver and refinement."""
    garments = config["wardrobe"]["garments"]
    names = timed_templates(config)
    return canonical(
        {
            "body": config["body"],
            "bases": [base_values(garments[category_and_number(name)[0]]) for name in names],
            "fps": config["motions"]["fps"],
            "lead_in": config["motions"]["lead_in"],
            "timing": {name: config["timing"][name] for name in ("frames", "warmup")},
            "fine": config["body"]["resolution"] == "full",
            "refinement": config["models"]["refinement"],
        }
    )


def _learning(config: Config) -> dict[str, Any]:
    return {"body": config["body"]} | wardrobe_learning(config)
