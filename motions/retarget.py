"""Recorded motion of another skeleton, carried over to the SMPL skeleton of a body.

Two kinds of rigs are understood:

- the Bandai-Namco rig, whose zero pose is meaningless (all bones along x): a table gives the T-pose axes of a joint;
- any rig with usual joint names whose zero pose is a standing person (arms anywhere): the directions of its limbs,
  read from the file's own offsets, are matched with those of the body's T-pose.

The root path is scaled by leg length, and the lowest point of the feet is put on the ground.
"""

from __future__ import annotations

import re
from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

from body.model import Body
from body.skeleton import JOINT_COUNT, JOINT_INDEX, PARENTS
from geometry.rotations import matrix_to_axis_angle
from motions.bvh import BvhMotion
from motions.clip import validate_motion
from motions.quality import sole_points
from motions.resample import resampled
from motions.timing import rotation_about

MAX_FPS = 480.0
GROUND_PERCENTILE = 2.0  # of the lowest sole point per frame: single bad frames do not lift the whole take
SIDES = ("left", "right")
LIMBS = (("hip", "knee"), ("knee", "ankle"), ("shoulder", "elbow"), ("elbow", "wrist"))

# Names of joints in common rigs, without their side: capture software, CMU and ASF, Mixamo, Blender.
SYNONYMS: dict[str, tuple[str, ...]] = {
    "hip": ("upleg", "upperleg", "thigh", "hip", "femur"),
    "knee": ("leg", "lowerleg", "lowleg", "knee", "shin", "calf", "tibia"),
    "ankle": ("foot", "ankle"),
    "foot": ("toebase", "toes", "toe", "ball"),
    "collar": ("collar", "clavicle", "shoulder"),
    "shoulder": ("arm", "upperarm", "uparm", "humerus", "shoulder"),
    "elbow": ("forearm", "lowerarm", "lowarm", "elbow", "radius"),
    "wrist": ("hand", "wrist"),
}
PELVIS_NAMES = ("hips", "pelvis", "hip", "root")
NECK_NAMES = ("neck", "neck1", "lowerneck")
HEAD_NAMES = ("head",)


@dataclass(frozen=True)
class _Rig:
    """How a file's joints drive the SMPL joints.

    Attributes:
        world: Rotation from the file's axes to y up, facing +z, shape [3, 3].
        source: Joint of the file for each SMPL joint, -1 where none, shape [24].
        alignment: For each SMPL joint, the rotation M with R_smpl = world G_file world^T M, shape [24, 3, 3]
            (for the Bandai-Namco rig world^T is left out and M = C^T).
        spine: Joints of the file from above the pelvis to below the neck.
        has_rest: Whether the zero pose of the file is a standing person.
    """

    world: np.ndarray
    source: np.ndarray
    alignment: np.ndarray
    spine: tuple[int, ...]
    has_rest: bool


def retarget(motion: BvhMotion, body: Body, fps: float, face_forward: bool = False) -> tuple[np.ndarray, np.ndarray]:
    """Carry a recording over to a body.

    Args:
        motion: The recording.
        body: Body whose proportions and soles are used.
        fps: Frames per second of the result [Hz]; rotations are interpolated spherically.
        face_forward: Turn the take so that the body faces +z in the first frame.

    Returns:
        Pose [rad], shape [T, 24, 3], and root [m], shape [T, 3], float32; the take starts over the origin and its
        feet touch y = 0.

    Raises:
        ValueError: Unknown rig (with the joint that is missing), a recording shorter than two frames, motion that
            makes no sense.
    """
    if not 1.0 <= fps <= MAX_FPS:
        raise ValueError(f"fps is {fps}, allowed are 1 to {MAX_FPS:.0f}")
    rig = _bandai_namco_rig(motion) if "UpperArm_L" in motion.names else _named_rig(motion, body)
    rotation, position = motion.world()
    scale = _leg_length_of(body) / _leg_length_in(motion, rig.source)
    pelvis = scale * position[:, rig.source[0]] @ rig.world.T
    pose = _smpl_pose(rotation, rig)
    pose, pelvis = resampled(pose, pelvis, motion.fps, fps)
    if face_forward:
        pose, pelvis = turn_to_front(pose, pelvis)
    root = pelvis - body.joints[0]
    root[:, [0, 2]] -= root[0, [0, 2]]
    validate_motion(pose, root, fps, "the retargeted recording")
    lowest = np.minimum(*(points[..., 1].min(axis=1) for points in sole_points(pose, root, body)))
    root[:, 1] -= np.percentile(lowest, GROUND_PERCENTILE)
    return pose.astype(np.float32), root.astype(np.float32)


