"""What determines the comparison of all systems on one garment, as canonical JSON (see ``pipeline.spec``)."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from typing import Any

from datasets.shards import BODIES, MATERIALS, MOTIONS
from datasets.splits import TRAIN, SplitRule
from pipeline.canonical import canonical
from pipeline.plan import shard_names, shard_plan, shard_simulations, tested_clips
from pipeline.spec import layer_simulate_spec, layer_types
from pipeline.wardrobe_plan import category_and_number, template_simulations, wardrobe_names

Config = Mapping[str, Any]

PAPER, TOLD = "paper", "conditioned"
"""Variants compared beside the one in use: the published network, and the regressor that is told the material."""

MODELS = ("garment_regressor", "motion_invariant", "gsnet", "mesh_vae_gan")
"""Models of the four systems, in the order of the table."""


def compared_garment(config: Config) -> str:
    """The garment that all systems dress; empty where there is no comparison."""
    return config["systems"]["garment"]


def compared_variants(config: Config, model: str) -> list[str]:
    """The published variant and the one in use, as far as they are configured; of regressors the told one too."""
    settings = config["models"][model]
    wanted = (PAPER, settings["use"], *([TOLD] if model == "garment_regressor" else []))
    return [variant for variant in dict.fromkeys(wanted) if variant in settings["variants"]]


def compare_systems_spec(config: Config) -> str:
    """The comparison: what is tested, and what each system was trained on."""
    rule = SplitRule(**config["data"]["splits"])
    garment = compared_garment(config)
    return canonical(
        {
            "garment": garment,
            "body": config["body"],
            "splits": config["data"]["splits"],
            "tested_clips": [clip.name for clip in tested_clips(config)],
            "evaluation": {"frames_stride": config["evaluation"]["frames_stride"]},
            "refinement": config["models"]["refinement"],
            "types": layer_types(config),
            "variants": {model: compared_variants(config, model) for model in MODELS},
            "use": {model: config["models"][model]["use"] for model in MODELS},
            "trained_on": {
                "own motions": [1, _of_garment(config, rule, (MOTIONS,))],
                "own materials": [1, _of_garment(config, rule, (MATERIALS,))],
                "own, all": [1, _of_garment(config, rule, (MATERIALS, MOTIONS, BODIES))],
                "wardrobe": _of_wardrobe(config, rule),
                "layers": _of_layers(config),
            },
            "report": {name: config["report"][name] for name in ("width", "height")},
        }
    )


def _of_garment(config: Config, rule: SplitRule, plans: Iterable[str]) -> int:
    """Simulations of the garment that are planned to be trained on."""
    count = 0
    for shard in shard_names(config, tuple(plans)):
        on_bodies = shard_plan(shard)[0] == BODIES
        for number, clip in shard_simulations(config, shard):
            phi, body = (0, number) if on_bodies else (number, 0)
            count += rule.split(phi, clip.take_index, clip.label, body) == TRAIN
    return count


def _of_wardrobe(config: Config, rule: SplitRule) -> list[int]:
    """Garments of the wardrobe and simulations of them that are planned to be trained on."""
    seen = [n for n in wardrobe_names(config) if category_and_number(n)[1] >= config["wardrobe"]["unseen"]]
    clips = [clip for name in seen for _, clip in template_simulations(config, name)]
    return [len(seen), sum(not rule.holds_out_take(clip.take_index) for clip in clips)]


def _of_layers(config: Config) -> list[int]:
    """Outfits and simulations of them that are planned to be trained on."""
    types = layer_types(config)
    planned = [one for kind in types for one in json.loads(layer_simulate_spec(config, kind))["simulations"]]
    rule = SplitRule(**config["data"]["splits"] | {"bodies_every": config["data"]["layers"]["bodies_every"]})
    # None of the clips is of a label that is held out.
    return [len(types), sum(rule.split(0, take, body_index=body) == TRAIN for body, _, take in planned)]
