"""The wardrobe: garments of all categories, simulated for networks that dress any garment (Peng 2023, section 4.1).

For every category (a garment kind; the paper's trousers are ``pants``) there are templates of differing measures and
numbers of vertices. Each is simulated on clips of its own in its category's fabric, on further clips in a sampled
material each, and on held-out clips that all templates share. The first ``unseen`` templates of every category are
tested on alone, so that asking for more templates appends to those that are trained on.

Everything is a function of the configuration alone; a template, its clips and its materials of its own number and the
run's seed, so that more of them never change an earlier one.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Mapping
from typing import Any

from datasets.shards import WARDROBE
from datasets.splits import UNSEEN_MOTIONS, SplitRule
from pipeline.canonical import canonical
from pipeline.plan import GOLDEN, PlannedClip, plan_clips
from sim.fabrics import base_values

Config = Mapping[str, Any]

CATEGORIES = ("tshirt", "top", "pants", "jumpsuit", "skirt", "dress")
"""Garment kinds that a wardrobe may hold, in the order of the paper's Table 2."""

SHORTEST_SAMPLED_SLEEVE = 0.15
"""A shorter sleeve is none [m]: of a loose garment it would end in the fabric under the armpit."""

_STEPS = {
    "vertices": GOLDEN,
    "length": math.sqrt(2.0),
    "ease": math.sqrt(3.0),
    "flare": math.sqrt(5.0),
    "sleeve": math.sqrt(7.0),
    "neck": math.sqrt(11.0),
    "strap": math.sqrt(13.0),
    "close": math.sqrt(17.0),
}
"""Multiples of irrational numbers, without their whole part, spread each measure over its range evenly (Weyl)."""


def wardrobe_names(config: Config) -> list[str]:
    """Names of all templates, ``<category>_<number>``, category by category."""
    settings = config["wardrobe"]
    return [f"{category}_{i:02d}" for category in settings["categories"] for i in range(settings["templates"])]


def category_and_number(name: str) -> tuple[str, int]:
    """Category and number of a template's name; ``ValueError`` for another name."""
    category, _, number = name.rpartition("_")
    if category not in CATEGORIES or not number.isdecimal():
        raise ValueError(
            f"{name!r} is no template of a wardrobe; they are called <category>_<number>, categories are "
            f"{', '.join(CATEGORIES)}"
        )
    return category, int(number)


def template_geometry(config: Config, name: str) -> dict[str, Any]:
    """Kind, number of vertices and measures [m] of a template, as ``garments.spec.GarmentSpec`` takes them."""
    category, number = category_and_number(name)
    settings = config["wardrobe"]

    def sampled(what: str, low: float, high: float) -> float:
        return low + _spread(config["seed"], category, what, number) * (high - low)

    ends = settings["vertices"]
    count = math.exp(sampled("vertices", math.log(ends["min"]), math.log(ends["max"])))
    geometry: dict[str, Any] = {"kind": category, "vertices": round(count)}
    for measure, ends in settings["garments"][category]["measures"].items():
        geometry[measure] = round(sampled(measure, ends["min"], ends["max"]), 3)
    if 0.0 < geometry.get("sleeve", 0.0) < SHORTEST_SAMPLED_SLEEVE:
        geometry["sleeve"] = 0.0
    if geometry.get("sleeve", 0.0) > 0.0:
        geometry.pop("strap", None)
    return geometry


def template_simulations(config: Config, name: str) -> list[tuple[int, PlannedClip]]:
    """The (parameter set, clip) pairs of a template; set 0 is its category's fabric, each other set is on one clip."""
    settings = config["wardrobe"]
    shared = shared_clips(config)
    own = _own_clips(config, name, settings["clips"] + settings["materials"])
    # The category's fabric has the first of the clips, also where there are fewer of them than asked for.
    sets = [0] * settings["clips"] + list(range(1, settings["materials"] + 1))
    return [(0, clip) for clip in shared] + list(zip(sets, own))


def shared_clips(config: Config) -> list[PlannedClip]:
    """Held-out clips of known labels that every template is simulated on, at most ``shared``, evenly spread."""
    rule = SplitRule(**config["data"]["splits"])
    clips = [c for c in plan_clips(config["motions"]) if rule.split(0, c.take_index, c.label) == UNSEEN_MOTIONS]
    count = min(config["wardrobe"]["shared"], len(clips))
    return [clips[i * len(clips) // count] for i in range(count)]


def template_batches(config: Config, name: str) -> list[int]:
    """The motion batches that a template's simulations use."""
    size = config["motions"]["clips_per_batch"]
    return sorted({clip.index // size for _, clip in template_simulations(config, name)})


def wardrobe_spec(config: Config, name: str) -> str:
    """A template and its shard: geometry, material, clips and the solver's settings."""
    category, _ = category_and_number(name)
    settings = config["wardrobe"]
    return canonical(
        {
            "garment": name,
            "plan": WARDROBE,
            "geometry": template_geometry(config, name),
            "seed": config["seed"],
            "body": config["body"],
            "base": base_values(settings["garments"][category]),
            "ranges": {parameter: [ends["min"], ends["max"]] for parameter, ends in settings["ranges"].items()},
            "simulations": [[phi, c.name, c.take_index] for phi, c in template_simulations(config, name)],
            "fps": config["motions"]["fps"],
            "lead_in": config["motions"]["lead_in"],
            "solver": config["simulation"],
        }
    )


def wardrobe_learning(config: Config) -> dict[str, Any]:
    """What a stage that learns from the wardrobe has to know, to be merged into its own specification.

    ``splits`` as everywhere, and in ``wardrobe`` how many templates of each category are ``unseen`` and the names of
    the intrinsic parameters by which ``materials`` differ.
    """
    settings = config["wardrobe"]
    return {
        "splits": config["data"]["splits"],
        "wardrobe": {"unseen": settings["unseen"], "materials": sorted(settings["ranges"])},
    }


def _own_clips(config: Config, name: str, count: int) -> list[PlannedClip]:
    """Consecutive clips, from a place of the template's own; none of a label held out whole, none of the shared."""
    category, number = category_and_number(name)
    rule, shared = SplitRule(**config["data"]["splits"]), {clip.name for clip in shared_clips(config)}
    clips = [
        clip
        for clip in plan_clips(config["motions"])
        if not rule.holds_out_label(clip.label) and clip.name not in shared
    ]
    run = number * len(CATEGORIES) + CATEGORIES.index(category)
    start = int(run * GOLDEN % 1.0 * len(clips))
    return [clips[(start + i) % len(clips)] for i in range(min(count, len(clips)))]


def _spread(seed: int, category: str, what: str, number: int) -> float:
    """A number in 0..1 for each template of a category, evenly spread however many there are."""
    digest = hashlib.sha256(f"{seed}/wardrobe/{category}/{what}".encode()).digest()
    return (int.from_bytes(digest[:8], "little") / 2.0**64 + number * _STEPS[what]) % 1.0
