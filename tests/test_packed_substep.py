"""Packs of sixteen against one world in one lane: the same arithmetic, so the same results up to rounding."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest
import warp as wp

from sim.body_contact import BodyContact
from sim.compile import compile_kernels, resolve_device
from sim.kernels.lanes import scalars, vectors
from sim.kernels.parameters import substep_constants
from sim.lane_substep import LaneSubstep, State
from sim.packed_substep import PackedSubstep
from sim.parameters import base_parameters
from sim.rest_state import RestState

DEVICE = resolve_device("cpu")
DT = 1.0 / 960.0
VALUES = {
    "air_drag": 0.2,
    "wind_speed": 1.0,
    "bend": 1.0e-4,
    "bend_damping": 1.0e-3,
    "bend_yield": 20.0,
    "friction": 0.4,
}


@pytest.fixture(scope="module", autouse=True)
def compiled():
    compile_kernels("cpu")


class Planes(BodyContact):
    """Contact planes as ``BodyContact`` has them, near some of the vertices."""

    def __init__(self, x: np.ndarray, rng: np.random.Generator):
        count = len(x)
        normal = rng.normal(size=(count, 3))
        normal /= np.linalg.norm(normal, axis=1, keepdims=True)
        point = x + 0.001 * rng.normal(size=(count, 3))
        values = point, 0.01 * rng.normal(size=(count, 3)), normal, 0.1 * rng.normal(size=(count, 3))
        self.device, self.count, self.width = DEVICE, count, 1
        self.planes = [wp.array(each.astype(np.float32), dtype=vectors(1), device=DEVICE) for each in values]
        self.near = wp.array((rng.random(count) < 0.6).astype(np.int32), dtype=int, device=DEVICE)
        gap = rng.uniform(0.001, 0.004, (count, 1)).astype(np.float32)
        self.clearance = wp.array(gap, dtype=scalars(1), device=DEVICE)


def cloth(side: int) -> tuple[RestState, np.random.Generator]:
    """Square sheet whose numbers of vertices, triangles and hinges are no multiples of sixteen; two pins."""
    rng = np.random.default_rng(side)
    row, column = np.divmod(np.arange(side * side), side)
    vertices = np.stack([0.01 * column, -0.01 * row, 0.0 * row], axis=1)
    vertices[:, :2] += rng.normal(0.0, 0.001, (side * side, 2))
    corner = (np.arange(side - 1)[:, None] * side + np.arange(side - 1)).ravel()
    right, down, across = corner + 1, corner + side, corner + side + 1
    faces = np.concatenate([np.stack([corner, down, right], axis=1), np.stack([right, down, across], axis=1)])
    return RestState.from_mesh(vertices, faces.astype(np.int32), np.array([0, side * side - 2], dtype=np.int32)), rng


def pair(side: int, touching: bool = False) -> list[LaneSubstep | PackedSubstep]:
    """Both kinds of substep from the same crumpled and moving state."""
    substeps = []
    for kind in (LaneSubstep, PackedSubstep):
        rest, rng = cloth(side)
        state = State.zero(rest, 1, DEVICE)
        count = len(rest.vertices)
        x = rest.vertices + rng.normal(0.0, 0.001, (count, 3))
        normals = rng.normal(size=(count, 3))
        state.x.assign(x)
        state.v.assign(rng.normal(size=(count, 3)))
        state.normals.assign(normals / np.linalg.norm(normals, axis=1, keepdims=True))
        state.parameters.assign(substep_constants(base_parameters(VALUES), DT, max_speed=2.5)[:, None])
        substeps.append(kind(rest, state, Planes(x, rng) if touching else None, DEVICE))
    return substeps


def after(substep: LaneSubstep | PackedSubstep, step: Callable) -> list[np.ndarray]:
    """Positions, velocities, positions before and predicted positions after a step."""
    step(substep)
    state = substep.state
    return [values.numpy().copy() for values in (state.x, state.v, state.x_prev, state.x_pred)]


def compare(lane: LaneSubstep, packed: PackedSubstep, step: Callable) -> None:
    """One step of both: positions within 1e-7 m, velocities within what that is over a substep."""
    before = after(lane, lambda _: None)
    expected, got = after(lane, step), after(packed, step)
    assert any(np.abs(e - b).max() > 1e-5 for e, b in zip(expected, before))
    for e, g, limit in zip(expected, got, (1e-7, 1e-7 / DT, 1e-7, 1e-7)):
        assert np.abs(e - g).max() < limit


@pytest.mark.parametrize("touching", [False, True])
@pytest.mark.parametrize("side", [4, 5, 9])
def test_substeps(side, touching):
    lane, packed = pair(side, touching)
    compare(lane, packed, lambda s: s.begin())
    compare(lane, packed, lambda s: s.solve_membrane())
    compare(lane, packed, lambda s: s.end(0.25, 0.25, True))
    compare(lane, packed, lambda s: s.solve_bending(2.0, False))
    compare(lane, packed, lambda s: s.end(0.5, 0.25, False))


@pytest.mark.parametrize("side", [4, 9])
def test_normals(side):
    """Unit normals weighted by area, against NumPy."""
    for substep in pair(side):
        x, faces = substep.state.x.numpy().astype(float), cloth(side)[0].topology.faces
        expected = np.zeros_like(x)
        for corner in range(3):
            np.add.at(
                expected, faces[:, corner], np.cross(x[faces[:, 1]] - x[faces[:, 0]], x[faces[:, 2]] - x[faces[:, 0]])
            )
        expected /= np.linalg.norm(expected, axis=1, keepdims=True)
        substep.find_normals()
        assert np.abs(substep.state.normals.numpy() - expected).max() < 1e-4


@pytest.mark.parametrize("side", [4, 9])
def test_damping(side):
    compare(*pair(side), lambda s: s.damp(4.0))


@pytest.mark.parametrize("side", [4, 9])
def test_creases(side):
    lane, packed = pair(side)
    for substep in (lane, packed):
        substep.crease_where_bent()
        assert np.abs(substep.crease.numpy()).max() > 0.0
    compare(lane, packed, lambda s: s.solve_bending(2.0, True))
    assert not np.allclose(
        lane.state.x.numpy(), after(pair(side)[0], lambda s: s.solve_bending(2.0, False))[0], atol=1e-6
    )


def test_fewer_vertices_than_a_pack_are_refused():
    rest, _ = cloth(3)
    with pytest.raises(ValueError, match="9 vertices: packs need 16 or more"):
        PackedSubstep(rest, State.zero(rest, 1, DEVICE), None, DEVICE)
