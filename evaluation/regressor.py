"""Rows of the garment regressor table: every method on every split, before and after refinement.

In: simulated test sequences of one garment and predictors (learned networks and baselines alike) as callables
``sequence -> vertices in the world [m], [T, V, 3]``. Out: one row a split and method. A figure is computed for each
sequence and then averaged over sequences; deepest penetrations are maxima. Body contact and Hausdorff distance look at
every ``frames_stride``-th frame, everything else at all frames. Refined methods are refined and judged in every frame.
A predictor may have nothing to say about a sequence (None): it then is no part of that method's row.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping
from collections.abc import Sequence as Many
from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from body.model import Body
from datasets.sequences import Sequence
from evaluation.collisions import contacts, refine_and_judge
from evaluation.metrics import (
    NearestVertices,
    VertexDistances,
    bend_of_normals,
    cosine_distance,
    edge_deviation,
    hausdorff,
    rmse,
    squared_variation,
)
from evaluation.sted import Sted, StedParameters, TrueEdges
from evaluation.table import Row
from garments.template import GarmentTemplate
from geometry.topology import vertex_normals
from models.refinement import RefinementSettings, Refiner

Predictor = Callable[[Sequence], np.ndarray | None]


@dataclass(frozen=True)
class RegressorEvaluation:
    """How to evaluate.

    Attributes:
        frames_stride: Every how many frames the costly figures are taken.
        detailed: Sequences of a split, evenly spread, of which more than the errors is computed; 0 = all.
        refinement: Weights of the refinement.
        sted: Parameters of STED; they stand in every row.
    """

    frames_stride: int = 4
    detailed: int = 0
    refinement: RefinementSettings = field(default_factory=RefinementSettings)
    sted: StedParameters = field(default_factory=StedParameters)


def regressor_rows(
    sequences: Many[Sequence],
    predictors: Mapping[str, Predictor],
    body: Body | Callable[[Sequence], Body],
    template: GarmentTemplate,
    settings: RegressorEvaluation | None = None,
    progress: Callable[[int], None] | None = None,
    refined: Collection[str] = (),
    rest: Callable[[Sequence], np.ndarray] | None = None,
) -> list[Row]:
    """Evaluate all predictors on all sequences.

    Args:
        sequences: Test sequences of the template's garment, of any splits.
        predictors: Methods by name, in table order. ``lambda s: s.vertices`` adds the simulation itself.
        body: The body that the sequences were simulated on, or that of each.
        template: The garment.
        settings: Strides and weights.
        progress: Called with 1 after each sequence and method.
        refined: Methods that are refined as well; it costs more than all else.
        rest: Rest shape [m], [V, 3], of a sequence's garment; the template's where None.

    Returns:
        Rows, split by split in order of first appearance.

    Raises:
        ValueError: A sequence of another garment, or a prediction of a wrong shape or with values that are not finite.
    """
    body_of = body if callable(body) else lambda _: body
    figures = _Figures(template, settings or RegressorEvaluation())
    collected: dict[tuple[str, str], list[dict[str, float]]] = {
        (split, method): [] for split in dict.fromkeys(s.split for s in sequences) for method in predictors
    }
    whole = _detailed(sequences, figures.settings.detailed)
    for number, sequence in enumerate(sequences):
        if sequence.garment != template.name:
            raise ValueError(f"evaluation of garment '{template.name}': got a sequence of '{sequence.garment}'")
        own_rest = template.vertices if rest is None else rest(sequence)
        worn = _Worn(body_of(sequence), sequence, own_rest, figures)
        looked_at: dict[str, np.ndarray] = {}
        for method, predict in predictors.items():
            predicted = predict(sequence)
            if predicted is not None:
                predicted = np.asarray(predicted, dtype=np.float32)
                _check(predicted, sequence, method)
                found = figures.errors(predicted, worn)
                if number in whole:
                    found |= figures.of(predicted, worn)
                    looked_at[method] = predicted[:: figures.settings.frames_stride]
                if method in refined:
                    found |= figures.refined(predicted, worn)
                collected[sequence.split, method].append(found)
            if progress is not None:
                progress(1)
        for method, contact in figures.contacts(looked_at, worn).items():
            collected[sequence.split, method][-1] |= contact
    return [
        figures.row(template.name, split, method, values) for (split, method), values in collected.items() if values
    ]


class _Worn:
    """One sequence's simulated garment, its rest shape and the body under it: what all methods share, made once."""

    def __init__(self, body: Body, sequence: Sequence, rest: np.ndarray, figures: _Figures) -> None:
        self._body, self._sequence, self._figures = body, sequence, figures
        self.truth, self.rest, self.body_faces = sequence.vertices, rest, body.faces

    @cached_property
    def variation(self) -> float:
        """Squared norm [m^2] of the simulated garment about each frame's mean point."""
        return squared_variation(self.truth)

    @cached_property
    def body_vertices(self) -> np.ndarray:
        """The posed body [m], [T, B, 3]."""
        return self._body.posed(self._sequence.pose, self._sequence.root)

    @cached_property
    def nearest(self) -> NearestVertices:
        """Of the body in every ``frames_stride``-th frame."""
        return NearestVertices(self.body_vertices[:: self._figures.settings.frames_stride], self.body_faces)

    @cached_property
    def normals(self) -> np.ndarray:
        """Unit vertex normals of the simulated garment, [T, V, 3]."""
        return vertex_normals(self.truth, self._figures.template.faces)

    @cached_property
    def edges(self) -> TrueEdges:
        """Of the simulated garment, for STED."""
        return self._figures.sted.beside(self.truth)


