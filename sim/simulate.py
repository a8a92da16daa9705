"""Clips of a garment on a moving body: settle, lead-in, recorded frames, quality figures; one world or many at once.

In: a garment template, its body, poses [L + T, 24, 3] and roots [L + T, 3] whose first L frames lead from the bind pose
into the clip, intrinsic parameters, settings. Out: a ``SimulationResult`` with the T recorded frames of each world.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from geometry.proximity import closest_surface
from sim.body_contact import BodyContact, sag
from sim.body_crossings import BodyCrossings
from sim.body_motion import PELVIS, moved, pelvis_positions, query_times, transforms_at
from sim.body_parts import body_regions, handless, whole_body, worn_parts
from sim.clip_figures import ClipFigures
from sim.compile import resolve_device
from sim.motion import checked_motion
from sim.parameters import PARAMETER_NAMES, check_parameters
from sim.rest_state import RestState
from sim.result import SimulationResult
from sim.self_contact import SelfContact
from sim.settings import SimulationSettings
from sim.skeleton import Skeleton, Skin
from sim.strain_meter import StrainMeter
from sim.xpbd import SOLVER_VERSION, XpbdSolver, even_split

if TYPE_CHECKING:
    from body.model import Body
    from garments.template import GarmentTemplate

__all__ = ["SOLVER_VERSION", "SimulationSettings", "Simulator", "World", "simulate_clip"]

Progress = Callable[[int, int], None]


@dataclass(frozen=True)
class World:
    """One of the simulations that a simulator runs at once: a motion and a parameter set.

    Attributes:
        pose: Axis-angle poses [rad], shape [L + T, 24, 3]; the first one is the bind pose.
        root: Root translations [m], shape [L + T, 3].
        parameters: Every intrinsic parameter by name.
    """

    pose: np.ndarray
    root: np.ndarray
    parameters: Mapping[str, float]


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
    """The garments at rest on the bind-pose body: world state, and what speed was left [m/s], shape [W]."""

    key: tuple[tuple[float, ...], ...]
    positions: np.ndarray
    velocities: np.ndarray
    crease: np.ndarray
    speed: np.ndarray


class Simulator:
    """A garment on a body, ready for many clips and parameter sets.

    Constraint colours, search trees and recorded graphs are made once. A clip gives the same numbers whether its
    simulator is new or has run others before.
    """

    def __init__(
        self,
        template: GarmentTemplate,
        body: Body,
        settings: SimulationSettings | None = None,
        worlds: int = 1,
        own_motions: bool = False,
    ):
        """Check the template against the body and copy both to the device.

        Args:
            template: Garment made for this body.
            body: Body, in the shape that the template was made for.
            settings: Frame rate, device, contact and settling; defaults where None.
            worlds: Number of simulations at once, 1 or 16: one a SIMD lane.
            own_motions: Whether every world has a motion of its own. Worlds that share one also share the search for
                contacts, and are faster.

        Raises:
            ValueError: The template was made for another body, its mesh is broken, or it lies inside the body.
        """
        self.settings = settings or SimulationSettings()
        self.body, self.template, self.worlds = body, template, worlds
        if template.body_digest != body.digest:
            raise ValueError(
                f"garment {template.name!r} was made for body {template.body_name!r} ({template.body_digest}), "
                f"not for {body.name!r} ({body.digest})"
            )
        self.rest = RestState.from_mesh(template.vertices, template.faces, template.pinned, template.pieces)
        device = resolve_device(self.settings.device)
        lane_motion = np.arange(worlds) if own_motions else np.zeros(worlds, dtype=np.int32)
        skeleton = Skeleton(len(body.joints), body.joints[PELVIS], lane_motion, device)
        self.contact = self._body_contact(skeleton, device)
        pinned = self.rest.pinned
        bind_pins = self.rest.vertices[pinned] - skeleton.centre
        skin = (template.skin_index[pinned], template.skin_weight[pinned])
        pins = Skin(bind_pins, *skin, skeleton.motions, device)
        self.folds = SelfContact(self.rest, worlds, device, template.layer) if self.settings.self_contact else None
        if self.folds is not None:
            # Between two surfaces without room for it, cloth follows its own: keeping apart there is impossible too.
            self.folds.released = self.contact.pinched
        self.solver = XpbdSolver(self.rest, skeleton, self.contact, pins, device, self.folds, self.settings.tethers)
        self.strain = StrainMeter(self.rest, worlds, device)
        self.pokes = BodyCrossings(template.faces, self.contact)
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
        return self.run_worlds([World(pose, root, parameters)], lead_in, progress)[0]

    def run_worlds(
        self, worlds: Sequence[World], lead_in: int, progress: Progress | None = None
    ) -> list[SimulationResult]:
        """Simulate up to as many worlds as the simulator has, side by side.

        Args:
            worlds: Motions of one length, the same one for all unless every world has its own; parameter sets with the
                same number of substeps. Lanes that are left over repeat the first world.
            lead_in: Number L of leading frames that are simulated but not recorded.
            progress: Called after each frame with (frames done, frames in all).

        Returns:
            The result of each world, as of :func:`simulate_clip`. ``frame_seconds`` and ``timing`` are those of all
            worlds together.

        Raises:
            ValueError: Anything is wrong with the input: found before time is spent.
        """
        settings, solver = self.settings, self.solver
        lanes = self._lanes(worlds)
        motions = [checked_motion(w.pose, w.root, lead_in, self.body, settings.fps) for w in self._motions(lanes)]
        parameters = [world.parameters for world in lanes]
        total, substeps = len(motions[0][0]), _shared_substeps(parameters)
        counts = even_split(substeps, settings.queries_per_frame)
        times = query_times(total, counts)
        transforms = np.stack([transforms_at(self.body, *motion, times) for motion in motions], axis=1)
        origins = pelvis_positions(self.body, transforms)

        started = time.perf_counter()
        rested = self._settle(parameters, counts)
        settle_seconds = time.perf_counter() - started
        self._set_parameters(parameters, 0.0)
        solver.place(*self._carried(rested, transforms[0]), transforms[0], origins[0], crease=rested.crease)
        self.strain.reset()

        recorded = np.empty((self.worlds, total - lead_in, solver.count, 3), dtype=np.float32)
        seconds = np.zeros(total)
        figures = ClipFigures(self.worlds)
        failures: list[str | None] = [None] * self.worlds
        query = 0
        for frame in range(total):
            begun = time.perf_counter()
            index = frame - lead_in
            for step, count in enumerate(counts if frame > 0 else ()):
                query += 1
                solver.advance(count, transforms[query], origins[query])
                if self.folds is not None and step == 0 and index > 0:
                    # An interval begins with a search: this one saw the end of the last frame.
                    figures.add_crossings(self.folds.crossing_count())
            self._retire_diverged(index, failures)
            if index >= 0:
                recorded[:, index] = solver.positions()
                figures.add_contact(self.contact.distances(), self.contact.pinched.numpy().T)
                if (index + 1) % settings.check_every == 0 or frame == total - 1:
                    figures.add_triangles(self.pokes.count(solver.x))
                for lane, failure in enumerate(failures):
                    if failure is not None:  # repeat the last good frame
                        recorded[lane, index] = recorded[lane, index - 1] if index else self.rest.vertices
            seconds[frame] = time.perf_counter() - begun
            if progress is not None:
                progress(frame + 1, total)
            if all(failures[: len(worlds)]):
                recorded[:, max(index, 0) + 1 :] = recorded[:, max(index, 0), None]
                if index < 0:
                    recorded[:] = self.rest.vertices
                break

        if self.folds is not None:
            figures.add_crossings(self.folds.count_crossings(solver.parameters, solver.x, solver.v))
        p99 = self.strain.percentile(0.99)
        timing = {"settle": settle_seconds, "lead_in": float(seconds[:lead_in].sum())}
        timing["frames"] = float(seconds[lead_in:].sum())
        results = []
        for lane in range(len(worlds)):
            quality = {
                "max_edge_strain": float(self.strain.highest[lane]),
                "p99_edge_strain": float(p99[lane]),
                **figures.of(lane),
                "residual_speed_m_s": float(rested.speed[lane]),
                "substeps": float(substeps),
                "seconds_per_frame": float(seconds[lead_in:].mean()) / len(worlds),
            }
            results.append(SimulationResult(recorded[lane], quality, failures[lane], timing, seconds[lead_in:]))
        return results

    def _body_contact(self, skeleton: Skeleton, device: str) -> BodyContact:
        body, template = self.body, self.template
        skin = (body.skin_index, body.skin_weight)
        if self.settings.contact == "own":
            faces = body.faces[handless(body.faces, *skin)]
            parts = worn_parts(
                template.worn_as, template.layer, faces, *skin, template.skin_index, template.skin_weight
            )
        else:
            faces = body.faces
            parts = whole_body(len(faces), len(template.vertices), body_regions(faces, *skin))
        standoff = sag(self.rest.topology.edges, self.rest.edge_length, len(template.vertices))
        edges = (self.rest.topology.edges, self.rest.edge_length)
        return BodyContact(body.vertices, faces, *skin, parts, standoff, skeleton, self.settings.reach, *edges, device)

    def _lanes(self, worlds: Sequence[World]) -> list[World]:
        """A world for every lane; ``ValueError`` for too many or none, or motions that cannot go together."""
        if not 1 <= len(worlds) <= self.worlds:
            raise ValueError(f"{len(worlds)} worlds: allowed are 1 to {self.worlds}")
        first = worlds[0]
        for number, world in enumerate(worlds):
            check_parameters(world.parameters)
            if len(world.pose) != len(first.pose):
                raise ValueError(f"world {number} has {len(world.pose)} frames, world 0 has {len(first.pose)}")
            if self.solver.skeleton.motions == 1 and not (
                world is first or (np.array_equal(world.pose, first.pose) and np.array_equal(world.root, first.root))
            ):
                raise ValueError(f"world {number} moves unlike world 0, in a simulator whose worlds share a motion")
        return [*worlds, *[first] * (self.worlds - len(worlds))]

    def _motions(self, lanes: list[World]) -> list[World]:
        return lanes[: self.solver.skeleton.motions]

    def _settle(self, parameters: list[Mapping[str, float]], counts: list[int]) -> _Rested:
        """Let the garments come to rest on the bind-pose body.

        The last parameter sets are remembered: the clips of one set all begin here. Each world's state is taken where
        it came to rest, so that it does not depend on the others.
        """
        key = tuple(tuple(float(one[name]) for name in PARAMETER_NAMES) for one in parameters)
        if self._rested is not None and self._rested.key == key:
            return self._rested
        settings, solver, width = self.settings, self.solver, self.worlds
        self._set_parameters(parameters, settings.settle_damping)
        transforms, origins = self._bind()
        solver.place(self.rest.vertices, None, transforms, origins)
        limits = np.array([round(settings.settle_seconds * settings.fps / one["time_scale"]) for one in parameters])
        speed, resting = np.zeros(width), limits == 0
        positions, velocities, crease = self._state()
        for frame in range(limits.max(initial=0)):
            for count in counts:
                solver.advance(count, transforms, origins)
            now = np.sqrt(np.mean((solver.velocities().reshape(width, -1, 3).astype(np.float64) ** 2).sum(-1), axis=1))
            # Not in the first frames: there, cloth is slow because it has not begun to fall.
            done = ~resting & (
                ~np.isfinite(now) | (frame + 1 >= limits) | ((frame >= 5) & (now < settings.settle_speed))
            )
            if done.any():
                here = self._state()
                positions[done], velocities[done], crease[:, done] = here[0][done], here[1][done], here[2][:, done]
                speed[done] = now[done]
                resting |= done
            if resting.all():
                break
        self._rested = _Rested(key, positions, velocities, crease, speed)
        return self._rested

    def _state(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """World positions and velocities [W, V, 3] and creases [H, W]."""
        solver = self.solver
        shape = (self.worlds, solver.count, 3)
        return solver.positions().reshape(shape), solver.velocities().reshape(shape), solver.creases()

    def _carried(self, rested: _Rested, transforms: np.ndarray) -> tuple[np.ndarray, np.ndarray | None]:
        """The rested garments on the first pose: moved rigidly where that is the bind pose, by their skin where not."""
        each = transforms[self.solver.skeleton.lane_motion]  # [W, J, 4, 4]
        pelvis = each[:, PELVIS]
        if np.abs(each - pelvis[:, None]).max() < 1e-3:
            return moved(pelvis[:, None], rested.positions), rested.velocities @ np.swapaxes(pelvis[:, :3, :3], 1, 2)
        index, weight = self.template.skin_index, self.template.skin_weight
        blended = np.einsum("vk,wvkab->wvab", weight, each[:, index])
        return moved(blended, rested.positions), None

    def _bind(self) -> tuple[np.ndarray, np.ndarray]:
        """Skinning transforms of the bind pose and its floating origin, for every motion."""
        motions = self.solver.skeleton.motions
        return np.tile(np.eye(4), (motions, len(self.body.joints), 1, 1)), np.tile(
            np.asarray(self.body.joints[PELVIS], dtype=np.float64), (motions, 1)
        )

    def _set_parameters(self, parameters: list[Mapping[str, float]], extra_damping: float) -> None:
        steps = [one["time_scale"] / (self.settings.fps * round(one["substeps"])) for one in parameters]
        self.solver.set_parameters(parameters, steps, extra_damping, self.settings.max_speed)

    def _retire_diverged(self, index: int, failures: list[str | None]) -> None:
        """Note which worlds cannot be used any more, and put them back to rest: they must not disturb the others."""
        strain = self.strain.measure(self.solver.x, index >= 0)
        bad = np.flatnonzero(strain > self.settings.absurd_strain)
        if not len(bad):
            return
        where = f"frame {index}" if index >= 0 else f"{-index} frames before the first recorded one"
        local = self.solver.local_positions()
        for lane in bad:
            lost = int((~np.isfinite(local[lane]).all(axis=1)).sum())
            what = f"{lost} vertices are not finite" if lost else f"an edge is strained by {strain[lane]:.0%}"
            failures[lane] = failures[lane] or f"{what} at {where}"
        self.solver.put_back(bad, self.rest.vertices - self.body.joints[PELVIS])

    def _check_start(self) -> None:
        """The template on its bind-pose body: no vertex may start deeper inside than the settings allow."""
        allowed = self.settings.start_depth
        depth = -closest_surface(self.rest.vertices, self.body.vertices, self.body.faces).distance
        if depth.max(initial=0.0) > allowed:
            worst = int(np.argmax(depth))
            raise ValueError(
                f"garment {self.template.name!r} starts inside the body: {int((depth > allowed).sum())} vertices "
                f"deeper than {allowed * 1e3:g} mm, vertex {worst} by {depth[worst] * 1e3:.1f} mm"
            )


def _shared_substeps(parameters: list[Mapping[str, float]]) -> int:
    """The substeps a frame of worlds that are simulated together."""
    counts = {round(one["substeps"]) for one in parameters}
    if len(counts) > 1:
        raise ValueError(f"substeps = {sorted(counts)}: worlds that are simulated together take the same number")
    return counts.pop()
