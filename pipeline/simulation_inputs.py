"""Everything that a shard is simulated from, read and checked before any time is spent.

In: the job of stage ``simulate``. Out: body, template, clips with their lead-ins, and the intrinsic parameters of every
set. Each ``ValueError`` is one sentence that names the file (or the specification) and the element: vertex, triangle,
clip, frame, joint or parameter. Nothing has been simulated or written by then.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import numpy as np

from body.model import Body
from garments.fit import check_size_and_place, check_uncrossed
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
    """Checked inputs of a shard.

    Attributes:
        body: The body, in the shape of the run.
        template: The garment; whether it was made for that body is asked by the simulator.
        clips: Every clip that the shard simulates, by name.
        leads: Pose [L, 24, 3] and root [L, 3] of the lead-in of each clip.
        parameters: Every intrinsic parameter, by the number of the parameter set.
    """

    body: Body
    template: GarmentTemplate
    clips: dict[str, Clip]
    leads: dict[str, tuple[np.ndarray, np.ndarray]]
    parameters: dict[int, dict[str, float]]


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
    return SimulationInputs(body, template, {name: clips[name] for name in used}, leads, parameters)


def _parameters(spec: Mapping[str, Any]) -> dict[int, dict[str, float]]:
    with naming("--spec", "base"):
        base = base_parameters(spec["base"])
    ranges = {name: tuple(ends) for name, ends in spec.get("ranges", {}).items()}
    sampled = {}
    for number in dict.fromkeys(number for number, _, _ in spec["simulations"]):
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
