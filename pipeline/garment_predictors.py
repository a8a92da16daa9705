"""Regressors, and Wang's autoencoder, as the evaluation takes them: from a sequence's motion to world vertices.

Sequences on other bodies than the run's own are dressed as on the own body, and grading does the rest.
"""

from __future__ import annotations

from collections.abc import Callable
from collections.abc import Sequence as Many

import numpy as np
import torch

from datasets.sequences import Sequence
from evaluation.regressor import Predictor
from evaluation.seeds import split_seed
from models.conditioned_regressor import ConditionedRegressor, Conditions, load_conditioned_regressor
from models.descriptor_regressor import load_descriptor_regressor
from models.garment_fitting import GarmentExample, load_regressor
from models.garment_regressor import Regressor
from models.intrinsic_fitting import decode_frames
from models.motion_features import MotionTrack, sequence_track
from models.motion_history import MotionHistory
from models.motion_invariant import MotionInvariantNetwork
from models.sequence_regressor import SequenceRegressor
from models.shape_descriptor import ShapeDescriptor, decode_all
from pipeline.garment_data import CONDITIONED, DESCRIPTOR_SPACE, Others, sequence_conditions

TOGETHER = 16
"""Sequences that a regressor dresses side by side."""


def load_variant(variant: str, path: str) -> Regressor:
    """The regressor of a named variant, or of a repetition of it from another seed."""
    loaders = {DESCRIPTOR_SPACE: load_descriptor_regressor, CONDITIONED: load_conditioned_regressor}
    return loaders.get(split_seed(variant)[0], load_regressor)(path)


def regressor_predictor(regressor: Regressor, sequences: Many[Sequence] = ()) -> Predictor:
    """A regressor as the evaluation takes it: from a sequence's motion to world vertices [m], [T, V, 3].

    A conditioned regressor is told what the sequence was simulated under.

    Args:
        regressor: Trained.
        sequences: Those that will be asked for, once each. An auto-regressive decoder takes a step a frame however
            many sequences it goes through side by side, so they are dressed together when the first comes up.
    """
    if isinstance(regressor, ConditionedRegressor):
        return told_predictor(regressor, sequence_conditions)
    if not isinstance(regressor, SequenceRegressor):
        sequences = ()  # costs no less together, and all at once would only fill the memory
    return _Together(lambda some: regressor.dress_all([sequence_track(s) for s in some], TOGETHER), sequences).predict


def told_predictor(
    regressor: ConditionedRegressor,
    conditions: Callable[[Sequence], Conditions],
    others: Others = lambda _: None,
) -> Predictor:
    """A conditioned regressor that is told what ``conditions`` says of a sequence, its garment graded to the body."""
    return _graded(lambda track, sequence: regressor.dress_under(track, conditions(sequence)), others)


def graded_predictor(regressor: Regressor, others: Others) -> Predictor:
    """A regressor that knows one body alone, its garment graded to each other."""
    return _graded(lambda track, _: regressor.dress(track), others)


def _graded(dress: Callable[[MotionTrack, Sequence], np.ndarray], others: Others) -> Predictor:
    def predict(sequence: Sequence) -> np.ndarray:
        track, other = sequence_track(sequence), others(sequence)
        if other is None:
            return sequence.in_world(dress(track, sequence))
        return sequence.in_world(dress(other.own_track(track), sequence) + other.change(track))

    return predict


def autoencoder_predictor(
    network: MotionInvariantNetwork, descriptor: ShapeDescriptor, latent: np.ndarray
) -> Predictor:
    """Wang's autoencoder as a regressor: ``latent [Z]`` decoded along a sequence's motion (Wang 2019, Fig. 10)."""

    def predict(sequence: Sequence) -> np.ndarray:
        history = MotionHistory([sequence_track(sequence)], network.config.signature, network.config.window)
        return sequence.in_world(decode_all(descriptor, decode_frames(network, latent, history[:])))

    return predict


def started_predictor(regressor: SequenceRegressor, sequences: Many[Sequence] = ()) -> Predictor:
    """As ``regressor_predictor``, from the true frame before (Shi 2023, Table 9); the first frame is the truth."""

    @torch.no_grad()
    def dress(some: list[Sequence]) -> list[np.ndarray]:
        dressed: dict[int, np.ndarray] = {}
        for group in _equal_lengths(some):
            tracks = [sequence_track(s) for s in group]
            later = [MotionTrack(t.pose, t.joints, t.lead + 1, t.fps) for t in tracks]
            # The first frame alone is looked at.
            first = torch.cat([_true_codes(regressor, s, 1) for s in group])
            free = regressor.unroll(torch.stack([regressor.features(t) for t in later]), later[0].lead, first[:, 0])
            for sequence, codes in zip(group, torch.cat([first, free], dim=1), strict=True):
                dressed[id(sequence)] = regressor.shape.decode(codes).numpy()
        return [dressed[id(s)] for s in some]

    return _Together(dress, sequences).predict


def taught_predictor(regressor: SequenceRegressor) -> Predictor:
    """What the regressor says about each frame if told the true ones before it, as under teacher forcing."""

    @torch.no_grad()
    def predict(sequence: Sequence) -> np.ndarray:
        track, codes = sequence_track(sequence), _true_codes(regressor, sequence)
        features = regressor.features(track)[None]
        past = torch.cat([regressor.first_token(features, track.lead)[:, None], codes[:, :-1]], dim=1)
        said = regressor.predict_all(features, past, track.lead)
        return sequence.in_world(regressor.shape.decode(said[0]).numpy())

    return predict


class _Together:
    """Predictions that are made for many sequences at once and handed out, and forgotten, one by one."""

    def __init__(self, dress: Callable[[list[Sequence]], list[np.ndarray]], sequences: Many[Sequence]) -> None:
        self._dress, self._coming = dress, list(sequences)
        self._made: dict[int, np.ndarray] = {}

    def predict(self, sequence: Sequence) -> np.ndarray:
        """World vertices [m], [T, V, 3] of a sequence, whether it was announced or not."""
        if id(sequence) not in self._made:
            coming = self._coming if any(s is sequence for s in self._coming) else [sequence]
            self._made |= zip(map(id, coming), self._dress(coming), strict=True)
            self._coming = [] if coming is self._coming else self._coming
        return sequence.in_world(self._made.pop(id(sequence)))


def _equal_lengths(sequences: Many[Sequence]) -> list[list[Sequence]]:
    """Groups of at most ``TOGETHER`` sequences of the same length and lead-in."""
    by_length: dict[tuple[int, int], list[Sequence]] = {}
    for sequence in sequences:
        by_length.setdefault((sequence.frames, len(sequence.lead_pose)), []).append(sequence)
    return [group[i : i + TOGETHER] for group in by_length.values() for i in range(0, len(group), TOGETHER)]


def _true_codes(regressor: Regressor, sequence: Sequence, frames: int | None = None) -> torch.Tensor:
    """Codes [1, T, K] of the simulated garment in its first frames, or all."""
    vertices = GarmentExample.from_world(sequence_track(sequence), sequence.vertices).vertices[:frames]
    with torch.no_grad():
        return regressor.shape.encode(torch.as_tensor(vertices))[None]
