"""The XPBD solver against closed-form mechanics and NumPy references; body contact has its own file."""

from __future__ import annotations

import numpy as np
import pytest

from sim.colouring import colour_constraints
from sim.compile import compile_kernels, resolve_device
from sim.lane_substep import LaneSubstep
from sim.packed_substep import PackedSubstep
from sim.parameters import base_parameters
from sim.rest_state import RestState, isometric_hinge_weights
from sim.skeleton import Skeleton, Skin
from sim.xpbd import XpbdSolver, even_split

DEVICE = resolve_device("cpu")
STILL = {"air_drag": 0.0, "stretch_damping": 0.0, "bend_damping": 0.0}
ORIGIN = np.zeros(3)
IDENTITY = np.eye(4)[None]


@pytest.fixture(scope="module", autouse=True)
def compiled():
    compile_kernels("cpu")


def lattice(rows: int, columns: int, edge: float) -> tuple[np.ndarray, np.ndarray]:
    """Sheet of equilateral triangles hanging in the x-y plane from y = 0, rows along x."""
    row, column = np.divmod(np.arange(rows * columns), columns)
    vertices = np.stack([(column + 0.5 * (row % 2)) * edge, -row * edge * np.sqrt(0.75), 0.0 * row], axis=1)
    faces = []
    for r in range(rows - 1):
        for c in range(columns - 1):
            a, b, d, e = (r * columns + c, r * columns + c + 1, (r + 1) * columns + c, (r + 1) * columns + c + 1)
            faces += [(a, d, b), (b, d, e)] if r % 2 == 0 else [(a, d, e), (a, e, b)]
    return vertices, np.array(faces, dtype=np.int32)


def solver_of(vertices: np.ndarray, faces: np.ndarray, pinned=(), velocities=None, origin=ORIGIN) -> XpbdSolver:
    """A garment without a body, its pins held by one joint."""
    rest = RestState.from_mesh(vertices, faces, np.array(pinned, dtype=np.int32))
    skeleton = Skeleton(1, np.zeros(3), [0], DEVICE)
    count = len(rest.pinned)
    pins = Skin(rest.vertices[rest.pinned], np.zeros((count, 1), dtype=int), np.ones((count, 1)), 1, DEVICE)
    solver = XpbdSolver(rest, skeleton, None, pins, DEVICE)
    solver.place(vertices, velocities, IDENTITY, np.asarray(origin, dtype=float))
    return solver


def run(solver: XpbdSolver, seconds: float, dt: float, interval: int = 16, **values: float) -> np.ndarray:
    solver.set_parameters(base_parameters({**STILL, **values}), dt)
    for _ in range(round(seconds / (dt * interval))):
        solver.advance(interval, IDENTITY, solver.skeleton.origins)
    return solver.positions()


def test_free_fall():
    vertices, faces = lattice(4, 4, 0.02)
    dt = 1.0 / 960.0
    fallen = run(solver_of(vertices, faces), 0.5, dt) - vertices
    steps = 480
    assert np.allclose(fallen[:, 1], -9.81 * dt**2 * steps * (steps + 1) / 2, rtol=2e-4)  # semi-implicit Euler's sum
    assert np.abs(fallen[:, [0, 2]]).max() < 5e-5  # float32 rounding, 1.2 m from the origin


@pytest.mark.parametrize(
    ("axes", "ratio", "factor"), [((0, 1, 2), 0.4, 0.4), ((0, 2, 1), 0.4, 1.0), ((0, 1, 2), 1.0, 1.0)]
)
def test_terminal_velocity_is_weight_over_drag(axes, ratio, factor):
    """A sheet that falls edge on (x-y plane) feels the drag along it, one that falls flat the drag across it."""
    vertices, faces = lattice(4, 4, 0.02)
    solver = solver_of(vertices[:, axes], faces)
    run(solver, 3.0, 1.0 / 960.0, air_drag=0.5, density=0.05, drag_ratio=ratio)
    assert np.allclose(solver.velocities()[:, 1], -9.81 * 0.05 / (0.5 * factor), rtol=1e-2)


