"""The data plan: which clips there are, in which batch, and which simulations make up which shard.

Everything is a function of the configuration alone, so that the workflow knows its jobs before the first one runs.
Clips and parameter sets are numbered so that asking for more appends: an earlier number never changes its meaning.

Three plans per garment (the papers need the first two; both name other bodies as what they lack):

- ``materials`` (Wang 2019): many sampled parameter sets, each on a few clips, as many sets on each;
- ``motions`` (Shi 2023): the base parameters on every clip;
- ``bodies``: many sampled body shapes, each in a garment graded to it, base parameters, each on clips of its own.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from datasets.shards import BODIES, MATERIALS, MOTIONS
from datasets.splits import UNSEEN_LABELS, UNSEEN_MOTIONS, UNSEEN_STYLES, SplitRule
from sim.parameters import ENSEMBLE

GOLDEN = 0.6180339887498949
"""Multiples of it, without their whole part, fill the unit interval evenly however many there are."""


@dataclass(frozen=True)
class PlannedClip:
    """A clip before it is made.

    Attributes:
        index: Number of the clip in the run.
        name: Unique name.
        label: Motion label.
        take: Recording that it is cut from, the unit of the split; a procedural clip is its own take.
        take_index: Number of the take.
        part: Variant of a procedural clip; number of the window in a recording.
    """

    index: int
    name: str
    label: str
    take: str
    take_index: int
    part: int


def plan_clips(motions: Mapping[str, Any]) -> list[PlannedClip]:
    """All clips of a run, in order; ``ValueError`` for unknown labels or an unusable folder."""
    planned = _plan_procedural(motions) if motions["source"] == "procedural" else _plan_bvh(motions)
    return planned[: motions["max_clips"]]


def learning_clips(motions: Mapping[str, Any]) -> list[PlannedClip]:
    """Clips of the motion models: those of the run, then ``unsimulated`` times as many that are never dressed.

    A pose costs next to nothing and a simulation much, so the networks that see poses alone get more of them.
    """
    times = 1 + motions["unsimulated"]
    procedural, bvh = motions["procedural"], motions["bvh"]
    more = {
        **motions,
        "max_clips": motions["max_clips"] * times,
        "procedural": {**procedural, "variants": procedural["variants"] * times},
        "bvh": {**bvh, "clips_per_take": bvh["clips_per_take"] * times},
    }
    simulated = plan_clips(motions)
    names = {clip.name for clip in simulated}
    return simulated + [clip for clip in plan_clips(more) if clip.name not in names]


def motion_labels(motions: Mapping[str, Any]) -> list[str]:
    """The labels of a run, sorted: their order is the networks' numbering."""
    return sorted({clip.label for clip in plan_clips(motions)})


