"""From simulated sequences to a regressor's examples, and from a regressor to what the evaluation takes."""

from __future__ import annotations

from collections.abc import Callable, Iterable

import numpy as np
import torch

from body.model import Body
from datasets.sequences import Sequence, from_canonical
from models.garment_fitting import GarmentExample
from models.garment_regressor import Regressor
from models.motion_features import MotionTrack, sequence_track
from models.sequence_regressor import SequenceRegressor


def garment_examples(sequences: Iterable[Sequence]) -> list[GarmentExample]:
    """Motions with their simulated garment."""
    return [GarmentExample.from_world(sequence_track(s), s.vertices) for s in sequences]


def regressor_predictor(regressor: Regressor, body: Body) -> Callable[[Sequence], np.ndarray]:
    """A regressor as the evaluation takes it: from a sequence's motion to world vertices [m], [T, V, 3]."""

    def predict(sequence: Sequence) -> np.ndarray:
        return from_canonical(regressor.dress(sequence_track(sequence)), sequence.pose, sequence.root, body)

    return predict


def started_predictor(regressor: SequenceRegressor, body: Body) -> Callable[[Sequence], np.ndarray]:
    """As ``regressor_predictor``, from the true frame before (Shi 2023, Table 9); the first frame is the truth."""

    def predict(sequence: Sequence) -> np.ndarray:
        track = sequence_track(sequence)
        later = MotionTrack(track.pose, track.joints, track.lead + 1, track.fps)
        codes = _true_codes(regressor, sequence)
        with torch.no_grad():
            free = regressor.unroll(regressor.features(later)[None], later.lead, codes[:, 0])
        return _world(regressor, torch.cat([codes[:, :1], free], dim=1), sequence, body)

    return predict


def taught_predictor(regressor: SequenceRegressor, body: Body) -> Callable[[Sequence], np.ndarray]:
    """What the regressor says about each frame if told the true ones before it, as under teacher forcing."""

    def predict(sequence: Sequence) -> np.ndarray:
        track, codes = sequence_track(sequence), _true_codes(regressor, sequence)
        features = regressor.features(track)[None]
        with torch.no_grad():
            past = torch.cat([regressor.first_token(features, track.lead)[:, None], codes[:, :-1]], dim=1)
            said = regressor.predict_all(features, past, track.lead)
        return _world(regressor, said, sequence, body)

    return predict


def _true_codes(regressor: Regressor, sequence: Sequence) -> torch.Tensor:
    """Codes [1, T, K] of the simulated garment."""
    vertices = GarmentExample.from_world(sequence_track(sequence), sequence.vertices).vertices
    with torch.no_grad():
        return regressor.shape.encode(torch.as_tensor(vertices))[None]


def _world(regressor: Regressor, codes: torch.Tensor, sequence: Sequence, body: Body) -> np.ndarray:
    with torch.no_grad():
        vertices = regressor.shape.decode(codes[0]).numpy()
    return from_canonical(vertices, sequence.pose, sequence.root, body)
