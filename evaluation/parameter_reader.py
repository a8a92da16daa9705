"""Intrinsic parameters read from z, with how sure they are.

In: what frames say of z (``MotionInvariantNetwork.evidence``) and the parameters they were simulated with. Out: an
estimate and an interval for each parameter, from the evidence of one frame or of several.

Estimates are linear in z (ridge regression), on the scale on which the parameter is sampled. The regression learns from
the autoencoder's own training sets. These it knows too well: of parameters that no shape shows, their z tells something
and that of others nothing. So the estimates are calibrated on parameter sets that were held out from all training: each
parameter is drawn back towards the mean by as much as it is worth there, and the interval is what was missed there, a
prediction interval of Student's t over the sets. With fewer than ``LEAST_SETS`` held-out sets, the training sets have
to do, each estimated by what was learned from the others.

A frame says less than a clip, so all this is kept for several numbers of frames. A parameter that a shape does not show
has an interval as wide as the values that were sampled, and says so by that.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import t as student

from evaluation.ridge import Ridge

SIZES = (1, 4, 16, 64)
"""Numbers of frames in a row that estimates are made for."""
DRAWS = 4
"""Stretches of a sequence of each size, spread evenly."""
FOLDS = 5
"""Parts of the training parameter sets, where these are calibrated on."""
LEAST_SETS = 6
"""Held-out parameter sets that a calibration needs."""
COVERAGE = 0.9
"""Share of the truths that an interval is to hold."""


@dataclass(frozen=True)
class Evidence:
    """What the frames of a sequence say of z: values and weights [T, Z], and the sequence's parameter set."""

    values: np.ndarray
    weights: np.ndarray
    phi: int


@dataclass(frozen=True)
class Estimate:
    """One parameter, in its own unit.

    Attributes:
        value: Estimated.
        low, high: Ends of the interval that holds the truth in ``COVERAGE`` of all cases.
        known: 0 where the interval is as wide as the sampled values', 1 where it has no width.
    """

    value: float
    low: float
    high: float
    known: float


@dataclass(frozen=True)
class _Calibration:
    """What a raw estimate is worth: ``slope raw``, give or take ``reach``; [P] each, about the training sets' mean."""

    slope: np.ndarray
    reach: np.ndarray

    @classmethod
    def of(cls, raw: np.ndarray, truth: np.ndarray, owner: np.ndarray) -> _Calibration:
        """From raw estimates and truths [N, P] of stretches of the sets ``owner [N]``."""
        slope = np.clip((raw * truth).sum(0) / np.maximum(np.square(raw).sum(0), 1e-12), 0.0, 1.0)
        sets = len(np.unique(owner))
        deviation = np.sqrt(np.square(truth - slope * raw).mean(0) * (1.0 + 1.0 / sets))
        return cls(slope, student.ppf(0.5 + 0.5 * COVERAGE, max(sets - 1, 1)) * deviation)


@dataclass(frozen=True)
class _Size:
    """Of one number of frames: the regression, its calibration, and those without one held-out set each."""

    frames: int
    ridge: Ridge
    calibration: _Calibration
    without: Mapping[int, _Calibration]


