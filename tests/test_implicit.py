"""The implicit solver against its energies, against closed-form mechanics and against the XPBD solver."""

from __future__ import annotations

import itertools

import numpy as np
import pytest
import trimesh

from geometry.proximity import closest_surface
from sim.body_contact import sag
from sim.body_parts import whole_body
from sim.compile import resolve_device
from sim.implicit.body_surface import BodySurface
from sim.implicit.energies import bending_energy, membrane_energy
from sim.implicit.settings import ImplicitSettings
from sim.implicit.solver import ImplicitCloth
from sim.parameters import base_parameters
from sim.rest_state import RestState

STEP = 1.0 / 240.0
STILL = {"gravity": 0.0, "air_drag": 0.0, "stretch_damping": 0.0, "bend_damping": 0.0}
TIGHT = ImplicitSettings(cg_tolerance=1e-9, cg_max_iterations=2000)

resolve_device("cpu")  # quiets Warp


def lattice(rows: int, columns: int, edge: float) -> tuple[np.ndarray, np.ndarray]:
    """Sheet of equilateral triangles in the x-z plane (rows along x), edges cut straight; vertices and faces."""
    x, z = np.meshgrid(np.arange(rows) * edge * np.sqrt(0.75), np.arange(columns) * edge, indexing="ij")
    z[1::2, :-1] += edge / 2
    z[1::2, -1] = z[0, -1]
    extra = np.array([[x[i, 0], 0.0] for i in range(1, rows, 2)])  # left end of the shifted rows
    vertices = np.stack([x.ravel(), np.zeros(x.size), z.ravel()], axis=1)
    vertices = np.concatenate([vertices, np.stack([extra[:, 0], np.zeros(len(extra)), extra[:, 1]], axis=1)])
    lines = []
    for i in range(rows):
        line = list(range(i * columns, (i + 1) * columns))
        lines.append([rows * columns + i // 2, *line] if i % 2 else line)
    faces = []
    for low, high in itertools.pairwise(lines):
        a, b = 0, 0
        while a < len(low) - 1 or b < len(high) - 1:
            # Advance on the side whose next vertex comes first.
            ahead = vertices[low[a + 1], 2] if a < len(low) - 1 else np.inf
            beside = vertices[high[b + 1], 2] if b < len(high) - 1 else np.inf
            if ahead <= beside:
                faces.append([low[a], low[a + 1], high[b]])
                a += 1
            else:
                faces.append([low[a], high[b + 1], high[b]])
                b += 1
    return vertices, np.array(faces, dtype=np.int32)


def upright(vertices: np.ndarray) -> np.ndarray:
    """The sheet hung up: its x becomes down."""
    return np.stack([vertices[:, 2], -vertices[:, 0], vertices[:, 1]], axis=1)


def system_at(rest: RestState, parameters: dict[str, float], positions: np.ndarray, step: float = 1.0):
    """Force (right side over the step) and stiffness matrix over step^2 at rest velocities."""
    cloth = ImplicitCloth(rest, parameters, step, TIGHT)
    cloth.place(positions)
    cloth.assemble()
    mass = np.repeat(parameters["density"] * rest.vertex_area, 3)
    stiffness = (cloth.system.to_scipy().toarray() - np.diag(mass)) / step**2
    return cloth.system.right_side.numpy() / step, stiffness


@pytest.fixture(scope="module")
def sheet() -> RestState:
    return RestState.from_mesh(*lattice(7, 6, 0.05))


@pytest.mark.parametrize(
    "stiffness", [{"bend": 1e-9}, {"stretch": 1.0, "shear": 0.1, "bend": 1e-2}], ids=["membrane", "bending"]
)
def test_force_is_minus_the_gradient_of_the_energy(sheet, stiffness):
    parameters = base_parameters(STILL | stiffness)
    positions = sheet.vertices + np.random.default_rng(1).normal(0.0, 0.01, sheet.vertices.shape)
    force, _ = system_at(sheet, parameters, positions)

    def energy(x: np.ndarray) -> float:
        return membrane_energy(sheet, x, parameters) + bending_energy(sheet, x, parameters)

    for vertex in (0, 8, 17, 40):
        for axis in range(3):
            shift = np.zeros_like(positions)
            shift[vertex, axis] = 1e-6
            slope = (energy(positions + shift) - energy(positions - shift)) / 2e-6
            assert force[vertex, axis] == pytest.approx(-slope, abs=2e-6 * np.abs(force).max())


def test_stiffness_is_the_derivative_of_the_force_where_nothing_is_dropped(sheet):
    parameters = base_parameters(STILL | {"bend": 1e-3})
    positions = 1.1 * sheet.vertices  # stretched everywhere, no shear: no part of the Hessian is dropped
    _, stiffness = system_at(sheet, parameters, positions)
    for vertex, axis in ((9, 0), (20, 1), (31, 2)):
        shift = np.zeros_like(positions)
        shift[vertex, axis] = 1e-6
        above, below = (system_at(sheet, parameters, positions + sign * shift)[0] for sign in (1, -1))
        column = -(above - below).ravel() / 2e-6
        np.testing.assert_allclose(stiffness[:, 3 * vertex + axis], column, atol=1e-5 * np.abs(column).max())


def test_matrix_is_symmetric_and_positive_semi_definite_under_compression(sheet):
    parameters = base_parameters(STILL | {"bend": 1e-3})
    crumpled = 0.7 * sheet.vertices + np.random.default_rng(2).normal(0.0, 0.015, sheet.vertices.shape)
    _, stiffness = system_at(sheet, parameters, crumpled)
    np.testing.assert_allclose(stiffness, stiffness.T, atol=1e-9 * np.abs(stiffness).max())
    values = np.linalg.eigvalsh(stiffness)
    assert values[0] > -1e-9 * values[-1]


def test_free_fall_follows_the_discrete_formula(sheet):
    cloth = ImplicitCloth(sheet, base_parameters({"air_drag": 0.0}), STEP, TIGHT)
    steps = 40
    for _ in range(steps):
        cloth.step()
    fallen = cloth.positions.numpy() - sheet.vertices
    np.testing.assert_allclose(fallen[:, 1], -9.81 * STEP**2 * steps * (steps + 1) / 2, rtol=1e-6)
    np.testing.assert_allclose(fallen[:, [0, 2]], 0.0, atol=1e-9)


@pytest.mark.parametrize("drag_ratio", [0.0, 0.3])
def test_drag_leads_to_the_terminal_speed_flat_and_edge_on(sheet, drag_ratio):
    parameters = base_parameters({"air_drag": 5.0, "density": 0.1, "drag_ratio": drag_ratio})
    flat = ImplicitCloth(sheet, parameters, STEP, TIGHT)
    edge_on = RestState.from_mesh(upright(sheet.vertices), sheet.topology.faces)
    falling = ImplicitCloth(edge_on, parameters, STEP, TIGHT)
    for _ in range(80):
        flat.step()
    for _ in range(300):
        falling.step()
    np.testing.assert_allclose(flat.velocities.numpy()[:, 1], -0.1 * 9.81 / 5.0, rtol=1e-4)
    expected = -0.1 * 9.81 / 1.5 if drag_ratio else -9.81 * 300 * STEP  # nothing holds a sheet that cuts the air
    np.testing.assert_allclose(falling.velocities.numpy()[:, 1], expected, rtol=1e-3)


def test_wind_carries_the_sheet_away_at_its_own_speed(sheet):
    """Blowing to +x onto a sheet that stands across it; the drag is implicit, whatever the step."""
    across = RestState.from_mesh(upright(sheet.vertices)[:, [2, 1, 0]], sheet.topology.faces[:, ::-1])
    parameters = base_parameters(
        {"gravity": 0.0, "air_drag": 20.0, "density": 0.05, "wind_speed": 4.0, "wind_heading": np.pi / 2}
    )
    cloth = ImplicitCloth(across, parameters, 0.1, TIGHT)
    speeds = []
    for _ in range(4):
        cloth.step()
        speeds.append(cloth.velocities.numpy()[:, 0].mean())
    decay = 1.0 / (1.0 + 0.1 * 20.0 / 0.05)  # of the difference to the wind, a step
    np.testing.assert_allclose(speeds, 4.0 * (1.0 - decay ** np.arange(1, 5)), rtol=1e-6)
    np.testing.assert_allclose(cloth.velocities.numpy()[:, 1:], 0.0, atol=1e-6)


def test_creases_are_refused(sheet):
    with pytest.raises(ValueError, match=r"bend_yield = 100: it forms no creases, allowed is 1000 1/m"):
        ImplicitCloth(sheet, base_parameters({"bend_yield": 100.0}), STEP, TIGHT)


def test_momentum_is_conserved_without_outer_forces(sheet):
    cloth = ImplicitCloth(sheet, base_parameters(STILL | {"stretch_damping": 0.01, "bend_damping": 0.1}), STEP, TIGHT)
    velocities = np.random.default_rng(3).normal(0.0, 0.3, sheet.vertices.shape)
    cloth.place(sheet.vertices, velocities)
    mass = cloth.masses.numpy()
    before = mass @ velocities
    energy = 0.5 * mass @ (velocities**2).sum(axis=1)
    for _ in range(20):
        cloth.step()
    after = cloth.velocities.numpy()
    np.testing.assert_allclose(mass @ after, before, atol=1e-7 * np.abs(mass[:, None] * velocities).sum())
    assert 0.5 * mass @ (after**2).sum(axis=1) < energy


def test_hanging_strip_stretches_by_its_weight_over_its_stiffness_and_pins_stay():
    vertices, faces = lattice(17, 5, 0.03)
    vertices = upright(vertices)
    pinned = np.flatnonzero(vertices[:, 1] > -1e-9)
    rest = RestState.from_mesh(vertices, faces, pinned)
    parameters = base_parameters({"stretch": 100.0, "stretch_damping": 0.05})
    cloth = ImplicitCloth(rest, parameters, 1.0 / 60.0, TIGHT)
    cloth.set_extra_damping(5.0)
    for _ in range(150):
        cloth.step()
    positions = cloth.positions.numpy()
    length = -vertices[:, 1].min()
    bottom = vertices[:, 1] < -length + 1e-6
    # Each cross-section carries what hangs below it: integral of density g y over the stiffness.
    expected = parameters["density"] * 9.81 * length**2 / (2.0 * 100.0)
    assert (vertices[bottom, 1] - positions[bottom, 1]).mean() == pytest.approx(expected, rel=0.02)
    np.testing.assert_allclose(positions[pinned], vertices[pinned], atol=1e-12)


def test_pins_move_through_their_targets():
    vertices, faces = lattice(6, 5, 0.04)
    rest = RestState.from_mesh(vertices, faces, np.arange(5))
    cloth = ImplicitCloth(rest, base_parameters(), STEP, ImplicitSettings())
    cloth.show_pins(vertices[:5])
    cloth.show_pins(vertices[:5] + [0.0, 0.02, 0.01])
    cloth.step(0.0, 0.25)
    np.testing.assert_allclose(cloth.positions.numpy()[:5] - vertices[:5], np.tile([0.0, 0.005, 0.0025], (5, 1)))


def test_cantilever_bends_like_a_beam():
    edge, bend, density = 0.01, 2e-4, 0.05
    vertices, faces = lattice(22, 6, edge)
    clamped = np.flatnonzero(vertices[:, 0] < 1.2 * edge)  # two rows hold the slope
    rest = RestState.from_mesh(vertices, faces, clamped)
    parameters = base_parameters({"bend": bend, "density": density, "gravity": 1.0, "stretch": 200.0, "shear": 100.0})
    cloth = ImplicitCloth(rest, parameters, 0.02, TIGHT)
    cloth.set_extra_damping(4.0)
    for _ in range(120):
        cloth.step()
    length = vertices[:, 0].max() - vertices[clamped, 0].max() + 0.5 * edge * np.sqrt(0.75)
    tip = -cloth.positions.numpy()[vertices[:, 0] > vertices[:, 0].max() - 1e-6, 1].mean()
    expected = density * 1.0 * length**4 / (8.0 * bend)
    assert 0.02 < expected / length < 0.3  # small deflection: linear beam theory holds
    assert tip == pytest.approx(expected, rel=0.15)


def incline(friction: float, degrees: float, steps: int = 40) -> tuple[float, float]:
    """Acceleration down a slope [m/s^2], once the contact is made, and what Coulomb's law says."""
    angle = np.radians(degrees)
    turn = np.array([[np.cos(angle), -np.sin(angle), 0.0], [np.sin(angle), np.cos(angle), 0.0], [0.0, 0.0, 1.0]])
    vertices, faces = lattice(5, 4, 0.05)
    flat = RestState.from_mesh(vertices, faces)
    lift = 0.003 + sag(flat.topology.edges, flat.edge_length, len(vertices)).max()
    rest = RestState.from_mesh((vertices + [0.0, lift, 0.0]) @ turn.T, faces)
    ground = np.array([[-3.0, 0, -3], [-3, 0, 3], [3, 0, 3], [3, 0, -3]]) @ turn.T
    ground_faces = np.array([[0, 1, 2], [0, 2, 3]])
    surface = BodySurface(ground[None], ground_faces, whole_body(2, len(vertices)))
    parameters = base_parameters({"friction": friction, "air_drag": 0.0})
    cloth = ImplicitCloth(rest, parameters, STEP, TIGHT, surface)
    down = turn @ [-1.0, 0.0, 0.0]
    speeds = []
    for _ in range(2):
        for _ in range(steps):
            cloth.step()
        speeds.append(float((cloth.velocities.numpy() @ down).mean()))
    return (speeds[1] - speeds[0]) / (steps * STEP), 9.81 * (np.sin(angle) - friction * np.cos(angle))


def test_friction_holds_below_its_angle_and_brakes_above_it():
    stuck, _ = incline(0.4, 19.0)
    assert abs(stuck) < 2e-3
    for friction, degrees in ((0.0, 15.0), (0.4, 25.0), (0.4, 35.0)):
        acceleration, expected = incline(friction, degrees)
        assert acceleration == pytest.approx(expected, rel=0.02)


def drape(settings: ImplicitSettings) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Sheet dropped on a ball of 15 cm for half a second: positions, edge strains, ball vertices."""
    ball = trimesh.creation.icosphere(3, 0.15)
    vertices, faces = lattice(18, 16, 0.03)
    vertices = vertices - vertices.mean(axis=0) + [0.0, 0.156, 0.0]
    rest = RestState.from_mesh(vertices, faces)
    surface = BodySurface(np.asarray(ball.vertices)[None], ball.faces, whole_body(len(ball.faces), len(vertices)))
    cloth = ImplicitCloth(rest, base_parameters(), STEP, settings, surface)
    for _ in range(15):
        for steps in settings.interval_steps:
            cloth.interval(steps)
        cloth.project_out()
    positions = cloth.positions.numpy().copy()
    return positions, rest.edge_strain(positions), ball


def test_sheet_drapes_on_a_ball_without_a_vertex_inside_and_the_same_twice():
    positions, strain, ball = drape(ImplicitSettings())
    distance = closest_surface(positions, np.asarray(ball.vertices), np.asarray(ball.faces)).distance
    assert distance.min() > 0.001
    assert positions[:, 1].min() < -0.02  # it does hang down
    assert np.quantile(np.abs(strain), 0.99) < 0.05
    np.testing.assert_array_equal(positions, drape(ImplicitSettings())[0])


def test_projection_lifts_vertices_out_of_the_body():
    ball = trimesh.creation.icosphere(3, 0.15)
    vertices, faces = lattice(5, 5, 0.02)
    vertices = vertices - vertices.mean(axis=0) + [0.0, 0.13, 0.0]
    surface = BodySurface(np.asarray(ball.vertices)[None], ball.faces, whole_body(len(ball.faces), len(vertices)))
    rest = RestState.from_mesh(vertices, faces)
    cloth = ImplicitCloth(rest, base_parameters(), STEP, ImplicitSettings(), surface)
    report = cloth.project_out()
    assert report.lifted == len(vertices) and report.left == 0
    assert 0.01 < report.lifted_depth < 0.03
    hits = closest_surface(cloth.positions.numpy(), np.asarray(ball.vertices), np.asarray(ball.faces))
    clearance = 0.003 + sag(rest.topology.edges, rest.edge_length, len(vertices))  # the same as XPBD keeps
    np.testing.assert_allclose(hits.distance, clearance, atol=5e-4)


def test_strain_limits_hold_a_limp_strip_together():
    vertices, faces = lattice(13, 5, 0.03)
    vertices = upright(vertices)
    rest = RestState.from_mesh(vertices, faces, np.flatnonzero(vertices[:, 1] > -1e-9))
    limp = base_parameters({"stretch": 2.0, "shear": 1.0})
    longest = {}
    for limits in (None, (0.95, 1.05)):
        cloth = ImplicitCloth(rest, limp, STEP, ImplicitSettings(strain_limits=limits, strain_sweeps=200))
        for _ in range(60):
            cloth.step()
        longest[limits] = rest.edge_strain(cloth.positions.numpy()).max()
    assert longest[None] > 0.15
    assert longest[0.95, 1.05] < 0.07


def test_no_step_is_refused(sheet):
    with pytest.raises(ValueError, match="the step must be above 0 s"):
        ImplicitCloth(sheet, base_parameters(), 0.0, TIGHT)
