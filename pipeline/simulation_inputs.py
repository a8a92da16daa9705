"""Everything that a shard is simulated from, read and checked before any time is spent.

In: the job of stage ``simulate``. Out: body, template, clips with their lead-ins, and the intrinsic parameters of every
set. Each ``ValueError`` is one sentence that names the file (or the specification) and the element: vertex, triangle,
clip, frame, joint or parameter. Nothing has been simulated or written by then.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from body.model import Body
from body.shapes import sampled_shape, scaled_root
from datasets.shards import BODIES
from garments.fit import check_size_and_place, check_uncrossed
from garments.grading import graded
from garments.template import GarmentTemplate
from motions.clip import Clip
from motions.clip_file import read_clips
from motions.lead_in import lead_in
from pipeline.stage import Job
from sim.motion import checked_motion
from sim.parameters import base_parameters, sample_parameters
from sim.pins import PinSpans


@dataclass(frozen=True)
class SimulationInputs:
    """Checked inputs of a shard, or of that part of it which is on one body.

    Attributes:
        body: The body, in the shape of the run or in a sampled one.
        template: The garment; whether it was made for that body is asked by the simulator.
        clips: Every clip that is simulated, by name, as this body makes it.
        leads: Pose [L, 24, 3] and root [L, 3] of the lead-in of each clip.
        parameters: Every intrinsic parameter, by the number of the parameter set.
        shape: Shape coefficients of the body [standard deviations], shape [<= 10].
        body_index: Number of the body shape, 0 = that of the run.
        unusable: What cannot be simulated on a sampled body, although the run's own can, and why: by name of the clip.
    """

    body: Body
    template: GarmentTemplate
    clips: dict[str, Clip]
    leads: dict[str, tuple[np.ndarray, np.ndarray]]
    parameters: dict[int, dict[str, float]]
    shape: np.ndarray
    body_index: int = 0
    unusable: dict[str, str] = field(default_factory=dict)


@contextmanager
def naming(*origin: str) -> Iterator[None]:
    """Put where a thing comes from in front of what is wrong with it, unless the sentence has it already."""
    try:
        yield
    except ValueError as error:
        text = str(error)
        where = ", ".join(origin)
        raise ValueError(text if text.startswith(origin[0]) else f"{where}: {text}") from None


def checked_inputs(job: Job) -> SimulationInputs:
    """Read and check all inputs of a shard; cheap things first.

    Raises:
        FileNotFoundError: The template or a motion file does not exist.
        ValueError: Anything is wrong with the parameters, the template or the motions.
    """
    spec = job.spec
    if len(job.inputs) < 2:
        raise ValueError(f"--in: a garment template and motion files are needed, got {len(job.inputs)} files")
    body = Body.load(spec["body"]["resolution"]).shaped(spec["body"]["shape"])
    parameters = _parameters(spec)
    template_path, *motion_paths = job.inputs
    template = GarmentTemplate.load(template_path)
    with naming(template_path):
        what = f"garment '{template.name}'"
        check_size_and_place(what, template.vertices, body)
        check_uncrossed(what, template.vertices, template.faces)

    clips, origin = {}, {}
    for path in motion_paths:
        for clip in read_clips(path):
            if clip.name in clips:
                raise ValueError(f"{path}: clip '{clip.name}' is in {origin[clip.name]} too")
            clips[clip.name], origin[clip.name] = clip, path
    used = list(dict.fromkeys(name for _, name, _ in spec["simulations"]))
    leads, pins = {}, PinSpans(template)
    for name in used:
        if name not in clips:
            raise ValueError(f"{', '.join(motion_paths)}: clip '{name}' is not there, but is to be simulated")
        with naming(origin[name], f"clip '{name}'"):
            leads[name] = _checked_lead(clips[name], body, pins, spec)
    shape = np.asarray(spec["body"]["shape"], dtype=np.float64)
    return SimulationInputs(body, template, {name: clips[name] for name in used}, leads, parameters, shape)


def inputs_by_body(own: SimulationInputs, spec: Mapping[str, Any]) -> list[SimulationInputs]:
    """Inputs of a shard, one for each body that it simulates: the run's own, or the sampled ones.

    What the run's own body can do and a sampled one cannot, that one goes without, and says why.
    """
    if spec["plan"] != BODIES:
        return [own]
    clips_of: dict[int, list[str]] = {}
    for number, name, _ in spec["simulations"]:
        clips_of.setdefault(number, []).append(name)
    return [_on_another_body(own, number, names, spec) for number, names in clips_of.items()]


def _on_another_body(own: SimulationInputs, number: int, names: list[str], spec: Mapping[str, Any]) -> SimulationInputs:
    """The run's garment graded to a sampled body, and the clips as that body makes them."""
    shape = sampled_shape(own.shape, spec["spread"], spec["seed"], number)
    body = Body.load(spec["body"]["resolution"]).shaped(shape)
    clips = {name: replace(own.clips[name], root=scaled_root(own.clips[name].root, own.body, body)) for name in names}
    leads, unusable, template = {}, {}, own.template
    try:
        template = graded(own.template, own.body, body)
    except ValueError as error:
        unusable = dict.fromkeys(names, str(error))
    pins = PinSpans(template)
    for name in names:
        try:
            leads[name] = _checked_lead(clips[name], body, pins, spec)
        except ValueError as error:
            unusable.setdefault(name, str(error))
    return SimulationInputs(body, template, clips, leads, own.parameters, shape, number, unusable)


def _parameters(spec: Mapping[str, Any]) -> dict[int, dict[str, float]]:
    with naming("--spec", "base"):
        base = base_parameters(spec["base"])
    ranges = {name: tuple(ends) for name, ends in spec.get("ranges", {}).items()}
    sampled = {}
    # Bodies are simulated with the base parameters: their numbers are not those of parameter sets.
    numbers = [0] if spec.get("plan") == BODIES else dict.fromkeys(number for number, _, _ in spec["simulations"])
    for number in numbers:
        with naming("--spec", f"parameter set {number}"):
            sampled[number] = sample_parameters(base, ranges, spec["seed"], spec["garment"], number)
    return sampled


def _checked_lead(clip: Clip, body: Body, pins: PinSpans, spec: Mapping[str, Any]) -> tuple[np.ndarray, np.ndarray]:
    """The lead-in of a clip; the two together are a motion that the body can make and the pins can follow."""
    if clip.fps != spec["fps"]:
        raise ValueError(f"has {clip.fps:g} frames a second, the run has {spec['fps']:g}")
    lead_pose, lead_root = lead_in(clip, body, spec["lead_in"])
    pose, root = np.concatenate([lead_pose, clip.pose]), np.concatenate([lead_root, clip.root])
    pose, root = checked_motion(pose, root, len(lead_pose), body, clip.fps)
    pins.check(body.joint_transforms(pose, root), len(lead_pose))
    return lead_pose, lead_root
