"""Ridge regression from sums: memory does not grow with the number of samples.

In: blocks of features [N, D] and targets [N, K]. Out: weights for standardised features. Sums of the training and the
held-out blocks are kept apart, so that the penalty can be chosen without a second pass over the data.
"""

from __future__ import annotations

import numpy as np

REACH = 6.0
"""Standard deviations from the training mean beyond which a feature is held, as the networks hold theirs: what a linear
map makes of a movement that it never saw has no bound."""

PENALTIES = (1e-4, 1e-3, 1e-2, 1e-1, 1.0)
"""Tried penalties, relative to the variance of a standardised feature."""

MOST_TARGETS_FOR_CHOICE = 96
"""Target columns that the held-out error is measured on; they are spread evenly."""


class _Sums:
    def __init__(self, features: int, targets: int) -> None:
        self.count = 0
        self.x, self.y = np.zeros(features), np.zeros(targets)
        self.xx, self.xy = np.zeros((features, features)), np.zeros((features, targets))
        self.yy = np.zeros(targets)

    def __add__(self, other: _Sums) -> _Sums:
        total = _Sums(len(self.x), len(self.y))
        for name in vars(total):
            setattr(total, name, getattr(self, name) + getattr(other, name))
        return total

    def columns(self, chosen: np.ndarray) -> _Sums:
        part = _Sums(len(self.x), len(chosen))
        part.count, part.x, part.xx = self.count, self.x, self.xx
        part.y, part.xy, part.yy = self.y[chosen], self.xy[:, chosen], self.yy[chosen]
        return part


class Ridge:
    """Linear map with an intercept and a penalty on its standardised weights."""

    def __init__(self) -> None:
        self._train: _Sums | None = None
        self._held_out: _Sums | None = None
        self.penalty = float("nan")

    def add(self, features: np.ndarray, targets: np.ndarray, held_out: bool = False) -> None:
        """Add a block: features [N, D], targets [N, K]; held-out blocks choose the penalty and then join the fit."""
        if features.ndim != 2 or targets.ndim != 2 or len(features) != len(targets):
            raise ValueError(
                f"ridge: expected features [N, D] and targets [N, K], got {list(features.shape)} and "
                f"{list(targets.shape)}"
            )
        if self._train is None:
            self._train = _Sums(features.shape[1], targets.shape[1])
            self._held_out = _Sums(features.shape[1], targets.shape[1])
            # Sums are taken about the first sample: large common offsets would cost digits.
            self._origin_x, self._origin_y = features[0].astype(np.float64), targets[0].astype(np.float64)
        sums = self._held_out if held_out else self._train
        x, y = features - self._origin_x, targets - self._origin_y
        sums.count += len(x)
        sums.x += x.sum(0)
        sums.y += y.sum(0)
        sums.xx += x.T @ x
        # The large product in single precision, its sum over blocks in double.
        sums.xy += x.T.astype(np.float32) @ y.astype(np.float32)
        sums.yy += np.einsum("nk,nk->k", y, y)

    def fit(self, penalty: float | None = None) -> Ridge:
        """Solve for the weights; without ``penalty`` the one with the least held-out error is taken."""
        if self._train is None or self._train.count == 0:
            raise ValueError("ridge: nothing to fit, no training block was added")
        if penalty is None and self._held_out.count:
            targets = len(self._train.y)
            chosen = np.unique(np.linspace(0, targets - 1, min(targets, MOST_TARGETS_FOR_CHOICE)).astype(int))
            train, held_out = self._train.columns(chosen), self._held_out.columns(chosen)
            errors = [_held_out_error(*_solve(train, p), held_out) for p in PENALTIES]
            penalty = PENALTIES[int(np.argmin(errors))]
        self.penalty = 1e-2 if penalty is None else penalty
        weights, intercept = _solve(self._train + self._held_out, self.penalty)
        self._intercept = (intercept + self._origin_y - self._origin_x @ weights).astype(np.float32)
        self._weights = weights.astype(np.float32)
        every = self._train + self._held_out
        mean = every.x / every.count
        spread = REACH * np.sqrt(np.maximum(np.diag(every.xx) / every.count - mean**2, 0.0))
        middle = self._origin_x + mean
        self._low, self._high = (middle - spread).astype(np.float32), (middle + spread).astype(np.float32)
        return self

    @property
    def size(self) -> int:
        """How many numbers were fitted."""
        return self._weights.size + self._intercept.size

    def predict(self, features: np.ndarray) -> np.ndarray:
        """Targets [N, K] float32 of features [N, D]."""
        held = np.clip(features.astype(np.float32), self._low, self._high)
        return held @ self._weights + self._intercept


def _solve(sums: _Sums, penalty: float) -> tuple[np.ndarray, np.ndarray]:
    """Weights [D, K] and intercept [K] about the origin of the sums."""
    mean_x, mean_y = sums.x / sums.count, sums.y / sums.count
    covariance = sums.xx / sums.count - np.outer(mean_x, mean_x)
    cross = sums.xy / sums.count - np.outer(mean_x, mean_y)
    deviation = np.sqrt(np.maximum(np.diag(covariance), 0.0))
    # A feature that never moved in training (a wrist, a pinned joint) says nothing and gets no weight.
    alive = deviation > 1e-6
    scale = np.where(alive, 1.0 / np.maximum(deviation, 1e-6), 0.0)
    standardised = covariance * scale[:, None] * scale + penalty * np.identity(len(scale))
    weights = scale[:, None] * np.linalg.solve(standardised, scale[:, None] * cross)
    return weights, mean_y - mean_x @ weights


def _held_out_error(weights: np.ndarray, intercept: np.ndarray, sums: _Sums) -> float:
    """Squared error summed over the blocks of ``sums``, from the sums alone."""
    xy = sums.xy - np.outer(sums.x, intercept)
    square = np.einsum("dk,dk->", weights, sums.xx @ weights) - 2 * np.einsum("dk,dk->", weights, xy)
    return float(square + sums.yy.sum() - 2 * sums.y @ intercept + sums.count * intercept @ intercept)
