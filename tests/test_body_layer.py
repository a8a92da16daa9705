"""The differentiable body equals the NumPy body, and the closed-form vertex loss equals the sum over vertices."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from body.model import Body
from geometry.rotations import axis_angle_to_6d
from models.body_layer import BodyLayer, rotation_from_6d

torch.set_num_threads(1)


@pytest.fixture(scope="module")
def body() -> Body:
    return Body.load("small")


@pytest.fixture(scope="module")
def layer(body: Body) -> BodyLayer:
    return BodyLayer(body)


def _motion(seed: int, frames: int = 5) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    return rng.normal(0.0, 0.6, (frames, 24, 3)), rng.normal(0.0, 1.0, (frames, 3))


def _six(pose: np.ndarray) -> torch.Tensor:
    return torch.as_tensor(axis_angle_to_6d(pose).astype(np.float32))


def test_vertices_and_joints_equal_the_numpy_body(body: Body, layer: BodyLayer) -> None:
    pose, root = _motion(0)
    moved = torch.as_tensor(root, dtype=torch.float32)
    np.testing.assert_allclose(layer(_six(pose), moved).numpy(), body.posed(pose, root), atol=1e-5)
    joints = layer.joint_positions(layer.global_rotations(_six(pose)), moved)
    np.testing.assert_allclose(joints.numpy(), body.joint_positions(pose, root), atol=1e-5)


def test_six_numbers_give_a_rotation_whatever_they_are() -> None:
    rotation = rotation_from_6d(torch.randn(50, 6, generator=torch.Generator().manual_seed(1)))
    np.testing.assert_allclose((rotation @ rotation.mT).numpy(), np.broadcast_to(np.eye(3), (50, 3, 3)), atol=1e-5)
    np.testing.assert_allclose(torch.linalg.det(rotation).numpy(), 1.0, atol=1e-5)


def test_closed_form_vertex_error_equals_the_sum_over_vertices(layer: BodyLayer) -> None:
    a, b = _six(_motion(1)[0]), _six(_motion(2)[0])
    brute = (layer(a) - layer(b)).square().sum(-1).mean()
    closed = layer.mean_squared_pose_error(layer.rotation_chain(a), layer.rotation_chain(b))
    assert float(closed) == pytest.approx(float(brute), rel=1e-4)


def test_joints_of_the_chain_are_those_of_the_numpy_body_about_its_pelvis(body: Body, layer: BodyLayer) -> None:
    pose, root = _motion(5)
    joints = body.joint_positions(pose, root)
    found = layer.joints_of_chain(layer.rotation_chain(_six(pose)), (0, 10, 20))
    expected = (joints[:, [0, 10, 20]] - joints[:, :1]).transpose(1, 2, 0)
    np.testing.assert_allclose(found.numpy(), expected, atol=1e-5)


def test_gradients_of_both_forms_agree(layer: BodyLayer) -> None:
    target = _six(_motion(3, 2)[0])
    gradients = []
    for closed in (True, False):
        pose = _six(_motion(4, 2)[0]).requires_grad_()
        if closed:
            error = layer.mean_squared_pose_error(layer.rotation_chain(pose), layer.rotation_chain(target))
        else:
            error = (layer(pose) - layer(target)).square().sum(-1).mean()
        error.backward()
        gradients.append(pose.grad.numpy())
    assert np.abs(gradients[0]).max() > 1e-3
    np.testing.assert_allclose(gradients[0], gradients[1], atol=1e-5)


def test_the_chain_of_rotations_is_that_of_the_skeleton(layer: BodyLayer) -> None:
    pose = torch.stack([_six(_motion(seed)[0]) for seed in (5, 6)])  # [2, 5, 24, 6]
    chain = layer.rotation_chain(pose)[:, :, torch.argsort(torch.tensor(layer.chain))]
    expected = layer.global_rotations(pose).flatten(0, 1).permute(2, 3, 1, 0)
    np.testing.assert_allclose(chain.numpy(), expected.numpy(), atol=1e-5)


def test_wrong_shape_is_named(layer: BodyLayer) -> None:
    with pytest.raises(ValueError, match=r"\[\.\.\., 24, 6\].*\[2, 23, 6\]"):
        layer(torch.zeros(2, 23, 6))
