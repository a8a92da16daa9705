"""Roll-outs that diverge are held near the body."""

from __future__ import annotations

import numpy as np

from evaluation.divergence import FARTHEST, held_near


def test_what_is_near_is_left_alone():
    vertices = np.array([[[0.1, -0.5, FARTHEST]]], dtype=np.float32)
    assert held_near(vertices) is vertices


def test_what_is_far_or_no_number_is_held():
    vertices = np.array([[1e30, -np.inf, 0.3], [np.nan, np.inf, -11.0]], dtype=np.float32)
    expected = np.array([[FARTHEST, -FARTHEST, 0.3], [FARTHEST, FARTHEST, -FARTHEST]], dtype=np.float32)
    np.testing.assert_array_equal(held_near(vertices), expected)
