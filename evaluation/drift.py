"""Rows of the drift table: does a regressor get worse along a sequence, and does it take long ones as a whole?

In: long simulated sequences and predictors. Out: one row a method with its error in each tenth of the sequence, the
error of the last tenth over that of the first, and its error over the first 60, 125, ... frames. Motions begin calm,
which is easy: the tenths begin after that. A motion may still be harder at its end than at its beginning, so
the rows of methods without any memory (mean shape, ridge regression) are the control: what they lose along the sequence
is not drift.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from collections.abc import Sequence as Many

import numpy as np

from datasets.sequences import Sequence
from evaluation.regressor import Predictor
from evaluation.table import Row

TENTHS = 10
RUN_UP = 60
"""Frames before the first tenth, at most a tenth of the sequence; they are in the errors over the first n frames."""

LENGTHS = (60, 125, 250, 500, 1000)
"""Lengths [frames] whose error is shown, as far as the sequences reach."""


def drift_rows(
    sequences: Many[Sequence],
    predictors: Mapping[str, Predictor],
    progress: Callable[[int], None] | None = None,
) -> list[Row]:
    """Errors along sequences of one length, root of the mean square over sequences, frames and vertices [mm].

    Raises:
        ValueError: No sequences, unequal lengths, or fewer than ten frames.
    """
    lengths = sorted({s.frames for s in sequences})
    if len(lengths) != 1 or lengths[0] < TENTHS:
        raise ValueError(f"drift: expected sequences of one length of at least {TENTHS} frames, got {lengths}")
    frames = lengths[0]
    rows = []
    for method, predict in predictors.items():
        square = np.zeros(frames)
        for sequence in sequences:
            difference = np.asarray(predict(sequence)) - sequence.vertices
            # A sum over the last axis alone, of three numbers, would take ten times as long.
            square += np.einsum("tvc,tvc->t", difference, difference) / difference.shape[1]
            if progress is not None:
                progress(1)
        square /= len(sequences)
        tenths = [_root_mm(part) for part in np.array_split(square[min(RUN_UP, frames // TENTHS) :], TENTHS)]
        row: Row = {"garment": sequences[0].garment, "method": method, "sequences": len(sequences), "frames": frames}
        row |= {"last_tenth_over_first": tenths[-1] / max(tenths[0], 1e-9)}
        row |= {f"tenth_{number}_rmse_mm": value for number, value in enumerate(tenths, start=1)}
        row |= {f"first_{n}_frames_rmse_mm": _root_mm(square[:n]) for n in LENGTHS if n <= frames}
        rows.append(row)
    return rows


def _root_mm(square: np.ndarray) -> float:
    return 1e3 * float(np.sqrt(square.mean()))