def test_wind_carries_free_cloth_along():
    """Against the air at rest with the wind, cloth without weight takes the wind's velocity: heading pi/2 is +x."""
    vertices, faces = lattice(4, 4, 0.02)
    solver = solver_of(vertices, faces)
    run(solver, 2.0, 1.0 / 960.0, air_drag=1.0, density=0.05, gravity=0.0, wind_speed=3.0, wind_heading=np.pi / 3)
    expected = 3.0 * np.array([np.sin(np.pi / 3), 0.0, np.cos(np.pi / 3)])
    assert np.allclose(solver.velocities(), expected, atol=0.01)


def test_drag_does_not_lighten_cloth_that_hangs():
    vertices, faces = lattice(6, 3, 0.02)
    dry = run(solver_of(vertices, faces, range(3)), 1.5, 1.0 / 960.0, stretch=20.0, shear=5.0, stretch_damping=0.01)
    wet = run(
        solver_of(vertices, faces, range(3)),
        3.0,
        1.0 / 960.0,
        stretch=20.0,
        shear=5.0,
        stretch_damping=0.01,
        air_drag=3.0,
    )
    assert np.abs(dry - wet).max() < 2e-5


def test_one_triangle_stretches_by_its_load_over_stiffness():
    """A k (|w_v| - 1) / h = m g with m = density A / 3: the link of compliance alpha that extends by m g alpha."""
    height, stretch, density = 0.05, 2.0, 0.2
    vertices = np.array([[-0.03, 0.0, 0.0], [0.03, 0.0, 0.0], [0.0, -height, 0.0]])
    solver = solver_of(vertices, np.array([[0, 2, 1]]), [0, 1])
    end = run(solver, 2.0, 1.0 / 960.0, stretch=stretch, density=density, stretch_damping=0.02)
    expected = density * 9.81 * height**2 / (3.0 * stretch)
    assert -end[2, 1] - height == pytest.approx(expected, rel=2e-3)


def test_hanging_strip_strains_by_the_load_below():
    """Strain density g (H - s) / k at distance s from the top; extension density g H^2 / (2 k)."""
    rows, stretch = 9, 30.0
    vertices, faces = lattice(rows, 6, 0.02)
    dt = 1.0 / 1920.0
    end = run(
        solver_of(vertices, faces, range(6)),
        1.5,
        dt,
        stretch=stretch,
        shear=10.0,
        stretch_damping=0.02,
        compression=1.0,
    )
    height = -vertices[-1, 1]
    extension = (vertices[-6:, 1] - end[-6:, 1]).mean()
    # Lumped masses carry half a row less than the continuous strip.
    assert extension == pytest.approx(0.2 * 9.81 * height**2 / (2.0 * stretch), rel=0.06)


def test_damping_takes_out_the_oscillation_at_its_analytic_rate():
    height, stretch, density = 0.05, 2.0, 0.2
    vertices = np.array([[-0.03, 0.0, 0.0], [0.03, 0.0, 0.0], [0.0, -height, 0.0]])
    frequency = np.sqrt(3.0 * stretch / density) / height  # of the free vertex along v
    tau, dt = 4.0e-4, 1.0 / 15360.0  # smaller steps drown in float32 rounding
    seconds = 0.1
    energies = []
    for damping in (0.0, tau):
        solver = solver_of(vertices, np.array([[0, 2, 1]]), [0, 1], np.array([[0.0] * 3, [0.0] * 3, [0.0, -0.05, 0.0]]))
        solver.set_parameters(
            base_parameters(
                {**STILL, "stretch": stretch, "gravity": 0.0, "stretch_damping": damping, "compression": 1.0}
            ),
            dt,
        )
        for _ in range(round(seconds / (dt * 64))):
            solver.advance(64, IDENTITY, ORIGIN)
        amplitude = np.hypot(solver.velocities()[2, 1], frequency * (solver.positions()[2, 1] + height))
        energies.append(amplitude)
    assert energies[1] / energies[0] == pytest.approx(np.exp(-tau * frequency**2 * seconds / 2.0), rel=0.05)


