"""From shards to the arrays that training and evaluation stages take."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from functools import cache

import numpy as np

from body.model import Body
from datasets.sequences import Sequence, load_sequences, to_canonical
from datasets.splits import SplitRule
from pipeline.stage import Job


def job_body(job: Job) -> Body:
    """The run's body."""
    settings = job.spec["body"]
    return Body.load(settings["resolution"]).shaped(settings["shape"])


def job_bodies(job: Job) -> Callable[[Sequence], Body]:
    """The body of each sequence, in the shape that it was simulated in: for readers of the plan of bodies."""
    plain = Body.load(job.spec["body"]["resolution"])

    @cache
    def shaped(shape: tuple[float, ...]) -> Body:
        return plain.shaped(shape)

    return lambda sequence: shaped(tuple(sequence.shape.tolist()))


def job_sequences(
    job: Job, paths: Iterable[str], splits: tuple[str, ...] | None = None, plans: tuple[str, ...] | None = None
) -> list[Sequence]:
    """Sequences of the shards among the job's inputs; ``ValueError`` when a split that is asked for is empty.

    Where no plans are named, all that are on the run's own body (``datasets.sequences.ONE_BODY``).
    """
    sequences = load_sequences(paths, SplitRule(**job.spec["splits"]), splits, plans)
    if not sequences:
        wanted = f"splits {', '.join(splits or ('any',))} of plans {', '.join(plans or ('any',))}"
        raise ValueError(f"{job.spec['garment']}: no simulated sequence in {wanted}; were all of them dropped?")
    return sequences


def canonical_frames(sequences: Iterable[Sequence], body: Body) -> np.ndarray:
    """All garment frames in their canonical frame [m], shape [N, V, 3]."""
    return np.concatenate([to_canonical(s.vertices, s.pose, s.root, body) for s in sequences])


def frame_numbers(sequences: list[Sequence], values: Iterable[int]) -> np.ndarray:
    """One integer a sequence, repeated for each of its frames, shape [N]."""
    return np.repeat(np.fromiter(values, dtype=np.int64), [s.frames for s in sequences])
