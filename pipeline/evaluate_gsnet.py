"""Stage ``evaluate_gsnet``: GSNet beside its baselines on garments seen and unseen (Peng 2023, section 4).

In: the trained variants with their losses, garments with long simulations, and the wardrobe. Out: the tables

- ``gsnet``: error, edge, bend and collision of every method in every split, and what it took to train (Table 1; the
  ablation of Table 3 is in it);
- ``gsnet_categories``: the same, category by category (Table 2);
- ``gsnet_gap``: train-test gap, on seen and unseen templates (Fig. 7);
- ``gsnet_stability``: error on held-out clips over the epochs (Fig. 8);
- ``gsnet_contact``: vertices inside the body before and after the physical regressor and the projection;
- ``gsnet_drift``: errors along a roll-out over long motions.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from collections.abc import Sequence as Many

import numpy as np
import torch

from body.model import Body
from datasets.sequences import Sequence, load_sequences
from datasets.shards import LONG
from datasets.splits import SplitRule
from evaluation.baselines import SkinnedRidge
from evaluation.collisions import Contact
from evaluation.drift import drift_rows
from evaluation.regressor import Predictor
from evaluation.table import Row, read_table, write_table
from evaluation.wardrobe import TestMotion, averaged, contact_rows, gap_rows, stability_rows
from garments.template import GarmentTemplate
from models.garment_animator import Animator
from models.garment_graph import GarmentGraph, material_row
from models.gsnet_fitting import build_animator, load_animator
from models.physical_regressor import corrector
from models.refinement import RefinementSettings
from pipeline.gsnet_data import dressed
from pipeline.progress import Progress
from pipeline.sequence_data import job_body
from pipeline.stage import Job, run_stage
from pipeline.wardrobe_data import (
    TRAIN,
    UNSEEN_BOTH,
    UNSEEN_MOTIONS,
    UNSEEN_TEMPLATES,
    WARDROBE_SPLITS,
    WardrobeGarment,
    job_wardrobe,
)

MOST = {TRAIN: 2, UNSEEN_MOTIONS: 6, UNSEEN_TEMPLATES: 6, UNSEEN_BOTH: 6}
"""Sequences of a garment in each split that are dressed, the clips that all templates share first."""

CONTACT = 3
"""Of these, sequences whose vertices are brought out of the body."""

LONG_MOTIONS = 3
"""Long simulations of a garment."""

FLOOR = "ridge on skinning (per garment)"
"""The floor that nothing has to be trained for; it has no rows for templates that it was not fitted to."""


def main(job: Job) -> None:
    """Dress the test sequences with every method, then lay the figures together."""
    torch.set_num_threads(job.threads)
    spec, variants = job.spec, job.spec["variants"]
    paths, losses, rest = _split(job.inputs, len(variants), len(variants))
    # Of thousands of frames on one body, every second one of those that the costly figures elsewhere look at will do.
    body, stride = job_body(job), 2 * spec["evaluation"]["frames_stride"]
    animators = dict(zip(variants, map(load_animator, paths), strict=True))
    names = animators[spec["use"]].config.materials
    skinning = build_animator("skinning", {"materials": names, "body": body.digest})
    methods: dict[str, Animator] = {"linear blend skinning": skinning} | animators
    garments = job_wardrobe(job, WARDROBE_SPLITS)

    rows: list[Row] = []
    contact: dict[str, dict[str, Contact]] = {}
    floor = _Floor(body)
    progress = Progress("evaluate gsnet", len(garments), "garments")
    for garment in garments:
        some, kept = _evaluate(garment, methods, floor, spec["use"], body, stride)
        rows += some
        if kept:
            made = _contact(garment, animators[spec["use"]], kept, body, RefinementSettings(**spec["refinement"]))
            contact[garment.template.name] = made
        progress(1)
    progress.finish()
    rows.sort(key=lambda row: WARDROBE_SPLITS.index(row["split"]))
    costs = {v: _cost(animators[v], read_table(path)) for v, path in zip(variants, losses, strict=True)}
    costs[FLOOR] = floor.cost
    write_table(job.outputs[0], [row | costs.get(row["method"], {}) for row in averaged(rows, ("split", "method"))])
    write_table(job.outputs[1], averaged([r for r in rows if r["split"] != TRAIN], ("split", "category", "method")))
    write_table(job.outputs[2], gap_rows(rows, TRAIN, UNSEEN_MOTIONS, UNSEEN_BOTH))
    write_table(
        job.outputs[3],
        [row for variant, path in zip(variants, losses) for row in stability_rows(variant, read_table(path))],
    )
    write_table(
        job.outputs[4],
        [
            {"garment": name, "after": stage} | figures.figures("")
            for name, stages in contact.items()
            for stage, figures in stages.items()
        ],
    )
    write_table(job.outputs[5], _drift(job, rest, methods, body))


def _cost(animator: Animator, losses: Many[Row]) -> Row:
    """What a network took to train: seconds of its beginning and its steps on its one thread, without validation; its
    numbers."""
    seconds = sum(row["seconds"] for row in losses if row["split"] != "validation")
    return {"training_s": seconds, "parameters": sum(p.numel() for p in animator.parameters())}


def _split(paths: list[str], *counts: int) -> tuple[list[str], ...]:
    """Runs of the given lengths, and the rest."""
    parts, start = [], 0
    for count in counts:
        parts.append(paths[start : start + count])
        start += count
    return *parts, paths[start:]


class _Floor:
    """Ridge regressions of the templates that are trained on, each its own, and what they cost together."""

    def __init__(self, body: Body) -> None:
        self.body, self.cost = body, {"training_s": 0.0, "parameters": 0}

    def dressed(self, garment: WardrobeGarment, sequences: Many[Sequence]) -> list[np.ndarray]:
        """Canonical vertices [T, N, 3] of the garment on the motions of sequences."""
        start = time.perf_counter()
        made = SkinnedRidge(self.body, garment.template).fit(garment.in_split(TRAIN))
        self.cost["training_s"] += time.perf_counter() - start
        self.cost["parameters"] += made.ridge.size
        return [s.canonical(made.predict(s)) for s in sequences]


def _evaluate(
    garment: WardrobeGarment, methods: dict[str, Animator], floor: _Floor, used: str, body: Body, stride: int
) -> tuple[list[Row], list[tuple[TestMotion, np.ndarray]]]:
    """Rows of one garment, and what the network in use made of its test sequences."""
    template = garment.template
    graph = GarmentGraph.of(template, body)
    sequences = [s for split in MOST for s in garment.in_split(split)[: MOST[split]]]
    motions = [TestMotion(s, body, stride) for s in sequences]
    made = {
        method: dressed(animator, graph, sequences, body, animator.config.materials)
        for method, animator in methods.items()
        if animator.knows(template.name)
    }
    if garment.in_split(TRAIN):
        made[FLOOR] = floor.dressed(garment, sequences)
    rows = [
        motion.row(template, garment.category, method, worn)
        for method, predicted in made.items()
        for motion, worn in zip(motions, predicted, strict=True)
    ]
    tested = [(m, worn) for m, worn in zip(motions, made[used], strict=True) if m.sequence.split != TRAIN]
    return rows, tested[:CONTACT]


def _contact(
    garment: WardrobeGarment,
    animator: Animator,
    kept: list[tuple[TestMotion, np.ndarray]],
    body: Body,
    settings: RefinementSettings,
) -> dict[str, Contact]:
    """Vertices inside the body in one garment's test sequences."""
    graph, names = GarmentGraph.of(garment.template, body), animator.config.materials
    predictions = (
        (m, p, corrector(animator, graph, material_row(m.sequence.parameters, names), settings.clearance))
        for m, p in kept
    )
    return contact_rows(garment.template, body, predictions, settings)