def test_damping_leaves_the_sag_alone():
    """Damping inside the position constraints (Macklin et al. 2016, eq. 26) would make the sag 1 + tau/dt times."""
    vertices, faces = lattice(12, 6, 0.02)
    sags = []
    for damping in (0.0, 0.005):
        end = run(solver_of(vertices, faces, range(6)), 2.0, 1.0 / 720.0, air_drag=2.0, stretch_damping=damping)
        sags.append((vertices - end)[-6:, 1].mean())
    assert sags[1] == pytest.approx(sags[0], rel=0.05)


def test_rest_stays_at_rest():
    vertices, faces = lattice(6, 6, 0.02)
    end = run(solver_of(vertices, faces), 1.0, 1.0 / 960.0, gravity=0.0)
    assert np.abs(end - vertices).max() < 2e-6


def test_momentum_is_conserved():
    vertices, faces = lattice(6, 6, 0.02)
    velocities = np.random.default_rng(1).normal(0.0, 0.5, vertices.shape)
    solver = solver_of(vertices, faces, velocities=velocities)
    mass = solver.rest.vertex_area[:, None]
    before, spin = (mass * velocities).sum(0), np.cross(vertices, mass * velocities).sum(0)
    end = run(solver, 0.2, 1.0 / 960.0, gravity=0.0, stretch_damping=0.005, bend_damping=0.02)
    after = solver.velocities()
    scale = (mass * np.abs(velocities)).sum()
    assert np.abs((mass * after).sum(0) - before).max() < 1e-4 * scale  # float32 rounding of 192 substeps
    assert np.abs(np.cross(end, mass * after).sum(0) - spin).max() < 2e-3 * scale * 0.1
    assert (mass * after**2).sum() < (mass * velocities**2).sum()


def test_rotation_and_translation_of_the_scene():
    """Turned about the vertical and moved a kilometre away, the same cloth does the same; so it does when the floating
    origin moves along."""
    vertices, faces = lattice(6, 4, 0.02)
    velocities = np.random.default_rng(2).normal(0.0, 0.2, vertices.shape)
    velocities[:4] = 0.0
    dt, values = 1.0 / 960.0, {"stretch": 100.0, "air_drag": 0.5, "stretch_damping": 0.005}
    plain = run(solver_of(vertices, faces, range(4), velocities), 0.2, dt, **values)

    angle = 1.1
    turn = np.array([[np.cos(angle), 0, np.sin(angle)], [0, 1, 0], [-np.sin(angle), 0, np.cos(angle)]])
    turned = run(solver_of(vertices @ turn.T, faces, range(4), velocities @ turn.T), 0.2, dt, **values)
    assert np.abs(turned - plain @ turn.T).max() < 2e-4

    far = np.array([1000.0, 50.0, -700.0])
    moved = solver_of(vertices, faces, range(4))
    transform = IDENTITY.copy()
    transform[0, :3, 3] = far
    moved.place(vertices + far, velocities, transform, far)
    moved.set_parameters(base_parameters({**STILL, **values}), dt)
    for step in range(12):
        moved.advance(16, transform, far + [0.01 * step, 0.02 * step, 0.0])
    assert np.abs(moved.positions() - far - plain).max() < 2e-4


def test_same_run_twice_is_bitwise_equal():
    vertices, faces = lattice(6, 4, 0.02)
    velocities = np.random.default_rng(3).normal(0.0, 0.5, vertices.shape)
    ends = [run(solver_of(vertices, faces, range(4), velocities), 0.2, 1.0 / 960.0) for _ in range(2)]
    assert np.array_equal(*ends)


