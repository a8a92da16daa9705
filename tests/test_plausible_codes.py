"""The ellipsoid of plausible codes: what lies inside stays, what lies outside goes to the nearest point of it."""

from __future__ import annotations

import numpy as np
import pytest

from models.plausible_codes import PlausibleCodes


def some_codes(count: int = 500) -> np.ndarray:
    rng = np.random.default_rng(0)
    turn = np.linalg.qr(rng.normal(size=(4, 4)))[0]
    return ((rng.normal(size=(count, 4)) * [3.0, 1.0, 0.3, 0.05]) @ turn + [1.0, 2.0, 3.0, 4.0]).astype(np.float32)


def test_the_ellipsoid_holds_its_share_and_leaves_what_is_inside():
    codes = some_codes()
    near = PlausibleCodes.of(codes, 0.8)
    inside = near.distances(codes) <= near.radius
    assert inside.mean() == pytest.approx(0.8, abs=0.01)
    assert np.array_equal(near.nearest(codes)[inside], codes[inside])


def test_codes_outside_go_to_the_nearest_point_of_the_surface():
    near = PlausibleCodes.of(some_codes(), 0.5)
    far = some_codes(40)[20:] * np.float32(3.0)
    moved = near.nearest(far)
    assert near.distances(moved) == pytest.approx(np.full(20, near.radius), rel=1e-3)
    # No other point of the surface is nearer.
    ball = np.random.default_rng(1).normal(size=(20000, 4))
    ball *= near.radius / np.linalg.norm(ball, axis=1, keepdims=True)
    surface = (ball * near.deviations) @ near.axes.T + near.mean
    least = np.linalg.norm(far[:, None] - surface[None], axis=2).min(axis=1)
    assert (np.linalg.norm(far - moved, axis=1) <= least * (1 + 1e-5)).all()


def test_a_direction_in_which_nothing_varies_is_kept_still():
    codes = some_codes()
    codes[:, 2] = 7.0
    near = PlausibleCodes.of(codes, 0.5)
    moved = near.nearest(codes[:1] + np.float32([0.0, 0.0, 50.0, 0.0]))
    assert np.isfinite(moved).all()
    assert moved[0, 2] == pytest.approx(7.0, abs=1e-2)


def test_wrong_codes_are_refused():
    with pytest.raises(ValueError, match="expected shape"):
        PlausibleCodes.of(np.zeros((1, 3)))
    with pytest.raises(ValueError, match="share must be above 0"):
        PlausibleCodes.of(some_codes(), 0.0)
