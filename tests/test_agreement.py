"""XPBD against implicit Euler on the same scene: the tolerances that ``benchmarks.agreement`` prints, on small meshes.

A method with an error of its own (a wrong stiffness, another standoff, damping that holds cloth back) does not converge
to the other one. XPBD's own error falls with the square of the substep, and that is tested too.
"""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.agreement import (
    WIND,
    apart,
    compare,
    draped_sheet,
    extrapolated,
    hanging_strip,
    row_sags,
    side_held_sheet,
    skirt,
)


@pytest.mark.parametrize("stretch", [100.0, 1000.0])
def test_hanging_strip_has_the_sag_of_statics_in_both(stretch):
    scene = hanging_strip(stretch, rows=17, length=0.5)
    implicit, exact = row_sags(scene, scene.implicit(8)[-1])
    np.testing.assert_allclose(implicit[1:], exact[1:], rtol=0.03)
    results = {n: scene.xpbd(n)[-1] for n in (64, 128)}
    sags = {n: row_sags(scene, frame)[0] for n, frame in results.items()}
    # XPBD hangs lower by its artificial stretch, which knows no material: below g dt^2 n^2 / 2 with n rows ...
    for n, sag in sags.items():
        artificial = sag[-1] - implicit[-1]
        assert 0.0 < artificial < 0.5 * 9.81 * (16.0 / (30.0 * n)) ** 2
    # ... and which goes with the square of the substep, so that two runs tell it from the material's.
    limit = row_sags(scene, extrapolated(results))[0]
    np.testing.assert_allclose(limit, implicit, atol=0.02 * implicit[-1] + 3e-5)


def test_side_held_sheet_shears_alike():
    scene = side_held_sheet(20.0)
    implicit = scene.implicit(4)[-1]
    results = {n: scene.xpbd(n)[-1] for n in (64, 128)}
    fallen = apart(implicit, scene.template.vertices.astype(np.float64))
    assert fallen > 1e-3
    assert apart(results[128], implicit) < 0.05 * fallen
    assert apart(extrapolated(results), implicit) < 0.01 * fallen


@pytest.mark.parametrize("heading", [0.0, 0.7])
def test_strip_in_the_wind_is_lifted_alike(heading):
    scene = hanging_strip(1000.0, rows=13, length=0.4, **(WIND | {"wind_heading": heading}))
    implicit = scene.implicit(4)[-1]
    moved = implicit - scene.template.vertices
    assert np.sqrt((moved**2).sum(axis=1).mean()) > 0.1
    assert (moved[:, 2].mean() > 0.05) and (heading == 0.0 or moved[:, 0].mean() > 2e-4)  # downwind
    np.testing.assert_allclose(scene.xpbd(64)[-1], implicit, atol=0.004)


def test_sheet_on_a_ball_takes_one_shape():
    found = compare("ball", draped_sheet(13, 0.25, 1.0), (32, 64, 128), 8)
    assert found.moved > 0.02 and found.own < 3e-4
    error = {n: np.sqrt((d**2).mean()) for n, d in found.distance.items()}
    assert error[128] < 5e-4 and error[64] < 2e-3
    assert error[32] / error[64] > 2.5 and error[64] / error[128] > 2.5
    assert found.extrapolated < 4e-4
    assert found.distance[128].max() < 2e-3


def test_skirt_at_rest_hangs_in_the_same_folds():
    scene = skirt(320, 1, walking=False)
    implicit = scene.implicit(4)
    assert apart(scene.xpbd(32), implicit) < 1.5e-3
    assert apart(scene.xpbd(128), implicit) < 5e-4


def test_walking_skirt_swings_alike():
    scene = skirt(320, 10, walking=True)
    implicit = scene.implicit(8)
    moved = apart(implicit, scene.template.vertices.astype(np.float64))
    assert moved > 0.04
    assert apart(scene.xpbd(32), implicit) < 0.15 * moved
    # The cached contact planes, and edges that XPBD lifts over the bend of the body, leave 2 mm.
    assert apart(scene.xpbd(128), implicit) < 0.055 * moved
