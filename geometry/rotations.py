"""Rotations in the three forms that the project uses: axis-angle [rad], matrix, and the continuous 6-D form.

The 6-D form is the first two *columns* of the matrix, stacked (Zhou et al. 2019), as the motion CVAE of Shi 2023 uses.
"""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation, Slerp


def axis_angle_to_matrix(axis_angle: np.ndarray) -> np.ndarray:
    """Rotation matrices, shape [..., 3, 3], of axis-angle vectors [rad], shape [..., 3]."""
    flat = np.asarray(axis_angle, dtype=np.float64).reshape(-1, 3)
    return Rotation.from_rotvec(flat).as_matrix().reshape(*np.shape(axis_angle)[:-1], 3, 3)


def matrix_to_axis_angle(matrix: np.ndarray) -> np.ndarray:
    """Axis-angle vectors [rad], shape [..., 3], of rotation matrices, shape [..., 3, 3]."""
    flat = np.asarray(matrix, dtype=np.float64).reshape(-1, 3, 3)
    return Rotation.from_matrix(flat).as_rotvec().reshape(*np.shape(matrix)[:-2], 3)


def matrix_to_6d(matrix: np.ndarray) -> np.ndarray:
    """Continuous 6-D form, shape [..., 6], of rotation matrices, shape [..., 3, 3]."""
    return np.concatenate([matrix[..., :, 0], matrix[..., :, 1]], axis=-1)


def matrix_from_6d(six: np.ndarray) -> np.ndarray:
    """Rotation matrices, shape [..., 3, 3], of the 6-D form by Gram-Schmidt, shape [..., 6]."""
    first = six[..., :3] / np.linalg.norm(six[..., :3], axis=-1, keepdims=True)
    second = six[..., 3:] - (first * six[..., 3:]).sum(-1, keepdims=True) * first
    second = second / np.linalg.norm(second, axis=-1, keepdims=True)
    return np.stack([first, second, np.cross(first, second)], axis=-1)


def axis_angle_to_6d(axis_angle: np.ndarray) -> np.ndarray:
    """6-D form, shape [..., 6], of axis-angle vectors [rad], shape [..., 3]."""
    return matrix_to_6d(axis_angle_to_matrix(axis_angle))


def slerp_poses(pose: np.ndarray, times: np.ndarray, query: np.ndarray) -> np.ndarray:
    """Spherical interpolation of joint rotations.

    Args:
        pose: Axis-angle key poses [rad], shape [K, J, 3].
        times: Increasing key times [s], shape [K].
        query: Times inside the key range [s], shape [T].

    Returns:
        Axis-angle poses [rad], shape [T, J, 3].
    """
    joints = [Slerp(times, Rotation.from_rotvec(pose[:, j]))(query).as_rotvec() for j in range(pose.shape[1])]
    return np.stack(joints, axis=1)
