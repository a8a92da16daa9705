"""Garment regressor that is told what the garment is made of and who wears it (variant ``conditioned``).

In: scaled motion features, the intrinsic parameters of the cloth and the shape coefficients of the body, of which most
is said by grading already (``models.other_bodies``). Out: shape codes. Body shape is the limit that Shi 2023 names;
intrinsic parameters are what Wang 2019 infers from given garments. Where nothing is said, it dresses the base body in
the base material.

It is the network of the variant ``window`` with the conditions beside its windows. Layers that the conditions scale and
shift (FiLM, Perez 2018) fitted as well and did worse on parameters that were not trained on: 12.5 mm against 10.6.

Dimensions: B sequences or frames, L lead-in and T wanted frames, D features, K code size, C conditions.
"""

from __future__ import annotations

import os
from collections.abc import Collection, Mapping, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from models.checkpoint import load_model, save_model
from models.frame_fitting import CodedExamples, error_terms, fit_frames
from models.garment_fitting import GarmentExample, RegressorTraining
from models.garment_regressor import Regressor, RegressorConfig
from models.motion_features import MotionTrack, track_features
from models.training import Progress, prepare

KIND = "conditioned_regressor"
MOST_BASIS_SHAPES = 6000
"""Shapes, spread evenly over the examples, that mean and principal directions are taken from."""

BODIES_A_COEFFICIENT = 3
"""Bodies that it takes to learn from a coefficient. Told five of six bodies, the error on new ones was 6.2 mm, of a
T-shirt that grading had brought to them; not told, 5.5 mm."""

REACH = 3.0
"""Deviations from the training mean at which a condition is held, as the motion features are."""


@dataclass(frozen=True)
class Conditions:
    """Under what a garment is simulated, beside the motion.

    Attributes:
        parameters: Intrinsic parameters by name.
        shape: Body shape coefficients [standard deviations], shape [<= 10]; missing ones are zero.
    """

    parameters: Mapping[str, float]
    shape: Sequence[float] | np.ndarray = ()


@dataclass(frozen=True)
class ConditionColumns:
    """Which conditions a regressor takes, in its order.

    Attributes:
        parameters: Names of intrinsic parameters.
        logarithmic: Those of them that are taken as their logarithm.
        shape: Numbers of body shape coefficients, from 0.
    """

    parameters: tuple[str, ...] = ()
    logarithmic: tuple[str, ...] = ()
    shape: tuple[int, ...] = ()

    @classmethod
    def varied(
        cls, conditions: Sequence[Conditions], logarithmic: Collection[str], without: Collection[str] = ()
    ) -> ConditionColumns:
        """The parameters, but those in ``without``, and coefficients that differ between conditions.

        One that is the same in all cannot be learned from. Coefficients of too few bodies (``BODIES_A_COEFFICIENT``)
        are not taken either.
        """
        first, most = conditions[0], max(len(c.shape) for c in conditions)
        names = tuple(
            n for n in first.parameters if n not in without and len({c.parameters[n] for c in conditions}) > 1
        )
        numbers = tuple(i for i in range(most) if len({_coefficient(c, i) for c in conditions}) > 1)
        shapes = {tuple(_coefficient(c, i) for i in numbers) for c in conditions}
        if len(shapes) <= BODIES_A_COEFFICIENT * len(numbers):
            numbers = ()
        return cls(names, tuple(n for n in names if n in logarithmic), numbers)

    def __len__(self) -> int:
        return len(self.parameters) + len(self.shape)

    def rows(self, conditions: Sequence[Conditions]) -> np.ndarray:
        """Values [N, C] float32, not yet standardised; ``ValueError`` where one is missing or has no logarithm."""
        return np.array([self._row(c) for c in conditions], dtype=np.float32).reshape(len(conditions), len(self))

    def _row(self, conditions: Conditions) -> list[float]:
        missing = [name for name in self.parameters if name not in conditions.parameters]
        if missing:
            raise ValueError(f"conditioned regressor: parameter {missing[0]!r} is needed, but is not given")
        values = {name: float(conditions.parameters[name]) for name in self.parameters}
        for name, value in values.items():
            if not np.isfinite(value) or (name in self.logarithmic and value <= 0.0):
                allowed = "above 0" if name in self.logarithmic else "finite"
                raise ValueError(f"conditioned regressor: parameter {name!r} must be {allowed}, got {value}")
        scaled = [float(np.log(v)) if name in self.logarithmic else v for name, v in values.items()]
        return scaled + [_coefficient(conditions, i) for i in self.shape]


