"""From simulated sequences to a regressor's examples, and from a regressor to what the evaluation takes."""

from __future__ import annotations

from collections.abc import Callable, Iterable

import numpy as np

from body.model import Body
from datasets.sequences import Sequence, from_canonical
from models.garment_fitting import GarmentExample
from models.garment_regressor import Regressor
from models.motion_features import sequence_track


def garment_examples(sequences: Iterable[Sequence]) -> list[GarmentExample]:
    """Motions with their simulated garment."""
    return [GarmentExample.from_world(sequence_track(s), s.vertices) for s in sequences]


def regressor_predictor(regressor: Regressor, body: Body) -> Callable[[Sequence], np.ndarray]:
    """A regressor as the evaluation takes it: from a sequence's motion to world vertices [m], [T, V, 3]."""

    def predict(sequence: Sequence) -> np.ndarray:
        return from_canonical(regressor.dress(sequence_track(sequence)), sequence.pose, sequence.root, body)

    return predict
