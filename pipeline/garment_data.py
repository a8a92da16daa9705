"""From simulated sequences to a regressor's examples.

Sequences on other bodies than the run's own go through ``models.other_bodies``: regressors learn as on the own body,
and grading does the rest.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import replace

from body.model import Body
from datasets.sequences import Sequence
from garments.template import GarmentTemplate
from models.conditioned_regressor import ConditionedExample, Conditions
from models.garment_fitting import GarmentExample
from models.motion_features import sequence_track
from models.other_bodies import OtherBody

DESCRIPTOR_SPACE, CONDITIONED = "descriptor-space", "conditioned"
"""Variants with a network, a training and a file of their own."""

Others = Callable[[Sequence], OtherBody | None]
"""The other body that a sequence was simulated on; None where it was the run's own."""


def garment_examples(sequences: Iterable[Sequence]) -> list[GarmentExample]:
    """Motions with their simulated garment."""
    return [GarmentExample.from_world(sequence_track(s), s.vertices) for s in sequences]


def sequence_conditions(sequence: Sequence) -> Conditions:
    """What a sequence was simulated under."""
    return Conditions(sequence.parameters, sequence.shape)


def other_bodies(template: GarmentTemplate, own: Body, bodies: Callable[[Sequence], Body]) -> Others:
    """Each sequence's body as one that the garment is graded to; one of each shape is made.

    Args:
        template: The garment.
        own: The run's own body.
        bodies: The body of each sequence.
    """

    made: dict[int, OtherBody] = {}

    def other(sequence: Sequence) -> OtherBody | None:
        number = sequence.body_index
        if number and number not in made:
            made[number] = OtherBody(template, own, bodies(sequence))
        return made.get(number)

    return other


def conditioned_examples(sequences: Iterable[Sequence], others: Others) -> list[ConditionedExample]:
    """Motions with their simulated garment, both as on the run's own body, and what it was simulated under."""
    return [ConditionedExample(_as_on_own_body(s, others(s)), sequence_conditions(s)) for s in sequences]


def _as_on_own_body(sequence: Sequence, other: OtherBody | None) -> GarmentExample:
    track = sequence_track(sequence)
    example = GarmentExample.from_world(track, sequence.vertices)
    if other is None:
        return example
    return replace(example, track=other.own_track(track), vertices=example.vertices - other.change(track))
