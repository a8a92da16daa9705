"""One garment under implicit Euler: the linear system of a step, its constraints and its solution.

Source: Baraff & Witkin 1998, "Large Steps in Cloth Simulation": equation 6 (the step), section 4 (membrane and its
damping), section 5 (constraints and modified conjugate gradients); bending after Bergou et al. 2006. One linear solve
a step, float64 throughout (closest-point queries: float32), one thread.
"""

from __future__ import annotations

import time
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np
import warp as wp

from geometry.topology import corner_table
from sim.body_contact import sag
from sim.implicit.body_surface import BodySurface
from sim.implicit.contact_kernels import advance, constrain, project
from sim.implicit.energies import deformation_coefficients
from sim.implicit.force_kernels import add_bending, add_body_forces, add_membrane
from sim.implicit.linear_system import BlockSystem
from sim.implicit.settings import ImplicitSettings
from sim.implicit.strain_limits import limit_strain
from sim.parameters import check_parameters, parameter
from sim.rest_state import RestState

TIMED_PARTS = ("forces", "solve", "contact", "strain_limits", "other")


class ProjectionReport(NamedTuple):
    """What the projection at the end of a frame found: before its first pass and in its last one (0 when all is well).

    Attributes:
        lifted: Vertices below the surface before it.
        lifted_depth: Depth of the deepest of them [m].
        left: Vertices that its last pass still found, and moved once more.
        left_depth: Depth of the deepest of them [m].
    """

    lifted: int
    lifted_depth: float
    left: int
    left_depth: float


