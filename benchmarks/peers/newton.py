"""Newton's cloth (github.com/newton-physics/newton, Apache-2.0) on the scene: XPBD and VBD, on one core.

The body is one mesh shape whose points, velocities and search tree follow the scene. Everything of a substep is
recorded once a frame's interval and replayed, as Newton's own examples do; contacts are found ``detections`` times a
frame and carried along with the velocity of the body in between, for Newton keeps them where they were found.

How the material is matched:

=============  =====================================================  ================================================
ours           XPBD                                                   VBD
=============  =====================================================  ================================================
stretch        springs along the edges, ``sqrt(3)/2 stretch`` of an   stable Neo-Hookean triangles, ``mu = shear`` and
               equilateral lattice; it has no triangles               ``lambda = stretch - 2 shear``: equal under
shear          follows from the springs (their lattice is isotropic)  uniaxial strain and in simple shear
compression    as stretch, for both                                   as stretch
bend           dihedral angle, ``2/sqrt(3) bend`` a hinge, over       dihedral angle, the same hinge over the length
               ``2 A``: its gradient lacks that division              of its edge
damping        ``stretch_damping`` and ``bend_damping`` times the stiffness
air_drag       a force on every particle, ``air_drag`` times area and velocity
friction       ``friction`` on both sides of the contact
thickness      radius of the particles; the triangles' sag between them is not added
=============  =====================================================  ================================================
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from benchmarks.peers.recording import PeerMissing, PeerRun, record
from benchmarks.scene import Scene, hinge_stiffness, spring_stiffness

try:
    import newton
    import warp as wp
except ImportError as error:
    raise PeerMissing(f"newton: {error}") from error


@dataclass(frozen=True)
class NewtonSettings:
    """Numbers of the method.

    Attributes:
        solver: ``xpbd`` or ``vbd``.
        substeps: Steps a frame.
        iterations: Iterations a step.
        detections: Searches for contacts with the body a frame.
        damping: Share of the material's damping that is given.
        contact_stiffness: Of VBD's contacts [N/m a particle]; XPBD's are rigid.
        gap: Distance beyond the particles' radius up to which contacts are found [m].
    """

    solver: str
    substeps: int
    iterations: int
    detections: int = 8
    damping: float = 1.0
    contact_stiffness: float = 1.0e3
    gap: float = 0.03


XPBD = NewtonSettings("xpbd", substeps=768, iterations=1, damping=0.0)
"""What it takes to stay on the body: its sum of corrections without averaging is stable like an explicit step, below
about ``sqrt(mass / stiffness)`` [s], and its damping makes that worse."""

XPBD_FEW_SUBSTEPS = NewtonSettings("xpbd", substeps=32, iterations=1, damping=0.0)
"""As many substeps as ours."""

VBD = NewtonSettings("vbd", substeps=16, iterations=10)


PIN_MASS = 1.0e3
"""Mass of VBD's pins [kg]: ten million times that of a vertex."""


@wp.kernel
def _move_points(
    start: wp.array(dtype=wp.vec3),
    end: wp.array(dtype=wp.vec3),
    fraction: float,
    rate: float,
    points: wp.array(dtype=wp.vec3),
    velocities: wp.array(dtype=wp.vec3),
):
    i = wp.tid()
    points[i] = start[i] + fraction * (end[i] - start[i])
    velocities[i] = rate * (end[i] - start[i])


@wp.kernel
def _move_pins(
    pinned: wp.array(dtype=int),
    start: wp.array(dtype=wp.vec3),
    end: wp.array(dtype=wp.vec3),
    first: wp.array(dtype=float),
    step: float,
    rate: float,
    q: wp.array(dtype=wp.vec3),
    qd: wp.array(dtype=wp.vec3),
):
    i = wp.tid()
    q[pinned[i]] = start[i] + (first[0] + step) * (end[i] - start[i])
    qd[pinned[i]] = rate * (end[i] - start[i])


@wp.kernel
def _carry_contacts(
    count: wp.array(dtype=int), velocity: wp.array(dtype=wp.vec3), dt: float, point: wp.array(dtype=wp.vec3)
):
    i = wp.tid()
    if i < count[0]:
        point[i] = point[i] + dt * velocity[i]