def _drift(job: Job, paths: list[str], methods: dict[str, Animator], body: Body) -> list[Row]:
    """Errors along long simulations of the run's garments, which are no part of the wardrobe."""
    rows: list[Row] = []
    for name in job.spec["long"]:
        template_path, shard, *paths = paths
        template = GarmentTemplate.load(template_path)
        graph = GarmentGraph.of(template, body)
        long: Many[Sequence] = load_sequences([shard], SplitRule(**job.spec["splits"]), plans=(LONG,))[:LONG_MOTIONS]
        if not long:
            rows.append({"garment": name, "method": "no long motion stayed inside the quality bounds", "sequences": 0})
            continue

        known = {method: _in_turn(a, graph, long, body) for method, a in methods.items() if a.knows(template.name)}
        rows += drift_rows(long, known)
    return rows or [{"garment": "", "method": "the run has no long simulations", "sequences": 0}]


def _in_turn(animator: Animator, graph: GarmentGraph, sequences: Many[Sequence], body: Body) -> Predictor:
    """A network as ``drift_rows`` takes it, which asks for each sequence once, in their order.

    All are dressed side by side when the first is asked for: a step costs hardly more for three than for one.
    """

    def made() -> Iterator[np.ndarray]:
        waiting = dressed(animator, graph, sequences, body, animator.config.materials)
        for sequence in sequences:
            yield sequence.in_world(waiting.pop(0))

    worn = made()
    return lambda _: next(worn)


if __name__ == "__main__":
    run_stage(main)
