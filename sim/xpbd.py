"""Extended position-based dynamics of one garment (Macklin et al. 2016) with small substeps (Macklin et al. 2019).

In: the rest state of a garment, moving bodies, and for each of W worlds a set of intrinsic parameters. Out: positions
at the end of each query interval. One interval of n substeps reads:

    move bodies and pins to the end of the interval; carry the cached contact planes along
    normals of the cloth; creases where it is bent beyond its yield
    for j = 1 .. n:
        every eighth substep: v <- damped v                       membrane and bending, implicit
        v <- in the air, under gravity;  x_pred <- x + v dt      predict
        membrane: triangles, colour by colour                    Gauss-Seidel, one iteration
        tethers to the pins                                      one-sided
        every other substep: bending: hinges, colour by colour
        cloth against cloth: the pairs that were found near each other
        contact planes at j/n of the interval, friction          last, so that it holds at the end
        v <- v + (x - x_pred) / dt
    put vertices outside the exact surface; cache the closest points for the next interval
    list what of the cloth may meet other cloth in the next interval

The whole interval but the search is recorded once as a graph and replayed: on a CPU this saves the launch overhead.
Positions are relative to floating origins that the caller moves with the pelvis; velocities are those of the world.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import warp as wp

from sim.body_contact import BodyContact
from sim.compile import load_kernels
from sim.kernels import integrate
from sim.kernels.lanes import launch
from sim.kernels.packs import PACK
from sim.kernels.parameters import substep_constants
from sim.lane_substep import LaneSubstep, State
from sim.packed_substep import PackedSubstep
from sim.parameters import check_parameters, parameter
from sim.rest_state import RestState
from sim.self_contact import SelfContact
from sim.skeleton import Skeleton, Skin
from sim.tethers import Tethers

SOLVER_VERSION = "xpbd-4"

# The implicit damping of a few substeps at once costs little and changes little: with real fabrics' stiffness a single
# triangle's strain rate is damped away within one substep anyway.
SUBSTEPS_A_DAMPING = 8
# Bending is so much softer than the membrane that the impulse of two substeps at once is as good.
SUBSTEPS_A_BENDING = 2

_NEVER_YIELDS = parameter("bend_yield").allowed[1]


class XpbdSolver:
    """State and step of W worlds of one garment; the lanes of ``skeleton`` say how many.

    Attributes:
        width: Number of worlds W.
        x: Positions relative to the floating origins [m], shape [V], a 3-D vector in every lane.
        v: Velocities in the world [m/s], likewise.
    """

    def __init__(
        self,
        rest: RestState,
        skeleton: Skeleton,
        contact: BodyContact | None,
        pins: Skin,
        device: str,
        self_contact: SelfContact | None = None,
        tethered: bool = False,
    ):
        """Copy the rest state to the device, constraints sorted by colour.

        Args:
            rest: Rest state of the garment.
            skeleton: Transforms shared by body and pins; its lanes are the worlds.
            contact: Body to collide with; None for none.
            pins: Skinned targets of ``rest.pinned``, in that order.
            device: Warp device.
            self_contact: Contact of the cloth with itself; None for none.
            tethered: Whether free vertices are tied to their nearest pin (``sim.tethers``).
        """
        width = len(skeleton.lane_motion)
        load_kernels(device, width)
        self.rest, self.skeleton, self.contact, self.pins, self.device = rest, skeleton, contact, pins, device
        self.self_contact = self_contact
        self.count, self.width = len(rest.vertices), width
        self.state = state = State.zero(rest, width, device)
        self.x, self.v, self.inverse_mass, self.parameters = state.x, state.v, state.inverse_mass, state.parameters
        packed = width == 1 and device == "cpu" and self.count >= PACK
        self.substep = (PackedSubstep if packed else LaneSubstep)(rest, state, contact, device)
        self.pinned = wp.array(rest.pinned, dtype=int, device=device)
        self.tethers = Tethers(rest, width, device) if tethered and len(rest.pinned) else None
        self.plastic = False
        self._graphs: dict[tuple[int, bool], wp.Graph] = {}

    def set_parameters(
        self,
        values: Mapping[str, float] | Sequence[Mapping[str, float]],
        dt: float | Sequence[float],
        extra_damping: float = 0.0,
        max_speed: float = 1.0e6,
    ) -> None:
        """Take the intrinsic parameters of every world.

        Args:
            values: Every intrinsic parameter, of all worlds or of each.
            dt: Substep [s], of all worlds or of each; they differ where time scales do.
            extra_damping: Rate at which velocities decay besides air drag [1/s].
            max_speed: Cap on the speed of a vertex [m/s].
        """
        each = [values] * self.width if isinstance(values, Mapping) else list(values)
        steps = np.broadcast_to(np.asarray(dt, dtype=np.float64), self.width)
        if len(each) != self.width:
            raise ValueError(f"{len(each)} parameter sets for {self.width} worlds")
        for one in each:
            check_parameters(one)
        longest = 0.0 if self.tethers is None else self.tethers.longest
        columns = [substep_constants(one, step, extra_damping, max_speed, longest) for one, step in zip(each, steps)]
        self.parameters.assign(np.stack(columns, axis=1))
        self.plastic = any(one["bend_yield"] < _NEVER_YIELDS for one in each)

    def place(
        self,
        positions: np.ndarray,
        velocities: np.ndarray | None,
        transforms: np.ndarray,
        origins: np.ndarray,
        passes: int = 3,
        crease: np.ndarray | None = None,
    ) -> None:
        """Put garments and bodies somewhere and find the contacts there.

        Args:
            positions: World positions [m], shape [V, 3] or [W, V, 3].
            velocities: World velocities [m/s], likewise; None for rest.
            transforms: Skinning transforms of the bodies, bind to world, shape [J, 4, 4] or [M, J, 4, 4].
            origins: Floating origins [m], shape [3] or [M, 3].
            passes: How often a vertex inside the body is moved out at most; 0 only measures.
            crease: Crease of each hinge as :meth:`creases` gives it; None for none.
        """
        transforms, origins = self._motions(transforms, origins)
        for _ in range(2):  # twice: start and end of the interval
            self.skeleton.set(transforms, origins)
            self.pins.launch(self.skeleton)
            if self.contact is not None:
                self.contact.forget()
                self.contact.launch_motion()
        local = np.asarray(positions, dtype=np.float64) - self._lane_origins()[:, None]
        self.x.assign(self._in_lanes(local))
        still = np.zeros((self.count, 3)) if velocities is None else velocities
        self.v.assign(self._in_lanes(np.asarray(still)))
        kept = self.substep.crease
        kept.zero_() if crease is None else kept.assign(crease.reshape(len(kept), -1))
        if self.self_contact is not None:
            self.self_contact.forget()
        if self.contact is not None:
            self.contact.find(self.inverse_mass, self.parameters, self.v, self.x, 0, passes)

    def advance(self, substeps: int, transforms: np.ndarray, origins: np.ndarray) -> None:
        """Simulate one query interval.

        Args:
            substeps: Number of substeps in it.
            transforms: Skinning transforms at its end, bind to world, shape [J, 4, 4] or [M, J, 4, 4].
            origins: Floating origins for it [m], shape [3] or [M, 3]; translations alone, so the dynamics stay those of
                the world.
        """
        self.skeleton.set(*self._motions(transforms, origins))
        if self.self_contact is not None and self.self_contact.find(substeps, self.parameters, self.x, self.v):
            self._graphs.clear()
        key = (substeps, self.plastic)
        if key not in self._graphs:
            with wp.ScopedCapture(device=self.device, force_module_load=False) as capture:
                self._interval(substeps)
            self._graphs[key] = capture.graph
        wp.capture_launch(self._graphs[key])
        if self.contact is not None:
            self.contact.find(self.inverse_mass, self.parameters, self.v, self.x, substeps)

    def local_positions(self) -> np.ndarray:
        """Positions relative to each lane's floating origin [m], shape [W, V, 3], float32."""
        return self._out_of_lanes(self.x)

    def positions(self) -> np.ndarray:
        """World positions [m], shape [W, V, 3], float64; [V, 3] of a single world."""
        world = self.local_positions() + self._lane_origins()[:, None]
        return world[0] if self.width == 1 else world

    def velocities(self) -> np.ndarray:
        """World velocities [m/s], shape [W, V, 3]; [V, 3] of a single world."""
        velocities = self._out_of_lanes(self.v)
        return velocities[0] if self.width == 1 else velocities

    def creases(self) -> np.ndarray:
        """Crease of each hinge in every lane [1], in the order of the solver, some of them repeated, shape [.., W]."""
        return self.substep.crease.numpy().reshape(-1, self.width).copy()

    def put_back(self, lanes: np.ndarray, local: np.ndarray) -> None:
        """Put the garments of some lanes at rest to these positions [m], shape [V, 3], relative to the origin."""
        x, v = (values.numpy().reshape(self.count, 3, self.width).copy() for values in (self.x, self.v))
        x[:, :, lanes], v[:, :, lanes] = local[..., None], 0.0
        self.x.assign(x.reshape(self.count, -1))
        self.v.assign(v.reshape(self.count, -1))

    def _motions(self, transforms: np.ndarray, origins: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        transforms, origins = np.asarray(transforms), np.asarray(origins, dtype=np.float64)
        return transforms.reshape(-1, *transforms.shape[-3:]), origins.reshape(-1, 3)

    def _lane_origins(self) -> np.ndarray:
        return self.skeleton.origins[self.skeleton.lane_motion]

    def _in_lanes(self, each: np.ndarray) -> np.ndarray:
        """[V, 3] or [W, V, 3] as the device has it: [V, 3 W], axis after axis."""
        each = np.broadcast_to(each, (self.width, self.count, 3))
        return np.ascontiguousarray(each.transpose(1, 2, 0).reshape(self.count, -1), dtype=np.float32)

    def _out_of_lanes(self, values: wp.array) -> np.ndarray:
        each = values.numpy().reshape(self.count, 3, self.width)
        return np.array(each.transpose(2, 0, 1), order="C")  # a copy: a view would follow the solver

    def _interval(self, substeps: int) -> None:
        skeleton = self.skeleton
        self._launch(integrate.shift_origin, self.count, [skeleton.device_lane_motion, skeleton.shift], [self.x])
        self.pins.launch(skeleton)
        if self.contact is not None:
            self.contact.launch_motion()
        self.substep.find_normals()
        if self.plastic:
            self.substep.crease_where_bent()
        done = 0
        for span in even_split(substeps, max(1, round(substeps / SUBSTEPS_A_DAMPING))):
            self.substep.damp(float(span))
            self.substep.begin()
            last = done + span
            for bends in _bending_spans(span):
                done += 1
                fraction = done / substeps
                self._solve(fraction, bends)
                self.substep.end(fraction, 1.0 / substeps, goes_on=done < last)

    def _solve(self, fraction: float, bends: int) -> None:
        """Constraints of a substep, all but the contact with the body."""
        if self.pins.count:
            inputs = [fraction, self.pinned, self.skeleton.device_lane_motion, self.pins.count]
            inputs += [self.pins.start, self.pins.end]
            self._launch(integrate.move_pins, self.pins.count, inputs, [self.x])
        self.substep.solve_membrane()
        if self.tethers is not None:
            self.tethers.launch(self.parameters, self.x)
        if bends:
            self.substep.solve_bending(float(bends), self.plastic)
        if self.self_contact is not None:
            self.self_contact.launch_solve(self.parameters, self.state.x_prev, self.x, self.state.x_pred)

    def _launch(self, kernel: wp.Kernel, size: int, inputs: list, outputs: list) -> None:
        launch(kernel, self.width, size, inputs, outputs, self.device)


def even_split(total: int, parts: int) -> list[int]:
    """``total`` in at most ``parts`` whole numbers, as even as can be and none of them zero."""
    parts = min(parts, total)
    ends = [(k + 1) * total // parts for k in range(parts)]
    return [end - start for start, end in zip([0] + ends, ends)]


def _bending_spans(substeps: int) -> list[int]:
    """For each substep, how many substeps' bending it does: 0 or, in the last of a few, their number."""
    spans = []
    for few in even_split(substeps, max(1, round(substeps / SUBSTEPS_A_BENDING))):
        spans += [0] * (few - 1) + [few]
    return spans
