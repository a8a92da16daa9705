"""Points that follow skinning transforms: the body's surface and the garment's pins, for every motion of a solver."""

from __future__ import annotations

import numpy as np
import warp as wp

from sim.kernels import contact as kernels


class Skeleton:
    """Skinning transforms of the motions on the device, each relative to its own floating origin.

    The bind pose is taken relative to ``centre``, so that float32 rounding acts on lengths around a metre.

    Attributes:
        lane_motion: Which motion each lane follows, shape [W].
        origins: Floating origin of each motion in the last interval [m], shape [M, 3], float64.
    """

    def __init__(self, joint_count: int, centre: np.ndarray, lane_motion: np.ndarray, device: str):
        self.centre = np.asarray(centre, dtype=np.float64)
        self.lane_motion = np.asarray(lane_motion, dtype=np.int32)
        self.motions = int(self.lane_motion.max()) + 1
        self.joints = joint_count
        self.origins = np.zeros((self.motions, 3))
        self.device_lane_motion = wp.array(self.lane_motion, dtype=int, device=device)
        self.rotation = wp.zeros(self.motions * joint_count, dtype=wp.mat33, device=device)
        self.translation = wp.zeros(self.motions * joint_count, dtype=wp.vec3, device=device)
        self.shift = wp.zeros(self.motions, dtype=wp.vec3, device=device)

    def set(self, transforms: np.ndarray, origins: np.ndarray) -> None:
        """Transforms [M, J, 4, 4] of bind to world points at the end of the interval, and the origins for it [M, 3]."""
        rotation = transforms[..., :3, :3].astype(np.float64)
        translation = transforms[..., :3, 3] + rotation @ self.centre - origins[:, None]
        self.rotation.assign(np.ascontiguousarray(rotation.reshape(-1, 3, 3), dtype=np.float32))
        self.translation.assign(translation.reshape(-1, 3).astype(np.float32))
        self.shift.assign((self.origins - origins).astype(np.float32))
        self.origins = np.array(origins, dtype=np.float64)


class Skin:
    """Points that follow a skeleton by linear blend skinning, at the start and the end of a query interval.

    Attributes:
        count: Number of points N of one motion.
        start: Positions at the start of the interval [m], motion after motion, shape [M * N].
        end: Positions at its end [m], shape [M * N].
    """

    def __init__(self, bind: np.ndarray, index: np.ndarray, weight: np.ndarray, motions: int, device: str):
        index, weight = _four_joints(index, weight)
        self.device = device
        self.count, self.motions = len(bind), motions
        self.bind = wp.array(bind.astype(np.float32), dtype=wp.vec3, device=device)
        self.index = wp.array(index, dtype=wp.vec4i, device=device)
        self.weight = wp.array(weight, dtype=wp.vec4, device=device)
        self.start = wp.zeros(motions * self.count, dtype=wp.vec3, device=device)
        self.end = wp.zeros(motions * self.count, dtype=wp.vec3, device=device)

    def launch(self, skeleton: Skeleton) -> None:
        """Begin an interval: the end becomes the start, a new end is skinned."""
        if self.count:
            inputs = [self.count, skeleton.joints, self.bind, self.index, self.weight]
            inputs += [skeleton.rotation, skeleton.translation, skeleton.shift]
            outputs = [self.start, self.end]
            wp.launch(kernels.skin_points, self.motions * self.count, inputs, outputs, device=self.device)


def _four_joints(index: np.ndarray, weight: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The four heaviest joints of each point, weights summing to one."""
    order = np.argsort(-weight, axis=1, kind="stable")[:, :4]
    index, weight = np.take_along_axis(index, order, axis=1), np.take_along_axis(weight, order, axis=1)
    missing = 4 - index.shape[1]
    index = np.pad(index, ((0, 0), (0, missing))).astype(np.int32)
    weight = np.pad(weight, ((0, 0), (0, missing))).astype(np.float32)
    return index, weight / np.maximum(weight.sum(axis=1, keepdims=True), 1e-12)
