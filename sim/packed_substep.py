"""The parts of a substep of a single world on a CPU, where sixteen constraints or vertices take the lanes."""

from __future__ import annotations

import warp as wp

from sim.body_contact import BodyContact
from sim.constraints import hinge_packs, triangle_packs
from sim.kernels import normals, packed_bending, packed_membrane, packed_motion
from sim.kernels.lanes import launch
from sim.kernels.packs import PACK, packed_float
from sim.lane_substep import State
from sim.rest_state import RestState


class PackedSubstep:
    """Same methods as :class:`LaneSubstep`, with the same results up to rounding."""

    def __init__(self, rest: RestState, state: State, contact: BodyContact | None, device: str):
        """Copy the constraints to the device, sorted by colour and packed."""
        self.state, self.device = state, device
        self.count = count = len(rest.vertices)
        if count < PACK:
            raise ValueError(f"{count} vertices: packs need {PACK} or more")
        self.packs = -(-count // PACK)
        self.triangles = triangle_packs(rest, device)
        self.hinges, self.over_curvature = hinge_packs(rest, device)
        self.crease = wp.zeros(len(self.hinges.items), dtype=packed_float, device=device)
        if contact is None:  # no vertex is near, and nothing else of these is looked at
            near, clearance = (wp.zeros(count, dtype=kind, device=device) for kind in (int, float))
            self.contact = [near, clearance, *[state.normals] * 4]
        else:
            self.contact = [contact.near, contact.clearance.view(wp.float32), *contact.planes]

    def find_normals(self) -> None:
        """Normals of the cloth where it is now."""
        s = self.state
        self._launch(normals.clear_normals, self.count, [s.x], [s.normals])
        for first, count in self.triangles.ranges:
            self._launch(packed_membrane.add_packed_normals, count, [first, self.triangles.items, s.x], [s.normals])
        self._launch(normals.scale_normals, self.count, [s.parameters], [s.normals])

    def crease_where_bent(self) -> None:
        """What hinges are bent beyond their yield becomes crease."""
        inputs = [self.hinges.items, self.over_curvature, self.state.parameters, self.state.x]
        self._launch(packed_bending.yield_packed_hinges, len(self.hinges.items), inputs, [self.crease])

    def damp(self, span: float) -> None:
        """Damp the velocities by the membrane and the hinges, for ``span`` substeps."""
        s = self.state
        for first, count in self.triangles.ranges:
            inputs = [first, span, self.triangles.items, s.parameters, s.x]
            self._launch(packed_membrane.damp_packed_membrane, count, inputs, [s.v])
        for first, count in self.hinges.ranges:
            inputs = [first, span, 1, self.hinges.items, s.parameters]
            self._launch(packed_bending.solve_packed_bending, count, inputs, [s.v])

    def begin(self) -> None:
        """Predict where the vertices go by themselves."""
        s = self.state
        inputs = [s.inverse_mass, s.parameters, s.normals]
        self._launch(packed_motion.begin_packed_substep, self.packs, inputs, [s.v, s.x, s.x_prev, s.x_pred])

    def solve_membrane(self) -> None:
        """Membrane: triangles, colour by colour."""
        s = self.state
        for first, count in self.triangles.ranges:
            inputs = [first, self.triangles.items, s.parameters]
            self._launch(packed_membrane.solve_packed_membrane, count, inputs, [s.x])

    def solve_bending(self, span: float, creased: bool) -> None:
        """Bending of ``span`` substeps: hinges, colour by colour."""
        s = self.state
        for first, count in self.hinges.ranges:
            inputs = [self.hinges.items, s.parameters]
            if creased:
                inputs = [first, span, *inputs, self.crease]
                self._launch(packed_bending.solve_packed_creased_bending, count, inputs, [s.x])
            else:
                self._launch(packed_bending.solve_packed_bending, count, [first, span, 0, *inputs], [s.x])

    def end(self, fraction: float, step: float, goes_on: bool) -> None:
        """Contact at ``fraction`` of the interval, velocities and, where it ``goes_on``, the next :meth:`begin`."""
        s = self.state
        inputs = [fraction, step, int(goes_on), s.inverse_mass, *self.contact, s.parameters, s.normals]
        self._launch(packed_motion.end_packed_substep, self.packs, inputs, [s.v, s.x, s.x_prev, s.x_pred])

    def _launch(self, kernel: wp.Kernel, size: int, inputs: list, outputs: list) -> None:
        launch(kernel, 1, size, inputs, outputs, self.device)
