"""Can a body move like that: sliding feet, feet in the ground, jerk of generated motions beside real ones.

In: real clips with their root, and generated poses, whose root ``motions.grounding`` derives. Out: rows of a table. The
real poses with a derived root stand between: what they lose against their own root is the derivation's, not a
generator's. Columns that begin with ``planted`` are of the motion as it is dressed, after ``motions.planting``.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace

import numpy as np

from body.model import Body
from evaluation.motion import axis_angle
from evaluation.motion_metrics import Repeated
from evaluation.table import Row
from motions.clip import Clip
from motions.grounding import ground_motion
from motions.planting import plant_feet
from motions.quality import measure

FIGURES = {
    "skate_m_s": "foot_skate_cm_s",
    "penetration_m": "ground_penetration_cm",
    "floating_m": "floating_cm",
    "joint_speed_rad_s": "joint_speed_rad_s",
    "joint_jerk_rad_s3": "joint_jerk_rad_s3",
    "planted_skate_m_s": "planted_foot_skate_cm_s",
    "planted_penetration_m": "planted_ground_penetration_cm",
    "planted_joint_jerk_rad_s3": "planted_joint_jerk_rad_s3",
}


def quality_rows(real: Sequence[Clip], generated: Mapping[str, np.ndarray], body: Body) -> list[Row]:
    """Figures of ``motions.quality.measure``, means over motions with their 95% interval, a row a source.

    A motion that no body can make (``motions.clip.Clip`` refuses it) is counted in ``refused_percent`` and in no mean.

    Args:
        real: Clips of the test split.
        generated: 6-D poses [N, T, 24, 6] by the name of their generator.
        body: Body that stands on the ground.

    Raises:
        ValueError: No real clip.
    """
    if not real:
        raise ValueError("motion quality: no real clip to compare with")
    sources: dict[str, tuple[int, Callable[[int], Clip]]] = {
        "real, unseen motions": (len(real), lambda n: real[n]),
        "real poses, derived root": (len(real), lambda n: _grounded(real[n].pose, real[0].fps, body)),
    }
    for name, poses in generated.items():
        sources[name] = (len(poses), lambda n, poses=poses: _grounded(axis_angle(poses[n]), real[0].fps, body))
    rows: list[Row] = []
    for name, (count, clip) in sources.items():
        found = []
        for n in range(count):
            try:
                found.append(_figures(clip(n), body))
            except ValueError:  # a clip refuses joints and roots that jump farther than a body can
                continue
        row: Row = {"source": name}
        for figure, column in FIGURES.items():
            scale = 100.0 if figure.endswith(("_m", "_m_s")) else 1.0
            repeated = Repeated.of([scale * values[figure] for values in found]) if found else None
            row[column] = repeated.mean if repeated else None
            row[f"{column}_interval"] = repeated.interval if repeated else None
        refused = 100.0 * (1.0 - len(found) / count)
        rows.append({**row, "refused_percent": refused, "motions": count, "split": "unseen motions", "body": body.name})
    return rows


def _figures(clip: Clip, body: Body) -> dict[str, float]:
    """Figures of a clip, and of the same with its feet planted."""
    planted = replace(clip, pose=plant_feet(clip.pose, clip.root, body, clip.fps))
    after = {f"planted_{name}": value for name, value in measure(planted, body).as_row().items()}
    return measure(clip, body).as_row() | after


def _grounded(pose: np.ndarray, fps: float, body: Body) -> Clip:
    pose = pose.astype(np.float32)
    return Clip("grounded", "grounded", "grounded", pose, ground_motion(pose, body), fps, "derived root")
