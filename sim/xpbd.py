"""Extended position-based dynamics of one garment (Macklin et al. 2016) with small substeps (Macklin et al. 2019).

In: the rest state of a garment, a moving body, a set of intrinsic parameters. Out: positions at the end of each query
interval. One interval of n substeps reads:

    move the body and the pins to the end of the interval; carry the cached contact planes along
    for j = 1 .. n:
        every fourth substep: v <- damped v                       membrane and bending, implicit
        v <- drag v + gravity dt;  x_pred <- x + v dt            predict
        membrane: triangles, colour by colour                    Gauss-Seidel, one iteration
        bending: hinges, colour by colour
        contact planes at j/n of the interval, friction          last, so that it holds at the end
        v <- v + (x - x_pred) / dt
    refit the body; put vertices outside the exact surface; cache the closest points for the next interval

The whole interval but the refit is recorded once as a graph and replayed: on a CPU this takes the launch overhead away.
Positions are relative to a floating origin that the caller moves with the pelvis; velocities are those of the world.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import warp as wp

from sim.body_contact import BodyContact, Skeleton, Skin
from sim.colouring import colour_constraints
from sim.compile import load_kernels
from sim.kernels import bending, integrate, membrane
from sim.kernels.parameters import SubstepParameters
from sim.parameters import check_parameters
from sim.rest_state import RestState

SOLVER_VERSION = "xpbd-1"

# The implicit damping of a few substeps at once costs little and changes little: with real fabrics' stiffness a single
# triangle's strain rate is damped away within one substep anyway.
SUBSTEPS_A_DAMPING = 4


class XpbdSolver:
    """State and step of one garment.

    Attributes:
        x: Positions relative to the floating origin [m], shape [V].
        v: Velocities in the world [m/s], shape [V].
    """

    def __init__(self, rest: RestState, skeleton: Skeleton, contact: BodyContact | None, pins: Skin, device: str):
        """Copy the rest state to the device, constraints sorted by colour.

        Args:
            rest: Rest state of the garment.
            skeleton: Transforms shared by body and pins.
            contact: Body to collide with; None for none.
            pins: Skinned targets of ``rest.pinned``, in that order.
            device: Warp device.
        """
        load_kernels(device)
        self.rest, self.skeleton, self.contact, self.pins, self.device = rest, skeleton, contact, pins, device
        count = len(rest.vertices)
        self.count = count
        self.triangle_colours, self.triangles = _device_triangles(rest, device)
        self.hinge_colours, self.hinges = _device_hinges(rest, device)
        self.pinned = wp.array(rest.pinned, dtype=int, device=device)
        self.inverse_mass = wp.array(rest.inverse_mass.astype(np.float32), dtype=float, device=device)
        self.x, self.v, self.x_prev, self.x_pred = (wp.zeros(count, dtype=wp.vec3, device=device) for _ in range(4))
        self.parameters = wp.zeros(1, dtype=SubstepParameters, device=device)
        self._graphs: dict[int, wp.Graph] = {}

    def set_parameters(
        self, values: Mapping[str, float], dt: float, extra_damping: float = 0.0, max_speed: float = 1.0e6
    ) -> None:
        """Take a set of intrinsic parameters for substeps of ``dt`` [s].

        Args:
            values: Every intrinsic parameter.
            dt: Substep [s].
            extra_damping: Rate at which velocities decay besides air drag [1/s].
            max_speed: Cap on the speed of a vertex [m/s].
        """
        check_parameters(values)
        p = SubstepParameters()
        scale = dt * dt / values["density"]
        p.dt = dt
        p.velocity_decay = float(np.exp(-(values["air_drag"] / values["density"] + extra_damping) * dt))
        p.gravity_step = values["gravity"] * dt
        p.stretch_root = float(np.sqrt(values["stretch"] * scale))
        p.shear_root = float(np.sqrt(values["shear"] * scale))
        p.compression_root = float(np.sqrt(values["compression"]))
        p.stretch_damping = values["stretch_damping"] / dt
        p.bend = values["bend"] * scale
        p.bend_damping = values["bend_damping"] / dt
        p.friction = values["friction"]
        p.thickness = values["thickness"]
        p.max_speed = max_speed
        self.parameters.assign([p])

    def place(
        self,
        positions: np.ndarray,
        velocities: np.ndarray | None,
        transforms: np.ndarray,
        origin: np.ndarray,
        passes: int = 3,
        reach: float | None = None,
    ) -> None:
        """Put garment and body somewhere and find the contacts there.

        Args:
            positions: World positions [m], shape [V, 3].
            velocities: World velocities [m/s], shape [V, 3]; None for rest.
            transforms: Skinning transforms of the body, bind to world, shape [J, 4, 4].
            origin: Floating origin [m], shape [3].
            passes: How often a vertex inside the body is moved out at most; 0 only measures.
            reach: Radius of the query [m] where it differs from that of the motion.
        """
        for _ in range(2):  # twice: start and end of the interval
            self.skeleton.set(transforms, origin)
            self.pins.launch(self.skeleton)
            if self.contact is not None:
                self.contact.forget()
                self.contact.launch_motion()
        self.x.assign((np.asarray(positions, dtype=np.float64) - origin).astype(np.float32))
        self.v.assign(np.zeros((self.count, 3), np.float32) if velocities is None else velocities.astype(np.float32))
        if self.contact is not None:
            self.contact.find(self.inverse_mass, self.parameters, self.x, passes, reach)

    def advance(self, substeps: int, transforms: np.ndarray, origin: np.ndarray) -> None:
        """Simulate one query interval.

        Args:
            substeps: Number of substeps in it.
            transforms: Skinning transforms at its end, bind to world, shape [J, 4, 4].
            origin: Floating origin for it [m], shape [3]; a translation alone, so the dynamics stay those of the world.
        """
        self.skeleton.set(transforms, origin)
        if substeps not in self._graphs:
            self._record(substeps)
        wp.capture_launch(self._graphs[substeps])
        if self.contact is not None:
            self.contact.find(self.inverse_mass, self.parameters, self.x)

    def positions(self) -> np.ndarray:
        """World positions [m], shape [V, 3], float64."""
        return self.x.numpy() + self.skeleton.origin

    def velocities(self) -> np.ndarray:
        """World velocities [m/s], shape [V, 3]."""
        return self.v.numpy().copy()

    def _record(self, substeps: int) -> None:
        with wp.ScopedCapture(device=self.device, force_module_load=False) as capture:
            self._interval(substeps)
        self._graphs[substeps] = capture.graph

    def _interval(self, substeps: int) -> None:
        wp.launch(integrate.shift_origin, self.count, [self.skeleton.shift], [self.x], device=self.device)
        self.pins.launch(self.skeleton)
        if self.contact is not None:
            self.contact.launch_motion()
        done = 0
        for span in even_split(substeps, max(1, round(substeps / SUBSTEPS_A_DAMPING))):
            self._damp(float(span))
            for _ in range(span):
                done += 1
                self._substep(done / substeps, 1.0 / substeps)

    def _damp(self, span: float) -> None:
        for first, count in self.triangle_colours:
            inputs = [first, span, self.triangles, self.inverse_mass, self.parameters, self.x]
            wp.launch(membrane.damp_membrane, count, inputs, [self.v], device=self.device)
        for first, count in self.hinge_colours:
            inputs = [first, span, self.hinges, self.inverse_mass, self.parameters]
            wp.launch(bending.damp_bending, count, inputs, [self.v], device=self.device)

    def _substep(self, fraction: float, step: float) -> None:
        inputs = [self.inverse_mass, self.parameters]
        wp.launch(integrate.predict, self.count, inputs, [self.v, self.x, self.x_prev, self.x_pred], device=self.device)
        if self.pins.count:
            inputs = [fraction, self.pinned, self.pins.start, self.pins.end]
            wp.launch(integrate.move_pins, self.pins.count, inputs, [self.x], device=self.device)
        for first, count in self.triangle_colours:
            inputs = [first, self.triangles, self.inverse_mass, self.parameters]
            wp.launch(membrane.solve_membrane, count, inputs, [self.x], device=self.device)
        for first, count in self.hinge_colours:
            inputs = [first, self.hinges, self.inverse_mass, self.parameters]
            wp.launch(bending.solve_bending, count, inputs, [self.x], device=self.device)
        if self.contact is not None:
            self.contact.launch_solve(fraction, step, self.inverse_mass, self.x_prev, self.parameters, self.x)
        inputs = [self.inverse_mass, self.parameters, self.x, self.x_prev, self.x_pred]
        wp.launch(integrate.update_velocity, self.count, inputs, [self.v], device=self.device)


def even_split(total: int, parts: int) -> list[int]:
    """``total`` in at most ``parts`` whole numbers, as even as can be and none of them zero."""
    parts = min(parts, total)
    ends = [(k + 1) * total // parts for k in range(parts)]
    return [end - start for start, end in zip([0] + ends, ends)]


def _device_triangles(rest: RestState, device: str) -> tuple[list[tuple[int, int]], wp.array]:
    """Triangles in packs of four of one colour: (first, count) of each colour's packs, and the packs."""
    faces = rest.topology.faces
    colouring = colour_constraints(faces, len(rest.vertices))
    ranges, members = [], []
    for start, count in colouring.ranges:
        packs = -(-count // membrane.LANES)
        ranges.append((sum(map(len, members)), packs))
        # The last pack is filled up by repeating a triangle; lanes beyond ``count`` are never stored.
        padded = np.full(packs * membrane.LANES, start + count - 1)
        padded[:count] = np.arange(start, start + count)
        members.append(colouring.order[padded].reshape(packs, membrane.LANES))
    packed = np.zeros(sum(map(len, members)), dtype=membrane.Triangles.numpy_dtype())
    packed["count"] = membrane.LANES
    for (first, packs), (_, count) in zip(ranges, colouring.ranges):
        packed["count"][first + packs - 1] = count - (packs - 1) * membrane.LANES
    lanes = np.concatenate(members)
    packed["i0"], packed["i1"], packed["i2"] = (faces[lanes, corner] for corner in range(3))
    packed["du1"], packed["dv1"] = (rest.inverse[lanes, 0, c] for c in range(2))
    packed["du2"], packed["dv2"] = (rest.inverse[lanes, 1, c] for c in range(2))
    packed["root_area"] = np.sqrt(rest.area[lanes])
    return ranges, wp.array(packed, dtype=membrane.Triangles, device=device)


def _device_hinges(rest: RestState, device: str) -> tuple[tuple[tuple[int, int], ...], wp.array]:
    colouring = colour_constraints(rest.hinges, len(rest.vertices))
    packed = np.zeros(len(rest.hinges), dtype=bending.Hinge.numpy_dtype())
    packed["i0"], packed["i1"], packed["i2"], packed["i3"] = rest.hinges.T
    packed["weight"] = rest.hinge_weights
    packed["norm"] = (rest.hinge_weights**2 * rest.inverse_mass[rest.hinges]).sum(axis=1)
    return colouring.ranges, wp.array(packed[colouring.order], dtype=bending.Hinge, device=device)
