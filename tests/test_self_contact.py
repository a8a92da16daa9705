"""Contact of cloth with itself: pairs kept apart, momentum kept, friction, lanes, layers, tangles, and full lists."""

from __future__ import annotations

import numpy as np
import pytest
import warp as wp

from sim.compile import resolve_device
from sim.constraints import device_hinges, device_triangles
from sim.kernels import bending, integrate, membrane
from sim.kernels.lanes import launch, scalars, vectors
from sim.kernels.parameters import ROW_COUNT, substep_constants
from sim.parameters import base_parameters
from sim.rest_state import RestState
from sim.self_contact import SelfContact
from sim.triangle_tree import TriangleTree

DEVICE = resolve_device("cpu")
DT = 1.0 / 960.0
THICKNESS = 0.003


def sheet(rows: int, columns: int, edge: float = 0.02) -> tuple[np.ndarray, np.ndarray]:
    """Horizontal sheet of equilateral triangles around the y axis, normals up."""
    row, column = np.divmod(np.arange(rows * columns), columns)
    vertices = np.stack([(column + 0.5 * (row % 2)) * edge, 0.0 * row, row * edge * np.sqrt(0.75)], axis=1)
    faces = []
    for r in range(rows - 1):
        for c in range(columns - 1):
            a, b, d, e = (r * columns + c, r * columns + c + 1, (r + 1) * columns + c, (r + 1) * columns + c + 1)
            faces += [(a, d, b), (b, d, e)] if r % 2 == 0 else [(a, d, e), (a, e, b)]
    return vertices - vertices.mean(axis=0), np.array(faces, dtype=np.int32)