class ConditionedRegressor(Regressor):
    """Fully connected network over a window of past motion and the conditions beside it.

    Buffers: ``condition_mean``, ``condition_scale`` and ``base`` (the standardised base conditions), all [C].
    """

    def __init__(self, config: RegressorConfig, faces: np.ndarray, columns: ConditionColumns) -> None:
        super().__init__(config, faces)
        self.columns = columns
        for name, value in (("condition_mean", 0.0), ("condition_scale", 1.0), ("base", 0.0)):
            self.register_buffer(name, torch.full((len(columns),), value))
        self.input_size += len(columns)
        self.network = self.direct_network()

    def set_condition_scaling(self, rows: np.ndarray, base: np.ndarray) -> None:
        """Mean and spread of the training conditions [N, C] and the base conditions [C].

        Each parameter set and each body counts once, however many simulations it is in: bodies are few beside the
        parameter sets, which are all on one, and their coefficients would seem to lie far outside of what is usual.
        """
        count = len(self.columns.parameters)
        sets = [np.unique(part, axis=0) for part in (rows[:, :count], rows[:, count:])]
        self.condition_mean.copy_(torch.as_tensor(np.concatenate([part.mean(axis=0) for part in sets])))
        spread = np.concatenate([part.std(axis=0) for part in sets])
        self.condition_scale.copy_(torch.as_tensor(spread).clamp_min(1e-6))
        self.base.copy_(self.standardised(base))

    def standardised(self, rows: np.ndarray) -> Tensor:
        """Conditions [..., C] as the network takes them; what lies far outside the training data is held."""
        raw = torch.as_tensor(rows, dtype=torch.float32, device=self.condition_mean.device)
        return ((raw - self.condition_mean) / self.condition_scale).clamp(-REACH, REACH)

    def codes_of(self, windows: Tensor, conditions: Tensor) -> Tensor:
        """Codes [..., K] of windows [..., offsets * D] and standardised conditions [..., C]."""
        return self.network(torch.cat([windows, conditions], dim=-1))

    def unroll(self, features: Tensor, lead: int, conditions: Tensor | None = None) -> Tensor:
        """Codes [B, T, K] of scaled features [B, L + T, D] under standardised conditions [B, C] or the base ones."""
        windows = self.windows(features)[:, lead:]
        told = self.base.expand(len(features), -1) if conditions is None else conditions
        return self.codes_of(windows, told[:, None].expand(-1, windows.shape[1], -1)).float()

    @torch.no_grad()
    def dress_under(self, track: MotionTrack, conditions: Conditions) -> np.ndarray:
        """``dress`` for cloth and wearer of choice: canonical garment vertices [m], shape [T, V, 3] float32."""
        told = self.standardised(self.columns.rows([conditions]))
        codes = self.unroll(self.features(track)[None], track.lead, told)
        return self.shape.decode(codes[0]).cpu().numpy()


@dataclass(frozen=True)
class ConditionedExample:
    """A simulated garment with its motion, and its conditions."""

    garment: GarmentExample
    conditions: Conditions


