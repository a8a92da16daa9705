"""Differentiable body: 6-D poses to joints and skinned vertices, and the vertex loss in closed form (Shi 2023, Eq. 1).

In: rotations in the 6-D form, relative to the SMPL T-pose. Out: what ``body.model.Body`` gives, with gradients.

Linear-blend-skinned vertices are linear in the joint transforms: ``V = A T`` with ``A [B, 96]`` from the skin weights
and rest vertices, and ``T [96, 3]`` the 24 transforms (three rows of 4x4 matrices) on top of each other. With the root
at rest the transforms are in turn linear in the world rotations, ``T = L G + constant`` with ``G [72, 3]``. The summed
squared vertex error is therefore ``||A L dG||^2 = ||S dG||^2`` with ``S [72, 72]`` of ``A L = QS``, the Cholesky factor
of a Gram matrix. It costs the same for any number of vertices and needs neither joints nor transforms.

What is left to pay for is the chain of rotations. Its matrices lie with the frames innermost, ``[3, 3, joints,
frames]``: products of 3x3 matrices are then sums of long rows, five times as fast on a CPU as batched products.

Dimensions: J = 24 joints, B body vertices, ... any leading shape (clips, frames).
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch
from torch import Tensor, nn

from body.model import Body, skin_matrix


def rotation_from_6d(six: Tensor) -> Tensor:
    """Rotation matrices [..., 3, 3] of 6-D forms [..., 6] (first two columns), by Gram-Schmidt (Zhou 2019)."""
    first = nn.functional.normalize(six[..., :3], dim=-1)
    second = six[..., 3:] - (first * six[..., 3:]).sum(-1, keepdim=True) * first
    second = nn.functional.normalize(second, dim=-1)
    return torch.stack([first, second, torch.linalg.cross(first, second)], dim=-1)


def _rotation_rows(six: Tensor) -> Tensor:
    """Rotation matrices [3, 3, ...] of 6-D forms [6, ...], as ``rotation_from_6d``, with the numbers in front."""
    first = six[:3] * six[:3].square().sum(0).clamp_min(1e-24).rsqrt()
    second = six[3:] - (first * six[3:]).sum(0) * first
    second = second * second.square().sum(0).clamp_min(1e-24).rsqrt()
    turned, ahead = [1, 2, 0], [2, 0, 1]
    third = first[turned] * second[ahead] - first[ahead] * second[turned]
    return torch.stack([first, second, third], dim=1)


class BodyLayer(nn.Module):
    """The NumPy body's skeleton and skin as a layer; it has buffers and nothing to train."""

    def __init__(self, body: Body) -> None:
        super().__init__()
        parents = np.asarray(body.parents)
        count = len(parents)
        rest = np.asarray(body.joint_positions(np.zeros((1, count, 3)), np.zeros((1, 3))))[0]
        bone = rest.copy()
        bone[parents >= 0] -= rest[parents[parents >= 0]]
        self.levels = _levels(parents)
        self.register_buffer("parents", torch.as_tensor(parents, dtype=torch.long), persistent=False)
        self.register_buffer("bone", _tensor(bone), persistent=False)
        unbind = np.swapaxes(np.asarray(body.bind_rotation), 1, 2)
        self.register_buffer("unbind", _tensor(unbind), persistent=False)
        self.register_buffer("bind_joints", _tensor(body.joints), persistent=False)
        skin = skin_matrix(body.vertices, body.skin_index, body.skin_weight).astype(np.float64)
        self.register_buffer("skin", _tensor(skin), persistent=False)
        self.vertex_count = len(skin)
        self.chain = [0] + [joint for level in self.levels for joint, _ in level]
        above = np.zeros((len(parents), len(parents), 3))  # bone that each joint in the order of the chain leads along
        for joint in range(len(parents)):
            child = joint
            while parents[child] >= 0:
                above[joint, self.chain.index(parents[child])] += bone[child]
                child = parents[child]
        self.register_buffer("bones_above", _tensor(above.reshape(len(parents), -1)), persistent=False)
        columns = [3 * joint + axis for joint in self.chain for axis in range(3)]
        # QR of the matrix itself instead of Cholesky of its Gram matrix: it squares no condition number, and it also
        # exists when a joint moves no vertex.
        factor = np.linalg.qr(skin @ self._transforms_of_rotations(body, bone), mode="r")
        self.register_buffer("rotation_factor", _tensor(factor[:, columns]), persistent=False)

    def _transforms_of_rotations(self, body: Body, bone: np.ndarray) -> np.ndarray:
        """Matrix L [96, 72]: stacked transforms, less a constant, of stacked transposed world rotations [72, 3]."""
        parents, unbind = np.asarray(body.parents), np.swapaxes(np.asarray(body.bind_rotation), 1, 2)
        linear = np.zeros((4 * len(parents), 3 * len(parents)))
        for joint in range(len(parents)):
            own = slice(3 * joint, 3 * joint + 3)
            linear[4 * joint : 4 * joint + 3, own] = unbind[joint].T
            shift = linear[4 * joint + 3]
            shift[own] -= unbind[joint] @ body.joints[joint]
            child = joint
            while parents[child] >= 0:  # the joint is where the bones above it lead
                shift[3 * parents[child] : 3 * parents[child] + 3] += bone[child]
                child = parents[child]
        return linear

    def global_rotations(self, pose6d: Tensor) -> Tensor:
        """World rotations [..., 24, 3, 3] of relative 6-D rotations [..., 24, 6]."""
        if pose6d.shape[-2:] != (len(self.parents), 6):
            raise ValueError(f"pose6d: expected shape [..., {len(self.parents)}, 6], got {list(pose6d.shape)}")
        local = rotation_from_6d(pose6d)
        world: list[Tensor] = [local[..., 0, :, :]] * len(self.parents)
        for level in self.levels:  # one product for all joints of the same depth
            parents = torch.stack([world[p] for _, p in level], dim=-3)
            product = parents @ local[..., [j for j, _ in level], :, :]
            for position, (joint, _) in enumerate(level):
                world[joint] = product[..., position, :, :]
        return torch.stack(world, dim=-3)

    def joint_positions(self, rotations: Tensor, root: Tensor | None = None) -> Tensor:
        """World joints [..., 24, 3] [m] of world rotations [..., 24, 3, 3] and root translation [..., 3]."""
        parents = self.parents.clamp_min(0)
        offset = (rotations[..., parents, :, :] @ self.bone[..., None])[..., 0]
        joints = [self.bone[0].expand(offset.shape[:-2] + (3,))] * len(self.parents)
        if root is not None:
            joints[0] = joints[0] + root
        for level in self.levels:
            for joint, parent in level:
                joints[joint] = joints[parent] + offset[..., joint, :]
        return torch.stack(joints, dim=-2)

    def transforms(self, pose6d: Tensor, root: Tensor | None = None) -> Tensor:
        """Skinning transforms [..., 24, 3, 4]: the upper rows of those that carry bind-space points to the world."""
        rotations = self.global_rotations(pose6d)
        joints = self.joint_positions(rotations, root)
        turn = rotations @ self.unbind
        shift = joints - (turn @ self.bind_joints[..., None])[..., 0]
        return torch.cat([turn, shift[..., None]], dim=-1)

    def forward(self, pose6d: Tensor, root: Tensor | None = None) -> Tensor:
        """Skinned vertices [..., B, 3] [m] of 6-D poses [..., 24, 6] and root translation [..., 3] (default 0)."""
        return self.skin @ stacked(self.transforms(pose6d, root))

    def rotation_chain(self, pose6d: Tensor) -> Tensor:
        """World rotations [3, 3, 24, F] of 6-D poses [..., 24, 6] with F frames in all, joints as in ``chain``."""
        local = _rotation_rows(pose6d.reshape(-1, len(self.parents), 6).permute(2, 1, 0).contiguous())
        above = local[:, :, [0]]
        found, place = [above], {0: 0}
        for level in self.levels:
            parent = above[:, :, [place[p] for _, p in level]]
            own = local[:, :, [j for j, _ in level]]
            above = parent[:, 0, None] * own[0] + parent[:, 1, None] * own[1] + parent[:, 2, None] * own[2]
            found.append(above)
            place = {joint: position for position, (joint, _) in enumerate(level)}
        return torch.cat(found, dim=2)

    def joints_of_chain(self, chain: Tensor, joints: Sequence[int]) -> Tensor:
        """Positions [J, 3, F] [m] relative to the pelvis of some joints, of what ``rotation_chain`` gives; linear."""
        rotations = chain.permute(2, 1, 0, 3).flatten(0, 1).flatten(1)  # [72, 3 F]
        return (self.bones_above[list(joints)] @ rotations).unflatten(1, (3, -1))

    def mean_squared_pose_error(self, chain: Tensor, target: Tensor) -> Tensor:
        """Mean over vertices and frames of the squared distance [m^2] of two poses, root at rest.

        Args:
            chain, target: What ``rotation_chain`` gives, shape [3, 3, 24, F].
        """
        difference = (chain - target).permute(2, 1, 0, 3).flatten(0, 1).flatten(1)  # [72, 3 F]
        frames = chain.shape[-1]
        return (self.rotation_factor @ difference).square().sum() / (frames * self.vertex_count)


def stacked(transforms: Tensor) -> Tensor:
    """Transforms [..., J, 3, 4] as the matrix [..., 4 J, 3] that ``body.model.skin_matrix`` multiplies."""
    return transforms.transpose(-1, -2).flatten(-3, -2)


def _levels(parents: np.ndarray) -> list[list[tuple[int, int]]]:
    """(joint, parent) pairs by depth below the root, nearest first."""
    depth = {0: 0}
    levels: dict[int, list[tuple[int, int]]] = {}
    for joint, parent in enumerate(parents.tolist()):
        if parent < 0:
            continue
        depth[joint] = depth[parent] + 1
        levels.setdefault(depth[joint], []).append((joint, parent))
    return [levels[d] for d in sorted(levels)]


def _tensor(array: np.ndarray) -> Tensor:
    return torch.as_tensor(np.asarray(array, dtype=np.float32))
