"""Sixteen worlds at once against the same worlds one by one."""

from __future__ import annotations

import numpy as np
import pytest

from body.model import Body
from garments.build import build_template
from garments.spec import GarmentSpec
from sim.parameters import ENSEMBLE, base_parameters, sample_parameters
from sim.settings import SimulationSettings
from sim.simulate import Simulator, World

LEAD = 4
SETTINGS = SimulationSettings(device="cpu", settle_seconds=0.2)
# Stiff in bending: limp cloth magnifies a last digit to centimetres within seconds, whatever computes it.
STIFF = {"bend": 2.0e-3, "substeps": 12, "stretch": 2000.0}
RANGES = {"density": (0.1, 0.4), "friction": (0.1, 0.8), "gravity": (7.0, 12.0), "time_scale": (0.8, 1.2)}


@pytest.fixture(scope="module")
def body() -> Body:
    return Body.load("small")


@pytest.fixture(scope="module")
def skirt(body):
    return build_template(GarmentSpec(name="skirt", kind="skirt", vertices=200), body)


def step(body: Body, turn: float = 0.4, frames: int = 12) -> tuple[np.ndarray, np.ndarray]:
    """From the bind pose into a step."""
    pose = np.tile(body.bind_pose().astype(float), (frames, 1, 1))
    s = np.linspace(0.0, 1.0, frames) ** 2 * (3.0 - 2.0 * np.linspace(0.0, 1.0, frames))
    pose[:, 1, 0] -= 0.5 * s
    pose[:, 2, 0] += 0.3 * s
    pose[:, 0, 1] += turn * s
    return pose, np.stack([0.1 * s, -0.03 * s, 0.2 * s], axis=1)


@pytest.fixture(scope="module")
def sets() -> list[dict[str, float]]:
    base = base_parameters(STIFF)
    return [sample_parameters(base, RANGES, 1, "test", index) for index in range(ENSEMBLE)]


@pytest.fixture(scope="module")
def single(body, skirt) -> Simulator:
    return Simulator(skirt, body, SETTINGS)


@pytest.fixture(scope="module")
def together(body, skirt) -> Simulator:
    return Simulator(skirt, body, SETTINGS, worlds=ENSEMBLE)


def test_worlds_that_share_a_motion_are_those_that_run_alone(body, single, together, sets):
    pose, root = step(body)
    results = together.run_worlds([World(pose, root, one) for one in sets], LEAD)
    assert len(results) == ENSEMBLE
    for lane in (0, 3, 15):
        alone = single.run(pose, root, LEAD, sets[lane])
        assert np.abs(results[lane].vertices - alone.vertices).max() < 5e-4
        for name in ("p99_edge_strain", "max_edge_strain", "residual_speed_m_s"):
            assert results[lane].quality[name] == pytest.approx(alone.quality[name], rel=0.05, abs=2e-3)
    spread = np.ptp([result.vertices[-1] for result in results], axis=0).max()
    assert spread > 5e-3  # the sets do differ


def test_worlds_with_their_own_motions_are_those_that_run_alone(body, skirt, single, sets):
    own = Simulator(skirt, body, SETTINGS, worlds=ENSEMBLE, own_motions=True)
    worlds = [World(*step(body, turn), one) for turn, one in zip(np.linspace(-0.5, 0.5, 5), sets)]
    results = own.run_worlds(worlds, LEAD)  # fewer than the lanes
    assert len(results) == 5
    for lane in (0, 4):
        alone = single.run(worlds[lane].pose, worlds[lane].root, LEAD, sets[lane])
        assert np.abs(results[lane].vertices - alone.vertices).max() < 5e-4


def test_a_world_that_diverges_leaves_the_others_alone(body, together, sets):
    pose, root = step(body)
    good = together.run_worlds([World(pose, root, one) for one in sets[:3]], LEAD)
    # Cloth without stretch stiffness to speak of, in strong gravity, is torn.
    limp = sets[1] | {"stretch": 1.0, "shear": 0.1, "gravity": 30.0, "density": 2.0}
    mixed = together.run_worlds([World(pose, root, one) for one in (sets[0], limp, sets[2])], LEAD)
    assert "strained" in mixed[1].failure and good[1].failure is None
    assert np.isfinite(mixed[1].vertices).all()
    for lane in (0, 2):
        assert mixed[lane].failure is None
        assert np.abs(mixed[lane].vertices - good[lane].vertices).max() < 5e-4


def test_the_same_run_twice_is_bitwise_equal(body, together, sets):
    worlds = [World(*step(body), one) for one in sets]
    first, second = together.run_worlds(worlds, LEAD), together.run_worlds(worlds, LEAD)
    assert all(np.array_equal(a.vertices, b.vertices) for a, b in zip(first, second))


def test_worlds_that_cannot_go_together_are_refused(body, together, sets):
    pose, root = step(body)
    world = World(pose, root, sets[0])
    with pytest.raises(ValueError, match="17 worlds: allowed are 1 to 16"):
        together.run_worlds([world] * 17, LEAD)
    with pytest.raises(ValueError, match="world 1 moves unlike world 0"):
        together.run_worlds([world, World(*step(body, 0.1), sets[1])], LEAD)
    with pytest.raises(ValueError, match="world 1 has 11 frames, world 0 has 12"):
        together.run_worlds([world, World(pose[:-1], root[:-1], sets[1])], LEAD)
    with pytest.raises(ValueError, match=r"substeps = \[12, 20\]"):
        together.run_worlds([world, World(pose, root, sets[1] | {"substeps": 20.0})], LEAD)