def membrane_step(rest: RestState, order: np.ndarray, x: np.ndarray, values: dict, dt: float) -> np.ndarray:
    """Gauss-Seidel over triangles with a dense 3 x 3 solve each, in float64."""
    x = x.copy()
    faces = rest.topology.faces
    for f in order:
        corners = faces[f]
        (du1, dv1), (du2, dv2) = rest.inverse[f]
        e1, e2 = x[corners[1]] - x[corners[0]], x[corners[2]] - x[corners[0]]
        wu, wv = e1 * du1 + e2 * du2, e1 * dv1 + e2 * dv2
        lu, lv = np.linalg.norm(wu), np.linalg.norm(wv)
        gu, gv = np.array([-du1 - du2, du1, du2]), np.array([-dv1 - dv2, dv1, dv2])
        gradient = np.stack([np.outer(gu, wu / lu), np.outer(gv, wv / lv), np.outer(gu, wv) + np.outer(gv, wu)])
        inverse_mass = rest.inverse_mass[corners] / values["density"]
        softness = [values["compression"] if length < 1.0 else 1.0 for length in (lu, lv)]
        stiffness = rest.area[f] * np.array([values["stretch"]] * 2 + [values["shear"]]) * np.array([*softness, 1.0])
        system = np.einsum("aik,i,bik->ab", gradient, inverse_mass, gradient) + np.diag(1.0 / (stiffness * dt**2))
        push = np.linalg.solve(system, -np.array([lu - 1.0, lv - 1.0, wu @ wv]))
        x[corners] += inverse_mass[:, None] * np.einsum("a,aik->ik", push, gradient)
    return x


def substep(solver: XpbdSolver, kind: type) -> LaneSubstep | PackedSubstep:
    return kind(solver.rest, solver.state, None, DEVICE)


@pytest.mark.parametrize("kind", [LaneSubstep, PackedSubstep])
@pytest.mark.parametrize("compression", [0.3, 1.0])
def test_membrane_kernel_against_dense_reference(compression, kind):
    vertices, faces = lattice(4, 5, 0.02)
    vertices = vertices + np.random.default_rng(4).normal(0.0, 0.002, vertices.shape)
    values = base_parameters({**STILL, "compression": compression})
    solver, dt = solver_of(vertices, faces, [0, 3]), 1.0e-3
    start = vertices + np.random.default_rng(5).normal(0.0, 0.002, vertices.shape)
    solver.set_parameters(values, dt)
    solver.place(start, None, IDENTITY, ORIGIN)
    substep(solver, kind).solve_membrane()
    order = colour_constraints(faces, len(vertices)).order
    expected = membrane_step(solver.rest, order, start, values, dt)
    assert np.abs(expected - start).max() > 1e-4
    assert np.abs(solver.positions() - expected).max() < 3e-6


@pytest.mark.parametrize("kind", [LaneSubstep, PackedSubstep])
def test_bending_kernel_against_dense_reference(kind):
    vertices, faces = lattice(4, 5, 0.02)
    solver, dt = solver_of(vertices, faces, [0, 3]), 1.0e-3
    values = base_parameters({**STILL, "bend": 5.0e-4})
    start = vertices + np.random.default_rng(6).normal(0.0, 0.003, vertices.shape)
    solver.set_parameters(values, dt)
    solver.place(start, None, IDENTITY, ORIGIN)
    substep(solver, kind).solve_bending(1.0, creased=False)

    rest, expected = solver.rest, start.copy()
    for h in colour_constraints(rest.hinges, len(vertices)).order:
        members, weight = rest.hinges[h], rest.hinge_weights[h]
        inverse_mass = rest.inverse_mass[members] / values["density"]
        curvature = weight @ expected[members]
        push = -curvature / ((inverse_mass * weight**2).sum() + 1.0 / (values["bend"] * dt**2))
        expected[members] += np.outer(inverse_mass * weight, push)
    assert np.abs(expected - start).max() > 1e-5
    assert np.abs(solver.positions() - expected).max() < 2e-6


