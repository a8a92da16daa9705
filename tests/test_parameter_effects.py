"""Every intrinsic parameter does what its meaning says: in the right direction, and where theory gives the size, by it.

Sheets of small triangles, three metres away from a standing body, in sixteen worlds that differ in one parameter.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import trimesh

from body.model import Body
from garments.template import GarmentTemplate
from sim.compile import compile_kernels
from sim.parameters import INTRINSIC_PARAMETERS, PARAMETER_NAMES, base_parameters
from sim.settings import SimulationSettings
from sim.simulate import Simulator, World
from tests.test_contact import cloth_on, sheet

G = 9.81
STILL = {"air_drag": 0.0, "stretch_damping": 0.0, "bend_damping": 0.0, "bend_yield": 1.0e3}
BODY = Body.load("small")


@pytest.fixture(scope="module", autouse=True)
def compiled():
    compile_kernels("cpu")


def lattice(rows: int, columns: int, edge: float) -> tuple[np.ndarray, np.ndarray]:
    """Vertical sheet of equilateral triangles: rows of triangles downwards along y, edges along x."""
    row, column = np.divmod(np.arange((rows + 1) * columns), columns)
    vertices = np.stack([(column + 0.5 * (row % 2)) * edge, -row * edge * np.sqrt(0.75), 0.0 * row], axis=1)
    faces = []
    for r in range(rows):
        for c in range(columns - 1):
            a, b = r * columns + c, r * columns + c + 1
            d, e = a + columns, b + columns
            faces += [(a, d, b), (b, d, e)] if r % 2 == 0 else [(a, d, e), (a, e, b)]
    return vertices, np.array(faces, dtype=np.int32)


def simulated(
    vertices: np.ndarray, faces: np.ndarray, pinned, worlds: list[dict], fps: float, seconds: float, substeps: int = 16
) -> list[np.ndarray]:
    """Frames [T, V, 3] of each world, from the rest shape on, without settling; frame 0 is the start.

    ``worlds`` hold what differs from cloth without drag, damping and creases. Positions are relative to the start's
    place.
    """
    place = np.array([0.0, 1.0, 3.0])
    count = len(vertices)
    weight = np.zeros((count, 4))
    weight[:, 0] = 1.0
    template = GarmentTemplate(
        name="sheet",
        kind="skirt",
        vertices=vertices + place,
        faces=faces,
        pinned=np.asarray(pinned, dtype=np.int32),
        skin_index=np.zeros((count, 4), dtype=np.int32),
        skin_weight=weight,
        body_name=BODY.name,
        body_digest=BODY.digest,
    )
    # Tethers would hide the artificial stretch that some of the tests are about.
    settings = SimulationSettings(
        fps=fps, device="cpu", settle_seconds=0.0, queries_per_frame=1, self_contact=False, tethers=False
    )
    frames = round(seconds * fps) + 1
    pose, root = np.repeat(BODY.bind_pose()[None], frames, axis=0), np.zeros((frames, 3))
    sets = [base_parameters({**STILL, **values, "substeps": float(substeps)}) for values in worlds]
    results = Simulator(template, BODY, settings, worlds=16).run_worlds([World(pose, root, one) for one in sets], 0)
    assert all(result.failure is None for result in results)
    return [result.vertices.astype(np.float64) - place for result in results]


def hung(worlds: list[dict]) -> tuple[np.ndarray, float]:
    """How much longer a sheet of soft cloth is when it hangs at rest [m], for each world; and its height [m]."""
    vertices, faces = lattice(10, 5, 0.02)
    settled = [{"stretch": 40.0, "shear": 20.0, "compression": 1.0, "stretch_damping": 0.02} | one for one in worlds]
    frames = simulated(vertices, faces, range(5), settled, fps=30.0, seconds=0.7, substeps=160)
    height = -vertices[:, 1].min()
    return np.array([-x[-1, -5:, 1].mean() - height for x in frames]), height


def test_density_gravity_and_stretch_set_how_far_cloth_hangs():
    """Extension density g H^2 / (2 k): each of them by its own power, and all by the right size."""
    worlds = [{}, {"density": 0.1}, {"density": 0.4}, {"gravity": 4.905}, {"gravity": 19.62}, {"stretch": 80.0}]
    longer, height = hung([*worlds, {"stretch": 20.0}])
    assert longer[0] == pytest.approx(0.2 * G * height**2 / (2.0 * 40.0), rel=0.03)
    assert longer[1:] / longer[0] == pytest.approx([0.5, 2.0, 0.5, 2.0, 0.5, 2.0], rel=0.03)


def test_more_substeps_take_out_the_stretch_that_is_not_the_material():
    """Stiff cloth: the surplus goes with the square of the time step."""
    vertices, faces = lattice(10, 5, 0.02)
    height = -vertices[:, 1].min()
    longer = []
    for substeps in (8, 16, 32):
        values = {"stretch": 1000.0, "shear": 300.0, "stretch_damping": 0.005, "air_drag": 3.0}
        end = simulated(vertices, faces, range(5), [values], fps=30.0, seconds=1.5, substeps=substeps)[0][-1]
        longer.append(-end[-5:, 1].mean() - height - 0.2 * G * height**2 / 2000.0)
    assert longer[0] / longer[1] == pytest.approx(4.0, rel=0.25)
    assert longer[1] / longer[2] == pytest.approx(4.0, rel=0.35)


def grid(rows: int, columns: int, step: float) -> tuple[np.ndarray, np.ndarray]:
    """Vertical sheet of squares with straight sides, their diagonals alternating."""
    row, column = np.divmod(np.arange((rows + 1) * (columns + 1)), columns + 1)
    vertices = np.stack([column * step, -row * step, 0.0 * row], axis=1)
    faces = []
    for r in range(rows):
        for c in range(columns):
            a = r * (columns + 1) + c
            b, d, e = a + 1, a + columns + 1, a + columns + 2
            faces += [(a, d, b), (b, d, e)] if (r + c) % 2 == 0 else [(a, d, e), (a, e, b)]
    return vertices, np.array(faces, dtype=np.int32)


def test_shear_holds_cloth_that_hangs_from_its_side():
    """A sheet much higher than wide, held along one side: its free side droops by density g L^2 / (2 k_shear)."""
    vertices, faces = grid(16, 4, 0.015)
    common = {"stretch": 1000.0, "stretch_damping": 0.02, "compression": 1.0}
    worlds = [common | {"shear": shear} for shear in (10.0, 20.0, 40.0)]
    held = np.flatnonzero(vertices[:, 0] == 0.0)
    frames = simulated(vertices, faces, held, worlds, fps=30.0, seconds=0.7, substeps=128)
    # Near the upper and lower edge, which carry no load, the cloth turns instead.
    free = np.flatnonzero((vertices[:, 0] > 0.059) & (np.abs(vertices[:, 1] + 0.12) < 0.061))
    droop = np.array([-(x[-1] - vertices)[free, 1].mean() for x in frames])
    assert droop[0] == pytest.approx(0.2 * G * 0.06**2 / (2.0 * 10.0), rel=0.1)
    assert droop[0] / droop == pytest.approx([1.0, 2.0, 4.0], rel=0.1)


def test_compression_softens_cloth_that_is_pushed_together():
    """A sheet that stands on its lower edge shortens by density g H^2 / (2 k ratio); one that hangs does not care."""
    vertices, faces = lattice(10, 5, 0.02)
    height = -vertices[:, 1].min()
    common = {"stretch": 160.0, "shear": 160.0, "stretch_damping": 0.02}
    worlds = [common | {"compression": ratio} for ratio in (1.0, 0.5, 0.25)]
    standing = simulated(vertices, faces, range(50, 55), worlds, fps=30.0, seconds=0.4, substeps=160)
    shorter = np.array([-x[-1, :5, 1].mean() for x in standing])
    assert shorter[0] == pytest.approx(0.2 * G * height**2 / (2.0 * 160.0), rel=0.1)
    assert shorter / shorter[0] == pytest.approx([1.0, 2.0, 4.0], rel=0.1)
    hanging = simulated(vertices, faces, range(5), worlds, fps=30.0, seconds=0.4, substeps=64)
    longer = [-x[-1, -5:, 1].mean() - height for x in hanging]
    assert longer[1:] == pytest.approx([longer[0]] * 2, rel=0.05)


def strip() -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray, float]:
    """Horizontal strip along x, clamped at one end: mesh, clamped and free vertices, free length [m]."""
    vertices, faces = lattice(5, 13, 0.01)
    vertices = vertices[:, [0, 2, 1]]
    clamped = np.flatnonzero(vertices[:, 0] < 0.016)
    free = np.flatnonzero(vertices[:, 0] > vertices[:, 0].max() - 0.006)
    return vertices, faces, clamped, free, 0.11


def test_bend_holds_up_a_strip():
    """Small droop density g L^4 / (8 k): half of it with twice the stiffness."""
    vertices, faces, clamped, free, length = strip()
    worlds = [{"bend": bend, "air_drag": 8.0, "stretch": 500.0, "drag_ratio": 1.0} for bend in (2.0e-3, 4.0e-3, 8.0e-3)]
    frames = simulated(vertices, faces, clamped, worlds, fps=240.0, seconds=0.4, substeps=64)
    droop = np.array([-x[-1, free, 1].mean() for x in frames])
    assert droop[1] == pytest.approx(0.2 * G * length**4 / (8.0 * 4.0e-3), rel=0.2)
    assert droop[1] / droop == pytest.approx([0.5, 1.0, 2.0], rel=0.1)


def decay(series: np.ndarray, seconds: float) -> float:
    """Rate at which the swings of a series [T] around its end value die out [1/s], from its turning points."""
    change = np.diff(series)
    turns = np.flatnonzero(np.sign(change[1:]) != np.sign(change[:-1])) + 1
    swings = np.abs(np.diff(series[turns]))
    times = turns[:-1] * seconds / (len(series) - 1)
    return float(-np.polyfit(times, np.log(swings), 1)[0])


def test_stretch_damping_takes_out_swings_along_the_cloth():
    """Rate tau omega^2 / 2 of the lowest mode, omega = pi/(2 H) sqrt(k / density)."""
    vertices, faces = lattice(10, 5, 0.02)
    common = {"stretch": 40.0, "shear": 20.0, "compression": 1.0}
    taus = (0.0, 1.0e-3, 2.0e-3)
    worlds = [common | {"stretch_damping": tau} for tau in taus]
    frames = simulated(vertices, faces, range(5), worlds, fps=480.0, seconds=0.2, substeps=32)
    height = -vertices[:, 1].min()
    mode = np.sin(-np.pi * vertices[:, 1] / (2.0 * height))
    rates = np.array([decay(x[:, :, 1] @ mode, 0.2) for x in frames])
    omega = np.pi / (2.0 * height) * np.sqrt(40.0 / 0.2)
    assert rates[1:] - rates[0] == pytest.approx(np.array(taus[1:]) * omega**2 / 2.0, rel=0.3)


def test_bend_damping_takes_out_the_swing_of_a_hinge():
    """Two triangles that flap: omega^2 = k sum(weight^2 / mass), and the swing dies out at tau omega^2 / 2."""
    edge, bend, seconds = 0.02, 5.0e-5, 0.5
    vertices = np.array([[0.0, 0.0, 0.0], [edge, 0.0, 0.0], [edge / 2, -edge * 0.75**0.5, 0.0], [0.0, 0.0, 0.0]])
    vertices[3] = vertices[2] * [1.0, -1.0, 1.0]
    faces = np.array([[0, 2, 1], [0, 1, 3]])
    rates, dt = [], 1.0 / 7680.0
    for tau in (0.0, 1.0e-4, 2.0e-4):
        solver = free_sheet(vertices, faces)
        rest = solver.rest
        weights, hinge = rest.hinge_weights[0], rest.hinges[0]
        flap = np.zeros((4, 3))
        flap[hinge, 2] = weights * rest.inverse_mass[hinge]
        values = {**STILL, "gravity": 0.0, "bend": bend, "bend_damping": tau}
        solver.set_parameters(base_parameters(values), dt)
        solver.place(vertices + flap * 1.0e-3 / np.abs(flap).max(), None, np.eye(4)[None], np.zeros(3))
        bent = []
        for _ in range(round(seconds / (16 * dt))):
            solver.advance(16, np.eye(4)[None], np.zeros(3))
            bent.append(weights @ solver.positions()[hinge, 2])
        rates.append(decay(np.array(bent), seconds))
    square = bend * (weights**2 * rest.inverse_mass[hinge]).sum() / 0.2
    assert np.diff(rates) == pytest.approx([1.0e-4 * square / 2.0] * 2, rel=0.1)


def test_time_scale_is_simulated_seconds_a_second_of_the_clip():
    vertices, faces = lattice(3, 4, 0.02)
    worlds = [{"time_scale": scale} for scale in (0.5, 1.0, 2.0)]
    fallen = [-x[-1, :, 1].mean() for x in simulated(vertices, faces, [], worlds, fps=60.0, seconds=0.2, substeps=16)]
    assert fallen[1] == pytest.approx(0.5 * G * 0.2**2 - vertices[:, 1].mean(), rel=0.02)
    dropped = np.array(fallen) + vertices[:, 1].mean()
    assert dropped / dropped[1] == pytest.approx([0.25, 1.0, 4.0], rel=0.01)


def fall(seconds: float, rate: float) -> float:
    """Way of a body that falls from rest against a drag that takes its speed at a rate [m]."""
    return G / rate * (seconds - (1.0 - np.exp(-rate * seconds)) / rate)


def test_air_drag_and_its_ratio_slow_a_falling_sheet():
    """Flat against the fall, a sheet of this density loses its speed at air_drag / density; edge on, at its ratio."""
    vertices, faces = lattice(4, 4, 0.02)
    drags = (0.5, 1.0, 2.0)
    flat = simulated(vertices[:, [0, 2, 1]], faces, [], [{"air_drag": c, "drag_ratio": 0.3} for c in drags], 60.0, 0.4)
    for x, drag in zip(flat, drags):
        assert -(x[-1] - x[0])[:, 1].mean() == pytest.approx(fall(0.4, drag / 0.2), rel=0.02)
    ratios = (0.0, 0.3, 1.0)
    edge_on = simulated(vertices, faces, [], [{"air_drag": 2.0, "drag_ratio": r} for r in ratios], 60.0, 0.4)
    for x, ratio in zip(edge_on, ratios):
        expected = fall(0.4, max(2.0 * ratio / 0.2, 1.0e-6))
        assert -(x[-1] - x[0])[:, 1].mean() == pytest.approx(expected, rel=0.02)


def test_wind_carries_free_cloth_along_its_heading_at_its_speed():
    """Without weight it takes on the wind's speed: w (t - (1 - exp(-rate t)) / rate)."""
    vertices, faces = lattice(4, 4, 0.02)
    winds = [(1.0, 0.0), (4.0, 0.0), (4.0, np.pi / 2.0), (4.0, -np.pi / 4.0)]
    worlds = [
        {"gravity": 0.0, "air_drag": 1.0, "drag_ratio": 1.0, "wind_speed": speed, "wind_heading": heading}
        for speed, heading in winds
    ]
    rate = 1.0 / 0.2
    for x, (speed, heading) in zip(simulated(vertices, faces, [], worlds, 60.0, 0.3), winds):
        way = speed * (0.3 - (1.0 - np.exp(-rate * 0.3)) / rate)
        expected = way * np.array([np.sin(heading), 0.0, np.cos(heading)])
        assert (x[-1] - x[0]).mean(axis=0) == pytest.approx(expected, abs=0.02 * way)


