"""Composing sequences from keyframes, against what was simulated (Wang 2019, section 4 (iii) and Fig. 13).

In: held-out simulated sequences in canonical frames, with their motion. Out: rows of the table ``composition``: the
error of everything between k evenly spaced keyframes, both ends included, when it is

- ``intrinsic space``: z of each keyframe, interpolated, decoded along the motion (the paper's method);
- ``intrinsic space, detail kept``: the same, and what the true keyframe has beyond it fades from there (ours);
- ``descriptors``: the keyframes' shape descriptors, interpolated and decoded (Fig. 13 (e));
- ``vertices, canonical`` and ``vertices, world``: linear interpolation of vertices in the frame of the pelvis and in
  the world (Fig. 13 (c)).

Only frames that are no keyframes count: at a keyframe, vertices have no error by construction.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np

from evaluation.metrics import rmse
from evaluation.table import Row

INTRINSIC, DETAILED = "intrinsic space", "intrinsic space, detail kept"
DESCRIPTORS, CANONICAL, WORLD = "descriptors", "vertices, canonical", "vertices, world"
LINEAR = (DESCRIPTORS, CANONICAL, WORLD)
"""Interpolations that know nothing of the motion."""

COUNTS = (2, 5, 10, 20)
"""Keyframes of a sequence that the table shows."""
TRIED = (2, 3, 4, 5, 6, 7, 8, 9, 10, 12, 14, 16, 18, 20, 24, 28, 32, 40, 48)
"""Numbers of keyframes among which the one is looked for that reaches an error."""

Between = Callable[[np.ndarray], np.ndarray]
"""Canonical garments [T, V, 3] [m] of all frames of a sequence, from the numbers of its keyframes [k]."""


@dataclass(frozen=True)
class ComposedSequence:
    """A simulated sequence, and how each method fills it between keyframes.

    Attributes:
        truth: Simulated garment in canonical frames [m], shape [T, V, 3].
        methods: By name.
        inside: Number of vertices of a canonical garment [V, 3] of a frame that are inside the body; takes both.
    """

    truth: np.ndarray
    methods: dict[str, Between]
    inside: Callable[[np.ndarray, int], int]


def composition_rows(
    sequences: Iterable[ComposedSequence], split: str, stride: int = 16, counts: tuple[int, ...] = COUNTS
) -> list[Row]:
    """Errors of each method at each number of keyframes.

    Args:
        sequences: Of one length each; taken one at a time.
        split: Name for the rows.
        stride: Frames from one to the next in which vertices inside the body are counted.
        counts: Numbers of keyframes whose rows are made.

    Returns:
        Rows with ``rmse_mm`` (root mean square over vertices and frames between keyframes, mean over sequences),
        ``inside_percent`` (vertices inside the body, before any refinement),
        ``keyframes_for_the_same`` and its share of the frames in percent: how many keyframes the method needs for the
        error that ``intrinsic space`` has with two; empty where none of ``TRIED`` reaches it.

    Raises:
        ValueError: No sequence.
    """
    errors: dict[tuple[str, int], list[float]] = {}
    inside: dict[tuple[str, int], list[float]] = {}
    lengths = []
    for sequence in sequences:
        frames, vertices = sequence.truth.shape[:2]
        lengths.append(frames)
        for name, between in sequence.methods.items():
            for count in sorted({*counts, *(TRIED if name in LINEAR else ())}):
                keys = evenly(frames, count)
                rest = np.setdiff1d(np.arange(frames), keys)
                if len(keys) < count or len(rest) == 0:
                    continue
                filled = between(keys)
                errors.setdefault((name, count), []).append(rmse(filled[rest], sequence.truth[rest]))
                if count in counts:
                    looked = rest[::stride]
                    found = sum(sequence.inside(filled[frame], int(frame)) for frame in looked)
                    inside.setdefault((name, count), []).append(found / (len(looked) * vertices))
    if not lengths:
        raise ValueError(f"composition, {split}: there is no sequence to compose")
    # A sequence that is too short for a number of keyframes would make its mean one of other sequences.
    means = {key: float(np.mean(values)) for key, values in errors.items() if len(values) == len(lengths)}
    frames, wanted = float(np.mean(lengths)), means.get((INTRINSIC, 2))
    rows: list[Row] = []
    for name in dict.fromkeys(name for name, _ in means):
        needed = None if wanted is None else keyframes_needed(means, name, wanted)
        for count in counts:
            if (name, count) in means:
                rows.append(
                    {
                        "split": split,
                        "method": name,
                        "keyframes": count,
                        "keyframe_share_percent": 100.0 * count / frames,
                        "rmse_mm": 1e3 * means[name, count],
                        "inside_percent": 100.0 * float(np.mean(inside[name, count])),
                        "keyframes_for_the_same": needed,
                        "share_for_the_same_percent": None if needed is None else 100.0 * needed / frames,
                        "frames": frames,
                        "sequences": len(lengths),
                    }
                )
    return rows


def keyframes_needed(means: dict[tuple[str, int], float], method: str, wanted: float) -> int | None:
    """Least number of keyframes with which a method's error is at most ``wanted``; None where none of them is."""
    reached = [count for (name, count), error in means.items() if name == method and error <= wanted * (1.0 + 1e-9)]
    return min(reached, default=None)


def evenly(frames: int, count: int) -> np.ndarray:
    """Numbers of ``count`` keyframes, spread evenly, both ends included; fewer where there are fewer frames."""
    return np.unique(np.round(np.linspace(0, frames - 1, min(count, frames))).astype(np.int64))


def linear(values: np.ndarray, keys: np.ndarray) -> np.ndarray:
    """Values [T, ...] of all frames, from those of the keyframes by linear interpolation."""
    frames = np.arange(len(values), dtype=np.float64)
    right = np.clip(np.searchsorted(keys, frames), 1, len(keys) - 1)
    left = right - 1
    share = ((frames - keys[left]) / (keys[right] - keys[left])).reshape(-1, *([1] * (values.ndim - 1)))
    share = share.astype(values.dtype)
    return (1 - share) * values[keys[left]] + share * values[keys[right]]
