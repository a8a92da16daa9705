"""Rows of the tables of networks that dress any garment (Peng 2023, Tables 1-3, Figures 7 and 8).

In: garments with simulated test sequences, what each method makes of them, and the bodies under them, all in the
pelvis frame of each frame. Out: a row a sequence and method, and their means a split, a category, a method. A method
may have nothing to say about a garment (None): it then is no part of that garment's rows.
"""

from __future__ import annotations

from collections.abc import Iterable
from collections.abc import Sequence as Many

import numpy as np

from body.model import Body
from datasets.sequences import Sequence
from evaluation.collisions import Contact
from evaluation.metrics import NearestVertices, bend, edge_deviation, mean_vertex_error
from evaluation.table import Row
from garments.template import GarmentTemplate
from models.physical_regressor import Correction
from models.refinement import RefinementSettings, Refiner

FIGURES = ("error_mm", "edge_mm", "bend", "collision_percent")
"""Columns that are averaged."""


class TestMotion:
    """A test sequence and the body under it, made once for all methods.

    Args:
        sequence: Simulated, in the world.
        body: The run's.
        stride: Every how many frames the body is looked at.
    """

    __test__ = False

    def __init__(self, sequence: Sequence, body: Body, stride: int) -> None:
        self.sequence, self.stride = sequence, stride
        rotation, position = sequence.pelvis
        self.truth = sequence.canonical(sequence.vertices)
        world = body.posed(sequence.pose[::stride], sequence.root[::stride])
        self.body = np.matmul(world - position[::stride, None], rotation[::stride]).astype(np.float32)
        self.nearest = NearestVertices(self.body, body.faces)

    def row(self, template: GarmentTemplate, category: str, method: str, predicted: np.ndarray) -> Row:
        """Figures of one method's garment [T, N, 3] [m]: of all frames, of every ``stride``-th for collisions.

        Raises:
            ValueError: A prediction of another shape, or with values that are not finite.
        """
        if predicted.shape != self.truth.shape or not np.isfinite(predicted).all():
            what = "values that are not finite" if predicted.shape == self.truth.shape else f"{list(predicted.shape)}"
            raise ValueError(f"{method} on {template.name}: expected vertices {list(self.truth.shape)}, got {what}")
        return {
            "category": category,
            "garment": template.name,
            "split": self.sequence.split,
            "clip": self.sequence.clip,
            "phi": self.sequence.phi,
            "method": method,
            "error_mm": 1e3 * mean_vertex_error(predicted, self.truth),
            "edge_mm": 1e3 * edge_deviation(predicted, template.vertices, template.topology.edges),
            "bend": bend(predicted, template.topology),
            "collision_percent": 100.0 * self.nearest.collision_rate(predicted[:: self.stride]),
        }


def averaged(rows: Iterable[Row], by: Many[str]) -> list[Row]:
    """Means of ``FIGURES`` over the sequences that are equal in the columns ``by``, in order of first appearance."""
    groups: dict[tuple, list[Row]] = {}
    for row in rows:
        groups.setdefault(tuple(row[name] for name in by), []).append(row)
    return [
        dict(zip(by, key))
        | {"garments": len({r["garment"] for r in group}), "sequences": len(group)}
        | {name: float(np.mean([r[name] for r in group])) for name in FIGURES}
        for key, group in groups.items()
    ]


def gap_rows(rows: Many[Row], seen: str, unseen_motions: str, unseen_templates: str) -> list[Row]:
    """Train-test gap (Fig. 7): errors [mm] on training clips, on new clips, and on the same new clips on new templates.

    New templates are compared with seen ones on the clips that both were simulated on, in the category's own fabric.
    """
    made = []
    for method in dict.fromkeys(r["method"] for r in rows):
        mine = [r for r in rows if r["method"] == method]
        shared = {r["clip"] for r in mine if r["split"] == unseen_templates and r["phi"] == 0}
        parts = {
            "train": [r for r in mine if r["split"] == seen],
            "unseen_motions": [r for r in mine if r["split"] == unseen_motions],
            "seen_templates_shared_clips": [
                r for r in mine if r["split"] == unseen_motions and r["phi"] == 0 and r["clip"] in shared
            ],
            "unseen_templates_shared_clips": [r for r in mine if r["split"] == unseen_templates and r["phi"] == 0],
        }
        error = {name: float(np.mean([r["error_mm"] for r in some])) for name, some in parts.items() if some}
        row: Row = {"method": method} | {f"{name}_error_mm": value for name, value in error.items()}
        row["test_over_train"] = _ratio(error, "unseen_motions", "train")
        row["unseen_over_seen_templates"] = _ratio(
            error, "unseen_templates_shared_clips", "seen_templates_shared_clips"
        )
        made.append(row)
    return made


def stability_rows(method: str, losses: Iterable[Row]) -> list[Row]:
    """Error on held-out sequences after each validated epoch (Fig. 8), from a table of losses."""
    found = [r for r in losses if r.get("split") == "validation" and r.get("error_mm") is not None]
    best = min((float(r["error_mm"]) for r in found), default=0.0)
    return [
        {"method": method, "epoch": r["epoch"], "validation_error_mm": r["error_mm"], "over_best": r["error_mm"] / best}
        for r in found
    ]


def contact_rows(
    template: GarmentTemplate,
    body: Body,
    predictions: Iterable[tuple[TestMotion, np.ndarray, Correction]],
    settings: RefinementSettings,
) -> dict[str, Contact]:
    """Vertices inside the body as the network leaves them, after its physical regressor, and after the projection.

    A prediction [T, N, 3] comes with the regressor for the material that its sequence is in.
    """
    refiner = Refiner(template.topology, body.faces, len(body.vertices), settings)
    found = {"network": Contact(), "regressor": Contact(), "projection": Contact()}
    for motion, predicted, correct in predictions:
        for vertices, under in zip(predicted[:: motion.stride], motion.body, strict=True):
            posed = refiner.body.at(under)
            hits = posed.query(vertices)
            found["network"].add(hits.distance)
            corrected = correct(vertices, hits.point, hits.normal)
            again = posed.query_moved(corrected, vertices, hits)
            found["regressor"].add(again.distance)
            refined, _ = refiner.refine_hits(corrected, posed, again)
            found["projection"].add(posed.query_moved(refined, corrected, again).distance)
    return found


def _ratio(values: dict[str, float], above: str, below: str) -> float | None:
    return values[above] / values[below] if above in values and below in values else None