def test_cloth_that_is_bent_beyond_its_yield_keeps_a_crease():
    """Rolled to a curvature and let go: what is beyond the yield curvature stays, the rest springs back."""
    vertices, faces = lattice(4, 12, 0.01)
    kappa, yields = 20.0, (12.0, 16.0, 1.0e3)
    rolled = vertices.copy()
    rolled[:, 0] = np.sin(kappa * vertices[:, 0]) / kappa
    rolled[:, 2] = (1.0 - np.cos(kappa * vertices[:, 0])) / kappa
    left = []
    for limit in yields:
        solver = free_sheet(vertices, faces)
        values = {**STILL, "gravity": 0.0, "bend": 1.0e-3, "bend_damping": 0.02, "air_drag": 0.5, "bend_yield": limit}
        solver.set_parameters(base_parameters(values), 1.0 / 3840.0)
        solver.place(rolled, None, np.eye(4)[None], np.zeros(3))
        for _ in range(120):
            solver.advance(16, np.eye(4)[None], np.zeros(3))
        left.append(curvature_along_x(solver.positions(), vertices))
    assert left[2] == pytest.approx(0.0, abs=0.6)
    assert left[:2] == pytest.approx([kappa - limit for limit in yields[:2]], rel=0.25)


def free_sheet(vertices: np.ndarray, faces: np.ndarray):
    """The solver of a sheet without a body or pins."""
    far = trimesh.creation.box((0.1, 0.1, 0.1)).apply_translation([0.0, -9.0, 0.0])
    return cloth_on(far, vertices, faces, 1.0 / 960.0)


