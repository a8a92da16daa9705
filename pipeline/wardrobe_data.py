"""The wardrobe as the models see it: every garment with its template, its sequences and what is held out of it.

In: shards of the plan ``wardrobe``, each beside its template. Out: ``WardrobeGarment`` objects. Two things are held
out, templates and takes, so a sequence is in one of four splits; whole labels that the run holds out are not in the
wardrobe at all.
"""

from __future__ import annotations

import os
from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from datasets.sequences import Sequence, load_sequences
from datasets.shards import WARDROBE, read_header
from datasets.splits import TRAIN, UNSEEN_MOTIONS, UNSEEN_PARAMETERS, SplitRule
from garments.template import GarmentTemplate
from pipeline.stage import Job
from pipeline.wardrobe_plan import CATEGORIES, category_and_number

UNSEEN_TEMPLATES = "unseen_templates"
"""Split of a template that is never trained on, on takes that others are trained on."""

UNSEEN_BOTH = "unseen_templates_and_motions"
"""Split of a template that is never trained on, on held-out takes."""

WARDROBE_SPLITS = (TRAIN, UNSEEN_MOTIONS, UNSEEN_TEMPLATES, UNSEEN_BOTH)

_SEEN_MOTION = (TRAIN, UNSEEN_PARAMETERS)  # of the run's own splits: here no material is held out


@dataclass(frozen=True, eq=False)
class WardrobeGarment:
    """One garment of the wardrobe.

    Attributes:
        template: The garment on the bind-pose body; its name is ``<category>_<number>``.
        category: One of ``CATEGORIES``.
        number: Of the template in its category.
        unseen: Whether it is tested on alone.
        sequences: Its simulations; ``split`` is one of ``WARDROBE_SPLITS``, ``phi`` 0 is the category's fabric and
            any other number a sampled material.
    """

    template: GarmentTemplate
    category: str
    number: int
    unseen: bool
    sequences: tuple[Sequence, ...]

    def in_split(self, *splits: str) -> tuple[Sequence, ...]:
        """Its sequences of the given splits."""
        return tuple(sequence for sequence in self.sequences if sequence.split in splits)


def load_wardrobe(
    paths: Iterable[str | os.PathLike], rule: SplitRule, unseen: int, splits: tuple[str, ...] | None = None
) -> list[WardrobeGarment]:
    """The garments of a wardrobe, in the order of the categories and their numbers.

    Args:
        paths: Shards; the template of each lies beside it, with the suffix ``.npz``.
        rule: Which takes are held out.
        unseen: How many templates of each category, the first, are tested on alone.
        splits: Splits that are wanted, all where None; garments without a sequence in them are left out.

    Raises:
        FileNotFoundError: A template is not there.
        ValueError: In one sentence: a shard of another plan, a template that is not the shard's, two shards of one
            garment, an unknown split, or no sequence at all.
    """
    unknown = sorted(set(splits or ()) - set(WARDROBE_SPLITS))
    if unknown:
        raise ValueError(f"wardrobe: split {unknown[0]!r} is not one of {', '.join(WARDROBE_SPLITS)}")
    garments: dict[str, WardrobeGarment] = {}
    for path in map(Path, paths):
        garment = _garment(path, rule, unseen, splits)
        name = garment.template.name
        if name in garments:
            raise ValueError(f"{path}: garment '{name}' is in another shard too")
        garments[name] = garment
    found = [garment for garment in garments.values() if garment.sequences]
    if not found:
        wanted = ", ".join(splits or ("any",))
        raise ValueError(f"wardrobe: no simulated sequence in splits {wanted}; were all of them dropped?")
    return sorted(found, key=lambda garment: (CATEGORIES.index(garment.category), garment.number))


def job_wardrobe(job: Job, splits: tuple[str, ...] | None = None) -> list[WardrobeGarment]:
    """The wardrobe among the inputs of a job whose specification holds what ``wardrobe_learning`` says."""
    templates = {Path(path) for path in job.inputs if path.endswith(".npz")}
    shards = [path for path in job.inputs if path.endswith(".h5") and Path(path).with_suffix(".npz") in templates]
    return load_wardrobe(shards, SplitRule(**job.spec["splits"]), job.spec["wardrobe"]["unseen"], splits)


def material_vector(sequence: Sequence, names: Iterable[str]) -> np.ndarray:
    """Intrinsic parameters of a sequence in their SI units, in the order of the names, shape [K] float64."""
    return np.array([sequence.parameters[name] for name in names], dtype=np.float64)


def _garment(path: Path, rule: SplitRule, unseen: int, splits: tuple[str, ...] | None) -> WardrobeGarment:
    header = read_header(path)
    if header.plan != WARDROBE:
        raise ValueError(f"{path}: a shard of the plan {header.plan!r}, not of the {WARDROBE}")
    template_path = path.with_suffix(".npz")
    template = GarmentTemplate.load(template_path)
    same = np.array_equal(template.faces, header.template_faces)
    same = same and np.array_equal(template.vertices, header.template_vertices)
    if template.name != header.garment or template.body_digest != header.body_digest or not same:
        raise ValueError(f"{template_path}: not the template that {path} was simulated with; make both again")
    try:
        category, number = category_and_number(template.name)
    except ValueError as error:
        raise ValueError(f"{path}: {error}") from None
    hidden = number < unseen
    sequences = []
    for sequence in load_sequences([path], rule, plans=(WARDROBE,)):
        held_out = sequence.split not in _SEEN_MOTION
        split = (UNSEEN_BOTH if held_out else UNSEEN_TEMPLATES) if hidden else (UNSEEN_MOTIONS if held_out else TRAIN)
        if splits is None or split in splits:
            sequences.append(replace(sequence, split=split))
    return WardrobeGarment(template, category, number, hidden, tuple(sequences))
