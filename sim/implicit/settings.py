"""Settings of the implicit solver: numbers of the method, not of the cloth."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class ImplicitSettings:
    """How the implicit solver runs.

    Attributes:
        fps: Frames a second of the clip [1/s].
        steps_per_frame: Implicit Euler steps a frame; the parameter ``substeps`` belongs to the XPBD solver.
        cg_tolerance: Relative residual at which the linear solve of a step stops.
        cg_max_iterations: Upper limit of its iterations.
        strain_limits: Smallest and largest principal stretch, for instance (0.95, 1.05); None leaves strain to the
            material's stiffness.
        strain_sweeps: Most sweeps of strain limiting in a step.
        contact: ``own`` (a vertex collides with the body parts it belongs to) or ``whole``.
        settle_seconds: Longest time in which the cloth comes to rest on the body's first pose [s].
        settle_speed: Settled when the root mean square speed falls below this [m/s].
        settle_damping: Extra damping of velocities while settling [1/s].
        contact_queries: Intervals of a frame; at the start of each the closest body points are sought, and within it
            the body moves along straight lines. One more query at the end of the frame projects what is inside.
        contact_radius: Farthest body point that a query looks for [m].
        push_speed: Fastest correction of a penetration [m/s].
        absurd_strain: Edge strain that counts as divergence.
        stick_speed: Tangential speed below which a slowing vertex sticks to the body [m/s].
    """

    fps: float = 30.0
    steps_per_frame: int = 8
    cg_tolerance: float = 1e-2
    cg_max_iterations: int = 300
    strain_limits: tuple[float, float] | None = None
    strain_sweeps: int = 50
    contact: str = "own"
    settle_seconds: float = 1.5
    settle_speed: float = 0.02
    settle_damping: float = 3.0
    contact_queries: int = 2
    contact_radius: float = 0.04
    push_speed: float = 0.5
    absurd_strain: float = 3.0
    stick_speed: float = 0.02

    def __post_init__(self) -> None:
        positive = ("fps", "cg_tolerance", "contact_radius", "push_speed", "absurd_strain", "stick_speed")
        for name in positive:
            if not getattr(self, name) > 0.0:
                raise ValueError(f"implicit settings: {name} = {getattr(self, name)}: must be above 0")
        for name in ("steps_per_frame", "cg_max_iterations", "strain_sweeps", "contact_queries"):
            value = getattr(self, name)
            if int(value) != value or value < 1:
                raise ValueError(f"implicit settings: {name} = {value}: must be a whole number of at least 1")
        for name in ("settle_seconds", "settle_speed", "settle_damping"):
            if getattr(self, name) < 0.0:
                raise ValueError(f"implicit settings: {name} = {getattr(self, name)}: must not be negative")
        if self.contact_queries > self.steps_per_frame:
            raise ValueError(
                f"implicit settings: contact_queries = {self.contact_queries}: "
                f"at most one a step, that is {self.steps_per_frame}"
            )
        if self.contact not in ("own", "whole"):
            raise ValueError(f"implicit settings: contact {self.contact!r}: allowed are own and whole")
        if self.strain_limits is not None:
            low, high = self.strain_limits
            if not 0.0 < low < 1.0 < high:
                raise ValueError(f"implicit settings: strain_limits = {low}, {high}: must lie on both sides of 1")

    @property
    def interval_steps(self) -> list[int]:
        """Steps of each query interval of a frame, as even as whole numbers allow."""
        ends = [(k + 1) * self.steps_per_frame // self.contact_queries for k in range(self.contact_queries)]
        return [end - start for start, end in zip([0] + ends, ends)]
