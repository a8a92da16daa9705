"""Shapes of the body that a run's models know, and what a body measures.

Which they know is said by the run's configuration: bodies that were simulated, and a regressor that was told of them.
Garments are dressed on them as the commands do it (``runtime.composing``, ``--shape``): as on the run's own body, then
moved as grading moves them.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy.spatial import ConvexHull

from body.model import Body
from body.shapes import FARTHEST, LIMIT, SAMPLED
from body.skeleton import JOINT_INDEX
from runtime.finished_run import CONDITIONED, FinishedRun

_GIRTHS = {"chest": "spine3", "waist": "spine1", "hips": "left_hip"}
"""Joints at whose height a body is measured."""

_TRUNK = ("pelvis", "left_hip", "right_hip", "spine1", "spine2", "spine3", "left_collar", "right_collar")


class BodyShapes:
    """The shapes around a run's own body that its models were trained on.

    Attributes:
        own: Coefficients of the run's own body [standard deviations], shape [5 or more].
        ends: Between what each coefficient was sampled [standard deviations]; none where there was one body alone.
        told: Why there are none, in a sentence; empty where there are.

    Args:
        run: A finished run.
    """

    def __init__(self, run: FinishedRun) -> None:
        self.own = np.zeros(max(SAMPLED, len(run.shape)))
        self.own[: len(run.shape)] = run.shape
        self.ends: tuple[tuple[float, float], ...] = ()
        bodies = run.config.get("data", {}).get("bodies", {})
        count, spread = int(bodies.get("samples", 0)), float(bodies.get("spread", 0.0))
        if not count or not spread:
            self.told = (
                f"{run.folder.name} was simulated on one body: its models know no other. "
                "`data.bodies.samples` in the configuration asks for more."
            )
        elif CONDITIONED not in run.config["models"]["garment_regressor"]["variants"]:
            self.told = (
                f"{run.folder.name} trained no model that was told of the body: they know one. The variant "
                f"`{CONDITIONED}` of `models.garment_regressor` is told."
            )
        else:
            self.told, reach = "", spread * LIMIT
            self.ends = tuple(
                (max(-FARTHEST, value - reach), min(FARTHEST, value + reach)) for value in self.own[:SAMPLED].tolist()
            )

    def checked(self, wanted: Sequence[float]) -> np.ndarray | None:
        """Coefficients of a body; None for the run's own.

        Args:
            wanted: One number for each of ``ends`` [standard deviations].

        Raises:
            ValueError: The models were trained on one body, or not so far out; says between what.
        """
        if not self.ends:
            raise ValueError(self.told)
        if len(wanted) != len(self.ends):
            raise ValueError(f"a body shape has {len(self.ends)} numbers here, not {len(wanted)}")
        for number, (value, (low, high)) in enumerate(zip(wanted, self.ends, strict=True), 1):
            if not low - 1e-6 <= value <= high + 1e-6:
                raise ValueError(
                    f"body shape {number}: the models were trained on {low:g} to {high:g} standard deviations, "
                    f"not on {value:g}"
                )
        shape = self.own.copy()
        shape[: len(wanted)] = wanted
        return None if np.array_equal(shape, self.own) else shape


def measures(body: Body) -> dict[str, float]:
    """Height and girths [m] of a body as it stands in its bind pose; a girth is that of a tape around the trunk."""
    vertices, trunk = body.vertices.astype(np.float64), [JOINT_INDEX[name] for name in _TRUNK]
    faces = body.faces[np.isin(body.part_of_vertex[body.faces], trunk).all(axis=1)]
    found = {"height": float(np.ptp(vertices[:, 1]))}
    for name, joint in _GIRTHS.items():
        level = body.joints[JOINT_INDEX[joint], 1]
        ends = vertices[faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2)]
        above = ends[..., 1] - level
        crossing = (above[:, 0] < 0.0) != (above[:, 1] < 0.0)
        ends, above = ends[crossing], above[crossing]
        share = above[:, :1] / (above[:, :1] - above[:, 1:])
        points = ends[:, 0] + share * (ends[:, 1] - ends[:, 0])
        found[name] = float(ConvexHull(points[:, [0, 2]]).area)  # of a polygon: its outline
    return found
