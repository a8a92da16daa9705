"""One clip of a garment on a moving body: settle, lead-in, recorded frames, quality figures.

In: a garment template, its body, poses [L + T, 24, 3] and roots [L + T, 3] whose first L frames lead from the bind pose
into the clip, intrinsic parameters, settings. Out: a ``SimulationResult`` with the T recorded frames.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from geometry.rotations import slerp_poses
from sim.body_contact import BodyContact, Skeleton, Skin, sag
from sim.body_parts import own_parts, whole_body
from sim.compile import resolve_device
from sim.motion import checked_motion
from sim.parameters import PARAMETER_NAMES, base_parameters, check_parameters
from sim.rest_state import RestState
from sim.result import SimulationResult
from sim.settings import SimulationSettings
from sim.xpbd import SOLVER_VERSION, XpbdSolver, even_split

if TYPE_CHECKING:
    from body.model import Body
    from garments.template import GarmentTemplate

__all__ = ["SOLVER_VERSION", "SimulationSettings", "Simulator", "simulate_clip"]

_PELVIS = 0
Progress = Callable[[int, int], None]


def simulate_clip(
    template: GarmentTemplate,
    body: Body,
    pose: np.ndarray,
    root: np.ndarray,
    lead_in: int,
    parameters: Mapping[str, float],
    settings: SimulationSettings | None = None,
    progress: Progress | None = None,
) -> SimulationResult:
    """Simulate one clip with XPBD. Many clips of one garment: make a :class:`Simulator` once and call its ``run``.

    The garment is put on in the bind pose, settles there, is carried through the lead-in and recorded from frame
    ``lead_in`` on. Pinned vertices follow the skinned body; all others are held by contact and friction alone.

    Args:
        template: Garment made for this body.
        body: Body, in the shape that the template was made for.
        pose: Axis-angle poses [rad], shape [L + T, 24, 3]; the first one is the bind pose.
        root: Root translations [m], shape [L + T, 3].
        lead_in: Number L of leading frames that are simulated but not recorded.
        parameters: Every intrinsic parameter by name.
        settings: Frame rate, device, contact and settling; defaults where None.
        progress: Called after each frame with (frames done, frames in all).

    Returns:
        Recorded frames with quality figures; ``failure`` says why a diverged run cannot be used.

    Raises:
        ValueError: Anything is wrong with the input: found before time is spent.
    """
    return Simulator(template, body, settings).run(pose, root, lead_in, parameters, progress)


@dataclass(frozen=True)
class _Rested:
    """A garment at rest on the bind-pose body under one parameter set: world state and what speed was left [m/s]."""

    key: tuple[float, ...]
    positions: np.ndarray
    velocities: np.ndarray
    speed: float


class Simulator:
    """A garment on a body, ready for many clips and parameter sets.

    Constraint colours, search trees and recorded graphs are made once. A clip gives the same numbers whether its
    simulator is new or has run others before.
    """

    def __init__(self, template: GarmentTemplate, body: Body, settings: SimulationSettings | None = None):
        """Check the template against the body and copy both to the device.

        Raises:
            ValueError: The template was made for another body, its mesh is broken, or it lies inside the body.
        """
        self.settings = settings or SimulationSettings()
        self.body, self.template = body, template
        if template.body_digest != body.digest:
            raise ValueError(
                f"garment {template.name!r} was made for body {template.body_name!r} ({template.body_digest}), "
                f"not for {body.name!r} ({body.digest})"
            )
        self.rest = RestState.from_mesh(template.vertices, template.faces, template.pinned, template.pieces)
        device = resolve_device(self.settings.device)
        if self.settings.contact == "own":
            parts = own_parts(
                template.kind, body.faces, body.skin_index, body.skin_weight, template.skin_index, template.skin_weight
            )
        else:
            parts = whole_body(len(body.faces), len(template.vertices))
        skeleton = Skeleton(len(body.joints), body.joints[_PELVIS], device)
        self.contact = BodyContact(
            body.vertices,
            body.faces,
            body.skin_index,
            body.skin_weight,
            parts,
            sag(self.rest.topology.edges, self.rest.edge_length, len(template.vertices)),
            skeleton,
            self.settings.reach,
            device,
        )
        pinned = self.rest.pinned
        bind_pins = self.rest.vertices[pinned] - skeleton.centre
        pins = Skin(bind_pins, template.skin_index[pinned], template.skin_weight[pinned], device)
        self.solver = XpbdSolver(self.rest, skeleton, self.contact, pins, device)
        self._shortest_absurd = (1.0 + self.settings.absurd_strain) * self.rest.edge_length.min()
        self._rested: _Rested | None = None
        self._check_start()

    def run(
        self,
        pose: np.ndarray,
        root: np.ndarray,
        lead_in: int,
        parameters: Mapping[str, float],
        progress: Progress | None = None,
    ) -> SimulationResult:
        """Simulate one clip; arguments, result and errors as in :func:`simulate_clip`."""
        pose, root = checked_motion(pose, root, lead_in, self.body, self.settings.fps)
        check_parameters(parameters)
        settings, total = self.settings, len(pose)
        substeps = round(parameters["substeps"])
        counts = even_split(substeps, settings.queries_per_frame)
        transforms = _transforms_at(self.body, pose, root, query_times(total, counts))
        origins = _moved(transforms[:, _PELVIS], self.body.joints[_PELVIS])

        started = time.perf_counter()
        rested = self._settle(parameters, counts)
        settle_seconds = time.perf_counter() - started
        self._set_parameters(parameters, 0.0)
        self.solver.place(*self._carried(rested, transforms[0]), transforms[0], origins[0])

        recorded = np.empty((total - lead_in, self.solver.count, 3), dtype=np.float32)
        seconds = np.zeros(total)
        inside, deepest, failure = 0, 0.0, None
        query = 0
        for frame in range(total):
            begun = time.perf_counter()
            if frame > 0:
                for count in counts:
                    query += 1
                    self.solver.advance(count, transforms[query], origins[query])
            index = frame - lead_in
            failure = self._divergence(index)
            if failure is not None:
                # Frames that were not reached repeat the last good one.
                recorded[max(index, 0) :] = recorded[index - 1] if index > 0 else self.rest.vertices
                break
            if index >= 0:
                recorded[index] = self.solver.positions()
                depth = -self.contact.distance.numpy()
                inside, deepest = max(inside, int((depth > 0.0).sum())), max(deepest, float(depth.max(initial=0.0)))
            seconds[frame] = time.perf_counter() - begun
            if progress is not None:
                progress(frame + 1, total)

        strain = np.abs(self.rest.edge_strain(recorded))
        quality = {
            "max_edge_strain": float(strain.max()),
            "p99_edge_strain": float(np.quantile(strain, 0.99)),
            "deepest_penetration_m": deepest,
            "vertices_inside": float(inside),
            "residual_speed_m_s": rested.speed,
            "substeps": float(substeps),
            "seconds_per_frame": float(seconds[lead_in:].mean()),
        }
        timing = {"settle": settle_seconds, "lead_in": float(seconds[:lead_in].sum())}
        timing["frames"] = float(seconds[lead_in:].sum())
        return SimulationResult(recorded, quality, failure, timing, seconds[lead_in:])

    def _settle(self, parameters: Mapping[str, float], counts: list[int]) -> _Rested:
        """Let the garment come to rest on the bind-pose body.

        The last parameter set is remembered: the clips of one set all begin here.
        """
        key = tuple(float(parameters[name]) for name in PARAMETER_NAMES)
        if self._rested is not None and self._rested.key == key:
            return self._rested
        settings, solver = self.settings, self.solver
        self._set_parameters(parameters, settings.settle_damping)
        transforms, origin = self._bind()
        solver.place(self.rest.vertices, None, transforms, origin)
        speed = 0.0
        for frame in range(round(settings.settle_seconds * settings.fps / parameters["time_scale"])):
            for count in counts:
                solver.advance(count, transforms, origin)
            speed = float(np.sqrt(np.mean((solver.velocities().astype(np.float64) ** 2).sum(axis=1))))
            # Not in the first frames: there, cloth is slow because it has not begun to fall.
            if not np.isfinite(speed) or (frame >= 5 and speed < settings.settle_speed):
                break
        self._rested = _Rested(key, solver.positions(), solver.velocities(), speed)
        return self._rested

    def _carried(self, rested: _Rested, transforms: np.ndarray) -> tuple[np.ndarray, np.ndarray | None]:
        """The rested garment on the first pose: moved rigidly where that is the bind pose, by its skin where not."""
        pelvis = transforms[_PELVIS]
        if np.abs(transforms - pelvis).max() < 1e-3:
            return _moved(pelvis, rested.positions), rested.velocities @ pelvis[:3, :3].T
        each = np.stack([_moved(matrix, rested.positions) for matrix in transforms])  # [J, V, 3]
        index, weight = self.template.skin_index, self.template.skin_weight
        rows = np.arange(len(index))[:, None]
        return (each[index, rows] * weight[..., None]).sum(axis=1), None

    def _bind(self) -> tuple[np.ndarray, np.ndarray]:
        """Skinning transforms of the bind pose and its floating origin."""
        return np.tile(np.eye(4), (len(self.body.joints), 1, 1)), np.asarray(
            self.body.joints[_PELVIS], dtype=np.float64
        )

    def _set_parameters(self, parameters: Mapping[str, float], extra_damping: float) -> None:
        dt = parameters["time_scale"] / (self.settings.fps * round(parameters["substeps"]))
        self.solver.set_parameters(parameters, dt, extra_damping, self.settings.max_speed)

    def _divergence(self, index: int) -> str | None:
        """Why the state cannot be used, None when it can; cheap, for it is asked every frame."""
        local = self.solver.x.numpy()
        i, j = self.rest.topology.edges.T
        span = local[i] - local[j]
        stretch = np.sqrt(np.einsum("ek,ek->e", span, span).max())  # NaN and infinity survive the maximum
        if stretch <= self._shortest_absurd:
            return None
        where = f"frame {index}" if index >= 0 else f"{-index} frames before the first recorded one"
        bad = ~np.isfinite(local).all(axis=1)
        if bad.any():
            return f"{int(bad.sum())} vertices are not finite at {where}"
        strain = float(self.rest.edge_strain(local).max())
        return f"an edge is strained by {strain:.0%} at {where}" if strain > self.settings.absurd_strain else None

    def _check_start(self) -> None:
        """The template on its bind-pose body: no vertex may start deeper inside than the settings allow."""
        allowed = self.settings.start_depth
        self._set_parameters(base_parameters(), 0.0)
        self.solver.place(self.rest.vertices, None, *self._bind(), passes=0, reach=1.0)
        depth = -self.contact.distance.numpy()
        if depth.max(initial=0.0) > allowed:
            worst = int(np.argmax(depth))
            raise ValueError(
                f"garment {self.template.name!r} starts inside the body: {int((depth > allowed).sum())} vertices "
                f"deeper than {allowed * 1e3:g} mm, vertex {worst} by {depth[worst] * 1e3:.1f} mm"
            )


def query_times(frames: int, counts: list[int]) -> np.ndarray:
    """Times of the queries in frames: 0 and the end of every interval, shape [1 + (frames - 1) * len(counts)]."""
    within = np.cumsum(counts) / sum(counts)
    return np.concatenate([[0.0], (np.arange(frames - 1)[:, None] + within).ravel()])


def _transforms_at(body: Body, pose: np.ndarray, root: np.ndarray, times: np.ndarray) -> np.ndarray:
    """Skinning transforms [Q, J, 4, 4] at times in frames: joints slerped, the root linear."""
    frames = np.arange(len(pose), dtype=np.float64)
    if len(times) > 1:
        pose = slerp_poses(pose, frames, times)
        root = np.stack([np.interp(times, frames, root[:, axis]) for axis in range(3)], axis=1)
    return body.joint_transforms(pose, root)


def _moved(transforms: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Points [..., 3] under 4 x 4 transforms [..., 4, 4]."""
    return np.einsum("...ab,...b->...a", transforms[..., :3, :3], points) + transforms[..., :3, 3]
