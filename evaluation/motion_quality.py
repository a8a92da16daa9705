"""Can a body move like that: sliding feet, feet in the ground, jerk of generated motions beside real ones.

In: real clips with their root, and generated motions; where a generator makes poses alone, ``motions.grounding``
derives the root. Out: rows of a table. The real poses with a derived root stand between: what they lose against their
own root is the derivation's, not a generator's. Columns that begin with ``planted`` are of the motion as it is dressed,
after ``motions.planting``.
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
    "planted_floating_m": "planted_floating_cm",
    "joint_speed_rad_s": "joint_speed_rad_s",
    "joint_jerk_rad_s3": "joint_jerk_rad_s3",
    "planted_skate_m_s": "planted_foot_skate_cm_s",
    "planted_penetration_m": "planted_ground_penetration_cm",
    "planted_joint_jerk_rad_s3": "planted_joint_jerk_rad_s3",
}


def quality_rows(
    real: Sequence[Clip], generated: Mapping[str, tuple[np.ndarray, np.ndarray | None]], body: Body
) -> list[Row]:
    """Figures of ``motions.quality.measure``, means over motions with their 95% interval, a row a source.

    A motion that no body can make (``motions.clip.Clip`` refuses it) is counted in ``refused_percent`` and in no mean.

    Args:
        real: Clips of the test split.
        generated: 6-D poses [N, T, 24, 6] and root translations [N, T, 3] [m] by the name of their generator; None for
            the root of one that makes poses alone.
        body: Body that stands on the ground.

    Raises:
        ValueError: No real clip.
    """
    if not real:
        raise ValueError("motion quality: no real clip to compare with")
    fps = real[0].fps
    sources: dict[str, tuple[int, str, Callable[[int], Clip]]] = {
        "real, unseen motions": (len(real), "recorded", lambda n: real[n]),
        "real poses, derived root": (len(real), "derived", lambda n: _clip(real[n].pose, None, fps, body)),
    }
    for name, (poses, roots) in generated.items():

        def made(n: int, poses: np.ndarray = poses, roots: np.ndarray | None = roots) -> Clip:
            return _clip(axis_angle(poses[n]), None if roots is None else roots[n], fps, body)

        sources[name] = (len(poses), "derived" if roots is None else "generated", made)
    rows: list[Row] = []
    for name, (count, root, clip) in sources.items():
        found = []
        for n in range(count):
            try:
                found.append(_figures(clip(n), body))
            except ValueError:  # a clip refuses joints and roots that jump farther than a body can
                continue
        row: Row = {"source": name, "root": root}
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
    pose, root = plant_feet(clip.pose, clip.root, body, clip.fps)
    planted = replace(clip, pose=pose, root=root)
    after = {f"planted_{name}": value for name, value in measure(planted, body).as_row().items()}
    return measure(clip, body).as_row() | after


def _clip(pose: np.ndarray, root: np.ndarray | None, fps: float, body: Body) -> Clip:
    """A motion as a clip, with a derived root where it has none."""
    pose = pose.astype(np.float32)
    root = ground_motion(pose, body) if root is None else root
    return Clip("generated", "generated", "generated", pose, root, fps, "generated")