@wp.kernel
def _drag(coefficient: wp.array(dtype=float), qd: wp.array(dtype=wp.vec3), force: wp.array(dtype=wp.vec3)):
    i = wp.tid()
    force[i] = -coefficient[i] * qd[i]


class NewtonCloth:
    """A garment in Newton and the body that it wears."""

    def __init__(self, scene: Scene, settings: NewtonSettings):
        """Build the model; Newton compiles its kernels at the first steps."""
        self.scene, self.settings = scene, settings
        self.dt = scene.parameters["time_scale"] / (scene.fps * settings.substeps)
        self.model, self.body = _model(scene, settings)
        self.body_mesh = self.body.mesh
        self.states = [self.model.state(), self.model.state()]
        self.control = self.model.control()
        self.solver = _solver(self.model, scene, settings)
        self.pipeline = newton.CollisionPipeline(
            self.model, soft_contact_gap=settings.gap, broad_phase="nxn", rigid_contact_max=1, max_triangle_pairs=1
        )
        self.contacts = self.pipeline.contacts()
        points, pins = scene.body[0], scene.pins[0]
        self.start, self.end = wp.array(points, dtype=wp.vec3), wp.array(points, dtype=wp.vec3)
        self.pinned = wp.array(scene.pinned.astype(np.int32), dtype=int)
        self.pin_start, self.pin_end = wp.array(pins, dtype=wp.vec3), wp.array(pins, dtype=wp.vec3)
        self.first = wp.zeros(1, dtype=float)
        drag = scene.parameters["air_drag"] * scene.vertex_area
        self.drag = wp.array(drag.astype(np.float32), dtype=float)
        self.graph: wp.Graph | None = None

    def step(self, start: int, end: int) -> None:
        """Advance by one frame while the body moves from frame ``start`` to frame ``end``."""
        self.start.assign(self.scene.body[start])
        self.end.assign(self.scene.body[end])
        self.pin_start.assign(self.scene.pins[start])
        self.pin_end.assign(self.scene.pins[end])
        rate = self.scene.fps / self.scene.parameters["time_scale"]
        for detection in range(self.settings.detections):
            fraction = detection / self.settings.detections
            inputs = [self.start, self.end, fraction, rate]
            wp.launch(_move_points, len(self.start), inputs, [self.body_mesh.points, self.body_mesh.velocities])
            self.body_mesh.refit()
            self.first.fill_(fraction)
            self.pipeline.collide(self.states[0], self.contacts)
            if self.graph is None:
                self._substeps()  # compiles, outside of the recording
                with wp.ScopedCapture() as capture:
                    self._substeps()
                self.graph = capture.graph
            else:
                wp.capture_launch(self.graph)

    def positions(self) -> np.ndarray:
        """Garment vertices [m], shape [V, 3]."""
        return self.states[0].particle_q.numpy()

    def _substeps(self) -> None:
        """The substeps between two detections; an even number, so that the states end where they began."""
        scene, settings = self.scene, self.settings
        rate = scene.fps / scene.parameters["time_scale"]
        for k in range(settings.substeps // settings.detections):
            now, then = self.states[k % 2], self.states[1 - k % 2]
            if len(scene.pinned):
                inputs = [self.pinned, self.pin_start, self.pin_end, self.first, k / settings.substeps, rate]
                wp.launch(_move_pins, len(scene.pinned), inputs, [now.particle_q, now.particle_qd])
            inputs = [self.contacts.soft_contact_count, self.contacts.soft_contact_body_vel, self.dt]
            wp.launch(_carry_contacts, self.contacts.soft_contact_max, inputs, [self.contacts.soft_contact_body_pos])
            wp.launch(_drag, len(scene.vertices), [self.drag, now.particle_qd], [now.particle_f])
            self.solver.step(now, then, self.control, self.contacts, self.dt)


def _model(scene: Scene, settings: NewtonSettings) -> tuple[newton.Model, newton.Mesh]:
    p = scene.parameters
    edge = float(scene.edge_length.mean())
    builder = newton.ModelBuilder(up_axis=newton.Axis.Y, gravity=(0.0, -p["gravity"], 0.0))
    hinge = hinge_stiffness(p["bend"])
    if settings.solver == "xpbd":
        # Measured on one hinge: the force is 2 A times the one of the energy, the gradient lacks that division.
        hinge /= 0.5 * np.sqrt(3.0) * edge**2
        spring = spring_stiffness(p["stretch"])
        material = {
            "add_springs": True,
            "spring_ke": spring,
            "spring_kd": settings.damping * spring * p["stretch_damping"],
            "tri_ke": 0.0,
            "tri_ka": 0.0,
            "tri_kd": 0.0,
        }
    else:
        material = {
            "tri_ke": p["shear"],
            "tri_ka": p["stretch"] - 2.0 * p["shear"],
            "tri_kd": 0.25 * p["stretch"] * p["stretch_damping"],  # its rate is that of F^T F, twice the strain's
        }
        hinge /= edge
    body = newton.Mesh(scene.body[0].astype(np.float32), scene.body_faces.ravel(), compute_inertia=False)
    config = newton.ModelBuilder.ShapeConfig(mu=p["friction"], ke=settings.contact_stiffness, kd=0.0, margin=0.0)
    builder.add_shape_mesh(-1, mesh=body, cfg=config)
    builder.add_cloth_mesh(
        pos=wp.vec3(0.0),
        rot=wp.quat_identity(),
        scale=1.0,
        vel=wp.vec3(0.0),
        vertices=[wp.vec3(*point) for point in scene.vertices.tolist()],
        indices=scene.faces.ravel().tolist(),
        density=p["density"],
        edge_ke=hinge,
        edge_kd=settings.damping * hinge * p["bend_damping"],
        tri_drag=0.0,
        tri_lift=0.0,
        particle_radius=p["thickness"],
        **material,
    )
    # Pins begin each step where they are and move in it by their velocity. VBD leaves a particle without inverse mass
    # where it is, so that its damping would pull the neighbours back: there, pins are very heavy instead.
    for index in scene.pinned.tolist():
        builder.particle_mass[index] = 0.0 if settings.solver == "xpbd" else PIN_MASS
    builder.color(include_bending=True)
    model = builder.finalize(device="cpu")
    model.edge_rest_angle.zero_()  # sheets that are flat at rest, as ours
    model.soft_contact_mu = p["friction"]
    model.soft_contact_ke, model.soft_contact_kd = settings.contact_stiffness, 0.0
    # The body moves as a mesh, which Newton's shapes do not: a box that holds every frame keeps it from being culled.
    model.shape_collision_aabb_lower.assign(scene.body.min(axis=(0, 1))[None] - 0.1)
    model.shape_collision_aabb_upper.assign(scene.body.max(axis=(0, 1))[None] + 0.1)
    return model, body


def _solver(model: newton.Model, scene: Scene, settings: NewtonSettings) -> newton.solvers.SolverBase:
    if settings.solver == "xpbd":
        if not scene.self_contact:  # its self-contact is that of particles with each other
            model.particle_max_radius = 0.0
            model.particle_grid = None
        return newton.solvers.SolverXPBD(model, iterations=settings.iterations)
    thickness = scene.parameters["thickness"]
    return newton.solvers.SolverVBD(
        model,
        iterations=settings.iterations,
        particle_enable_self_contact=scene.self_contact,
        particle_self_contact_margin=thickness,
        particle_self_contact_gap=0.5 * thickness,
    )


def run(scene: Scene, settings: NewtonSettings = VBD) -> PeerRun:
    """Simulate the scene with one of Newton's cloth solvers."""
    wp.config.log_level = wp.LOG_ERROR
    with wp.ScopedDevice("cpu"):
        cloth = NewtonCloth(scene, settings)
        vertices, wall, cpu = record(scene, cloth.step, cloth.positions)
    words = f"{settings.substeps} x {settings.iterations}, {settings.detections} detections"
    return PeerRun(
        f"Newton {newton.__version__} {settings.solver.upper()}", words, settings.substeps, vertices, wall, cpu
    )
