"""What every learned garment model has to beat, and the floor that no linear shape space of its size gets below.

Each baseline is ``fit(training sequences)``, then ``predict(sequence) -> vertices in the world [m], [T, V, 3]``. All
work in the canonical frame (the pelvis frame of each frame). ``PcaFloor`` sees the truth: it is a bound, not a method.
"""

from __future__ import annotations

from collections.abc import Callable
from collections.abc import Sequence as Many
from typing import Protocol

import numpy as np

from body.model import Body, skin
from datasets.sequences import Sequence
from evaluation.ridge import Ridge
from garments.template import GarmentTemplate
from models.motion_features import sequence_track, track_features

HISTORY_OFFSETS = (0, 1, 2, 3, 5, 7, 10, 14)
"""Frames looked back, half a second at 30 fps; closer together near the present."""

ROTATION_OFFSETS = (0, 2, 5, 10, 16)
"""Frames looked back where joint rotations are among the features: fewer, for there are three times as many."""

HELD_OUT_EVERY = 5
"""Every fifth training take chooses the ridge penalty."""

MOST_PCA_FRAMES = 1500
"""Frames, spread evenly over the training set, that principal components are computed from."""


class Baseline(Protocol):
    """A predictor that can be fitted."""

    def fit(self, sequences: Many[Sequence]) -> Baseline:
        """Learn from simulated training sequences of one garment."""

    def predict(self, sequence: Sequence) -> np.ndarray:
        """Garment vertices in the world [m], shape [T, V, 3] float32."""


class MeanShape:
    """The mean canonical garment, carried by the pelvis."""

    def fit(self, sequences: Many[Sequence]) -> MeanShape:
        """Average the canonical vertices over all frames."""
        total = sum(s.canonical(s.vertices).sum(axis=0, dtype=np.float64) for s in _checked(sequences))
        self.mean = (total / sum(s.frames for s in sequences)).astype(np.float32)
        return self

    def predict(self, sequence: Sequence) -> np.ndarray:
        """The same shape in every frame."""
        shape = np.broadcast_to(self.mean, (sequence.frames, *self.mean.shape))
        return sequence.in_world(shape)


class SkinnedTemplate:
    """Linear blend skinning of the template with its own weights, plus the mean canonical residual."""

    def __init__(self, body: Body, template: GarmentTemplate) -> None:
        self.body, self.template = body, template

    def fit(self, sequences: Many[Sequence]) -> SkinnedTemplate:
        """Average what skinning leaves unexplained."""
        total = sum(
            (s.canonical(s.vertices) - self.skinned(s)).sum(axis=0, dtype=np.float64) for s in _checked(sequences)
        )
        self.residual = (total / sum(s.frames for s in sequences)).astype(np.float32)
        return self

    def predict(self, sequence: Sequence) -> np.ndarray:
        """Skinned template with the mean residual."""
        return sequence.in_world(self.skinned(sequence) + self.residual)

    def skinned(self, sequence: Sequence) -> np.ndarray:
        """Canonical vertices of the skinned template [m], shape [T, V, 3]."""
        template = self.template
        transforms = self.body.joint_transforms(sequence.pose, sequence.root)
        world = skin(template.vertices, template.skin_index, template.skin_weight, transforms)
        return sequence.canonical(world)


class RidgeRegression:
    """Ridge regression from body motion to canonical vertices.

    Args:
        body: The body that wears the garment.
        offsets: Past frames that the features are taken from: joints, gravity direction, linear and angular velocity
            in the pelvis frame. Empty: the current pose alone, joint rotations and gravity direction.
        rotations: Whether the joints' rotations are among the features of past frames too.
    """

    def __init__(self, offsets: tuple[int, ...] = HISTORY_OFFSETS, rotations: bool = False) -> None:
        self.offsets, self.rotations = offsets, rotations

    def fit(self, sequences: Many[Sequence]) -> RidgeRegression:
        """Gather the sums sequence by sequence, choose the penalty on held-out takes, solve."""
        takes = sorted({s.take for s in _checked(sequences)})
        held_out = set(takes[HELD_OUT_EVERY - 1 :: HELD_OUT_EVERY])
        self.ridge = Ridge()
        for s in sequences:
            targets = (s.canonical(s.vertices) - self._before(s)).reshape(s.frames, -1)
            self.ridge.add(self._features(s), targets, held_out=s.take in held_out)
        self.ridge.fit()
        return self

    def predict(self, sequence: Sequence) -> np.ndarray:
        """The linear map of the features, frame by frame."""
        canonical = self.ridge.predict(self._features(sequence)).reshape(sequence.frames, -1, 3)
        return sequence.in_world(canonical + self._before(sequence))

    def _before(self, sequence: Sequence) -> np.ndarray | float:
        """Canonical vertices [m] that the linear map is added to."""
        return 0.0

    def _features(self, sequence: Sequence) -> np.ndarray:
        """Features of the recorded frames, shape [T, D]."""
        track = sequence_track(sequence)
        motion = track_features(track, "motion")
        frames = track.lead + np.arange(sequence.frames)
        if self.rotations:
            motion = np.concatenate([motion, track_features(track, "pose")[:, 6:]], axis=1)
        if self.offsets:
            return history(motion, self.offsets, frames)
        gravity = motion[frames, 69:72]
        return np.concatenate([track_features(track, "pose")[frames, 6:], gravity], axis=1)