def test_bending_energy_of_a_cylinder():
    """Isometric bending of a sheet rolled to radius r: energy k/2 an area over r^2, within 15%."""
    vertices, faces = lattice(24, 24, 0.01)
    rest = RestState.from_mesh(vertices, faces)
    radius = 0.1
    energies = []
    for across, along in ((0, 1), (1, 0)):
        rolled = vertices.copy()
        rolled[:, across] = radius * np.sin(vertices[:, across] / radius)
        rolled[:, 2] = radius * (1.0 - np.cos(vertices[:, across] / radius))
        rolled[:, along] = vertices[:, along]
        curvature = np.einsum("hi,hik->hk", rest.hinge_weights, rolled[rest.hinges])
        energies.append(0.5 * (curvature**2).sum() / rest.area.sum())
    assert np.allclose(energies, 0.5 / radius**2, rtol=0.15)


def test_flat_sheet_has_no_bending_energy():
    vertices, faces = lattice(5, 5, 0.02)
    vertices[:, :2] += np.random.default_rng(7).normal(0.0, 0.002, (25, 2))
    rest = RestState.from_mesh(vertices, faces)
    weights = isometric_hinge_weights(vertices, rest.hinges)
    assert np.abs(np.einsum("hi,hik->hk", weights, vertices[rest.hinges])).max() < 1e-10


def test_cantilever_droops_like_a_beam():
    """Small droop of a clamped strip: density g L^4 / (8 k). Air drag brings it to rest; it does not carry weight."""
    vertices, faces = lattice(6, 13, 0.01)
    vertices = vertices[:, [0, 2, 1]]  # horizontal, along x
    clamped = np.flatnonzero(vertices[:, 0] < 0.016)
    free = np.flatnonzero(vertices[:, 0] > vertices[:, 0].max() - 0.006)
    length = 0.11  # mean over the straight and the shifted rows
    droops = []
    for bend in (1.0e-3, 4.0e-3):
        end = run(solver_of(vertices, faces, clamped), 0.4, 1.0 / 15360.0, 64, bend=bend, air_drag=8.0, stretch=500.0)
        droops.append(-end[free, 1].mean())
    assert droops[1] == pytest.approx(0.2 * 9.81 * length**4 / (8.0 * 4.0e-3), rel=0.2)
    assert droops[1] < 0.4 * droops[0]


def test_colours_never_share_a_vertex():
    _, faces = lattice(9, 9, 0.02)
    colouring = colour_constraints(faces, 81)
    assert sorted(colouring.order) == list(range(len(faces)))
    for start, count in colouring.ranges:
        members = faces[colouring.order[start : start + count]].ravel()
        assert len(np.unique(members)) == len(members)


def test_even_split_has_no_empty_part():
    for total in range(1, 40):
        for parts in range(1, 9):
            split = even_split(total, parts)
            assert sum(split) == total and min(split) >= 1 and max(split) - min(split) <= 1


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (lambda v, f: (np.where(np.arange(len(v))[:, None] == 3, np.nan, v), f, []), "vertex 3 is not finite"),
        (lambda v, f: (v, f, [99]), "lie outside"),
        (lambda v, f: (v, np.concatenate([f, f[:1] + 100]), []), "outside the"),
        (lambda v, f: (np.where(np.arange(len(v))[:, None] == 5, v[4], v), f, []), "degenerate"),
        (lambda v, f: (np.concatenate([v, v[:1]]), f, []), "belongs to no triangle"),
        (lambda v, f: (v[:, :2], f, []), r"\[V, 3\]"),
    ],
)
def test_broken_mesh_is_refused(change, message):
    vertices, faces, pinned = change(*lattice(4, 4, 0.02))
    with pytest.raises(ValueError, match=message):
        RestState.from_mesh(vertices, faces, np.array(pinned, dtype=np.int32))


def test_parameters_outside_their_limits_are_refused():
    solver = solver_of(*lattice(3, 3, 0.02))
    values = base_parameters()
    for broken in ({**values, "density": -1.0}, {**values, "stretch": float("nan")}, {"density": 0.2}):
        with pytest.raises(ValueError, match="intrinsic parameter"):
            solver.set_parameters(broken, 1.0e-3)
