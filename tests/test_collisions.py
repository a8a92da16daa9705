"""Contact of garments with a body: what is not looked up has to come out as if it were."""

from __future__ import annotations

import numpy as np
import pytest

from body.model import Body
from evaluation.collisions import LOOK_UP, Contact, KnownGarment, contacts
from geometry.proximity import SurfaceQuery
from geometry.topology import vertex_normals


@pytest.fixture(scope="module")
def scene() -> tuple[SurfaceQuery, np.ndarray, np.ndarray]:
    """A body in two poses and a tight garment around it, 1 to 50 mm away."""
    body, rng = Body.load("small"), np.random.default_rng(0)
    pose = 0.1 * rng.standard_normal((2, 24, 3))
    posed = body.posed(pose, np.zeros((2, 3)))
    torso = np.flatnonzero(np.isin(body.part_of_vertex, (3, 6, 9)))[::3]
    away = rng.uniform(0.001, 0.05, (2, len(torso), 1))
    garment = posed[:, torso] + away * vertex_normals(posed, body.faces)[:, torso]
    return SurfaceQuery(body.faces, len(body.vertices)), posed, garment.astype(np.float32)


@pytest.mark.parametrize("spread", [0.0, 0.003, 0.02])
def test_contact_equals_a_query_of_every_vertex(scene, spread: float) -> None:
    surface, posed, truth = scene
    moved = (truth + spread * np.random.default_rng(1).standard_normal(truth.shape)).astype(np.float32)
    expected = Contact()
    for vertices, under in zip(moved, posed, strict=True):
        expected.add(surface.query(vertices, under).distance)
    found = contacts({"moved": moved, "truth": truth}, truth, surface, posed)
    assert vars(found["moved"]) == vars(expected)
    assert list(found) == ["moved", "truth"] and found["truth"].below == 0
    if spread == 0.02:
        assert 0 < expected.below < expected.near < expected.count


def test_distances_are_exact_near_the_body_and_never_too_large(scene) -> None:
    surface, posed, truth = scene
    moved = truth[0] + np.float32(0.004) * np.random.default_rng(2).standard_normal(truth[0].shape).astype(np.float32)
    exact = surface.query(moved, posed[0]).distance
    found = KnownGarment(truth[0], surface.at(posed[0])).distances(moved)
    near = exact < LOOK_UP
    assert near.any() and np.array_equal(found[near], exact[near])
    assert (found[~near] > LOOK_UP - 1e-9).all() and (found <= exact + 1e-9).all()
    assert (found < exact - 1e-6).any()  # some were not looked up
