"""Intrinsic parameters read from z, with how sure they are.

In: what training frames say of z (``MotionInvariantNetwork.evidence``) and the parameters they were simulated with.
Out: an estimate and an interval for each parameter, from the evidence of one frame or of several.

Estimates are linear in z (ridge regression), on the scale on which the parameter is sampled. The interval is what such
estimates missed on training parameter sets that the regression had not seen: their quantiles over ``FOLDS`` folds of
parameter sets. Nothing is assumed of the noise. A frame says less than a clip, so both are kept for several numbers
of frames. A parameter that a shape does not show has an interval as wide as the range that it was sampled from, and
says so by that.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from evaluation.ridge import Ridge

SIZES = (1, 4, 16, 64)
"""Numbers of frames in a row that estimates are made for."""
DRAWS = 4
"""Stretches of a training sequence of each size, spread evenly."""
FOLDS = 5
"""Parts of the training parameter sets; each is estimated by what was learned from the others."""
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
class _Size:
    frames: int
    ridge: Ridge
    low: np.ndarray
    high: np.ndarray


class ParameterReader:
    """Regressions for several numbers of frames, with their calibration.

    Args:
        training: Sequences to learn from, of at least ``FOLDS`` parameter sets.
        parameters: Values by name, by number of the parameter set; names that do not vary are left out.
        logarithmic: Names that are regressed as their logarithm.
        prior: Weight of z = 0 in pooling (``MotionInvariantNetwork.prior``).

    Raises:
        ValueError: Fewer than two parameter sets.
    """

    def __init__(
        self,
        training: Sequence[Evidence],
        parameters: Mapping[int, Mapping[str, float]],
        logarithmic: Sequence[str] | set[str],
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
        self._prior = prior
        scaled = self._scaled(table[:, varied])
        self._centre, self._spread = scaled.mean(0), scaled.std(0)
        truths = dict(zip(phis, (scaled - self._centre) / self._spread, strict=True))
        units = np.stack(list(truths.values()))
        self._least, self._most = units.min(0), units.max(0)
        # Of the sampled values, what the interval of an estimate without any evidence would hold.
        tail = 0.5 * (1.0 - COVERAGE)
        self._width = np.quantile(units, 1.0 - tail, axis=0) - np.quantile(units, tail, axis=0)
        self._sizes = [self._fit(training, truths, size) for size in SIZES]

    def estimates(self, values: np.ndarray, weights: np.ndarray) -> dict[str, Estimate]:
        """Parameters from the evidence ``values, weights [n, Z]`` of n frames of one garment."""
        point, low, high = (self._plain(part) for part in self._units(values, weights))
        inner = self._units(values, weights)
        known = np.clip(1.0 - (inner[2] - inner[1]) / self._width, 0.0, 1.0)
        return {
            name: Estimate(float(p), float(a), float(b), float(k))
            for name, p, a, b, k in zip(self.names, point, low, high, known, strict=True)
        }

    def checked(
        self, tests: Sequence[Evidence], parameters: Mapping[int, Mapping[str, float]], frames: int
    ) -> list[dict[str, float | str | int | None]]:
        """Rows of R^2, coverage and width of each parameter on unseen sequences, from ``frames`` frames of each.

        The stretches are those of the training: ``DRAWS`` a sequence. ``interval_of_range`` is the mean width of the
        interval over that of the sampled values.
        """
        rows, truths, found = [], [], []
        for evidence in tests:
            truth = np.array([parameters[evidence.phi][name] for name in self.names])
            for part in _stretches(len(evidence.values), frames):
                found.append(self._units(evidence.values[part], evidence.weights[part]))
                truths.append((self._scaled(truth[None])[0] - self._centre) / self._spread)
        point, low, high = (np.stack(part) for part in zip(*found, strict=True))
        truth = np.stack(truths)
        error, total = ((point - truth) ** 2).sum(0), ((truth - truth.mean(0)) ** 2).sum(0)
        held = ((truth >= low - 1e-9) & (truth <= high + 1e-9)).mean(0)
        width = (high - low).mean(0) / self._width
        for k, name in enumerate(self.names):
            rows.append(
                {
                    "parameter": name,
                    "frames": frames,
                    "r_squared": float(1.0 - error[k] / total[k]) if total[k] > 1e-12 else None,
                    "coverage_percent": 100.0 * float(held[k]),
                    "interval_of_range": float(width[k]),
                    "sequences": len(tests),
                    "parameter_sets": len({e.phi for e in tests}),
                }
            )
        return rows

    def _units(self, values: np.ndarray, weights: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Estimate and ends of the interval [P] each, in units of the training sets' deviation."""
        size = min(self._sizes, key=lambda s: abs(np.log(s.frames / len(values))))
        point = size.ridge.predict(self._pooled(values, weights)[None])[0]
        # Nothing outside of the sampled range was ever seen: neither is it claimed.
        held = [np.clip(part, self._least, self._most) for part in (point, point + size.low, point + size.high)]
        return held[0], held[1], held[2]

    def _fit(self, training: Sequence[Evidence], truths: Mapping[int, np.ndarray], size: int) -> _Size:
        latents, targets, owners = [], [], []
        for evidence in training:
            for part in _stretches(len(evidence.values), size):
                latents.append(self._pooled(evidence.values[part], evidence.weights[part]))
                targets.append(truths[evidence.phi])
                owners.append(evidence.phi)
        x, y, owner = np.stack(latents), np.stack(targets), np.array(owners)
        phis = np.unique(owner)
        folds = min(FOLDS, len(phis))
        missed = []
        for fold in range(folds):
            out = np.isin(owner, phis[fold::folds])
            missed.append(y[out] - _ridge(x[~out], y[~out]).predict(x[out]))
        tail = 0.5 * (1.0 - COVERAGE)
        # Sets count, not their stretches: so many are the independent truths (split conformal prediction).
        level = min(1.0, (1.0 - tail) * (len(phis) + 1) / len(phis))
        errors = np.concatenate(missed)
        return _Size(size, _ridge(x, y), np.quantile(errors, 1.0 - level, axis=0), np.quantile(errors, level, axis=0))

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
