"""What a schema cannot say about the configuration of a wardrobe."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

from garments.spec import MEASURES, VERTEX_LIMITS

Fault = tuple[tuple[str, ...], str, str]
"""Key below ``wardrobe``, what was found there, and what is allowed."""


def wardrobe_faults(wardrobe: Mapping[str, Any]) -> Iterator[Fault]:
    """Everything that is wrong with the section ``wardrobe`` of a configuration, one by one."""
    templates, unseen = wardrobe["templates"], wardrobe["unseen"]
    if unseen >= templates:
        yield ("unseen",), f"found {unseen} of {templates} templates", "at least one must be left to train on"
    for category in wardrobe["categories"]:
        if category not in wardrobe["garments"]:
            known = ", ".join(wardrobe["garments"])
            yield ("categories",), f"found {category!r}", f"allowed are the garments that are described: {known}"
            continue
        yield from _outside(("vertices",), wardrobe["vertices"], *VERTEX_LIMITS[category], category)
    for category, settings in wardrobe["garments"].items():
        for measure, ends in settings["measures"].items():
            key = ("garments", category, "measures", measure)
            if measure not in MEASURES[category]:
                yield key, f"a {category} has no such measure", f"allowed are {', '.join(MEASURES[category])}"
                continue
            limits = MEASURES[category][measure]
            yield from _outside(key, ends, limits.low, limits.high, category)


def _outside(
    key: tuple[str, ...], ends: Mapping[str, float], low: float, high: float, category: str
) -> Iterator[Fault]:
    for end in ("min", "max"):
        if not low <= ends[end] <= high:
            yield (*key, end), f"found {ends[end]:g}", f"allowed are {low:g} to {high:g} for a {category}"
    if ends["min"] > ends["max"]:
        yield key, f"min {ends['min']:g} is above max {ends['max']:g}", "min must not be above max"
