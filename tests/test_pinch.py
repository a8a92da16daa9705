"""Cloth that the body pinches: it is flagged and counted, takes no part in self-contact, never explodes, recovers."""

from __future__ import annotations

import numpy as np
import pytest

from body.model import Body
from geometry.rotations import axis_angle_to_matrix, matrix_to_axis_angle
from sim.clip_figures import ClipFigures
from sim.crossings import CrossingChecker
from sim.parameters import ENSEMBLE, base_parameters
from sim.settings import SimulationSettings
from sim.simulate import Simulator, World
from tests.test_contact import tube_skirt

SHOULDERS = ((16, -1.0), (17, 1.0))
LEAD = 4
FRAMES = 48
CLOSED, OPEN = (20, 27), 38
"""Frames between which the arms are all the way down, and from which on they are off the hips."""
SETTINGS = SimulationSettings(device="cpu", settle_seconds=0.3)


@pytest.fixture(scope="module")
def body() -> Body:
    return Body.load("small")


@pytest.fixture(scope="module")
def simulator(body) -> Simulator:
    """A tube around the hips, sixteen at once, each on a body of its own."""
    return Simulator(tube_skirt(body), body, SETTINGS, worlds=ENSEMBLE, own_motions=True)


def arms_down(body: Body, angle: float) -> tuple[np.ndarray, np.ndarray]:
    """Both arms come down onto the hips, stay there and go up: at 0.8 rad 16 mm deep, at 0.9 rad 42, at 1 rad 66."""
    pose = np.tile(body.bind_pose().astype(float), (FRAMES, 1, 1))
    share = np.interp(np.arange(FRAMES), [LEAD, *CLOSED, FRAMES - 4], [0.0, 1.0, 1.0, 0.0])
    for joint, side in SHOULDERS:
        hanging = axis_angle_to_matrix(body.bind_pose()[joint].astype(float))
        for frame in range(FRAMES):
            down = axis_angle_to_matrix(np.array([0.0, 0.0, side * angle * share[frame]]))
            pose[frame, joint] = matrix_to_axis_angle(down @ hanging)
    return pose, np.zeros((FRAMES, 3))


ANGLES = (0.8, 0.0, 0.9, 1.0)


@pytest.fixture(scope="module")
def squeezed(body, simulator):
    """Results of worlds whose arms come down by ``ANGLES``, and the flags after each frame, [frames, worlds]."""
    flags = []
    worlds = [World(*arms_down(body, angle), base_parameters()) for angle in ANGLES]
    results = simulator.run_worlds(
        worlds, LEAD, lambda done, total: flags.append((simulator.contact.pinched.numpy() > 0.0).sum(axis=0))
    )
    return results, np.array(flags)[:, : len(ANGLES)]