class SkinnedRidge(RidgeRegression):
    """Ridge regression from the motion's past to what linear blend skinning leaves over.

    Args:
        body: The body that wears the garment.
        template: The garment.
    """

    def __init__(self, body: Body, template: GarmentTemplate) -> None:
        super().__init__()
        self._skinning = SkinnedTemplate(body, template)

    def _before(self, sequence: Sequence) -> np.ndarray:
        return self._skinning.skinned(sequence)


class PcaFloor:
    """The truth projected on the first principal components of the training shapes."""

    def __init__(self, dimensions: int) -> None:
        self.dimensions = dimensions

    def fit(self, sequences: Many[Sequence]) -> PcaFloor:
        """Principal components of frames spread evenly over the training set."""
        frames = sum(s.frames for s in _checked(sequences))
        step = max(1, -(-frames // MOST_PCA_FRAMES))
        first, shapes = 0, []
        for s in sequences:
            shapes.append(s.canonical(s.vertices)[(-first) % step :: step])
            first += s.frames
        flat = np.concatenate(shapes).reshape(sum(map(len, shapes)), -1)
        self.mean = flat.mean(axis=0)
        flat = flat - self.mean
        # Fewer frames than coordinates: eigenvectors of the frames' Gram matrix give the same components.
        values, vectors = np.linalg.eigh((flat @ flat.T).astype(np.float64))
        keep = np.argsort(-values)[: self.dimensions]
        keep = keep[values[keep] > 1e-12 * values.max()]
        self.components = (vectors[:, keep] / np.sqrt(values[keep])).T.astype(np.float32) @ flat
        return self

    def predict(self, sequence: Sequence) -> np.ndarray:
        """The nearest shape in the space to the *true* one."""
        flat = sequence.canonical(sequence.vertices).reshape(sequence.frames, -1) - self.mean
        near = (flat @ self.components.T) @ self.components + self.mean
        return sequence.in_world(near.reshape(sequence.frames, -1, 3))


class SimulatedAgain:
    """The chaos floor: the same clip and parameters, simulated once more from a start that differs a little.

    Of two runs neither is the truth. Were both scattered independently about what the motion determines, each would be
    their root mean square difference over sqrt(2) away from it; so the second run is drawn to the first by that much.

    Args:
        sequences: The second runs.
    """

    def __init__(self, sequences: Many[Sequence]) -> None:
        self._again = {s.clip: s.vertices for s in sequences}

    def predict(self, sequence: Sequence) -> np.ndarray | None:
        """The first run's garment moved by the difference over sqrt(2); None where there is no second run."""
        again = self._again.get(sequence.clip)
        return None if again is None else sequence.vertices + (again - sequence.vertices) / np.float32(np.sqrt(2.0))


def fit_baselines(
    sequences: Many[Sequence], body: Body, template: GarmentTemplate, pca_dimensions: int
) -> dict[str, Callable[[Sequence], np.ndarray]]:
    """All baselines fitted on one garment's training sequences: name -> predictor, from the weakest to the floor."""
    baselines: dict[str, Baseline] = {
        "mean shape": MeanShape(),
        "linear blend skinning + mean residual": SkinnedTemplate(body, template),
        "ridge, current pose": RidgeRegression(()),
        "ridge, pose history": RidgeRegression(),
        "ridge, pose history with rotations": RidgeRegression(ROTATION_OFFSETS, rotations=True),
        f"PCA-{pca_dimensions} of the truth (floor)": PcaFloor(pca_dimensions),
    }
    return {name: baseline.fit(sequences).predict for name, baseline in baselines.items()}


def history(features: np.ndarray, offsets: tuple[int, ...], frames: np.ndarray) -> np.ndarray:
    """Rows ``t - offset`` of ``features [F, D]`` side by side for each wanted frame, shape [N, len(offsets) * D].

    Before the first row the body stood still: the first row is repeated.
    """
    index = np.maximum(np.asarray(frames)[:, None] - np.asarray(offsets)[None, :], 0)
    return features[index].reshape(len(index), -1)


def _checked(sequences: Many[Sequence]) -> Many[Sequence]:
    if len(sequences) == 0:
        raise ValueError("baseline: no training sequences")
    garments = {s.garment for s in sequences}
    if len(garments) > 1:
        raise ValueError(f"baseline: expected sequences of one garment, got {', '.join(sorted(garments))}")
    return sequences
