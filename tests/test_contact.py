"""Contact of cloth with a moving body: planes, spheres, a swinging capsule, and clips on the small body."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import trimesh

from body.model import Body
from garments.template import GarmentTemplate
from geometry.proximity import closest_surface
from geometry.rotations import axis_angle_to_matrix, matrix_to_axis_angle
from sim.body_contact import BodyContact, sag
from sim.body_parts import own_parts, whole_body
from sim.compile import resolve_device
from sim.parameters import base_parameters
from sim.rest_state import RestState
from sim.settings import SimulationSettings
from sim.simulate import Simulator, simulate_clip
from sim.skeleton import Skeleton, Skin
from sim.xpbd import XpbdSolver

DEVICE = resolve_device("cpu")
SETTINGS = SimulationSettings(device="cpu", settle_seconds=0.5)


def sheet(size: float, edge: float, height: float) -> tuple[np.ndarray, np.ndarray]:
    """Horizontal sheet of equilateral triangles around the y axis."""
    columns, rows = round(size / edge) + 1, round(size / (edge * np.sqrt(0.75))) + 1
    row, column = np.divmod(np.arange(rows * columns), columns)
    vertices = np.stack([(column + 0.5 * (row % 2)) * edge, 0.0 * row, row * edge * np.sqrt(0.75)], axis=1)
    vertices += [0.0, height, 0.0] - vertices.mean(axis=0) * [1, 0, 1]
    faces = []
    for r in range(rows - 1):
        for c in range(columns - 1):
            a, b, d, e = (r * columns + c, r * columns + c + 1, (r + 1) * columns + c, (r + 1) * columns + c + 1)
            faces += [(a, d, b), (b, d, e)] if r % 2 == 0 else [(a, d, e), (a, e, b)]
    return vertices, np.array(faces, dtype=np.int32)


def cloth_on(body: trimesh.Trimesh, vertices: np.ndarray, faces: np.ndarray, dt: float, **values: float) -> XpbdSolver:
    """A free cloth above a rigid body with one joint."""
    rest = RestState.from_mesh(vertices, faces)
    skeleton = Skeleton(1, np.zeros(3), [0], DEVICE)
    count = len(body.vertices)
    one = np.zeros((count, 1), dtype=int), np.ones((count, 1))
    standoff = sag(rest.topology.edges, rest.edge_length, len(vertices))
    parts = whole_body(len(body.faces), len(vertices))
    contact = BodyContact(
        body.vertices,
        np.asarray(body.faces),
        *one,
        parts,
        standoff,
        skeleton,
        reach=0.05,
        edges=rest.topology.edges,
        edge_length=rest.edge_length,
        device=DEVICE,
    )
    solver = XpbdSolver(rest, skeleton, contact, Skin(np.zeros((0, 3)), one[0][:0], one[1][:0], 1, DEVICE), DEVICE)
    solver.set_parameters(base_parameters({"air_drag": 0.0, **values}), dt)
    solver.place(vertices, None, np.eye(4)[None], np.zeros(3))
    return solver


def moved(matrix: np.ndarray, points: np.ndarray) -> np.ndarray:
    return points @ matrix[:3, :3].T + matrix[:3, 3]


@pytest.mark.parametrize(("friction", "slides"), [(0.7, False), (0.3, True), (0.0, True)])
def test_cloth_on_an_incline_sticks_or_slides(friction, slides):
    """Below atan(mu) it sticks, above it slides with g (sin - mu cos)."""
    angle, dt, steps = np.radians(25.0), 1.0 / 960.0, 16 * 18
    slope = trimesh.transformations.rotation_matrix(angle, [0, 0, 1])
    plane = trimesh.creation.box((4.0, 0.2, 2.0)).apply_translation([0.0, -0.1, 0.0])
    vertices, faces = sheet(0.1, 0.02, 0.004)
    lift = base_parameters()["thickness"] + sag_of(vertices, faces)
    vertices[:, 1] = lift  # exactly at the distance of contact
    plane.apply_transform(slope)
    solver = cloth_on(plane, moved(slope, vertices), faces, dt, friction=friction)
    start = solver.positions()
    for _ in range(steps // 16):
        solver.advance(16, np.eye(4)[None], np.zeros(3))
    travel = ((solver.positions() - start) @ [-np.cos(angle), -np.sin(angle), 0.0]).mean()
    expected = 9.81 * (np.sin(angle) - friction * np.cos(angle)) * (steps * dt) ** 2 / 2 if slides else 0.0
    assert travel == pytest.approx(expected, rel=0.01, abs=2e-4)


def sag_of(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    rest = RestState.from_mesh(vertices, faces)
    return sag(rest.topology.edges, rest.edge_length, len(vertices))


def test_drape_over_a_sphere_leaves_no_vertex_inside():
    sphere = trimesh.creation.icosphere(3, 0.15)
    vertices, faces = sheet(0.5, 0.03, 0.16)
    solver = cloth_on(sphere, vertices, faces, 1.0 / 960.0)
    for _ in range(2 * 40):
        solver.advance(16, np.eye(4)[None], np.zeros(3))
        hits = closest_surface(solver.positions(), sphere.vertices, sphere.faces)
        assert hits.distance.min() > 0.0025  # thickness 3 mm
    end = solver.positions()
    assert end[:, 1].min() < 0.02 and np.abs(end[:, [0, 2]]).max() < 0.3  # hangs around it
    assert np.quantile(np.abs(solver.rest.edge_strain(end)), 0.99) < 0.05


def test_swinging_capsule_carries_cloth_without_entering_it():
    """A fast limb (10 rad/s) from below throws the cloth up; the surface stays outside at every query."""
    capsule = trimesh.creation.capsule(0.5, 0.06, count=[16, 16]).apply_transform(
        trimesh.transformations.rotation_matrix(np.pi / 2, [0, 1, 0])
    )
    vertices, faces = sheet(0.3, 0.02, 0.075)
    vertices[:, 0] += 0.25
    solver = cloth_on(capsule, vertices, faces, 1.0 / 960.0, friction=0.6)
    highest = 0.0
    for step in range(1, 25):
        turn = trimesh.transformations.rotation_matrix(0.6 * np.sin(10.0 / 0.6 * step / 60.0), [0, 0, 1])
        solver.advance(16, turn[None], np.zeros(3))
        hits = closest_surface(solver.positions(), moved(turn, capsule.vertices), capsule.faces)
        assert hits.distance.min() > 0.0
        highest = max(highest, solver.positions()[:, 1].max())
    assert highest > 0.2  # thrown up by the tip of the capsule


def test_cloth_rides_on_a_body_that_moves_along():
    """A plate that accelerates below the friction's limit takes the cloth with it, and the floating origin too."""
    plate = trimesh.creation.box((0.6, 0.2, 0.6)).apply_translation([0.0, -0.1, 0.0])
    vertices, faces = sheet(0.1, 0.02, 0.0)
    vertices[:, 1] = 0.003 + sag_of(vertices, faces)
    solver = cloth_on(plate, vertices, faces, 1.0 / 960.0, friction=0.5)
    shift = np.eye(4)
    for step in range(1, 31):
        shift[0, 3] = 0.5 * 2.0 * (step / 60.0) ** 2  # 2 m/s^2 of 0.5 * 9.81 at most
        solver.advance(16, shift[None].copy(), shift[:3, 3].copy())
    travel = (solver.positions() - vertices)[:, 0]
    # The plate moves linearly in an interval: at each start the cloth slips until friction has caught up with the jump
    # of velocity, (2 / 60)^2 / (2 mu g) = 0.11 mm in each of 30 intervals.
    assert np.abs(travel - shift[0, 3]).max() < 0.006


