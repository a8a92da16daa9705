"""A skinned human body that SMPL pose vectors drive.

In: a body name (or the arrays themselves), poses as axis-angle ``[T, 24, 3]`` [rad] in SMPL joint order and root
translations ``[T, 3]`` [m]. Out: joint frames and posed vertices [m], y up, facing +z, left along +x.

The vertices are stored in their *bind pose* (an A-pose), while SMPL's zero pose is a T-pose. ``bind_rotation`` holds
the global rotation B_j of each joint from the T-pose to the bind, so that linear blend skinning reads
``x = sum_j w_j (G_j(theta) B_j^T (v - J_j) + p_j(theta))`` (Loper et al. 2015, eq. 2-4; for a body that is bound in the
T-pose, B_j = I and this is SMPL's own formula).

Shapes: T frames, B body vertices, F faces, J = 24 joints.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from body.skeleton import JOINT_COUNT, JOINT_NAMES, PARENTS
from geometry.rotations import axis_angle_to_matrix, matrix_to_axis_angle

DATA_FOLDER = Path(__file__).parent / "data"

BODY_NAMES: tuple[str, ...] = ("full", "small")
"""Bodies that come with the project: 6,890 vertices for results, 1,229 for tests and smoke runs."""

FRAMES_PER_CHUNK = 32  # bounds the temporary memory of skinning: 32 frames of 6,890 vertices are 2.6 MB


@dataclass(frozen=True, eq=False)  # compared by identity: arrays have no truth value
class Body:
    """A body surface with its skeleton, skinning weights and shape components.

    Attributes:
        name: Name under which the body was loaded.
        vertices: Bind-pose (A-pose) vertices [m], shape [B, 3].
        faces: Outward oriented triangles of a closed surface, shape [F, 3].
        joints: Bind-pose joint positions [m], shape [24, 3].
        parents: Parent joints, -1 for the root, shape [24].
        skin_index: The four joints of each vertex, heaviest first, shape [B, 4].
        skin_weight: Their weights, summing to one, shape [B, 4].
        shape_basis: Vertex offsets for one standard deviation of each shape component [m], shape [B, 3, 10].
        joint_basis: Joint offsets for the same components [m], shape [24, 3, 10].
        bind_rotation: Global rotation of each joint from SMPL's T-pose to the bind pose, shape [24, 3, 3].
    """

    name: str
    vertices: np.ndarray
    faces: np.ndarray
    joints: np.ndarray
    parents: np.ndarray
    skin_index: np.ndarray
    skin_weight: np.ndarray
    shape_basis: np.ndarray
    joint_basis: np.ndarray
    bind_rotation: np.ndarray

    @classmethod
    def load(cls, name: str) -> Body:
        """Load a body of the project by its name; raises ``ValueError`` naming the known bodies."""
        if name not in BODY_NAMES:
            raise ValueError(f"unknown body {name!r}: the known bodies are {', '.join(BODY_NAMES)}")
        with np.load(DATA_FOLDER / f"body_{name}.npz", allow_pickle=False) as data:
            weight = data["skin_weight"].astype(np.float32)
            return cls(
                name=name,
                vertices=data["vertices"].astype(np.float32),
                faces=data["faces"].astype(np.int32),
                joints=data["joints"].astype(np.float32),
                parents=np.array(PARENTS, dtype=np.int32),
                skin_index=data["skin_index"].astype(np.int32),
                skin_weight=weight / weight.sum(axis=1, keepdims=True),
                shape_basis=data["shape_basis"].astype(np.float32),
                joint_basis=data["joint_basis"].astype(np.float32),
                bind_rotation=data["bind_rotation"].astype(np.float64),
            )

    @cached_property
    def digest(self) -> str:
        """Short SHA-256 of the topology (faces and vertex count): the same for every shape of one body."""
        content = hashlib.sha256(np.int64(len(self.vertices)).tobytes())
        content.update(np.ascontiguousarray(self.faces, dtype="<i4").tobytes())
        return content.hexdigest()[:16]

    @cached_property
    def part_of_vertex(self) -> np.ndarray:
        """The joint with the largest weight at each vertex, shape [B]."""
        return self.skin_index[np.arange(len(self.skin_index)), self.skin_weight.argmax(axis=1)]

    def shaped(self, beta: np.ndarray) -> Body:
        """The body with shape components applied, standing on the ground again.

        Args:
            beta: Shape coefficients in standard deviations, shape [<= 10]; missing ones are zero.

        Raises:
            ValueError: More coefficients than the body has components, or not one-dimensional.
        """
        beta = np.asarray(beta, dtype=np.float64)
        components = self.shape_basis.shape[-1]
        if beta.ndim != 1 or len(beta) > components:
            raise ValueError(f"beta: expected shape [<= {components}], got {list(beta.shape)}")
        if not np.isfinite(beta).all():
            raise ValueError("beta: expected finite coefficients, got a NaN or an infinity")
        used = len(beta)
        moved = replace(
            self,
            vertices=(self.vertices + self.shape_basis[..., :used] @ beta).astype(np.float32),
            joints=(self.joints + self.joint_basis[..., :used] @ beta).astype(np.float32),
        )
        return moved.grounded()

    def grounded(self) -> Body:
        """The body shifted vertically so that its lowest vertex is at y = 0 in the zero pose."""
        lift = np.array([0.0, self.posed(np.zeros((1, JOINT_COUNT, 3)), np.zeros((1, 3)))[..., 1].min(), 0.0])
        return replace(
            self,
            vertices=(self.vertices - lift).astype(np.float32),
            joints=(self.joints - lift).astype(np.float32),
        )

    def bind_pose(self) -> np.ndarray:
        """The SMPL pose [rad] that reproduces the bind vertices, shape [24, 3]."""
        local = self.bind_rotation.copy()
        for joint, parent in enumerate(self.parents):
            if parent >= 0:
                local[joint] = self.bind_rotation[parent].T @ self.bind_rotation[joint]
        return matrix_to_axis_angle(local).astype(np.float32)

    def joint_frames(self, pose: np.ndarray, root: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Forward kinematics: global joint rotations [T, 24, 3, 3] (from the T-pose) and positions [T, 24, 3] [m].

        Raises:
            ValueError: ``pose`` is not [T, 24, 3], or ``root`` is not [T, 3] with the same T.
        """
        pose, root = checked_motion(pose, root)
        local = axis_angle_to_matrix(pose)
        rotation = np.empty_like(local)
        position = np.empty(pose.shape)
        joints = self.joints.astype(np.float64)
        for joint, parent in enumerate(self.parents):
            if parent < 0:
                rotation[:, joint] = local[:, joint]
                position[:, joint] = joints[joint] + root
                continue
            rest_offset = self.bind_rotation[parent].T @ (joints[joint] - joints[parent])
            rotation[:, joint] = rotation[:, parent] @ local[:, joint]
            position[:, joint] = position[:, parent] + rotation[:, parent] @ rest_offset
        return rotation, position

    def joint_transforms(self, pose: np.ndarray, root: np.ndarray) -> np.ndarray:
        """Skinning transforms: matrices that map bind-space points [m] to the world, shape [T, 24, 4, 4]."""
        rotation, position = self.joint_frames(pose, root)
        linear = rotation @ self.bind_rotation.transpose(0, 2, 1)
        transforms = np.zeros((*position.shape[:2], 4, 4))
        transforms[..., :3, :3] = linear
        transforms[..., :3, 3] = position - np.einsum("tjab,jb->tja", linear, self.joints.astype(np.float64))
        transforms[..., 3, 3] = 1.0
        return transforms

    def joint_positions(self, pose: np.ndarray, root: np.ndarray) -> np.ndarray:
        """World positions of the joints [m], shape [T, 24, 3]."""
        return self.joint_frames(pose, root)[1].astype(np.float32)

    def pelvis_frames(self, pose: np.ndarray, root: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Rotation [T, 3, 3] and world position [T, 3] [m] of the pelvis: the frame of the canonical coordinates."""
        pose, root = checked_motion(pose, root)
        return axis_angle_to_matrix(pose[:, 0]), self.joints[0].astype(np.float64) + root

    def posed(self, pose: np.ndarray, root: np.ndarray) -> np.ndarray:
        """Vertices of the posed body [m], shape [T, B, 3] float32."""
        return apply_skin(self._skin_matrix, self.joint_transforms(pose, root))

    @cached_property
    def _skin_matrix(self) -> np.ndarray:
        return skin_matrix(self.vertices, self.skin_index, self.skin_weight)


def skin(points: np.ndarray, index: np.ndarray, weight: np.ndarray, transforms: np.ndarray) -> np.ndarray:
    """Linear blend skinning of any points that carry joint weights (a garment's pins, a baseline).

    Args:
        points: Bind-space points [m], shape [N, 3].
        index: Joints of each point, shape [N, K].
        weight: Their weights, shape [N, K].
        transforms: Skinning transforms of ``Body.joint_transforms``, shape [T, 24, 4, 4].

    Returns:
        World points [m], shape [T, N, 3] float32.
    """
    return apply_skin(skin_matrix(points, index, weight), transforms)


def skin_matrix(points: np.ndarray, index: np.ndarray, weight: np.ndarray) -> np.ndarray:
    """Weighted homogeneous points ``w_j (x, y, z, 1)``, shape [N, 24 * 4]: skinning becomes one matrix product."""
    points, index, weight = np.asarray(points), np.asarray(index), np.asarray(weight)
    if points.ndim != 2 or points.shape[1] != 3:
        raise ValueError(f"points: expected shape [N, 3], got {list(points.shape)}")
    if index.shape != weight.shape or index.ndim != 2 or len(index) != len(points):
        raise ValueError(
            f"skin weights: expected index and weight of one shape [{len(points)}, K], "
            f"got {list(index.shape)} and {list(weight.shape)}"
        )
    if index.size and (index.min() < 0 or index.max() >= JOINT_COUNT):
        raise ValueError(f"skin index: expected 0..{JOINT_COUNT - 1}, got {index.min()}..{index.max()}")
    dense = np.zeros((len(points), JOINT_COUNT), dtype=np.float32)
    np.add.at(dense, (np.arange(len(points))[:, None], index), weight)
    homogeneous = np.concatenate([points, np.ones((len(points), 1))], axis=1).astype(np.float32)
    return (dense[:, :, None] * homogeneous[:, None, :]).reshape(len(points), JOINT_COUNT * 4)


def apply_skin(matrix: np.ndarray, transforms: np.ndarray) -> np.ndarray:
    """World points [m], shape [T, N, 3] float32, of a :func:`skin_matrix` and skinning transforms [T, 24, 4, 4]."""
    if transforms.ndim != 4 or transforms.shape[1:] != (JOINT_COUNT, 4, 4):
        raise ValueError(f"transforms: expected shape [T, {JOINT_COUNT}, 4, 4], got {list(transforms.shape)}")
    frames = len(transforms)
    columns = transforms[:, :, :3, :].transpose(1, 3, 0, 2).astype(np.float32)  # [24, 4, T, 3]
    world = np.empty((frames, len(matrix), 3), dtype=np.float32)
    for start in range(0, frames, FRAMES_PER_CHUNK):
        chunk = columns[:, :, start : start + FRAMES_PER_CHUNK]
        count = chunk.shape[2]
        product = matrix @ chunk.reshape(JOINT_COUNT * 4, count * 3)
        world[start : start + count] = product.reshape(len(matrix), count, 3).transpose(1, 0, 2)
    return world


def checked_motion(pose: np.ndarray, root: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """``pose [T, 24, 3]`` and ``root [T, 3]`` as float64; raises ``ValueError`` saying what is wrong."""
    pose, root = np.asarray(pose, dtype=np.float64), np.asarray(root, dtype=np.float64)
    if pose.ndim != 3 or pose.shape[1:] != (JOINT_COUNT, 3):
        raise ValueError(f"pose: expected shape [T, {JOINT_COUNT}, 3], got {list(pose.shape)}")
    if root.shape != (len(pose), 3):
        raise ValueError(f"root: expected shape [{len(pose)}, 3] to match the pose, got {list(root.shape)}")
    for name, values in (("pose", pose), ("root", root)):
        if not np.isfinite(values).all():
            frame = int(np.argwhere(~np.isfinite(values))[0, 0])
            raise ValueError(f"{name}: expected finite values, got a NaN or an infinity in frame {frame}")
    return pose, root


__all__ = ["BODY_NAMES", "JOINT_NAMES", "PARENTS", "Body", "apply_skin", "checked_motion", "skin", "skin_matrix"]