def turn_to_front(pose: np.ndarray, path: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Pose [T, 24, 3] and pelvis path [T, 3] turned about the vertical so that the body faces +z in the first frame."""
    pelvis = Rotation.from_rotvec(pose[:, 0])
    ahead = pelvis[0].apply([0.0, 0.0, 1.0])
    turn = Rotation.from_rotvec([0.0, -np.arctan2(ahead[0], ahead[2]), 0.0])
    turned = pose.copy()
    turned[:, 0] = (turn * pelvis).as_rotvec()
    return turned, turn.apply(path)


def _smpl_pose(rotation: np.ndarray, rig: _Rig) -> np.ndarray:
    """Local SMPL rotations [rad], shape [T, 24, 3], from the file's global ones, shape [T, J, 3, 3]."""
    frames = len(rotation)
    in_world = rig.world @ rotation @ rig.world.T if rig.has_rest else rotation
    total = np.tile(np.eye(3), (frames, JOINT_COUNT, 1, 1))
    for joint in range(JOINT_COUNT):
        if rig.source[joint] >= 0:
            total[:, joint] = in_world[:, rig.source[joint]] @ rig.alignment[joint]
    chain = [total[:, 0]] + [in_world[:, joint] @ rig.alignment[JOINT_INDEX["spine3"]] for joint in rig.spine]
    for index, name in enumerate(("spine1", "spine2", "spine3")):
        total[:, JOINT_INDEX[name]] = _along_chain(chain, index)
    local = total.copy()
    for joint, parent in enumerate(PARENTS):
        if parent >= 0:
            if rig.source[joint] < 0 and joint not in _SPINE:
                total[:, joint] = total[:, parent]
            local[:, joint] = total[:, parent].transpose(0, 2, 1) @ total[:, joint]
    local[:, [JOINT_INDEX["left_hand"], JOINT_INDEX["right_hand"]]] = np.eye(3)
    return matrix_to_axis_angle(local)


_SPINE = tuple(JOINT_INDEX[name] for name in ("spine1", "spine2", "spine3"))


def _along_chain(chain: list[np.ndarray], index: int) -> np.ndarray:
    """Rotation of the index-th of three SMPL spine joints, from the rotations of pelvis and spine joints of a file,
    [T, 3, 3].

    Two spine joints are taken as SMPL's last two, with half the first one's rotation below them; more or fewer are
    distributed evenly.
    """
    steps = len(chain) - 1
    place = (0.5, 1.0, 2.0)[index] if steps == 2 else steps * (index + 1) / 3.0
    below = min(int(place), steps)
    if place == below or below == steps:
        return chain[below]
    start, end = Rotation.from_matrix(chain[below]), Rotation.from_matrix(chain[below + 1])
    return (start * Rotation.from_rotvec((place - below) * (start.inv() * end).as_rotvec())).as_matrix()


def _leg_length_of(body: Body) -> float:
    pairs = [(JOINT_INDEX[f"{side}_{a}"], JOINT_INDEX[f"{side}_{b}"]) for side in SIDES for a, b in LIMBS[:2]]
    return float(sum(np.linalg.norm(body.joints[a] - body.joints[b]) for a, b in pairs) / 2.0)


def _leg_length_in(motion: BvhMotion, source: np.ndarray) -> float:
    rest = motion.rest_positions()
    pairs = [
        (source[JOINT_INDEX[f"{side}_{a}"]], source[JOINT_INDEX[f"{side}_{b}"]]) for side in SIDES for a, b in LIMBS[:2]
    ]
    length = float(sum(np.linalg.norm(rest[a] - rest[b]) for a, b in pairs) / 2.0)
    if not length > 1e-6:
        raise ValueError("the legs of the recorded skeleton have no length")
    return length


# --- Bandai-Namco ---------------------------------------------------------------------------------------------------


def _bandai_namco_rig(motion: BvhMotion) -> _Rig:
    """The rig of the Bandai-Namco Research Motiondataset: columns of C are a joint's local axes in the T-pose world."""
    x, y, z = np.eye(3)
    trunk = np.stack([y, z, x], axis=-1)
    legs = {"L": np.stack([-y, x, z], axis=-1), "R": np.stack([y, x, -z], axis=-1)}
    arms = {"L": np.eye(3), "R": np.diag([1.0, -1.0, -1.0])}
    table: dict[str, tuple[str, np.ndarray]] = {
        "pelvis": ("Hips", np.stack([y, -x, z], axis=-1)),
        "neck": ("Neck", trunk),
        "head": ("Head", trunk),
    }
    for side, letter in zip(SIDES, "LR"):
        leg, arm = legs[letter], arms[letter]
        table |= {
            f"{side}_hip": (f"UpperLeg_{letter}", leg),
            f"{side}_knee": (f"LowerLeg_{letter}", leg),
            f"{side}_ankle": (f"Foot_{letter}", leg @ rotation_about("y", np.radians(-70.4))),
            f"{side}_foot": (f"Toes_{letter}", leg @ rotation_about("y", np.radians(-90.0))),
            f"{side}_collar": (f"Shoulder_{letter}", arm),
            f"{side}_shoulder": (f"UpperArm_{letter}", arm),
            f"{side}_elbow": (f"LowerArm_{letter}", arm),
            f"{side}_wrist": (f"Hand_{letter}", arm),
        }
    source, alignment = np.full(JOINT_COUNT, -1), np.tile(np.eye(3), (JOINT_COUNT, 1, 1))
    for name, (joint, axes) in table.items():
        source[JOINT_INDEX[name]] = _index(motion, joint)
        alignment[JOINT_INDEX[name]] = axes.T
    alignment[list(_SPINE)] = trunk.T
    return _Rig(np.eye(3), source, alignment, (_index(motion, "Spine"), _index(motion, "Chest")), has_rest=False)


def _index(motion: BvhMotion, name: str) -> int:
    if name not in motion.names:
        raise ValueError(f"the recorded skeleton has no joint '{name}', which its kind of rig always has")
    return motion.names.index(name)


# --- Rigs by name ---------------------------------------------------------------------------------------------------


def _named_rig(motion: BvhMotion, body: Body) -> _Rig:
    source = _match_names(motion)
    rest = motion.rest_positions()
    world = _file_axes(rest, source)
    rest = rest @ world.T
    zero = np.zeros((1, JOINT_COUNT, 3))
    template = body.joint_frames(zero, np.zeros((1, 3)))[1][0]
    alignment = np.tile(np.eye(3), (JOINT_COUNT, 1, 1))
    for side in SIDES:
        for start, end in LIMBS:
            joint, child = JOINT_INDEX[f"{side}_{start}"], JOINT_INDEX[f"{side}_{end}"]
            bone = rest[source[child]] - rest[source[joint]]
            alignment[joint] = _shortest_rotation(template[child] - template[joint], bone)
        alignment[JOINT_INDEX[f"{side}_wrist"]] = alignment[JOINT_INDEX[f"{side}_elbow"]]
        _align_foot(alignment, rest, source, side)
    return _Rig(world, source, alignment, _spine_chain(motion, source), has_rest=True)


def _align_foot(alignment: np.ndarray, rest: np.ndarray, source: np.ndarray, side: str) -> None:
    """A foot keeps its angle to the shank (splayed legs splay their feet); its outward turn in the file is kept out."""
    knee, ankle, toe = (JOINT_INDEX[f"{side}_{part}"] for part in ("knee", "ankle", "foot"))
    alignment[ankle] = alignment[toe] = alignment[knee]
    if source[toe] >= 0:
        along = alignment[knee].T @ (rest[source[toe]] - rest[source[ankle]])
        if np.hypot(along[0], along[2]) > 0.3 * np.linalg.norm(along):
            yaw = np.arctan2(along[0], along[2])
            # The body's own feet point a little outward in the zero pose, those of files mostly straight ahead.
            alignment[ankle] = alignment[toe] = alignment[knee] @ rotation_about("y", np.array(yaw - _natural(side)))


def _natural(side: str) -> float:
    return 0.08 if side == "left" else -0.08


def _shortest_rotation(start: np.ndarray, end: np.ndarray) -> np.ndarray:
    """Rotation that takes one direction into another by the shortest way, shape [3, 3]."""
    a, b = start / np.linalg.norm(start), end / max(np.linalg.norm(end), 1e-12)
    axis, cosine = np.cross(a, b), float(a @ b)
    if np.linalg.norm(axis) < 1e-9:
        return np.eye(3) if cosine > 0 else rotation_about("z", np.array(np.pi))
    return Rotation.from_rotvec(axis / np.linalg.norm(axis) * np.arctan2(np.linalg.norm(axis), cosine)).as_matrix()


def _file_axes(rest: np.ndarray, source: np.ndarray) -> np.ndarray:
    """Rotation from the file's axes to (left, up, ahead), each along a coordinate axis of the file, shape [3, 3]."""
    left = rest[source[JOINT_INDEX["left_hip"]]] - rest[source[JOINT_INDEX["right_hip"]]]
    up = rest[source[JOINT_INDEX["head"]]] - rest[source[JOINT_INDEX["left_ankle"]]]
    axes = []
    for direction in (left, up):
        axis = np.zeros(3)
        axis[np.abs(direction).argmax()] = np.sign(direction[np.abs(direction).argmax()])
        axes.append(axis)
    if abs(axes[0] @ axes[1]) > 0.5 or not np.abs(axes).sum() == 2.0:
        raise ValueError("the zero pose of the recorded skeleton is not a standing person, so its axes cannot be found")
    return np.stack([*axes, np.cross(*axes)])


def _match_names(motion: BvhMotion) -> np.ndarray:
    """Joint of the file for each SMPL joint (-1: none), shape [24]; raises for a limb that is missing."""
    plain = [re.sub(r"[^a-z0-9]", "", name.rsplit(":", 1)[-1].lower()) for name in motion.names]
    by_side = {side: _sided(motion.names, plain, side) for side in SIDES}
    source = np.full(JOINT_COUNT, -1)
    for smpl, names in (("pelvis", PELVIS_NAMES), ("neck", NECK_NAMES), ("head", HEAD_NAMES)):
        source[JOINT_INDEX[smpl]] = next((plain.index(name) for name in names if name in plain), -1)
    for side in SIDES:
        joints = by_side[side]
        for part, names in SYNONYMS.items():
            source[JOINT_INDEX[f"{side}_{part}"]] = next((joints[name] for name in names if name in joints), -1)
        # "LeftShoulder" is the collar bone where there is a "LeftArm", and the upper arm where there is none.
        if source[JOINT_INDEX[f"{side}_collar"]] == source[JOINT_INDEX[f"{side}_shoulder"]]:
            source[JOINT_INDEX[f"{side}_collar"]] = -1
    needed = ["pelvis", "head"] + [
        f"{side}_{part}" for side in SIDES for part in SYNONYMS if part not in ("foot", "collar")
    ]
    for name in needed:
        if source[JOINT_INDEX[name]] < 0:
            raise ValueError(
                f"no joint of the recorded skeleton could be taken for '{name}'; "
                f"its joints are {', '.join(motion.names)[:300]}"
            )
    return source


def _sided(names: tuple[str, ...], plain: list[str], side: str) -> dict[str, int]:
    """Joints of one side by their plain name without the side; the first one of a name counts."""
    letter, found = side[0], {}
    for index, (name, word) in enumerate(zip(names, plain)):
        last = name.rsplit(":", 1)[-1]
        if word.startswith(side) or word.endswith(side):
            rest = word.removeprefix(side) if word.startswith(side) else word.removesuffix(side)
        elif re.search(rf"[._-]{letter}$", last.lower()) or re.search(rf"^{letter}[._-]", last.lower()):
            rest = word[:-1] if re.search(rf"[._-]{letter}$", last.lower()) else word[1:]
        elif re.match(rf"{letter.upper()}[A-Z]", last) or re.match(rf"{letter}[a-z]", last):
            rest = word[1:]
        else:
            continue
        found.setdefault(rest, index)
    return found


def _spine_chain(motion: BvhMotion, source: np.ndarray) -> tuple[int, ...]:
    """Joints of the file between the pelvis and the neck (or head), from below."""
    top = source[JOINT_INDEX["neck"]] if source[JOINT_INDEX["neck"]] >= 0 else source[JOINT_INDEX["head"]]
    chain = []
    joint = motion.parents[top]
    while joint >= 0 and joint != source[0]:
        chain.append(int(joint))
        joint = motion.parents[joint]
    return tuple(reversed(chain))
