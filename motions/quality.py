"""Figures that say whether a motion can be believed: sliding feet, feet in the ground, joint speed, jerk."""

from __future__ import annotations

from dataclasses import asdict, dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from body.model import Body, apply_skin, skin_matrix
from body.skeleton import JOINT_INDEX
from motions.clip import Clip

CONTACT_HEIGHT = 0.005  # [m] above the ground, up to which a point of the sole counts as touching
FOOT_JOINTS = tuple(JOINT_INDEX[name] for name in ("left_ankle", "left_foot", "right_ankle", "right_foot"))


@dataclass(frozen=True)
class MotionQuality:
    """Quality figures of one clip; the ground is the plane y = 0.

    Attributes:
        skate_m_s: 99th percentile over frames and feet of the horizontal speed of a touching foot [m/s]; the foot's
            speed is the lower quartile over the points of the sole that touch in both frames (a rolling foot does not
            slide), and 0 without contact.
        penetration_m: Deepest point of a foot below the ground over the clip [m].
        floating_m: Largest height of the lowest point of both feet over the clip [m]; large in a jump.
        joint_speed_rad_s: Largest speed of a joint's local rotation [rad/s].
        joint_jerk_rad_s3: Root mean square of the third derivative of the local rotations [rad/s^3].
        start_speed_rad_s: Largest joint speed between the first two frames [rad/s].
    """

    skate_m_s: float
    penetration_m: float
    floating_m: float
    joint_speed_rad_s: float
    joint_jerk_rad_s3: float
    start_speed_rad_s: float

    def as_row(self) -> dict[str, float]:
        """The figures as one row of a table."""
        return asdict(self)


def measure(clip: Clip, body: Body) -> MotionQuality:
    """Quality figures of a clip on a body."""
    soles = sole_points(clip.pose, clip.root, body)
    skate = np.concatenate([sliding_speed(points, clip.fps) for points in soles])
    lowest = np.minimum(*(points[..., 1].min(axis=1) for points in soles))
    velocity = joint_velocity(clip.pose, clip.fps)
    speed = np.linalg.norm(velocity, axis=-1)
    jerk = np.diff(velocity, n=2, axis=0) * clip.fps**2
    return MotionQuality(
        skate_m_s=float(np.percentile(skate, 99.0)),
        penetration_m=float(max(0.0, -lowest.min())),
        floating_m=float(max(0.0, lowest.max())),
        joint_speed_rad_s=float(speed.max()),
        joint_jerk_rad_s3=float(np.sqrt((jerk**2).sum(-1).mean())) if len(jerk) else 0.0,
        start_speed_rad_s=float(speed[0].max()),
    )


def joint_velocity(pose: np.ndarray, fps: float) -> np.ndarray:
    """Angular velocities of the local joint rotations, in the joint's axes [rad/s], shape [T - 1, 24, 3]."""
    rotation = Rotation.from_rotvec(np.asarray(pose, dtype=np.float64).reshape(-1, 3))
    joints = pose.shape[1]
    step = rotation[:-joints].inv() * rotation[joints:]
    return step.as_rotvec().reshape(-1, joints, 3) * fps


def sole_points(pose: np.ndarray, root: np.ndarray, body: Body) -> tuple[np.ndarray, np.ndarray]:
    """World positions of the skin of the left and the right foot's soles [m], each shape [T, S, 3]."""
    zero = body.posed(np.zeros((1, *pose.shape[1:])), np.zeros((1, 3)))[0]
    transforms = body.joint_transforms(pose, root)
    soles = []
    for joints in (FOOT_JOINTS[:2], FOOT_JOINTS[2:]):
        foot = np.isin(body.part_of_vertex, joints)
        chosen = np.flatnonzero(foot & (zero[:, 1] < zero[foot, 1].min() + 0.02))
        matrix = skin_matrix(body.vertices[chosen], body.skin_index[chosen], body.skin_weight[chosen])
        soles.append(apply_skin(matrix, transforms).astype(np.float64))
    return soles[0], soles[1]


def sliding_speed(points: np.ndarray, fps: float) -> np.ndarray:
    """Horizontal speed of a touching foot between frames [m/s], shape [T - 1]; points of the sole are [T, S, 3]."""
    low = points[..., 1] < CONTACT_HEIGHT
    touching = low[1:] & low[:-1]
    speed = np.linalg.norm(np.diff(points[..., [0, 2]], axis=0), axis=-1) * fps
    grounded = touching.any(axis=1)
    result = np.zeros(len(speed))
    result[grounded] = _lower_quartile(speed[grounded], touching[grounded])
    return result


def _lower_quartile(values: np.ndarray, counted: np.ndarray) -> np.ndarray:
    """Lower quartile of the counted values of each row, of which there is one at least: all rows are sorted at once."""
    ordered = np.sort(np.where(counted, values, np.inf), axis=1)
    rows, place = np.arange(len(values)), 0.25 * (counted.sum(axis=1) - 1)
    below = np.floor(place).astype(int)
    low, high = ordered[rows, below], ordered[rows, np.ceil(place).astype(int)]
    return low + (place - below) * (high - low)
