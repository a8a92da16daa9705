"""Rows of the table that holds all systems beside each other on one garment.

In: test sequences of the garment, and systems as predictors of its vertices in the world. Out: a row a split and
system: its errors, how it stretches, bends and sinks into the body before any projection, what it costs to run, and
what it was trained on. Figures are those of ``evaluation.regressor``; times are processor time, of one thread where the
caller sees to that.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from collections.abc import Sequence as Many
from dataclasses import dataclass, field

import numpy as np

from body.model import Body
from datasets.sequences import Sequence
from evaluation.divergence import held_near
from evaluation.metrics import mean_vertex_error
from evaluation.regressor import Predictor, RegressorEvaluation, regressor_rows
from evaluation.table import Row
from garments.layer_wearing import LayerWearing
from garments.template import GarmentTemplate

FIGURES = {
    "mean_vertex_mm": "error_mm",
    "rmse_mm": "rmse_mm",
    "edge_mm": "edge_mm",
    "bend": "bend",
    "collision_rate_percent": "collision_percent",
    "deepest_mm": "deepest_mm",
    "sted": "sted",
}
"""Columns of ``evaluation.regressor`` and what they are called here."""

REPETITIONS = 5
"""Times that a system dresses the timed sequence, after one that warms up."""


ADRIFT = 1.0
"""Mean error above which a garment is not on its body any more [m]."""


@dataclass(frozen=True)
class System:
    """A way to dress the garment.

    Attributes:
        paper: Whose it is: ``Shi 2023`` ..., or ``baseline`` for what needs no network.
        method: Name of the row.
        predict: Vertices in the world [m], [T, V, 3], of a sequence; None where it has nothing to say.
        told: What it is told of the sequence.
        published: Whether it follows the paper; None where there is no paper.
        points: The points over the body [m], [T, C, 3], of a system that says these: ``predict`` is then the garment
            at them. None: they are those of its garment.
        timed: Whether its time is measured: not where it sees the truth.
        costs: Further columns: parameters, training.
    """

    paper: str
    method: str
    predict: Predictor
    told: str
    published: bool | None = None
    points: Predictor | None = None
    timed: bool = True
    costs: Row = field(default_factory=dict)


def system_rows(
    sequences: Many[Sequence],
    systems: Many[System],
    body: Body,
    template: GarmentTemplate,
    wearing: LayerWearing,
    settings: RegressorEvaluation,
    progress: Callable[[int], None] | None = None,
) -> list[Row]:
    """Evaluate all systems on all sequences.

    Args:
        sequences: Test sequences of the template's garment on the body, of any splits.
        systems: In table order; no two of one paper and method.
        body: The body.
        template: The garment.
        wearing: The points of the garment that lie over body vertices.
        settings: Strides, and how many sequences are looked at closely.
        progress: Called with 1 after each sequence and system.

    Returns:
        Rows, split by split in order of first appearance. Times are of the first sequence and stand in every row.
        What diverges is held within ten metres of the body, so that it is seen and nothing else is disturbed.

    Raises:
        ValueError: A sequence of another garment, or a prediction of a wrong shape.
    """
    if not sequences:
        raise ValueError(f"systems: no test sequence of garment '{template.name}'; were all of them dropped?")
    named = {f"{system.paper}, {system.method}": system for system in systems}
    if len(named) < len(systems):
        raise ValueError("systems: two of them have the same name")
    watched = {name: _Watched(system, wearing) for name, system in named.items()}
    predictors = {name: one.predict for name, one in watched.items()}
    found = regressor_rows(sequences, predictors, body, template, settings, progress)
    milliseconds = {name: 1e3 * seconds_a_frame(s.predict, sequences[0]) for name, s in named.items() if s.timed}
    rows = []
    for row in found:
        name, split = str(row["method"]), str(row["split"])
        system = named[name]
        figures = {ours: row.get(theirs) for theirs, ours in FIGURES.items()}
        if figures["error_mm"] > 1e3 * ADRIFT:  # nowhere near the body, nothing is inside it
            figures |= {"collision_percent": None, "deepest_mm": None}
        rows.append(
            {
                "split": split,
                "paper": system.paper,
                "method": system.method,
                "published": system.published,
                "told": system.told,
                "sequences": row["sequences"],
                **figures,
                "layer_error_mm": 1e3 * float(np.mean(watched[name].errors[split])),
                "time_ms_per_frame": milliseconds.get(name),
            }
            | system.costs
            | {"sted_parameters": row["sted_parameters"]}
        )
    return rows


class _Watched:
    """A system whose points over the body are compared as it predicts: mean distances [m] of sequences, by split."""

    def __init__(self, system: System, wearing: LayerWearing) -> None:
        self.system, self.wearing = system, wearing
        self.errors: dict[str, list[float]] = {}

    def predict(self, sequence: Sequence) -> np.ndarray | None:
        """What the system says."""
        wearing, system = self.wearing, self.system
        if system.points is None:
            garment = system.predict(sequence)
            if garment is None:
                return None
            garment = held(garment, sequence)
            points = wearing.points(garment)
        else:
            points = system.points(sequence)
            if points is None:
                return None
            garment = held(wearing.garment(points, sequence.pose, sequence.root), sequence)
        error = mean_vertex_error(np.asarray(points), wearing.points(sequence.vertices))
        self.errors.setdefault(sequence.split, []).append(error)
        return garment


def held(garment: np.ndarray, sequence: Sequence) -> np.ndarray:
    """Vertices [T, V, 3] [m] held near the pelvis: ``evaluation.divergence``."""
    garment = np.asarray(garment)
    if garment.shape != sequence.vertices.shape:
        return garment  # whoever evaluates it says so
    pelvis = np.asarray(sequence.joints[:, :1], dtype=np.float32)
    local = garment - pelvis
    near = held_near(local)
    return garment if near is local else near + pelvis


def seconds_a_frame(predict: Predictor, sequence: Sequence) -> float:
    """Processor time a recorded frame [s], median over repetitions of the whole sequence."""
    taken = []
    for _ in range(REPETITIONS + 1):
        start = time.process_time()
        predict(sequence)
        taken.append((time.process_time() - start) / sequence.frames)
    return float(np.median(taken[1:]))