class ImplicitCloth:
    """State and step of one garment.

    Attributes:
        positions, velocities: World positions [m] and velocities [m/s], ``wp.array`` of vec3d, shape [V].
        seconds: Wall seconds spent so far in each of ``TIMED_PARTS``.
        iterations: Conjugate gradient iterations so far.
        steps: Steps so far.
    """

    def __init__(
        self,
        rest: RestState,
        parameters: Mapping[str, float],
        step: float,
        settings: ImplicitSettings,
        body: BodySurface | None = None,
    ):
        """Set up a garment at rest in its rest positions.

        Args:
            rest: Undeformed cloth; its pinned vertices follow the targets of :meth:`show_pins`.
            parameters: All intrinsic parameters (``sim.parameters``); ``substeps`` and ``time_scale`` are not read.
            step: Length of a step [s].
            settings: Numbers of the method.
            body: Moving body to collide with.
        """
        check_parameters(parameters)
        never = parameter("bend_yield").allowed[1]
        if parameters["bend_yield"] < never:
            raise ValueError(
                f"implicit solver: bend_yield = {parameters['bend_yield']:g}: it forms no creases, "
                f"allowed is {never:g} 1/m (never)"
            )
        if not step > 0.0:
            raise ValueError(f"implicit solver: the step must be above 0 s, got {step}")
        self.rest, self.parameters, self.step_seconds, self.settings = rest, dict(parameters), float(step), settings
        self.body = body
        count = rest.topology.vertex_count
        pinned = rest.pinned
        if body is not None and body.hit_face.shape[0] != count:
            raise ValueError(f"implicit solver: {count} vertices, but contact groups for {body.hit_face.shape[0]}")

        def array(values: np.ndarray, dtype: type) -> wp.array:
            return wp.array(np.ascontiguousarray(values), dtype=dtype, device="cpu")

        def zeros(dtype: type, size: int = count) -> wp.array:
            return wp.zeros(size, dtype=dtype, device="cpu")

        topology = rest.topology
        self._masses = parameters["density"] * rest.vertex_area
        self.masses = array(self._masses, wp.float64)
        self._inverse_masses = array(1.0 / self._masses, wp.float64)
        self.positions, self.velocities = array(rest.vertices, wp.vec3d), zeros(wp.vec3d)
        self._faces, self._hinges = array(topology.faces, wp.vec3i), array(rest.hinges, wp.vec4i)
        self._along_u, self._along_v = (array(c, wp.vec3d) for c in deformation_coefficients(rest))
        self._areas = array(rest.area, wp.float64)
        self._hinge_weights = array(rest.hinge_weights, wp.vec4d)
        self._vertex_areas = array(rest.vertex_area, wp.float64)
        first_corner, corners = corner_table(topology.faces, count)
        self._first_corner, self._corners = array(first_corner, wp.int32), array(corners, wp.vec2i)
        self._gravity = wp.vec3d(0.0, -parameters["gravity"], 0.0)
        heading, speed = parameters["wind_heading"], parameters["wind_speed"]
        self._wind = wp.vec3d(speed * np.sin(heading), 0.0, speed * np.cos(heading))
        self._extra_damping = 0.0
        clearance = parameters["thickness"] + sag(topology.edges, rest.edge_length, count)
        self._clearance, self._near = array(clearance, wp.float64), float(clearance.max())

        pin = np.full(count, -1, dtype=np.int32)
        pin[pinned] = np.arange(len(pinned))
        self._pin = array(pin, wp.int32)
        targets = rest.vertices[pinned] if len(pinned) else np.zeros((1, 3))
        self._pin_start, self._pin_end = array(targets, wp.vec3d), array(targets, wp.vec3d)

        self._state = zeros(wp.int32)
        self._normal_force, self._slip_speed = zeros(wp.float64), zeros(wp.float64)
        self._starting_force, self._body_velocity = zeros(wp.vec3d), zeros(wp.vec3d)
        self._inside, self._deepest, self._sweeps = zeros(wp.int32, 1), zeros(wp.float64, 1), zeros(wp.int32, 1)
        self._no_body = (zeros(wp.vec3d, 1), array(np.zeros((1, 3)), wp.vec3i), wp.full(count, -1, dtype=wp.int32))

        self.system = BlockSystem(topology)
        self._face_blocks = array(self.system.block_indices(topology.faces), wp.int32)
        self._hinge_blocks = self.system.block_indices(rest.hinges)
        self._base = array(self._constant_matrix(), wp.mat33d)
        self.seconds = dict.fromkeys(TIMED_PARTS, 0.0)
        self.iterations = self.steps = 0

    def set_extra_damping(self, rate: float) -> None:
        """Damp all velocities at ``rate`` [1/s] besides the drag of the air."""
        self._extra_damping = float(rate)

    def _constant_matrix(self) -> np.ndarray:
        """``M + (h^2 + h tau_bend) K_bend`` by block, shape [N, 3, 3]: isometric bending is quadratic."""
        h = self.step_seconds
        weights = self.rest.hinge_weights
        stiffness = (h * h + h * self.parameters["bend_damping"]) * self.parameters["bend"]
        bending = stiffness * weights[:, :, None] * weights[:, None, :]
        entries = np.bincount(self._hinge_blocks.ravel(), bending.ravel(), len(self.system.matrix))
        entries[self.system.diagonal.numpy()] += self._masses
        return entries[:, None, None] * np.eye(3)

    def place(self, positions: np.ndarray, velocities: np.ndarray | None = None) -> None:
        """Put the garment somewhere: positions [m] and velocities [m/s] (None: at rest), shape [V, 3]."""
        self.positions.assign(np.asarray(positions, dtype=np.float64))
        self.velocities.assign(np.zeros((self.system.count, 3)) if velocities is None else velocities)
        self._state.zero_()

    def show_pins(self, targets: np.ndarray) -> None:
        """Where the pinned vertices shall be at the end of the coming interval [m], shape [P, 3]."""
        if len(targets):
            wp.copy(self._pin_start, self._pin_end)
            self._pin_end.assign(np.asarray(targets, dtype=np.float64))

    def interval(self, steps: int) -> None:
        """Advance through one query interval, over which body and pins move from their last place to the shown one."""
        for k in range(steps):
            self.step(k / steps, (k + 1) / steps, query=k == 0)

    def step(self, share_start: float = 0.0, share_end: float = 1.0, query: bool = True) -> None:
        """One implicit Euler step over the part of the interval between two shares of it (0 to 1)."""
        begin = time.perf_counter()
        self.assemble()
        assembled = time.perf_counter()
        if query and self.body is not None:
            self.body.query(
                self.positions,
                self.velocities,
                self.step_seconds,
                share_end,
                self.settings.contact_radius,
                self._near,
            )
        self._constrain(share_start, share_end)
        constrained = time.perf_counter()
        self.iterations += self.system.solve(self.settings.cg_tolerance, self.settings.cg_max_iterations)
        solved = time.perf_counter()
        self._advance()
        advanced = time.perf_counter()
        if self.settings.strain_limits is not None:
            self._limit_strain()
        self.steps += 1
        self.seconds["forces"] += assembled - begin
        self.seconds["contact"] += constrained - assembled
        self.seconds["solve"] += solved - constrained
        self.seconds["other"] += advanced - solved
        self.seconds["strain_limits"] += time.perf_counter() - advanced

    def assemble(self) -> None:
        """Fill the system ``A dv = b`` of a step from the present positions and velocities, without contact."""
        p, h, system = self.parameters, self.step_seconds, self.system
        wp.copy(system.matrix, self._base)
        self._launch(
            add_body_forces,
            system.count,
            [
                self.positions, self.velocities, self.masses, self._vertex_areas, self._first_corner, self._corners,
                system.diagonal, self._gravity, self._wind, p["air_drag"], p["air_drag"] * p["drag_ratio"],
                self._extra_damping, h, system.matrix, system.right_side,
            ],
        )  # fmt: skip
        self._launch(
            add_membrane,
            len(self._faces),
            [
                self.positions, self.velocities, self._faces, self._along_u, self._along_v, self._areas,
                self._face_blocks, p["stretch"], p["shear"], p["compression"],
                p["stretch_damping"], h, system.matrix, system.right_side,
            ],
        )  # fmt: skip
        self._launch(
            add_bending,
            len(self._hinges),
            [
                self.positions, self.velocities, self._hinges, self._hinge_weights, p["bend"],
                p["bend_damping"], h, system.right_side,
            ],
        )  # fmt: skip

    def project_out(self) -> ProjectionReport:
        """Lift vertices that ended a frame below the body's surface to their clearance above it."""
        if self.body is None:
            return ProjectionReport(0, 0.0, 0, 0.0)
        begin = time.perf_counter()
        passes = []
        # A lifted vertex can end up under another fold of the body: look again, a few times.
        while len(passes) < 4 and (not passes or passes[-1][0] > 0):
            passes.append(self._project_once())
        self.seconds["contact"] += time.perf_counter() - begin
        return ProjectionReport(*passes[0], *passes[-1])

    def _project_once(self) -> tuple[int, float]:
        body, near = self.body, self._near
        body.query(self.positions, self.velocities, 0.0, 1.0, self.settings.contact_radius, near)
        self._inside.zero_()
        self._deepest.zero_()
        self._launch(
            project,
            self.system.count,
            [
                body.hit_face, body.hit_weights, body.faces, body.end, body.normal_end, self._pin,
                self._clearance, self.positions, self._inside, self._deepest,
            ],
        )  # fmt: skip
        return int(self._inside.numpy()[0]), float(self._deepest.numpy()[0])

    def _constrain(self, share_start: float, share_end: float) -> None:
        p, settings, system, body = self.parameters, self.settings, self.system, self.body
        points, faces, no_hit = self._no_body
        if body is None:
            surface = [no_hit, system.solution, faces, points, points, points, points]
        else:
            surface = [
                body.hit_face, body.hit_weights, body.faces,
                body.start, body.end, body.normal_start, body.normal_end,
            ]  # fmt: skip
        self._launch(
            constrain,
            system.count,
            [
                self.positions, self.velocities, self.masses, self._pin, self._pin_start, self._pin_end, *surface,
                share_start, share_end, self.step_seconds, self._clearance, p["friction"], settings.push_speed,
                settings.stick_speed, system.diagonal, self._state, self._normal_force, self._slip_speed,
                self._starting_force, self._body_velocity, system.held, system.normals, system.solution,
                system.matrix, system.right_side,
            ],
        )  # fmt: skip

    def _advance(self) -> None:
        system = self.system
        self._launch(
            advance,
            system.count,
            [
                self.step_seconds, self.parameters["friction"], self.settings.stick_speed, self._pin, system.held,
                system.normals, system.solution, system.impulse, self._body_velocity, self.positions, self.velocities,
                self._state, self._normal_force, self._slip_speed, self._starting_force,
            ],
        )  # fmt: skip

    def _limit_strain(self) -> None:
        low, high = self.settings.strain_limits
        before = self.positions.numpy().copy()
        self._launch(
            limit_strain,
            1,
            [
                self._faces, self._along_u, self._along_v, self._inverse_masses, self.system.held, low, high,
                self.settings.strain_sweeps, self.positions, self._sweeps,
            ],
        )  # fmt: skip
        # On the CPU .numpy() shares the array's memory.
        velocities = self.velocities.numpy()
        velocities += (self.positions.numpy() - before) / self.step_seconds

    def _launch(self, kernel: wp.Kernel, dim: int, inputs: list) -> None:
        wp.launch(kernel, dim=dim, inputs=inputs, device="cpu")
