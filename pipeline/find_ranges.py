"""Stage ``find_ranges``: how far each intrinsic parameter of a garment can go (Wang 2019, section 4).

In: a garment template and a batch of motions. Out: the ranges as a configuration fragment that can be laid over the
run's own (YAML), all trials (CSV) and a plot (SVG). The liveliest clips of the batch are simulated under parameter sets
that differ from the base in one parameter; ``sim.range_finder`` says which, and what stops it. Then the ranges are
narrowed until parameters drawn from all of them together hold as well.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from body.model import Body
from body.skeleton import PARENTS
from datasets.atomic import write_text
from evaluation.table import Row, write_table
from garments.template import GarmentTemplate
from motions.clip import Clip
from motions.clip_file import read_clips
from motions.lead_in import lead_in
from pipeline.progress import Progress
from pipeline.stage import Job, run_stage
from report.ranges_plot import ranges_plot
from sim.parameters import ENSEMBLE, base_parameters, parameter
from sim.range_finder import (
    CRITERIA,
    FoundRange,
    Outcome,
    SearchSettings,
    Trial,
    find_ranges,
    judge,
    widest_common_share,
)
from sim.result import SimulationResult
from sim.settings import SimulationSettings
from sim.simulate import Simulator, World

FEW = 4
"""Fewer sets than these are faster one after the other."""


def main(job: Job) -> None:
    """Search, narrow, write."""
    spec, search = job.spec, job.spec["ranges"]
    fragment_path, table_path, plot_path = job.outputs
    body = Body.load(spec["body"]["resolution"]).shaped(spec["body"]["shape"])
    template = GarmentTemplate.load(job.inputs[0])
    clips = liveliest(read_clips(job.inputs[1]), template, body, search["clips"], search["frames"])
    settings = SimulationSettings(
        fps=spec["fps"], device=job.device, settle_seconds=spec["settle"], self_contact=spec["self_contact"]
    )
    attempt = Attempt(template, body, settings, clips, spec["lead_in"], search["criteria"])
    base, limits = base_parameters(spec["base"]), _limits(search["limits"])

    steps = SearchSettings(search["factor"], search["share"], search["bisections"])
    found, trials = find_ranges(base, search["parameters"], attempt, steps, limits)
    free = {name: limits.get(name, parameter(name).allowed) for name in search["free"]}
    together = search["together"]
    share, held = widest_common_share(
        found, base, attempt, together["sets"], together["accepted"], seed=spec["seed"], free=free
    )
    attempt.progress.finish()

    names = [clip.name for clip in clips]
    write_text(fragment_path, fragment(spec["garment"], found, free, share, held, together["sets"], names, search))
    write_table(table_path, [_row(spec["garment"], trial) for trial in trials])
    write_text(plot_path, ranges_plot(spec["garment"], found, trials, share))
    print(f"[ranges {spec['garment']}] {len(trials)} trials; at {share:.0%} of the ranges {held:.0%} of the sets hold")


class Attempt:
    """Tries parameter sets: every clip is simulated, and the worst of each figure is judged.

    Sets with the same number of substeps are simulated side by side, one a SIMD lane.
    """

    def __init__(
        self,
        template: GarmentTemplate,
        body: Body,
        settings: SimulationSettings,
        clips: Sequence[Clip],
        lead: int,
        criteria: Mapping[str, float],
    ):
        self.criteria, self.fps, self.lead = criteria, settings.fps, lead
        self.one = Simulator(template, body, settings)
        self.many = Simulator(template, body, settings, worlds=ENSEMBLE)
        self.motions = []
        for clip in clips:
            lead_pose, lead_root = lead_in(clip, body, lead)
            self.motions.append((np.concatenate([lead_pose, clip.pose]), np.concatenate([lead_root, clip.root])))
        self.progress = Progress(f"ranges {template.name}", 0, "parameter sets")

    def __call__(self, sets: Sequence[Mapping[str, float]]) -> list[Outcome]:
        self.progress.total += len(sets)
        outcomes: dict[int, Outcome] = {}
        for chunk in side_by_side([round(values["substeps"]) for values in sets]):
            outcomes |= zip(chunk, self._together([sets[index] for index in chunk]))
            self.progress(len(chunk))
        return [outcomes[index] for index in range(len(sets))]

    def _together(self, sets: Sequence[Mapping[str, float]]) -> list[Outcome]:
        worst: list[dict[str, float]] = [{} for _ in sets]
        outcomes: list[Outcome] = [Outcome({}) for _ in sets]
        for pose, root in self.motions:
            # One bad clip is enough.
            holding = [index for index, outcome in enumerate(outcomes) if outcome.cause is None]
            worlds = [World(pose, root, sets[index]) for index in holding]
            for index, result in zip(holding, self._run(worlds)):
                figures = measured(result, self.fps)
                worst[index] = {k: float(np.maximum(v, worst[index].get(k, v))) for k, v in figures.items()}
                outcomes[index] = judge(worst[index], self.criteria, result.failure)
        return outcomes

    def _run(self, worlds: Sequence[World]) -> list[SimulationResult]:
        if len(worlds) < FEW:
            return [result for world in worlds for result in self.one.run_worlds([world], self.lead)]
        return self.many.run_worlds(worlds, self.lead)


def side_by_side(substeps: Sequence[int]) -> list[list[int]]:
    """Indices of the sets that are simulated together: at most as many as there are lanes, of the same substeps."""
    groups: dict[int, list[int]] = {}
    for index, count in enumerate(substeps):
        groups.setdefault(count, []).append(index)
    return [group[start : start + ENSEMBLE] for group in groups.values() for start in range(0, len(group), ENSEMBLE)]


def measured(result: SimulationResult, fps: float) -> dict[str, float]:
    """The figures that are judged; acceleration is that of the vertices over three frames, as the clip's time goes."""
    x, quality = result.vertices.astype(np.float64), result.quality
    acceleration = np.linalg.norm(x[2:] - 2.0 * x[1:-1] + x[:-2], axis=-1) * fps**2
    return {
        "p99_edge_strain": quality["p99_edge_strain"],
        "penetration": quality["deepest_penetration_m"],
        "vertices_inside": quality["vertices_inside"] / x.shape[1],
        "residual_speed": quality["residual_speed_m_s"],
        "jitter": float(np.quantile(acceleration, 0.99)) if acceleration.size else 0.0,
    }