def test_cloth_is_flagged_while_an_arm_presses_it_on_the_hips(squeezed):
    _, flags = squeezed
    pressed = flags[CLOSED[0] + 1 : CLOSED[1]]
    for lane, angle in enumerate(ANGLES):
        assert (pressed[:, lane] > 0).all() if angle else not flags[:, lane].any(), angle
    assert not flags[: CLOSED[0] // 2].any()


def test_pinched_cloth_does_not_explode_and_recovers(simulator, squeezed):
    results, flags = squeezed
    assert not flags[OPEN:].any()  # a few frames after the arms began to open
    for result in results:
        assert result.failure is None
        strain = np.abs(simulator.rest.edge_strain(result.vertices)).max(axis=1)
        assert strain.max() < 2.0
        assert strain[-6:].max() < 0.1
    untouched = results[ANGLES.index(0.0)].vertices[-1]
    for result in results:  # it hangs as if nothing had been
        assert np.linalg.norm(result.vertices[-1] - untouched, axis=1).max() < 0.05


def test_quality_counts_pinched_cloth(squeezed):
    results, flags = squeezed
    for lane, result in enumerate(results):
        recorded = flags[LEAD:, lane]
        assert result.quality["pinched_vertices"] == recorded.max()
        assert result.quality["pinched_frames"] == (recorded > 0).sum()
        runs = "".join("x" if count else " " for count in recorded).split()
        assert result.quality["longest_pinch_frames"] == max(map(len, runs), default=0)


def test_pinched_cloth_is_let_go_by_self_contact(simulator):
    """What the search for contacts flags is what the search for folds releases: the same memory."""
    assert simulator.folds.released.ptr == simulator.contact.pinched.ptr
    loose = Simulator(simulator.template, simulator.body, SimulationSettings(device="cpu", self_contact=False))
    assert loose.folds is None


def test_figures_of_known_frames():
    figures = ClipFigures(2)
    for pinched in ([[1, 0, 1], [0, 0, 0]], [[1, 0, 0], [0, 1, 0]], [[0, 0, 0]] * 2, [[1, 1, 1], [0, 0, 0]]):
        figures.add_contact(np.array([[0.01, -0.002, 0.0], [0.1, 0.1, 0.1]]), np.array(pinched, dtype=np.float32))
    assert "crossing_pairs" not in figures.of(0)
    for crossings in ([0, 4], [3, 9], [0, 2]):
        figures.add_crossings(np.array(crossings))
    figures.add_triangles(np.array([7, 0]))
    figures.add_triangles(np.array([5, 1]))
    names = ("vertices_inside", "deepest_penetration_m", "triangles_inside_sampled", "pinched_vertices")
    names += ("pinched_frames", "longest_pinch_frames", "crossing_pairs", "crossing_frames")
    assert [figures.of(0)[name] for name in names] == [1, 0.002, 7, 3, 3, 2, 3, 1]
    assert [figures.of(1)[name] for name in names] == [0, 0, 1, 1, 1, 1, 9, 3]


def test_triangles_inside_are_those_of_the_exact_check(body, simulator):
    """Garments pushed into the body, each lane by another way: counted as the survey counts them."""
    check = CrossingChecker(simulator.template.faces, body.faces, "cpu").check
    pose = np.tile(body.bind_pose().astype(float), (ENSEMBLE, 1, 1))
    pose[:, 2, 0] += np.linspace(0.0, 0.5, ENSEMBLE)
    transforms, posed = body.joint_transforms(pose, np.zeros((ENSEMBLE, 3))), body.posed(pose, np.zeros((ENSEMBLE, 3)))
    origins = np.tile(body.joints[0].astype(float), (ENSEMBLE, 1))
    cloth = simulator.rest.vertices + np.linspace(0.0, 0.05, ENSEMBLE)[:, None, None] * [0.6, 0.0, 0.8]
    simulator.solver.set_parameters(base_parameters(), 1.0 / 960.0)
    simulator.solver.place(cloth, None, transforms, origins, passes=0)
    counted = simulator.pokes.count(simulator.solver.x)
    exact = [int(check(cloth[lane], posed[lane]).triangle_inside.sum()) for lane in range(ENSEMBLE)]
    assert counted.tolist() == exact
    assert exact[0] == 0 and exact[-1] > 50


def test_crossings_are_counted_in_what_was_recorded(body, simulator, monkeypatch):
    """Each count belongs to the end of one recorded frame, the last one too, which no other search follows."""
    folds, at_search, counted = simulator.folds, [], []
    find = folds.find

    def watched(substeps, parameters, x, v):
        at_search[:] = [x.numpy().reshape(-1, 3, ENSEMBLE).transpose(2, 0, 1).copy()]
        return find(substeps, parameters, x, v)

    def count():
        counted.append(at_search[0])
        return np.full(ENSEMBLE, len(counted) % 3)

    monkeypatch.setattr(folds, "find", watched)
    monkeypatch.setattr(folds, "crossing_count", count)
    pose, root = (array[18:26] for array in arms_down(body, 0.8))
    (result,) = simulator.run_worlds([World(pose, root, base_parameters())], 2)
    assert len(counted) == len(result.vertices) == 6
    for x, recorded in zip(counted, result.vertices):  # the pelvis, their origin, stays where it is
        np.testing.assert_allclose(x[0] + body.joints[0], recorded, atol=1e-6)
    assert (result.quality["crossing_pairs"], result.quality["crossing_frames"]) == (2, 4)


def test_edges_that_pierce_triangles_tell_how_many_pairs_cross(body, simulator):
    """The front of the tube pushed through its back: along a contour there is about one for each pair."""
    check = CrossingChecker(simulator.template.faces, body.faces, "cpu").check
    push = np.linspace(0.0, 0.4, ENSEMBLE)[:, None]
    cloth = np.repeat(simulator.rest.vertices[None], ENSEMBLE, axis=0)
    front = (cloth[0, :, 2] > 0.05) & (cloth[0, :, 1] < 0.95)
    cloth[:, front] -= push[..., None] * [0.05, 0.1, 1.0]
    solver, bind = simulator.solver, np.tile(np.eye(4), (ENSEMBLE, len(body.joints), 1, 1))
    solver.set_parameters(base_parameters(), 1.0 / 960.0)
    solver.place(cloth, None, bind, np.tile(body.joints[0].astype(float), (ENSEMBLE, 1)), passes=0)
    counted = simulator.folds.count_crossings(solver.parameters, solver.x, solver.v)
    pairs = np.array([check(one, body.vertices + 10.0).self_pairs for one in cloth])
    assert pairs[0] == counted[0] == 0 and pairs.max() > 50
    assert (np.abs(counted - pairs) <= 0.2 * pairs).all()