@pytest.fixture(scope="module")
def body() -> Body:
    return Body.load("small")


@pytest.fixture(scope="module")
def skirt(body) -> GarmentTemplate:
    """A plain tube around the hips, pinned at its top ring."""
    return tube_skirt(body)


def tube_skirt(body: Body, clearance: float = 0.012) -> GarmentTemplate:
    rings, sides = 12, 36
    top = body.joints[0, 1] + 0.08
    angle = np.arange(sides) * 2.0 * np.pi / sides
    direction = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    near = body.vertices[np.isin(body.part_of_vertex, (0, 1, 2, 3))]
    vertices = []
    widest = np.zeros(sides)
    for ring in range(rings):
        y = top - 0.03 * ring
        band = near[np.abs(near[:, 1] - y) < 0.04][:, [0, 2]]
        widest = np.maximum(widest, (direction @ band.T).max(axis=1) + clearance)  # support of the convex slice
        vertices.append(np.stack([direction[:, 0] * widest, np.full(sides, y), direction[:, 1] * widest], axis=1))
    vertices = np.concatenate(vertices)
    faces = []
    for r in range(rings - 1):
        for s in range(sides):
            a, b = r * sides + s, r * sides + (s + 1) % sides
            faces += [(a, b, a + sides), (b, b + sides, a + sides)]
    nearest = np.argmin(((vertices[:, None] - body.vertices[None]) ** 2).sum(-1), axis=1)
    return GarmentTemplate(
        name="tube",
        kind="skirt",
        vertices=vertices.astype(np.float32),
        faces=np.array(faces, dtype=np.int32),
        pinned=np.arange(sides, dtype=np.int32),
        skin_index=body.skin_index[nearest],
        skin_weight=body.skin_weight[nearest],
        body_name=body.name,
        body_digest=body.digest,
    )