def liveliest(clips: Sequence[Clip], template: GarmentTemplate, body: Body, count: int, frames: int) -> list[Clip]:
    """The clips that move the garment's part of the body the fastest in the frames that are simulated, cut to these.

    Only one clip of a label is taken, so that they stress the garment in different ways; the fastest comes first.
    """
    worn = np.unique(template.skin_index[template.skin_weight > 0.1])
    # A joint moves what hangs on it: how fast, its children tell.
    followed = [joint for joint, parent in enumerate(PARENTS) if joint in worn or parent in worn]
    speeds = []
    for clip in clips:
        joints = body.joint_positions(clip.pose[:frames], clip.root[:frames])[:, followed]
        speed = np.linalg.norm(np.diff(joints, axis=0), axis=-1) * clip.fps
        speeds.append(float(np.quantile(speed.max(axis=1), 0.9)))
    chosen: dict[str, Clip] = {}
    for index in np.argsort(-np.array(speeds), kind="stable"):
        chosen.setdefault(clips[index].label, clips[index])
    return [replace(c, pose=c.pose[:frames], root=c.root[:frames]) for c in list(chosen.values())[:count]]


def fragment(
    garment: str,
    found: Sequence[FoundRange],
    free: Mapping[str, tuple[float, float]],
    share: float,
    held: float,
    sets: int,
    clips: Sequence[str],
    search: Mapping,
) -> str:
    """The ranges as a configuration overlay; every line says its unit, what was found alone, and what stopped it."""
    criteria = search["criteria"]
    bounds = ", ".join(f"{label} {criteria[k]:g}{unit}" for k, (label, unit) in CRITERIA.items() if k in criteria)
    lines = [
        f"# Ranges of {garment}, found by `snakemake ranges` (Wang 2019, section 4) on the clips {', '.join(clips)}.",
        f"# A trial holds up to: {bounds}.",
        f"# Found one parameter at a time. Here they stand at {share:.0%} of the way from the base value to either",
        f"# end, in the logarithm where values span decades: drawn from all together, {held:.0%} of {sets} sets hold.",
        "garments:",
        f"  {garment}:",
        "    ranges:",
    ]
    for r in found:
        p = parameter(r.parameter)
        low, high = (rounded_inwards(value, r.base) for value in r.narrowed(share))
        if p.integer:
            low, high = int(low), int(high)
        stops = f"{_stop(r.low_stop)} below, {_stop(r.high_stop)} above"
        alone = f"alone {r.low:.3g} to {r.high:.3g}: {stops}"
        lines.append(f"      {p.name}: {{min: {_number(low)}, max: {_number(high)}}} # [{p.unit}] {alone}")
    for name, (low, high) in free.items():
        p = parameter(name)
        ends = f"{{min: {_number(low)}, max: {_number(high)}}}"
        lines.append(f"      {name}: {ends} # [{p.unit}] not searched: whole physical range")
    return "\n".join(lines) + "\n"


def rounded_inwards(value: float, base: float, digits: int = 2) -> float:
    """Two significant digits, on the side of the base value."""
    if value in (0.0, base):
        return value
    unit = 10.0 ** (math.floor(math.log10(abs(value))) - digits + 1)
    steps = value / unit
    whole = math.floor(steps + 1e-9) if value > base else math.ceil(steps - 1e-9)
    inside = float(f"{whole * unit:.{digits}g}")
    return min(inside, value) if value > base else max(inside, value)


def _number(value: float) -> str:
    """As YAML reads it for a number: an exponent needs a point before it and a sign."""
    if isinstance(value, int):
        return str(value)
    text = f"{value:.6g}"
    if "e" in text:
        mantissa, exponent = text.split("e")
        return f"{mantissa if '.' in mantissa else mantissa + '.0'}e{exponent}"
    return text if "." in text else f"{text}.0"


def _stop(outcome: Outcome | None) -> str:
    return "limit" if outcome is None else outcome.sentence


def _limits(limits: Mapping[str, Mapping[str, float]]) -> dict[str, tuple[float, float]]:
    return {name: (float(ends["min"]), float(ends["max"])) for name, ends in limits.items()}


def _row(garment: str, trial: Trial) -> Row:
    p, outcome = parameter(trial.parameter), trial.outcome
    row: Row = {"garment": garment, "parameter": p.name, "unit": p.unit, "value": trial.value}
    row |= {"holds": outcome.cause is None, "cause": outcome.cause or "", "stopped_by": outcome.sentence}
    return row | {name: outcome.figures.get(name) for name in CRITERIA}


if __name__ == "__main__":
    run_stage(main)