def tested_clips(config: Mapping[str, Any]) -> list[PlannedClip]:
    """The clips that regressors are evaluated on: at most ``data.tests.clips`` a held-out split, evenly spread."""
    rule, most = SplitRule(**config["data"]["splits"]), config["data"]["tests"]["clips"]
    by_split: dict[str, list[PlannedClip]] = {split: [] for split in (UNSEEN_MOTIONS, UNSEEN_STYLES, UNSEEN_LABELS)}
    for clip in plan_clips(config["motions"]):
        split = rule.split(0, clip.take_index, clip.label)
        if split in by_split:
            by_split[split].append(clip)
    chosen = []
    for clips in by_split.values():
        count = min(most, len(clips))
        chosen += [clips[i * len(clips) // count] for i in range(count)]
    return chosen


def _plan_procedural(motions: Mapping[str, Any]) -> list[PlannedClip]:
    from motions.procedural import DEFAULT_LABELS, LABELS

    asked = motions["procedural"]["labels"]
    labels = {"default": DEFAULT_LABELS, "all": LABELS}[asked] if isinstance(asked, str) else asked
    if isinstance(labels, int):
        if labels > len(LABELS):
            raise ValueError(f"{labels} labels are asked for, the generator knows {len(LABELS)}")
        labels = LABELS[:labels]
    for label in labels:
        if label not in LABELS:
            raise ValueError(f"unknown motion label {label!r}; known are {', '.join(LABELS)}")
    # Variant by variant, so that more variants append.
    pairs = [(label, variant) for variant in range(motions["procedural"]["variants"]) for label in labels]
    names = [f"{label}_{variant:03d}" for label, variant in pairs]
    return [PlannedClip(i, n, p[0], n, i, p[1]) for i, (n, p) in enumerate(zip(names, pairs))]


def _plan_bvh(motions: Mapping[str, Any]) -> list[PlannedClip]:
    from motions.bvh_folder import list_takes

    settings = motions["bvh"]
    if not settings["folder"]:
        raise ValueError("no folder is given; name the folder that holds the BVH files and their labels.csv")
    takes = list_takes(Path(settings["folder"]), settings["labels"])
    takes = _interleaved_by_label(takes, settings["takes_per_label"])
    windows = {t.file: t.clip_count(motions["frames"], motions["fps"]) for t in takes}
    planned = []
    # Window by window, so that the first clips show as many takes and labels as there are.
    for part in range(settings["clips_per_take"]):
        for number, take in enumerate(takes):
            if part < windows[take.file]:
                name = f"{Path(take.file).stem}_{part:03d}"
                planned.append(PlannedClip(len(planned), name, take.label, take.file, number, part))
    if not planned:
        raise ValueError(f"{settings['folder']}: no recording is as long as one clip of {motions['frames']} frames")
    names = [clip.name for clip in planned]
    if len(set(names)) < len(names):
        twice = next(n for n in names if names.count(n) > 1)
        raise ValueError(f"{settings['folder']}: two recordings share the file name of clip {twice!r}; rename one")
    return planned


def _interleaved_by_label(takes: list, least: int) -> list:
    """One take of every label that has at least ``least``, then the second of every label, and so on."""
    counts = Counter(take.label for take in takes)
    rank: dict[str, int] = {}
    keyed = []
    for position, take in enumerate(takes):
        if counts[take.label] < least:
            continue
        rank[take.label] = rank.get(take.label, -1) + 1
        keyed.append((rank[take.label], position, take))
    return [take for _, _, take in sorted(keyed, key=lambda k: k[:2])]


def batch_count(motions: Mapping[str, Any]) -> int:
    """Number of motion batch files that are simulated."""
    return -(-len(plan_clips(motions)) // motions["clips_per_batch"])


def learning_batch_count(motions: Mapping[str, Any]) -> int:
    """Number of all motion batch files; those that are not simulated come last."""
    more = len(learning_clips(motions)) - len(plan_clips(motions))
    return batch_count(motions) + -(-more // motions["clips_per_batch"])


def batch_clips(motions: Mapping[str, Any], batch: int) -> list[PlannedClip]:
    """The clips of one batch file, simulated or not."""
    size, simulated = motions["clips_per_batch"], plan_clips(motions)
    number = batch - batch_count(motions)
    if number < 0:
        return simulated[batch * size : (batch + 1) * size]
    return learning_clips(motions)[len(simulated) :][number * size : (number + 1) * size]


def shard_names(config: Mapping[str, Any], plans: Collection[str] = (MATERIALS, MOTIONS, BODIES)) -> list[str]:
    """Names of a garment's shards of the given plans: ``materials_0000`` ..., ``motions_0000`` ..., ``bodies_0000``."""
    materials, bodies = config["data"]["materials"], config["data"]["bodies"]
    counts = {
        MATERIALS: materials["samples"] // materials["samples_per_shard"],
        MOTIONS: batch_count(config["motions"]),
        BODIES: bodies["samples"] // bodies["samples_per_shard"],
    }
    return [f"{plan}_{i:04d}" for plan, count in counts.items() if plan in plans for i in range(count)]


def shard_plan(shard: str) -> tuple[str, int]:
    """Plan and number of a shard name."""
    plan, number = shard.rsplit("_", 1)
    return plan, int(number)


def shard_batches(config: Mapping[str, Any], shard: str) -> list[int]:
    """The motion batches that a shard's simulations use."""
    plan, number = shard_plan(shard)
    if plan == MOTIONS:
        return [number]
    size = config["motions"]["clips_per_batch"]
    return sorted({clip.index // size for _, clip in shard_simulations(config, shard)})


def shard_simulations(config: Mapping[str, Any], shard: str) -> list[tuple[int, PlannedClip]]:
    """The (number, clip) pairs of a shard.

    The number is that of the parameter set, 0 the base set; in the plan of bodies it is that of the body shape.
    """
    plan, number = shard_plan(shard)
    if plan == MOTIONS:
        return [(0, clip) for clip in batch_clips(config["motions"], number)]
    size = config["data"][plan]["samples_per_shard"]
    clips = body_clips if plan == BODIES else material_clips
    sampled = range(number * size + 1, (number + 1) * size + 1)
    return [(sample, clip) for sample in sampled for clip in clips(config, sample)]


def material_clips(config: Mapping[str, Any], phi: int) -> list[PlannedClip]:
    """The clips that a parameter set is simulated on; none of a label that is held out whole.

    With ``own_clips`` every sixteen sets, which are simulated together, have a run of clips of their own. Otherwise the
    first clips, the same for all sets (Wang 2019).
    """
    materials = config["data"]["materials"]
    return _run_of_clips(config, (phi - 1) // ENSEMBLE if materials["own_clips"] else 0, materials["clips"])


def body_clips(config: Mapping[str, Any], number: int) -> list[PlannedClip]:
    """The clips that a body shape is simulated on, a run of its own; none of a label that is held out whole."""
    return _run_of_clips(config, number - 1, config["data"]["bodies"]["clips"])


def layer_clips(config: Mapping[str, Any], number: int, body: int | None = None) -> list[PlannedClip]:
    """The clips of a type of clothing: some to train on, some of takes that are held out; none of a held-out label.

    Bodies that are trained on have clips of their own: as many simulations show more motions. A body that is held out
    has those of one that is not, so that its clips are seen ones. Types take turns with two sets of clips. All are
    evenly spread over the run, and begin anew where it has fewer than are asked for.

    Args:
        config: The run.
        number: Number of the type.
        body: Number of the body; None for the clips of all bodies.
    """
    layers = config["data"]["layers"]
    rule = SplitRule(**config["data"]["splits"] | {"bodies_every": layers["bodies_every"]})
    bodies = range(1, layers["bodies"] + 1)
    if body is None:
        return list(dict.fromkeys(clip for one in bodies for clip in layer_clips(config, number, one)))
    held_out = rule.holds_out_body(body)
    place = [one for one in bodies if rule.holds_out_body(one) is held_out].index(body)
    trained = sum(not rule.holds_out_body(one) for one in bodies)
    turn = (number + number // 2) % 2  # of four types, those that have no length in common share their clips
    start, step = 2 * (place % trained) + turn, 2 * trained
    usable = [clip for clip in plan_clips(config["motions"]) if not rule.holds_out_label(clip.label)]
    chosen: list[PlannedClip] = []
    for wanted, unseen in ((layers["clips"], False), (layers["unseen_clips"], True)):
        clips = [clip for clip in usable if rule.holds_out_take(clip.take_index) is unseen]
        # By the golden ratio, for even steps would meet the same few labels in every round of variants.
        order = np.argsort(np.arange(len(clips)) * GOLDEN % 1.0, kind="stable")
        rank = np.argsort(order, kind="stable")
        chosen += dict.fromkeys(clips[rank[(start + step * k) % len(clips)]] for k in range(wanted)) if clips else ()
    return chosen


def _run_of_clips(config: Mapping[str, Any], run: int, count: int) -> list[PlannedClip]:
    """Consecutive clips of the whole run, round the end if need be.

    Where it starts is spread over all clips by the golden ratio: more runs or longer ones change no earlier one.
    """
    rule = SplitRule(**config["data"]["splits"])
    clips = [clip for clip in plan_clips(config["motions"]) if not rule.holds_out_label(clip.label)]
    start = int(run * GOLDEN % 1.0 * len(clips))
    return [clips[(start + i) % len(clips)] for i in range(min(count, len(clips)))]