def lunge(body: Body, frames: int = 20) -> tuple[np.ndarray, np.ndarray]:
    """From the bind pose into a step with a turned pelvis."""
    pose = np.tile(body.bind_pose().astype(float), (frames, 1, 1))
    s = np.linspace(0.0, 1.0, frames) ** 2 * (3.0 - 2.0 * np.linspace(0.0, 1.0, frames))
    pose[:, 1, 0] -= 0.6 * s
    pose[:, 2, 0] += 0.4 * s
    pose[:, 0, 1] += 0.5 * s
    root = np.stack([0.1 * s, -0.05 * s, 0.3 * s], axis=1)
    return pose, root


def test_clip_keeps_the_garment_outside_the_body(body, skirt):
    pose, root = lunge(body)
    calls = []
    result = simulate_clip(skirt, body, pose, root, 6, base_parameters(), SETTINGS, lambda *done: calls.append(done))
    assert result.failure is None
    assert result.vertices.shape == (14, len(skirt.vertices), 3) and result.vertices.dtype == np.float32
    assert calls[-1] == (20, 20) and len(calls) == 20
    free = np.setdiff1d(np.arange(len(skirt.vertices)), skirt.pinned)
    posed = body.posed(pose[6:], root[6:])
    for frame in range(0, 14, 3):
        assert closest_surface(result.vertices[frame, free], posed[frame], body.faces).distance.min() > 0.0
    assert result.quality["vertices_inside"] == 0 and result.quality["p99_edge_strain"] < 0.15
    expected = {"max_edge_strain", "p99_edge_strain", "deepest_penetration_m", "vertices_inside", "pinched_vertices"}
    expected |= {"triangles_inside_sampled", "pinched_frames", "longest_pinch_frames"}
    expected |= {"crossing_pairs", "crossing_frames"}
    assert expected | {"residual_speed_m_s", "substeps", "seconds_per_frame"} == set(result.quality)
    # Pins follow the skinned body.
    transforms = body.joint_transforms(pose[-1:], root[-1:])[0]
    homogeneous = np.concatenate([skirt.vertices, np.ones((len(skirt.vertices), 1))], axis=1)
    each = np.einsum("jab,vb->vja", transforms[:, :3], homogeneous)
    rows = np.arange(len(skirt.vertices))[:, None]
    skinned = (each[rows, skirt.skin_index] * skirt.skin_weight[..., None]).sum(axis=1)
    assert np.abs(result.vertices[-1] - skinned)[skirt.pinned].max() < 1e-5


def test_reused_simulator_gives_the_same_numbers(body, skirt):
    pose, root = lunge(body, 10)
    first, other = base_parameters(), base_parameters({"stretch": 300.0, "substeps": 17, "time_scale": 0.8})
    simulator = Simulator(skirt, body, SETTINGS)
    runs = [simulator.run(pose, root, 4, values).vertices for values in (first, other, first, first)]
    assert np.array_equal(runs[0], runs[2]) and not np.array_equal(runs[0], runs[1])
    assert np.array_equal(runs[0], runs[3])  # of the same parameters, whose rest is remembered
    assert np.array_equal(runs[1], simulate_clip(skirt, body, pose, root, 4, other, SETTINGS).vertices)


def test_clip_moved_and_turned_on_the_ground(body, skirt):
    """The first pose decides where the settled garment is put on: another place and heading, the same motion."""
    pose, root = lunge(body, 10)
    angle, offset = 2.0, np.array([30.0, 0.0, -20.0])
    turn = trimesh.transformations.rotation_matrix(angle, [0, 1, 0])[:3, :3]
    pelvis = body.joints[0].astype(float)
    turned_pose = pose.copy()
    turned_pose[:, 0] = matrix_to_axis_angle(turn @ axis_angle_to_matrix(pose[:, 0]))
    turned_root = (root + pelvis) @ turn.T - pelvis + offset
    plain = simulate_clip(skirt, body, pose, root, 4, base_parameters(), SETTINGS).vertices
    turned = simulate_clip(skirt, body, turned_pose, turned_root, 4, base_parameters(), SETTINGS).vertices
    # A turn by 1e-4 already moves single vertices by 0.7 mm: rounding decides which face of an edge is the closest.
    difference = np.abs(turned - (plain @ turn.T + offset))
    assert difference.max() < 5e-3 and np.sqrt((difference**2).mean()) < 3e-4


