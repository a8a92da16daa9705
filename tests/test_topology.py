"""Mesh geometry: the quick forms are to the last bit those of NumPy, on which stored data depends."""

from __future__ import annotations

import numpy as np
import pytest

from body.model import Body
from geometry.topology import edge_lengths, face_normals, lengths, normalized, vertex_normals


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_equal_to_numpy_to_the_last_bit(dtype: type) -> None:
    body, rng = Body.load("small"), np.random.default_rng(0)
    vertices = (body.vertices + 0.01 * rng.standard_normal((2, *body.vertices.shape))).astype(dtype)
    faces, edges = body.faces, body.faces[:, :2]
    a, b, c = (vertices[:, faces[:, k]] for k in range(3))
    normals, along = np.cross(b - a, c - a), vertices[:, edges[:, 0]] - vertices[:, edges[:, 1]]
    for found, expected in (
        (face_normals(vertices, faces, unit=False), normals),
        (edge_lengths(vertices, edges), np.linalg.norm(along, axis=-1)),
        (lengths(normals), np.linalg.norm(normals, axis=-1)),
        (normalized(along), along / np.linalg.norm(along, axis=-1, keepdims=True)),
    ):
        assert found.dtype == dtype and np.array_equal(found, expected)
    assert np.array_equal(normalized(np.zeros((1, 3))), np.zeros((1, 3)))


def test_vertex_normals_are_sums_over_faces() -> None:
    body = Body.load("small")
    vertices, summed = body.vertices.astype(float), np.zeros((len(body.vertices), 3))
    for k in range(3):
        np.add.at(summed, body.faces[:, k], face_normals(vertices, body.faces, unit=False))
    expected = summed / np.linalg.norm(summed, axis=1, keepdims=True)
    found = vertex_normals(np.stack([vertices, vertices + 1.0]), body.faces)
    assert np.allclose(found, expected, atol=1e-7)