class ParameterReader:
    """Regressions for several numbers of frames, with their calibration.

    Args:
        training: Sequences that the autoencoder was trained on, to learn from.
        held_out: Sequences of parameter sets that it was not trained on, to calibrate on.
        parameters: Values by name, by number of the parameter set; names that do not vary are left out.
        logarithmic: Names that are regressed as their logarithm.
        prior: Weight of z = 0 in pooling (``MotionInvariantNetwork.prior``).

    Raises:
        ValueError: Fewer than two training parameter sets.
    """

    def __init__(
        self,
        training: Sequence[Evidence],
        held_out: Sequence[Evidence],
        parameters: Mapping[int, Mapping[str, float]],
        logarithmic: Collection[str],
        prior: float,
    ) -> None:
        phis = sorted({e.phi for e in training})
        if len(phis) < 2:
            raise ValueError(f"reading parameters: at least 2 parameter sets are needed, there are {len(phis)}")
        every = list(next(iter(parameters.values())))
        table = np.array([[parameters[phi][name] for name in every] for phi in phis])
        varied = [k for k in range(len(every)) if np.ptp(table[:, k]) > 1e-9 * max(abs(table[0, k]), 1e-30)]
        self.names = [every[k] for k in varied]
        self.logarithmic = np.array([name in logarithmic for name in self.names])
        self._prior, self._parameters = prior, parameters
        scaled = self._scaled(table[:, varied])
        self._centre, self._spread = scaled.mean(0), scaled.std(0)
        units = (scaled - self._centre) / self._spread
        self._least, self._most = units.min(0), units.max(0)
        # Without any evidence, an interval is that of the sampled values.
        tail = 0.5 * (1.0 - COVERAGE)
        self._prior_ends = np.quantile(units, tail, axis=0), np.quantile(units, 1.0 - tail, axis=0)
        self._sizes = [self._fit(training, held_out, size) for size in SIZES]

    def estimates(self, values: np.ndarray, weights: np.ndarray) -> dict[str, Estimate]:
        """Parameters from the evidence ``values, weights [n, Z]`` of n frames of one garment."""
        units = self._units(values, weights, None)
        known = np.clip(1.0 - (units[2] - units[1]) / self._prior_width, 0.0, 1.0)
        found = zip(self.names, *(self._plain(part) for part in units), known, strict=True)
        return {name: Estimate(float(p), float(a), float(b), float(k)) for name, p, a, b, k in found}

    def checked(self, tests: Sequence[Evidence], frames: int) -> list[dict[str, float | str | int | None]]:
        """Rows of R^2, coverage and width of each parameter on unseen sequences, from ``frames`` frames of each.

        A set that was calibrated on is judged by the calibration of all others. Stretches are ``DRAWS`` a sequence.
        ``interval_of_range`` is the mean width of the interval over that of the sampled values.
        """
        truths, found = [], []
        for evidence in tests:
            for part in _stretches(len(evidence.values), frames):
                found.append(self._units(evidence.values[part], evidence.weights[part], evidence.phi))
                truths.append(self._truth(evidence.phi))
        point, low, high = (np.stack(part) for part in zip(*found, strict=True))
        truth = np.stack(truths)
        error, total = ((point - truth) ** 2).sum(0), ((truth - truth.mean(0)) ** 2).sum(0)
        held = ((truth >= low - 1e-9) & (truth <= high + 1e-9)).mean(0)
        width = (high - low).mean(0) / self._prior_width
        return [
            {
                "parameter": name,
                "frames": frames,
                "r_squared": float(1.0 - error[k] / total[k]) if total[k] > 1e-12 else None,
                "coverage_percent": 100.0 * float(held[k]),
                "interval_of_range": float(width[k]),
                "sequences": len(tests),
                "parameter_sets": len({e.phi for e in tests}),
            }
            for k, name in enumerate(self.names)
        ]

    @property
    def _prior_width(self) -> np.ndarray:
        return self._prior_ends[1] - self._prior_ends[0]

    def _units(
        self, values: np.ndarray, weights: np.ndarray, phi: int | None
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Estimate and ends of the interval, [P] each, in units of the training sets' deviation; calibrated without
        the set ``phi``."""
        size = min(self._sizes, key=lambda s: abs(np.log(s.frames / len(values))))
        calibration = size.without.get(phi, size.calibration)
        raw = size.ridge.predict(self._pooled(values, weights)[None])[0]
        # Nothing outside of the sampled range was ever seen: neither is it claimed.
        point = np.clip(calibration.slope * raw, self._least, self._most)
        low, high = (
            np.maximum(point - calibration.reach, self._least),
            np.minimum(point + calibration.reach, self._most),
        )
        unknown = high - low >= self._prior_width
        return point, np.where(unknown, self._prior_ends[0], low), np.where(unknown, self._prior_ends[1], high)

    def _fit(self, training: Sequence[Evidence], held_out: Sequence[Evidence], size: int) -> _Size:
        x, y, owner = self._stacked(training, size)
        ridge = _ridge(x, y)
        other = self._stacked(held_out, size) if len({e.phi for e in held_out}) >= LEAST_SETS else None
        if other is not None:
            z, truth, sets = other
            raw = ridge.predict(z)
            without = {
                int(phi): _Calibration.of(raw[m], truth[m], sets[m]) for phi in np.unique(sets) for m in [sets != phi]
            }
            return _Size(size, ridge, _Calibration.of(raw, truth, sets), without)
        phis = np.unique(owner)
        folds, raw = min(FOLDS, len(phis)), np.zeros_like(y)
        for fold in range(folds):
            out = np.isin(owner, phis[fold::folds])
            raw[out] = _ridge(x[~out], y[~out]).predict(x[out])
        return _Size(size, ridge, _Calibration.of(raw, y, owner), {})

    def _stacked(self, sequences: Sequence[Evidence], size: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """z [N, Z], truths [N, P] in units and parameter sets [N] of stretches of a size."""
        latents, targets, owners = [], [], []
        for evidence in sequences:
            for part in _stretches(len(evidence.values), size):
                latents.append(self._pooled(evidence.values[part], evidence.weights[part]))
                targets.append(self._truth(evidence.phi))
                owners.append(evidence.phi)
        return np.stack(latents), np.stack(targets), np.array(owners)

    def _truth(self, phi: int) -> np.ndarray:
        values = np.array([self._parameters[phi][name] for name in self.names])
        return (self._scaled(values) - self._centre) / self._spread

    def _pooled(self, values: np.ndarray, weights: np.ndarray) -> np.ndarray:
        return ((values * weights).sum(0) / (weights.sum(0) + self._prior)).astype(np.float32)

    def _scaled(self, table: np.ndarray) -> np.ndarray:
        return np.where(self.logarithmic, np.log(np.where(self.logarithmic, table, 1.0)), table)

    def _plain(self, units: np.ndarray) -> np.ndarray:
        scaled = units * self._spread + self._centre
        return np.where(self.logarithmic, np.exp(np.where(self.logarithmic, scaled, 0.0)), scaled)


def _stretches(frames: int, size: int) -> list[slice]:
    """At most ``DRAWS`` stretches of ``size`` frames in a row, or all frames where there are fewer."""
    length = min(size, frames)
    starts = np.unique(np.round(np.linspace(0, frames - length, DRAWS)).astype(int))
    return [slice(start, start + length) for start in starts.tolist()]


def _ridge(x: np.ndarray, y: np.ndarray) -> Ridge:
    ridge = Ridge()
    ridge.add(x, y)
    return ridge.fit(1e-2)