def curvature_along_x(positions: np.ndarray, rest: np.ndarray) -> float:
    """Mean curvature of the sheet's rows [1/m]: how much they turn from link to link over their length."""
    turned, length = 0.0, 0.0
    for height in np.unique(rest[:, 1].round(6)):
        step = np.diff(positions[np.isclose(rest[:, 1], height, atol=1.0e-5)], axis=0)[1:-1]
        unit = step / np.linalg.norm(step, axis=1, keepdims=True)
        turned += np.arccos(np.clip((unit[1:] * unit[:-1]).sum(axis=1), -1.0, 1.0)).sum()
        length += np.linalg.norm(step, axis=1)[1:].sum()
    return float(turned / length)


def on_a_plate(friction: float, thickness: float, speed: float, frames: int):
    """Way that a sheet slides on a level plate [m], and the mean height of its vertices at the end [m]."""
    plate = trimesh.creation.box((6.0, 0.2, 2.0)).apply_translation([0.0, -0.1, 0.0])
    vertices, faces = sheet(0.1, 0.02, 0.02)
    solver = cloth_on(plate, vertices, faces, 1.0 / 960.0, friction=friction, thickness=thickness)
    for _ in range(24):
        solver.advance(16, np.eye(4)[None], np.zeros(3))
    start = solver.positions()
    velocities = solver.velocities() + np.array([speed, 0.0, 0.0])
    solver.place(start, velocities, np.eye(4)[None], np.zeros(3))
    for _ in range(frames):
        solver.advance(16, np.eye(4)[None], np.zeros(3))
    end = solver.positions()
    return (end - start)[:, 0].mean(), end[:, 1].mean()


@pytest.mark.parametrize("friction", [0.2, 0.4, 0.8])
def test_friction_stops_a_sliding_sheet(friction):
    """From speed v it slides v^2 / (2 mu g)."""
    way, _ = on_a_plate(friction, 0.003, 1.0, 24)
    assert way == pytest.approx(1.0 / (2.0 * friction * G), rel=0.06)


def test_thickness_is_the_distance_that_cloth_keeps():
    heights = [on_a_plate(0.5, thickness, 0.0, 4)[1] for thickness in (0.002, 0.004, 0.008)]
    assert np.diff(heights) == pytest.approx([0.002, 0.004], rel=0.03)


def test_every_parameter_is_varied_here():
    """Self-friction, which needs a sheet that lies on itself, is tested where sheets do."""
    source = Path(__file__).read_text(encoding="utf-8").split("def test_every_parameter_is_varied_here")[0]
    varied = {p.name for p in INTRINSIC_PARAMETERS if f'"{p.name}"' in source or f"{p.name}=" in source}
    assert varied == set(PARAMETER_NAMES) - {"self_friction"}
