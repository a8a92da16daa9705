"""From the wardrobe's garments to the examples of networks that dress any garment."""

from __future__ import annotations

from collections.abc import Iterable
from collections.abc import Sequence as Many

import numpy as np

from body.model import Body
from datasets.sequences import Sequence
from evaluation.divergence import held_near
from models.garment_animator import Animator
from models.garment_graph import GarmentGraph, material_row
from models.gsnet_examples import WardrobeExample
from models.motion_features import sequence_track
from pipeline.wardrobe_data import WardrobeGarment

TOGETHER = 8
"""Sequences that a network dresses side by side."""


def wardrobe_examples(
    garments: Iterable[WardrobeGarment], splits: tuple[str, ...], body: Body, materials: Many[str]
) -> list[WardrobeExample]:
    """The garments' sequences of some splits, in the pelvis frame of each frame."""
    return [
        WardrobeExample(graph, material_row(s.parameters, materials), sequence_track(s), s.canonical(s.vertices))
        for garment in garments
        for graph in [GarmentGraph.of(garment.template, body)]
        for s in garment.in_split(*splits)
    ]


def dressed(
    animator: Animator, graph: GarmentGraph, sequences: Many[Sequence], body: Body, materials: Many[str]
) -> list[np.ndarray]:
    """Canonical vertices [T, N, 3] of a garment on the motions of sequences, in their materials, held near the body."""
    found: list[np.ndarray] = []
    for start in range(0, len(sequences), TOGETHER):
        some = sequences[start : start + TOGETHER]
        rows = [material_row(s.parameters, materials) for s in some]
        made = animator.dress_all(graph, rows, [sequence_track(s) for s in some], body)
        found += [held_near(vertices) for vertices in made]
    return found
