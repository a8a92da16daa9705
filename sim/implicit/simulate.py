"""One clip of a garment under the implicit solver: settle, lead-in, recorded frames, quality figures and timing.

In and out are those of ``sim.simulate.simulate_clip``, so that both solvers can be compared on one garment, body, clip
and parameter set. Every parameter means the same in both, with two exceptions: this solver knows no collision of the
cloth with itself (``self_friction`` is not read) and forms no creases (a ``bend_yield`` below its limit is refused).
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING

import numpy as np

from geometry.rotations import slerp_poses
from sim.body_parts import whole_body, worn_parts
from sim.compile import resolve_device
from sim.implicit.body_surface import BodySurface
from sim.implicit.settings import ImplicitSettings
from sim.implicit.solver import ImplicitCloth, ProjectionReport
from sim.motion import checked_motion
from sim.parameters import check_parameters
from sim.rest_state import RestState
from sim.result import SimulationResult

if TYPE_CHECKING:
    from body.model import Body
    from garments.template import GarmentTemplate

__all__ = ["ImplicitSettings", "simulate_clip_implicit"]

Progress = Callable[[int, int], None]


def simulate_clip_implicit(
    template: GarmentTemplate,
    body: Body,
    pose: np.ndarray,
    root: np.ndarray,
    lead_in: int,
    parameters: Mapping[str, float],
    settings: ImplicitSettings | None = None,
    progress: Progress | None = None,
) -> SimulationResult:
    """Simulate one clip with implicit Euler.

    The garment is carried by its skinning weights to the first pose, settles there with the body at rest, follows the
    lead-in and is recorded from frame ``lead_in`` on.

    Args:
        template: Garment made for this body.
        body: Body, in the shape that the template was made for.
        pose: Axis-angle poses [rad], shape [L + T, 24, 3].
        root: Root translations [m], shape [L + T, 3].
        lead_in: Number L of leading frames that are simulated but not recorded.
        parameters: Every intrinsic parameter by name; ``substeps`` is the XPBD solver's and is not read;
            ``bend_yield`` must be at its upper end.
        settings: Numbers of the method; defaults where None.
        progress: Called after each frame with (frames done, frames in all).

    Returns:
        Recorded frames. Besides the common quality figures: ``lifted_vertices`` and ``lifted_depth_m``, the most and
        the deepest that a frame's final projection found below the surface, and ``cg_iterations`` a step. ``timing``
        splits the recorded frames' wall time into forces (with assembly), solve, contact, strain_limits and other.

    Raises:
        ValueError: Anything is wrong with the input.
    """
    settings = settings or ImplicitSettings()
    pose, root = checked_motion(pose, root, lead_in, body, settings.fps)
    check_parameters(parameters)
    if template.body_digest != body.digest:
        raise ValueError(
            f"garment {template.name!r} was made for body {template.body_name!r} ({template.body_digest}), "
            f"not for {body.name!r} ({body.digest})"
        )
    resolve_device("cpu")  # quiets Warp's banner
    rest = RestState.from_mesh(template.vertices, template.faces, template.pinned, template.pieces)
    pose, root = _resampled(pose, root, settings.contact_queries)
    surface = BodySurface(body.posed(pose, root), body.faces, _contact_parts(template, body, settings))
    transforms = body.joint_transforms(pose, root)
    pins = _skinned(rest.vertices, template, rest.pinned, transforms)
    step = parameters["time_scale"] / (settings.fps * settings.steps_per_frame)
    cloth = ImplicitCloth(rest, parameters, step, settings, surface)
    everything = np.arange(len(rest.vertices))
    cloth.place(_skinned(rest.vertices, template, everything, transforms[:1])[0])
    for _ in range(2):  # twice: start and end of the interval
        cloth.show_pins(pins[0])

    residual = _settle(cloth, settings, parameters["time_scale"])
    run = _Recording(cloth, rest, settings, frames=len(pose[:: settings.contact_queries]), lead_in=lead_in)
    for frame in range(run.frames):
        begun = time.perf_counter()
        report = ProjectionReport(0, 0.0, 0, 0.0)
        if frame == lead_in:
            run.start()
        if frame > 0:
            for k, steps in enumerate(settings.interval_steps):
                sample = (frame - 1) * settings.contact_queries + k + 1
                with_body = time.perf_counter()
                surface.show(sample)
                cloth.show_pins(pins[sample])
                cloth.seconds["contact"] += time.perf_counter() - with_body
                cloth.interval(steps)
            report = cloth.project_out()
        if not run.record(frame, report, begun):
            break
        if progress is not None:
            progress(frame + 1, run.frames)
    return run.result(residual)


class _Recording:
    """Recorded frames of a clip and the figures that go with them."""

    def __init__(self, cloth: ImplicitCloth, rest: RestState, settings: ImplicitSettings, frames: int, lead_in: int):
        self.cloth, self.rest, self.settings = cloth, rest, settings
        self.frames, self.lead_in = frames, lead_in
        self.vertices = np.empty((frames - lead_in, len(rest.vertices), 3), dtype=np.float32)
        self.seconds = np.zeros(frames - lead_in)
        self.failure: str | None = None
        self.left, self.left_depth, self.lifted, self.lifted_depth = 0, 0.0, 0, 0.0
        self.start()

    def start(self) -> None:
        """Count time and iterations from here."""
        self.before = dict(self.cloth.seconds)
        self.steps, self.iterations = self.cloth.steps, self.cloth.iterations

    def record(self, frame: int, report: ProjectionReport, begun: float) -> bool:
        """Take a frame; False when the run has diverged."""
        positions = self.cloth.positions.numpy()
        index = frame - self.lead_in
        self.failure = self._divergence(positions, index)
        if self.failure is not None:
            # Frames that were not reached repeat the last good one.
            self.vertices[max(index, 0) :] = self.vertices[index - 1] if index > 0 else self.rest.vertices
            return False
        if index >= 0:
            self.vertices[index] = positions
            self.seconds[index] = time.perf_counter() - begun
            self.left, self.left_depth = max(self.left, report.left), max(self.left_depth, report.left_depth)
            self.lifted = max(self.lifted, report.lifted)
            self.lifted_depth = max(self.lifted_depth, report.lifted_depth)
        return True

    def result(self, residual: float) -> SimulationResult:
        """The frames with quality figures and the timing split."""
        strain = np.abs(self.rest.edge_strain(self.vertices))
        steps = max(self.cloth.steps - self.steps, 1)
        quality = {
            "max_edge_strain": float(strain.max()),
            "p99_edge_strain": float(np.quantile(strain, 0.99)),
            "deepest_penetration_m": self.left_depth,
            "vertices_inside": float(self.left),
            "residual_speed_m_s": residual,
            "substeps": float(self.settings.steps_per_frame),
            "seconds_per_frame": float(self.seconds.mean()),
            "lifted_vertices": float(self.lifted),
            "lifted_depth_m": self.lifted_depth,
            "cg_iterations": (self.cloth.iterations - self.iterations) / steps,
        }
        timing = {name: seconds - self.before[name] for name, seconds in self.cloth.seconds.items()}
        # What no part claims (copying frames, Python between the kernels) belongs to the frame all the same.
        timing["other"] += max(float(self.seconds.sum()) - sum(timing.values()), 0.0)
        return SimulationResult(self.vertices, quality, self.failure, timing, self.seconds)

    def _divergence(self, positions: np.ndarray, index: int) -> str | None:
        where = f"frame {index}" if index >= 0 else f"{-index} frames before the first recorded one"
        bad = ~np.isfinite(positions).all(axis=1)
        if bad.any():
            return f"{int(bad.sum())} vertices are not finite at {where}"
        strain = float(np.abs(self.rest.edge_strain(positions)).max())
        if strain > self.settings.absurd_strain:
            return f"an edge is strained by {strain:.0%} at {where}"
        return None


def _settle(cloth: ImplicitCloth, settings: ImplicitSettings, time_scale: float) -> float:
    """Let the cloth come to rest on the standing body; returns its root mean square speed [m/s]."""
    cloth.set_extra_damping(settings.settle_damping)
    speed = 0.0
    for frame in range(round(settings.settle_seconds * settings.fps / time_scale)):
        for steps in settings.interval_steps:
            cloth.interval(steps)
        cloth.project_out()
        speed = float(np.sqrt(np.mean((cloth.velocities.numpy() ** 2).sum(axis=1))))
        # Not in the first frames: there, cloth is slow because it has not begun to fall.
        if not np.isfinite(speed) or (frame >= 5 and speed < settings.settle_speed):
            break
    cloth.set_extra_damping(0.0)
    return speed


def _contact_parts(template: GarmentTemplate, body: Body, settings: ImplicitSettings):
    if settings.contact == "whole":
        return whole_body(len(body.faces), len(template.vertices))
    skins = (body.skin_index, body.skin_weight, template.skin_index, template.skin_weight)
    return worn_parts(template.worn_as, template.layer, body.faces, *skins)


def _resampled(pose: np.ndarray, root: np.ndarray, intervals: int) -> tuple[np.ndarray, np.ndarray]:
    """Motion at the ends of all query intervals: joints slerped, the root linear."""
    if len(pose) == 1 or intervals == 1:
        return pose, root
    frames = np.arange(len(pose), dtype=np.float64)
    times = np.linspace(0.0, frames[-1], (len(pose) - 1) * intervals + 1)
    return slerp_poses(pose, frames, times), np.stack([np.interp(times, frames, axis) for axis in root.T], axis=1)


def _skinned(points: np.ndarray, template: GarmentTemplate, which: np.ndarray, transforms: np.ndarray) -> np.ndarray:
    """Bind-pose points of the garment under linear blend skinning, shape [Q, N, 3] for transforms [Q, J, 4, 4]."""
    index, weight = template.skin_index[which], template.skin_weight[which].astype(np.float64)
    blended = np.einsum("nk,qnkab->qnab", weight, transforms[:, index])
    return np.einsum("qnab,nb->qna", blended[..., :3, :3], points[which]) + blended[..., :3, 3]
