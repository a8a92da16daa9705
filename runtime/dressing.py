"""From a motion to a garment in motion, by a finished run's networks or by its simulator.

In: a clip, a garment of the run, perhaps a material and a body. Out: an ``Animation`` of garment and body. Learned
garments are refined: no vertex is inside the body (Wang 2019, section 3.5).
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from body.model import Body
from formats.animation import Animation, dressed, plain_name
from formats.body_notes import body_notes
from models.conditioned_regressor import Conditions
from models.motion_features import MotionTrack
from models.other_bodies import OtherBody
from motions.clip import Clip
from motions.lead_in import lead_in
from runtime.finished_run import LearnedGarment
from runtime.motion_making import clip_track, on_body
from sim.bounds import out_of_bounds
from sim.simulate import SimulationSettings, Simulator


@dataclass(frozen=True)
class Wearing:
    """What a motion is dressed in, and who wears it.

    Attributes:
        garment: Garment of a finished run.
        parameters: Every intrinsic parameter; the base material where None.
        shape: Shape coefficients of the body [standard deviations]; the run's own where None.
    """

    garment: LearnedGarment
    parameters: Mapping[str, float] | None = None
    shape: np.ndarray | None = None

    @property
    def body(self) -> Body:
        """The body that wears it."""
        run = self.garment.run
        return run.body if self.shape is None else run.plain_body.shaped(self.shape)

    @property
    def all_parameters(self) -> Mapping[str, float]:
        """Every intrinsic parameter."""
        return self.garment.base_parameters if self.parameters is None else self.parameters


@dataclass(frozen=True)
class Dressed:
    """A dressed motion.

    Attributes:
        animation: Garment and body.
        inside: Share of the garment's vertices that were inside the body before refinement [1].
        inside_after: Vertices inside at the end; 0 after refinement.
    """

    animation: Animation
    inside: float
    inside_after: int


def dress(clip: Clip, wearing: Wearing, refine: bool = True) -> Dressed:
    """Dress a motion by the networks: the regressor in use, or the one that is told the material.

    On another body, the garment is graded to it (``models.other_bodies``).

    Args:
        clip: Motion of the run's own body, at the run's frame rate.
        wearing: Garment, material and body.
        refine: Whether the garment is taken out of the body.

    Raises:
        ValueError: Another frame rate, a motion that begins far from what a body can do, or a model that is missing.
    """
    garment, run, body = wearing.garment, wearing.garment.run, wearing.body
    if clip.fps != run.fps:
        raise ValueError(f"motion '{clip.name}' has {clip.fps:g} frames a second, {run.folder} has {run.fps:g}")
    worn = clip if wearing.shape is None else on_body(clip, run.body, body)
    track = clip_track(worn, body, run.lead_in)
    other = None if wearing.shape is None else OtherBody(garment.template, run.body, body, garment.grader)
    vertices = track.in_world(_canonical(track, wearing, other))
    body_vertices = body.posed(worn.pose, worn.root)
    refiner = garment.refiner(body)
    if refine:
        vertices, stats = refiner.refine_sequence(vertices, body_vertices)
        inside, inside_after = stats.inside, stats.inside_after
    else:
        posed = (refiner.body.at(under) for under in body_vertices)
        inside = sum(int((under.query(v).distance < 0.0).sum()) for v, under in zip(vertices, posed, strict=True))
        inside_after = inside
    animation = _animation(worn, wearing, vertices, body_vertices, "learned")
    return Dressed(animation, inside / vertices[..., 0].size, inside_after)


def simulate(clip: Clip, wearing: Wearing, device: str = "auto") -> Dressed:
    """Dress a motion by the simulator that the run's data came from.

    Raises:
        ValueError: The simulation failed or is outside the run's bounds of quality; says why.
    """
    garment, run, body = wearing.garment, wearing.garment.run, wearing.body
    if clip.fps != run.fps:
        raise ValueError(f"motion '{clip.name}' has {clip.fps:g} frames a second, {run.folder} has {run.fps:g}")
    worn = clip if wearing.shape is None else on_body(clip, run.body, body)
    template = garment.template if wearing.shape is None else garment.grader.on(body)
    solver = run.config["simulation"]
    settings = SimulationSettings(
        fps=run.fps, device=device, settle_seconds=solver["settle"], self_contact=solver["self_contact"]
    )
    lead_pose, lead_root = lead_in(worn, body, run.lead_in)
    pose, root = np.concatenate([lead_pose, worn.pose]), np.concatenate([lead_root, worn.root])
    parameters, simulator = dict(wearing.all_parameters), Simulator(template, body, settings)
    for _ in range(solver["attempts"]):
        result = simulator.run(pose, root, len(lead_pose), parameters)
        why = result.failure or out_of_bounds(result.quality, solver["bounds"], len(template.vertices))
        if why is None:
            break
        parameters["substeps"] = float(round(parameters["substeps"] * solver["substeps_factor"]))
    else:
        raise ValueError(
            f"{garment.name} on '{clip.name}': the simulation did not hold in {solver['attempts']} attempts: {why}"
        )
    animation = _animation(worn, wearing, result.vertices, body.posed(worn.pose, worn.root), "xpbd")
    inside = int(result.quality["vertices_inside"])
    return Dressed(animation, inside / len(template.vertices), inside)


def _canonical(track: MotionTrack, wearing: Wearing, other: OtherBody | None) -> np.ndarray:
    """Canonical garment vertices [T, V, 3] [m] along a track of the body that wears it."""
    garment = wearing.garment
    own = track if other is None else other.own_track(track)
    if wearing.parameters is None:
        vertices = garment.regressor.dress(own)
    else:
        shape = garment.run.shape if wearing.shape is None else wearing.shape
        vertices = garment.conditioned.dress_under(own, Conditions(wearing.parameters, shape))
    return vertices if other is None else vertices + other.change(track)


def dressed_animation(
    name: str,
    clip: Clip,
    wearing: Wearing,
    vertices: np.ndarray,
    body_vertices: np.ndarray,
    notes: Mapping[str, str | float],
) -> Animation:
    """The animation of a garment that was worn in a motion.

    Args:
        name: Of the animation.
        clip: The motion that was made in it.
        wearing: Garment and body.
        vertices: Garment in the world [m], shape [T, V, 3].
        body_vertices: Body in the world [m], shape [T, B, 3].
        notes: What is to be told beside garment, label and body shape.
    """
    garment, body = wearing.garment, wearing.body
    told: dict[str, str | float] = {"garment": garment.name, "label": clip.label, **notes}
    told |= body_notes(body, wearing.shape)
    return dressed(
        name,
        garment.name,
        np.asarray(vertices, dtype=np.float32),
        garment.template.faces,
        body_vertices.astype(np.float32),
        body.faces,
        clip.fps,
        clip,
        told,
    )


def _animation(clip: Clip, wearing: Wearing, vertices: np.ndarray, body_vertices: np.ndarray, solver: str) -> Animation:
    notes: dict[str, str | float] = {"solver": solver}
    notes |= {f"parameter_{name}": float(value) for name, value in wearing.all_parameters.items()}
    name = plain_name(f"{wearing.garment.name}_{clip.name}")
    return dressed_animation(name, clip, wearing, vertices, body_vertices, notes)
