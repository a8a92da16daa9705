"""The parts of a substep with one world in each lane, as ``sim.xpbd`` puts them together."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import warp as wp

from sim.body_contact import BodyContact
from sim.cloth_normals import find_normals
from sim.constraints import device_hinges, device_triangles
from sim.kernels import bending, integrate, membrane
from sim.kernels.lanes import launch, scalars, vectors
from sim.kernels.parameters import ROW_COUNT
from sim.rest_state import RestState


@dataclass(frozen=True)
class State:
    """What the kernels of all worlds share; vectors and scalars have a value in every lane.

    Attributes:
        x, v: Positions relative to the floating origins [m] and velocities in the world [m/s], vectors, shape [V].
        x_prev, x_pred: Positions at the beginning of the substep, and where they went by themselves, likewise.
        normals: Unit normals of the cloth at the beginning of the interval, likewise.
        inverse_mass: Of unit density [1/m^2], 0 where pinned, shape [V], plain numbers.
        parameters: Constants of the worlds, scalars, shape [ROW_COUNT].
        width: Number of worlds W.
    """

    x: wp.array
    v: wp.array
    x_prev: wp.array
    x_pred: wp.array
    normals: wp.array
    inverse_mass: wp.array
    parameters: wp.array
    width: int

    @classmethod
    def zero(cls, rest: RestState, width: int, device: str) -> State:
        """State of W worlds before they are placed."""
        each = [wp.zeros(len(rest.vertices), dtype=vectors(width), device=device) for _ in range(5)]
        mass = wp.array(rest.inverse_mass.astype(np.float32), dtype=float, device=device)
        return cls(*each, mass, wp.zeros(ROW_COUNT, dtype=scalars(width), device=device), width)


class LaneSubstep:
    """Every method records launches that act on the state."""

    def __init__(self, rest: RestState, state: State, contact: BodyContact | None, device: str):
        """Copy the constraints to the device, sorted by colour."""
        self.state, self.contact, self.device = state, contact, device
        self.count = len(rest.vertices)
        self.triangles = device_triangles(rest, device)
        self.hinges = device_hinges(rest, device)
        self.crease = wp.zeros(len(rest.hinges), dtype=state.parameters.dtype, device=device)

    def find_normals(self) -> None:
        """Normals of the cloth where it is now."""
        s = self.state
        find_normals(self.triangles, s.parameters, s.x, s.normals, s.width, self.device)

    def crease_where_bent(self) -> None:
        """What hinges are bent beyond their yield becomes crease."""
        inputs = [self.hinges.items, self.state.parameters, self.state.x]
        self._launch(bending.yield_hinges, len(self.hinges.items), inputs, [self.crease])

    def damp(self, span: float) -> None:
        """Damp the velocities by the membrane and the hinges, for ``span`` substeps."""
        s = self.state
        for first, count in self.triangles.ranges:
            inputs = [first, span, self.triangles.items, s.inverse_mass, s.parameters, s.x]
            self._launch(membrane.damp_membrane, count, inputs, [s.v])
        for first, count in self.hinges.ranges:
            inputs = [first, span, self.hinges.items, s.inverse_mass, s.parameters]
            self._launch(bending.damp_bending, count, inputs, [s.v])

    def begin(self) -> None:
        """Predict where the vertices go by themselves."""
        s = self.state
        inputs = [s.inverse_mass, s.parameters, s.normals]
        self._launch(integrate.predict, self.count, inputs, [s.v, s.x, s.x_prev, s.x_pred])

    def solve_membrane(self) -> None:
        """Membrane: triangles, colour by colour."""
        s = self.state
        for first, count in self.triangles.ranges:
            inputs = [first, self.triangles.items, s.inverse_mass, s.parameters]
            self._launch(membrane.solve_membrane, count, inputs, [s.x])

    def solve_bending(self, span: float, creased: bool) -> None:
        """Bending of ``span`` substeps: hinges, colour by colour."""
        s = self.state
        for first, count in self.hinges.ranges:
            inputs = [first, span, self.hinges.items, s.inverse_mass, s.parameters]
            if creased:
                self._launch(bending.solve_creased_bending, count, [*inputs, self.crease], [s.x])
            else:
                self._launch(bending.solve_bending, count, inputs, [s.x])

    def end(self, fraction: float, step: float, goes_on: bool) -> None:
        """Contact at ``fraction`` of the interval, velocities and, where it ``goes_on``, the next :meth:`begin`."""
        s = self.state
        if self.contact is not None:
            self.contact.launch_solve(fraction, step, s.inverse_mass, s.x_prev, s.parameters, s.x)
        inputs = [s.inverse_mass, s.parameters, s.x, s.x_prev, s.x_pred]
        self._launch(integrate.update_velocity, self.count, inputs, [s.v])
        if goes_on:
            self.begin()

    def _launch(self, kernel: wp.Kernel, size: int, inputs: list, outputs: list) -> None:
        launch(kernel, self.state.width, size, inputs, outputs, self.device)