@pytest.mark.parametrize(
    "values",
    [
        {"density": 0.1, "stretch": 5000, "shear": 2000, "bend": 1e-3, "stretch_damping": 0.02, "bend_damping": 0.1},
        {"density": 0.5, "stretch": 200, "shear": 50, "bend": 1e-6, "stretch_damping": 0.0, "bend_damping": 0.0},
        {"substeps": 16, "time_scale": 1.5, "gravity": 15.0, "friction": 1.0, "thickness": 0.006, "air_drag": 3.0},
        {"substeps": 48, "time_scale": 0.5, "gravity": 5.0, "friction": 0.0, "compression": 0.1, "air_drag": 0.1},
    ],
)
def test_corners_of_the_sampled_range_stay_sound(body, skirt, values):
    pose, root = lunge(body, 12)
    result = simulate_clip(skirt, body, pose, root, 4, base_parameters(values), SETTINGS)
    assert result.failure is None
    assert result.quality["p99_edge_strain"] < 0.5 and result.quality["vertices_inside"] == 0


def test_divergence_is_a_failure_and_no_exception(body, skirt):
    pose, root = lunge(body, 10)
    index, weight = skirt.skin_index.copy(), skirt.skin_weight.copy()
    index[9], weight[9] = 4, (1.0, 0.0, 0.0, 0.0)  # a pin of the waist hangs on the shank,
    pose[6:, 4, 0] += 0.5  # which swings away within a frame and tears the cloth
    torn = replace(skirt, skin_index=index, skin_weight=weight)
    result = simulate_clip(torn, body, pose, root, 4, base_parameters(), SETTINGS)
    assert result.failure is not None and "frame 2" in result.failure
    assert np.isfinite(result.vertices).all() and np.array_equal(result.vertices[2], result.vertices[1])


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (
            lambda a: a.update(pose=np.where(np.arange(8)[:, None, None] == 5, np.nan, a["pose"])),
            "frame 5 is not finite",
        ),
        (lambda a: a.update(root=a["root"][:-1]), r"expected shape \[8, 3\]"),
        (lambda a: a.update(pose=a["pose"][:, :23]), r"\[L \+ T, 24, 3\]"),
        (lambda a: a.update(lead_in=8), "lead_in = 8"),
        (lambda a: a.update(parameters={**a["parameters"], "friction": 9.0}), "friction = 9"),
        (lambda a: a.update(template=replace(a["template"], body_digest="another")), "was made for body"),
        (lambda a: a.update(template=shrunk(a["template"])), "starts inside the body"),
    ],
)
def test_bad_input_is_refused_in_one_sentence(body, skirt, change, message):
    pose, root = lunge(body, 8)
    arguments = {"template": skirt, "pose": pose, "root": root, "lead_in": 2, "parameters": base_parameters()}
    change(arguments)
    with pytest.raises(ValueError, match=message):
        simulate_clip(body=body, settings=SETTINGS, **arguments)


def shrunk(template: GarmentTemplate) -> GarmentTemplate:
    centre = template.vertices.mean(axis=0)
    return replace(template, vertices=(centre + 0.7 * (template.vertices - centre)).astype(np.float32))


def test_settings_are_checked():
    for broken in ({"fps": 0.0}, {"device": "tpu"}, {"contact": "none"}, {"reach": float("nan")}):
        with pytest.raises(ValueError, match="allowed are"):
            SimulationSettings(**broken)


def test_vertices_collide_with_the_parts_they_belong_to(body):
    """A sleeve vertex knows its arm and, near the shoulder, the trunk; a skirt knows both legs."""
    index = np.array([[16, 13, 0, 0], [6, 9, 0, 0], [1, 0, 0, 0]])
    weight = np.array([[0.7, 0.3, 0, 0], [0.6, 0.4, 0, 0], [0.95, 0.05, 0, 0]])
    weights = (body.faces, body.skin_index, body.skin_weight, index, weight)
    shirt = own_parts("tshirt", *weights)
    sets = [{part for part in row if part >= 0} for row in shirt.owned.tolist()]
    assert len(sets[0]) == 2 and len(sets[1]) == 1 and sets[1] < sets[0] and len(sets[2]) == 1
    assert sets[2].isdisjoint(sets[0])
    skirt_parts = own_parts("skirt", *weights)
    legs = skirt_parts.faces[skirt_parts.owned[2, 0]]
    part_of_face = body.part_of_vertex[body.faces[legs]]
    assert {1, 2, 4, 5} <= set(part_of_face.ravel().tolist())