def fit_conditioned_regressor(
    examples: Sequence[ConditionedExample],
    base: Conditions,
    logarithmic: Collection[str],
    faces: np.ndarray,
    config: RegressorConfig,
    settings: RegressorTraining,
    work_dir: str | Path,
    validation: Sequence[ConditionedExample] = (),
    progress: Progress | None = None,
    without: Collection[str] = (),
) -> ConditionedRegressor:
    """Train on simulations under many conditions; returns the regressor on the CPU in eval mode.

    Args:
        examples: Training split, all of one length.
        base: What is meant where nothing is said.
        logarithmic: Names of parameters that are learned as their logarithm.
        faces: Triangles of the garment, shape [F, 3].
        config: Of the variant ``window``, as ``variant_config`` makes it.
        settings: Epochs, learning rates, frames a batch.
        work_dir: Folder of this run alone; a killed run continues there.
        validation: Held-out examples whose vertex error [mm] is logged.
        progress: Takes lines of text.
        without: Names of parameters that it is not told, though they vary.

    Raises:
        ValueError: No examples, unequal lengths, or another number of vertices than the config's.
    """
    if not examples:
        raise ValueError("garment regressor: no training examples")
    counts = {e.garment.vertices.shape[1] for e in examples}
    if counts != {config.vertices}:
        raise ValueError(f"garment regressor: config says {config.vertices} vertices, examples have {sorted(counts)}")
    device = prepare(settings.training)
    columns = ConditionColumns.varied([e.conditions for e in examples], logarithmic, without)
    regressor = ConditionedRegressor(config, faces, columns)
    tracks = [e.garment.track for e in examples]
    regressor.set_feature_scaling(np.concatenate([track_features(t, config.features) for t in tracks]))
    rows = columns.rows([e.conditions for e in examples])
    regressor.set_condition_scaling(rows, columns.rows([base])[0])
    step = max(1, sum(t.frames for t in tracks) // MOST_BASIS_SHAPES)
    shapes = np.concatenate([e.garment.vertices[number % step :: step] for number, e in enumerate(examples)])
    regressor.shape.fit(shapes, np.random.default_rng(settings.training.seed))
    del shapes
    with torch.no_grad():
        # Example by example: all of them at once would be in memory twice.
        codes = np.stack([regressor.shape.encode(torch.as_tensor(e.garment.vertices)).numpy() for e in examples])
        told = regressor.standardised(rows).numpy()
    regressor.to(device)

    def validate() -> dict[str, float]:
        errors = []
        for example in validation:
            dressed = regressor.dress_under(example.garment.track, example.conditions)
            errors.append(float(np.square(dressed - example.garment.vertices).sum(-1).mean()))
        return error_terms(regressor, errors)

    fit_frames(
        regressor,
        regressor.codes_of,
        CodedExamples(tracks, codes, told),
        settings,
        work_dir,
        validate if validation else None,
        progress,
        f"{KIND} {columns}",
    )
    return regressor


def save_conditioned_regressor(path: str | os.PathLike, regressor: ConditionedRegressor) -> None:
    """Write a trained regressor to one file."""
    config = {"regressor": asdict(regressor.config), "columns": asdict(regressor.columns)}
    save_model(path, KIND, config, regressor)


def load_conditioned_regressor(path: str | os.PathLike) -> ConditionedRegressor:
    """Read a regressor written by ``save_conditioned_regressor``; ``ValueError`` when the file is none."""
    stored = load_model(path, KIND)
    if "shape.faces" not in stored.state or not {"regressor", "columns"} <= set(stored.config):
        raise ValueError(f"{path} is damaged: it lacks the garment's faces or its conditions")
    columns = ConditionColumns(**{name: tuple(value) for name, value in stored.config["columns"].items()})
    faces = stored.state["shape.faces"].numpy()
    regressor = ConditionedRegressor(RegressorConfig(**stored.config["regressor"]), faces, columns)
    stored.into(regressor)
    return regressor


def _coefficient(conditions: Conditions, number: int) -> float:
    return float(conditions.shape[number]) if number < len(conditions.shape) else 0.0