class _Figures:
    """Everything that is computed once a garment and used for every sequence."""

    def __init__(self, template: GarmentTemplate, settings: RegressorEvaluation) -> None:
        self.settings, self.template = settings, template
        self.sted = Sted(template.topology, settings.sted)
        self.laplacian = template.topology.uniform_laplacian()
        self._refiner: Refiner | None = None

    def refiner(self, worn: _Worn) -> Refiner:
        """For the garment on bodies that are connected as this one."""
        if self._refiner is None:
            topology = self.template.topology
            count = worn.body_vertices.shape[1]
            self._refiner = Refiner(topology, worn.body_faces, count, self.settings.refinement)
        return self._refiner

    def errors(self, predicted: np.ndarray, worn: _Worn) -> dict[str, float]:
        """What is cheap: errors of one predicted sequence [mm]."""
        distances = VertexDistances(predicted, worn.truth)
        return {
            "frames": len(worn.truth),
            "rmse_mm": 1e3 * distances.rmse(),
            "mean_vertex_mm": 1e3 * distances.mean(),
            "kg_error_percent": distances.kg_error(worn.variation),
        }

    def of(self, predicted: np.ndarray, worn: _Worn) -> dict[str, float]:
        """Figures of one predicted sequence, lengths in millimetres and shares in percent."""
        topology, stride = self.template.topology, self.settings.frames_stride
        sted, normals = worn.edges.compare(predicted), vertex_normals(predicted, topology.faces)
        return {
            "detailed_sequences": 1,
            "hausdorff_mm": 1e3 * hausdorff(predicted, worn.truth, stride),
            "sted": sted.sted,
            "sted_spatial": sted.spatial,
            "sted_temporal": sted.temporal,
            "normal_cosine": cosine_distance(normals, worn.normals),
            "edge_mm": 1e3 * edge_deviation(predicted, worn.rest, topology.edges),
            "bend": bend_of_normals(normals, topology),
            "collision_rate_vertex_percent": 100.0 * worn.nearest.collision_rate(predicted[::stride]),
        }

    def contacts(self, predictions: Mapping[str, np.ndarray], worn: _Worn) -> dict[str, dict[str, float]]:
        """Shares inside the body [%] and depths [mm] of all methods' garments in every ``frames_stride``-th frame."""
        if not predictions:
            return {}
        stride, body = self.settings.frames_stride, self.refiner(worn).body
        found = contacts(predictions, worn.truth[::stride], body, worn.body_vertices[::stride])
        return {method: contact.figures("") for method, contact in found.items()}

    def refined(self, predicted: np.ndarray, worn: _Worn) -> dict[str, float]:
        """What refinement does to a predicted sequence, judged in all frames."""
        refined, figures = refine_and_judge(self.refiner(worn), self.laplacian, predicted, worn.body_vertices)
        return figures | {"refined_rmse_mm": 1e3 * rmse(refined, worn.truth)}

    def row(self, garment: str, split: str, method: str, values: list[dict[str, float]]) -> Row:
        """One table row: means over sequences, maxima of the deepest penetrations and moves."""
        row: Row = {"garment": garment, "split": split, "method": method, "sequences": len(values)}
        for name in dict.fromkeys(name for value in values for name in value):
            column = [v[name] for v in values if name in v]
            if name in ("frames", "detailed_sequences"):
                row[name] = int(sum(column))
            elif "deepest" in name or "largest" in name:
                row[name] = float(max(column))
            else:
                row[name] = float(np.mean(column))
        return row | {"sted_parameters": self.sted.parameters.label, "frames_stride": self.settings.frames_stride}


def _detailed(sequences: Many[Sequence], most: int) -> set[int]:
    """Numbers of the sequences of which everything is computed, the same for every method."""
    chosen: set[int] = set()
    for split in dict.fromkeys(s.split for s in sequences):
        members = [number for number, s in enumerate(sequences) if s.split == split]
        count = min(most or len(members), len(members))
        chosen |= {members[k * len(members) // count] for k in range(count)}
    return chosen


def _check(predicted: np.ndarray, sequence: Sequence, method: str) -> None:
    if predicted.shape != sequence.vertices.shape:
        raise ValueError(
            f"method '{method}' on clip {sequence.clip}: expected vertices {list(sequence.vertices.shape)}, "
            f"got {list(predicted.shape)}"
        )
    if not np.isfinite(predicted).all():
        raise ValueError(f"method '{method}' on clip {sequence.clip}: the prediction has values that are not finite")