def together(*parts: tuple[np.ndarray, np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    starts = np.cumsum([0, *(len(v) for v, _ in parts)])
    return np.concatenate([v for v, _ in parts]), np.concatenate([f + s for (_, f), s in zip(parts, starts)])


class Cloth:
    """A small solver: gravity, membrane, bending and self-contact, without a body."""

    def __init__(self, rest_vertices, faces, width=1, pinned=(), layer=None, at_once=False, **values):
        pieces = len(np.unique(layer)) if layer is not None else 8
        self.rest = RestState.from_mesh(rest_vertices, faces, np.array(pinned, dtype=np.int32), pieces)
        self.width, self.count = width, len(rest_vertices)
        self.contact = SelfContact(self.rest, width, DEVICE, layer)
        if at_once:  # as on a GPU
            self.contact.one_by_one, self.contact.threads = False, 7
            self.contact.active = wp.zeros(self.count, dtype=scalars(width), device=DEVICE)
            self.contact.delta = wp.zeros(self.count, dtype=vectors(width), device=DEVICE)
        each = [base_parameters({"thickness": THICKNESS, "air_drag": 0.0, "gravity": 0.0, **values})] * width
        self.parameters = wp.zeros(ROW_COUNT, dtype=scalars(width), device=DEVICE)
        self.parameters.assign(np.stack([substep_constants(one, DT) for one in each], axis=1))
        self.triangles, self.hinges = device_triangles(self.rest, DEVICE), device_hinges(self.rest, DEVICE)
        self.mass = wp.array(self.rest.inverse_mass.astype(np.float32), dtype=float, device=DEVICE)
        self.x, self.v, self.x_prev, self.x_pred, self.normals = (
            wp.zeros(self.count, dtype=vectors(width), device=DEVICE) for _ in range(5)
        )
        self.put(self.x, rest_vertices)

    def put(self, target, each) -> None:
        each = np.broadcast_to(each, (self.width, self.count, 3)).transpose(1, 2, 0)
        target.assign(np.ascontiguousarray(each.reshape(self.count, -1), dtype=np.float32))

    def get(self, source) -> np.ndarray:
        return source.numpy().reshape(self.count, 3, self.width).transpose(2, 0, 1).astype(np.float64)

    def find(self, substeps: int = 8) -> bool:
        return self.contact.find(substeps, self.parameters, self.x, self.v)

    def launch(self, kernel, size, inputs, outputs) -> None:
        launch(kernel, self.width, size, inputs, outputs, DEVICE)

    def run(self, seconds: float, interval: int = 8, solve=True) -> np.ndarray:
        for _ in range(round(seconds / (DT * interval))):
            self.find(interval)
            for _ in range(interval):
                state = [self.v, self.x, self.x_prev, self.x_pred]
                self.launch(integrate.predict, self.count, [self.mass, self.parameters, self.normals], state)
                for first, count in self.triangles.ranges:
                    inputs = [first, self.triangles.items, self.mass, self.parameters]
                    self.launch(membrane.solve_membrane, count, inputs, [self.x])
                for first, count in self.hinges.ranges:
                    inputs = [first, 1.0, self.hinges.items, self.mass, self.parameters]
                    self.launch(bending.solve_bending, count, inputs, [self.x])
                if solve:
                    self.contact.launch_solve(self.parameters, self.x_prev, self.x, self.x_pred)
                inputs = [self.mass, self.parameters, self.x, self.x_prev, self.x_pred]
                self.launch(integrate.update_velocity, self.count, inputs, [self.v])
        self.find(interval)
        return self.get(self.x)

    def momentum(self) -> np.ndarray:
        """Linear and angular momentum of each lane for unit density, shape [W, 6]."""
        x, v, mass = self.get(self.x), self.get(self.v), self.rest.vertex_area[:, None]
        return np.concatenate([(mass * v).sum(axis=1), (mass * np.cross(x, v)).sum(axis=1)], axis=1)


def crossings(points: np.ndarray, faces: np.ndarray) -> int:
    """Edges of faces that pierce other faces without a common vertex: every pair, in float64."""
    corners = points[faces]
    low, high = corners.min(axis=1), corners.max(axis=1)
    meets = ((low[:, None] <= high[None]) & (low[None] <= high[:, None])).all(axis=2)
    meets &= ~(faces[:, None, :, None] == faces[None, :, None, :]).any(axis=(2, 3))
    first, second = np.nonzero(meets)
    a, b, c = corners[second].transpose(1, 0, 2)
    pierced = np.zeros(len(first), dtype=bool)
    for k in range(3):
        p, q = corners[first, k], corners[first, (k + 1) % 3]
        volume = [np.einsum("ij,ij->i", np.cross(s - p, t - p), q - p) for s, t in ((a, b), (b, c), (c, a))]
        inside = (np.min(volume, axis=0) > 0.0) | (np.max(volume, axis=0) < 0.0)
        normal = np.cross(b - a, c - a)
        pierced |= inside & (((p - a) * normal).sum(-1) * ((q - a) * normal).sum(-1) < 0.0)
    return int(pierced.sum())


def two_sheets(gap: float) -> tuple[np.ndarray, np.ndarray]:
    vertices, faces = sheet(7, 7)
    turn = np.array([[0.9, 0.0, 0.44], [0.0, 1.0, 0.0], [-0.44, 0.0, 0.9]]) / np.hypot(0.9, 0.44)
    turn[1, 1] = 1.0
    return together((vertices, faces), ((vertices * 0.8) @ turn.T + [0.003, gap, 0.002], faces))


@pytest.mark.parametrize(("at_once", "friction"), [(False, 0.5), (False, 0.0), (True, 0.5)])
def test_sheets_thrown_at_each_other_stay_apart_and_keep_momentum(at_once, friction):
    vertices, faces = two_sheets(0.02)
    cloth = Cloth(vertices, faces, at_once=at_once, self_friction=friction)
    speed = np.zeros((98, 3))
    speed[:49], speed[49:] = [0.1, 0.8, 0.0], [0.0, -0.6, 0.05]
    cloth.put(cloth.v, speed)
    before = cloth.momentum()
    for _ in range(12):
        x = cloth.run(0.01)[0]
        assert crossings(x, faces) == 0
    assert cloth.contact.crossing_count()[0] == 0
    change = cloth.momentum() - before
    scale = cloth.rest.vertex_area.sum()
    assert np.abs(change[0, :3]).max() < 2e-5 * scale
    # To first order in the substep, and friction acts on both sides of the gap.
    assert np.abs(change[0, 3:]).max() < 2e-4 * scale
    # They bounced or came along: the lower sheet no longer rises through the upper one.
    v = cloth.get(cloth.v)[0]
    assert v[:49, 1].mean() < v[49:, 1].mean() + 0.05


def test_without_it_the_same_sheets_cross():
    vertices, faces = two_sheets(0.02)
    cloth = Cloth(vertices, faces)
    speed = np.zeros((98, 3))
    speed[:49, 1], speed[49:, 1] = 0.8, -0.6
    vertices[49:, 1] += 0.1 * vertices[49:, 0]
    cloth.put(cloth.x, vertices)
    cloth.put(cloth.v, speed)
    worst = 0
    for _ in range(6):
        worst = max(worst, crossings(cloth.run(0.005, interval=4, solve=False)[0], faces))
    assert worst > 10


def test_a_ribbon_falls_on_itself_without_crossing():
    vertices, faces = sheet(40, 4, 0.015)
    vertices = vertices - vertices[0]
    up = np.stack([vertices[:, 0], vertices[:, 2], 0.004 * np.sin(vertices[:, 2] * 25.0)], axis=1)
    floor, floor_faces = sheet(12, 12, 0.03)
    floor[:, 1] -= 0.01
    points, triangles = together((up, faces), (floor, floor_faces))
    pinned = np.arange(len(up), len(points))
    cloth = Cloth(points, triangles, pinned=pinned, gravity=9.81, bend=5e-6, self_friction=0.3)
    counts = [crossings(cloth.run(0.1, interval=4)[0], triangles) for _ in range(9)]
    end = cloth.get(cloth.x)[0][: len(up)]
    assert np.ptp(end[:, 1]) < 0.2, "the ribbon has come down"
    assert max(counts) <= 12
    assert counts[-1] == 0
    strain = np.abs(cloth.rest.edge_strain(cloth.get(cloth.x)[0]))
    assert np.quantile(strain, 0.99) < 0.05


@pytest.mark.parametrize(("friction", "slides"), [(0.7, False), (0.3, True), (0.0, True)])
def test_cloth_on_an_incline_of_cloth_sticks_or_slides(friction, slides):
    """Below atan(mu) it sticks, above it slides with g (sin - mu cos)."""
    angle, seconds = np.radians(25.0), 0.2
    turn = np.array([[np.cos(angle), -np.sin(angle), 0.0], [np.sin(angle), np.cos(angle), 0.0], [0.0, 0.0, 1.0]])
    slope, slope_faces = sheet(14, 24, 0.03)
    small, small_faces = sheet(5, 5, 0.017)
    lifted = small + [0.0, THICKNESS, 0.0]
    points, triangles = together((slope, slope_faces), (lifted, small_faces))
    cloth = Cloth(points @ turn.T, triangles, pinned=range(len(slope)), gravity=9.81, self_friction=friction)
    end = cloth.run(seconds)[0][len(slope) :]
    travel = ((end - points[len(slope) :] @ turn.T) @ [-np.cos(angle), -np.sin(angle), 0.0]).mean()
    expected = 9.81 * (np.sin(angle) - friction * np.cos(angle)) * seconds**2 / 2 if slides else 0.0
    assert travel == pytest.approx(expected, rel=0.03, abs=2e-4)


def test_lanes_equal_the_single_world():
    vertices, faces = two_sheets(0.012)
    speed = np.zeros((98, 3))
    speed[:49, 1], speed[49:, 0] = 0.5, 0.3
    ends = []
    for width in (1, 16):
        cloth = Cloth(vertices, faces, width)
        cloth.put(cloth.v, speed)
        ends.append(cloth.run(0.05))
    assert np.abs(ends[1] - ends[0]).max() < 2e-5
    assert np.abs(ends[0][0] - vertices - speed * 0.05).max() > 0.003, "they have touched"


def test_lanes_do_not_disturb_each_other():
    """A lane in which nothing touches moves as if it were alone, whatever happens in the others."""
    vertices, faces = two_sheets(0.012)
    cloth = Cloth(vertices, faces, 16)
    speed = np.zeros((16, 98, 3))
    speed[3, :49, 1] = 1.0
    cloth.put(cloth.v, speed)
    end = cloth.run(32 * DT)
    assert np.abs(end[0] - vertices).max() < 1e-6
    assert np.abs(end[3] - vertices - speed[3] * 32 * DT).max() > 0.003


def test_a_world_that_has_diverged_costs_and_changes_the_others_nothing():
    vertices, faces = two_sheets(0.012)
    speed = np.zeros((16, 98, 3))
    speed[:, :49, 1] = 0.5
    ends, counts = [], []
    for broken in (False, True):
        cloth = Cloth(vertices, faces, 16)
        start = np.repeat(vertices[None], 16, axis=0)
        if broken:
            start[5], start[6] = np.nan, np.random.default_rng(0).normal(0.0, 1.0e4, (98, 3))
            start[7] = np.random.default_rng(0).normal(0.0, 1.0, (98, 3))
        cloth.put(cloth.x, start)
        cloth.put(cloth.v, speed)
        assert not cloth.find()
        counts.append(cloth.contact.found.numpy()[0])
        ends.append(np.delete(cloth.run(16 * DT), [5, 6, 7], axis=0))
    assert counts[1] <= counts[0]
    assert np.array_equal(*ends)


def test_the_same_run_twice_is_bitwise_equal():
    vertices, faces = two_sheets(0.01)
    ends = []
    for _ in range(2):
        cloth = Cloth(vertices, faces, 16)
        cloth.put(cloth.v, np.repeat([[0.1, 1.0, 0.0], [0.0, 0.0, 0.0]], 49, axis=0))
        ends.append(cloth.run(0.03))
    assert np.array_equal(*ends)


def test_full_lists_grow():
    vertices, faces = two_sheets(0.004)
    cloth, small = Cloth(vertices, faces), Cloth(vertices, faces)
    small.contact._allocate([5, 3, 1])
    assert not cloth.find()
    assert small.find()
    assert small.contact.pair_count() == cloth.contact.pair_count() > 50
    assert np.array_equal(small.contact.pairs.numpy()[:50], cloth.contact.pairs.numpy()[:50])
    assert not small.find()


def test_the_search_finds_every_near_pair():
    """Against all pairs: vertices over a triangle within the thickness, in a crumpled sheet."""
    rng = np.random.default_rng(3)
    vertices, faces = sheet(12, 12)
    cloth = Cloth(vertices, faces)
    folded = vertices.copy()
    right = folded[:, 0] > 0.01
    folded[right, 0], folded[right, 1] = 0.02 - folded[right, 0], 0.006
    folded += rng.normal(0.0, 0.001, folded.shape)
    cloth.put(cloth.x, folded)
    cloth.find()
    found = cloth.contact.pairs.numpy()[: cloth.contact.pair_count()]
    known = {(p["i0"], *sorted((p["i1"], p["i2"], p["i3"]))) for p in found if p["edges"] == 0}
    corners, rest = folded[faces], vertices[faces]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    expected = 0
    for i in range(len(vertices)):
        offset = folded[i] - corners[:, 0]
        distance = (offset * normal).sum(axis=1)
        foot = folded[i] - distance[:, None] * normal
        sides = [
            (np.cross(corners[:, (k + 1) % 3] - corners[:, k], foot - corners[:, k]) * normal).sum(-1) for k in range(3)
        ]
        over = (np.min(sides, axis=0) > 0.0) & (np.abs(distance) < THICKNESS + 0.002)
        over &= np.linalg.norm(rest - vertices[i], axis=2).min(axis=1) > 2.0 * 0.02
        for t in np.flatnonzero(over):
            expected += 1
            assert (i, *sorted(faces[t])) in known
    assert expected > 8


def test_released_cloth_passes_through_itself():
    vertices, faces = two_sheets(0.006)
    cloth = Cloth(vertices, faces, 16)
    cloth.put(cloth.v, np.repeat([[0.0, 0.6, 0.0], [0.0, 0.0, 0.0]], 49, axis=0))
    mask = np.zeros((98, 16), np.float32)
    mask[:, 1] = 1.0
    cloth.contact.released.assign(mask)
    end = cloth.run(0.03)
    assert (end[1, :49, 1].mean() > end[1, 49:, 1].mean()) and (end[0, :49, 1].mean() < end[0, 49:, 1].mean())


def tubes(inner: float, outer: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Two upright tubes around the y axis with outward normals, and their layers."""
    parts = []
    for radius in (inner, outer):
        around, up = 30, 9
        row, column = np.divmod(np.arange(around * up), around)
        angle = 2.0 * np.pi * (column + 0.5 * (row % 2)) / around
        edge = 2.0 * np.pi * radius / around
        points = np.stack([radius * np.sin(angle), row * edge * 0.87, radius * np.cos(angle)], axis=1)
        faces = []
        for r in range(up - 1):
            for c in range(around):
                a, b = r * around + c, r * around + (c + 1) % around
                d, e = a + around, b + around
                faces += [(a, b, d), (b, e, d)] if r % 2 == 0 else [(a, e, d), (a, b, e)]
        parts.append((points, np.array(faces, dtype=np.int32)))
    vertices, faces = together(*parts)
    return vertices, faces, np.repeat([0, 1], 270)


def test_the_outer_garment_comes_out_of_the_inner_one_and_stays_out():
    """Outer tube laid 2 mm inside the inner one: the order of the layers decides, not where they start."""
    vertices, faces, layer = tubes(0.1, 0.104)
    normal = np.cross(vertices[faces[:, 1]] - vertices[faces[:, 0]], vertices[faces[:, 2]] - vertices[faces[:, 0]])
    assert ((normal * vertices[faces[:, 0]] * [1, 0, 1]).sum(axis=1) > 0.0).all()
    cloth = Cloth(vertices, faces, layer=layer, stretch=100.0, shear=30.0)
    start = vertices.copy()
    start[270:, [0, 2]] *= 0.098 / 0.104
    cloth.put(cloth.x, start)
    cloth.run(0.12)
    end = cloth.get(cloth.x)[0]
    radius = np.linalg.norm(end[:, [0, 2]], axis=1)
    assert radius[270:].mean() - radius[:270].mean() > 0.6 * THICKNESS
    assert crossings(end, faces) == 0
    free = Cloth(vertices, faces, stretch=100.0, shear=30.0)
    free.put(free.x, start)
    stuck = np.linalg.norm(free.run(0.12)[0][:, [0, 2]], axis=1)
    assert stuck[270:].mean() < stuck[:270].mean(), "without layers they keep the sides they start with"


def test_a_corner_that_pokes_through_is_drawn_back():
    vertices, faces = two_sheets(0.006)
    cloth = Cloth(vertices, faces)
    start = vertices.copy()
    start[24, 1] = 0.008
    cloth.put(cloth.x, start)
    cloth.find()
    assert cloth.contact.crossing_count()[0] > 0
    cloth.run(0.1)
    assert cloth.contact.crossing_count()[0] == 0
    end = cloth.get(cloth.x)[0]
    assert crossings(end, faces) == 0
    assert end[24, 1] < end[49:, 1].mean()


def test_a_bump_that_is_through_for_long_is_let_go_and_slides_free():
    """Contact alone would hold a patch of vertices on the side on which it was put."""
    vertices, faces = two_sheets(0.006)
    start = vertices.copy()
    start[:49, 1] += np.where(np.abs(start[:49, [0, 2]]).max(axis=1) < 0.03, 0.012, 0.0)
    cloth = Cloth(vertices, faces, bend=1e-6)
    cloth.put(cloth.x, start)
    ages, counts = [], []
    for _ in range(60):
        cloth.run(8 * DT)
        ages.append(cloth.contact.tangled.numpy().max())
        counts.append(cloth.contact.crossing_count()[0])
    assert counts[0] > 10 and counts[-1] == 0
    assert ages[-1] == 0.0
    cloth.contact.tangled.fill_(5.0)
    cloth.contact.forget()
    assert cloth.contact.tangled.numpy().max() == 0.0


def test_layers_are_checked():
    vertices, faces = two_sheets(0.01)
    rest = RestState.from_mesh(vertices, faces, pieces=2)
    with pytest.raises(ValueError, match="layer: expected integers of shape \\[98\\]"):
        SelfContact(rest, 1, DEVICE, np.zeros(5, dtype=int))
    with pytest.raises(ValueError, match="piece 0 of the mesh has layers \\[0, 1\\]"):
        SelfContact(rest, 1, DEVICE, np.arange(98) % 2)


def test_the_tree_holds_every_triangle_once_and_pieces_apart():
    vertices, faces = two_sheets(0.01)
    tree = TriangleTree.build(vertices, faces, np.repeat([0, 1], 72))
    assert sorted(tree.order) == list(range(144))
    assert (tree.count[tree.leaves] <= 4).all() and tree.count.sum() == 144
    assert sorted(np.concatenate([*tree.levels, tree.leaves])) == list(range(len(tree.first)))
    assert (tree.piece[tree.leaves] >= 0).all() and tree.piece[0] == -1
    assert tree.escape[0] == len(tree.first)
    inner = np.flatnonzero(tree.count == 0)
    assert (tree.right[inner] == tree.escape[inner + 1]).all()
