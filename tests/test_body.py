"""The shipped bodies: surface, skinning, kinematics, shape components, and what bad input says."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial import cKDTree

from body.model import BODY_NAMES, Body, skin
from body.skeleton import JOINT_INDEX, JOINT_NAMES, LEFT_RIGHT_PAIRS, PARENTS, mirrored_joint_order
from body.surface import closed_surface_faults, enclosed_volume, self_intersecting_faces
from geometry.decimate import decimate
from geometry.rotations import axis_angle_to_matrix, matrix_to_axis_angle
from geometry.topology import face_angles

SIZES = {"full": (6890, 13776), "small": (1229, 2454)}
DIGESTS = {"full": "2d52def5c2abb744", "small": "aaf6279a3773f706"}
T_POSE, ORIGIN = np.zeros((1, 24, 3)), np.zeros((1, 3))


@pytest.fixture(scope="module", params=BODY_NAMES)
def body(request: pytest.FixtureRequest) -> Body:
    return Body.load(request.param)


def random_motion(seed: int, frames: int = 5) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    return rng.normal(0.0, 0.4, (frames, 24, 3)), rng.normal(0.0, 1.0, (frames, 3))


def test_skeleton_is_smpls() -> None:
    assert len(JOINT_NAMES) == len(PARENTS) == 24
    assert all(parent < joint for joint, parent in enumerate(PARENTS))
    assert JOINT_NAMES[PARENTS[JOINT_INDEX["left_elbow"]]] == "left_shoulder"
    assert len(LEFT_RIGHT_PAIRS) == 9
    order = mirrored_joint_order()
    assert (order[order] == np.arange(24)).all()
    assert order[JOINT_INDEX["left_hand"]] == JOINT_INDEX["right_hand"]
    # A pair's parents are a pair too (or the same joint of the middle).
    assert all(order[PARENTS[left]] == PARENTS[right] for left, right in LEFT_RIGHT_PAIRS)


def test_surface_is_closed_and_clean(body: Body) -> None:
    assert (len(body.vertices), len(body.faces)) == SIZES[body.name]
    assert closed_surface_faults(body.vertices, body.faces) == []
    assert 0.04 < enclosed_volume(body.vertices, body.faces) < 0.09  # an adult: 40 to 90 litres
    assert np.degrees(face_angles(body.vertices, body.faces)).min() > 2.0
    for vertices in (body.vertices, body.posed(T_POSE, ORIGIN)[0]):
        assert len(self_intersecting_faces(vertices, body.faces)) == 0


def test_closed_surface_faults_are_named() -> None:
    tetrahedron = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], dtype=float)
    faces = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
    assert closed_surface_faults(tetrahedron, faces) == []
    assert "inwards" in closed_surface_faults(tetrahedron, faces[:, ::-1])[0]
    assert "boundary" in closed_surface_faults(tetrahedron, faces[:3])[0]
    two = np.concatenate([tetrahedron, tetrahedron + 5.0]), np.concatenate([faces, faces + 4])
    assert any("2 components" in fault for fault in closed_surface_faults(*two))


def test_self_intersections_are_found() -> None:
    tetrahedron = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], dtype=float)
    faces = np.array([[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]])
    both = np.concatenate([faces, faces + 4])
    apart = np.concatenate([tetrahedron, tetrahedron + 2.0])
    assert len(self_intersecting_faces(apart, both)) == 0
    # The corner (0.2, 0.2, 0.2) of the second one lies inside the first: its three faces cut the slanted face 3.
    cut = self_intersecting_faces(np.concatenate([tetrahedron, tetrahedron + 0.2]), both)
    assert cut.tolist() == [3, 4, 5, 6]


def test_weights(body: Body) -> None:
    assert body.skin_index.shape == body.skin_weight.shape == (len(body.vertices), 4)
    assert body.skin_index.min() == 0 and body.skin_index.max() == 23
    assert (body.skin_weight >= 0.0).all()
    np.testing.assert_allclose(body.skin_weight.sum(axis=1), 1.0, atol=1e-6)
    carried = np.bincount(body.skin_index.ravel(), weights=body.skin_weight.ravel(), minlength=24)
    assert (carried > 1.0).all()  # every joint moves some of the surface
    for left, right in LEFT_RIGHT_PAIRS:
        assert carried[left] == pytest.approx(carried[right], rel=1e-3)
    head = body.vertices[body.part_of_vertex == JOINT_INDEX["head"]]
    assert head[:, 1].min() > body.joints[JOINT_INDEX["left_shoulder"], 1]


def test_bind_pose_reproduces_the_bind(body: Body) -> None:
    bind = body.bind_pose()
    assert bind.shape == (24, 3)
    posed = body.posed(bind[None], ORIGIN)
    assert posed.dtype == np.float32
    np.testing.assert_allclose(posed[0], body.vertices, atol=1e-6)
    np.testing.assert_allclose(body.joint_positions(bind[None], ORIGIN)[0], body.joints, atol=1e-6)
    np.testing.assert_allclose(
        body.joint_transforms(bind[None], ORIGIN)[0], np.broadcast_to(np.eye(4), (24, 4, 4)), atol=1e-6
    )


def test_zero_pose_is_a_t_pose_on_the_ground(body: Body) -> None:
    vertices = body.posed(T_POSE, ORIGIN)[0]
    joints = body.joint_positions(T_POSE, ORIGIN)[0]
    assert abs(vertices[:, 1].min()) < 1e-5
    assert 1.66 < np.ptp(vertices[:, 1]) < 1.74
    for side, sign in (("left", 1.0), ("right", -1.0)):
        arm = joints[[JOINT_INDEX[f"{side}_{part}"] for part in ("shoulder", "elbow", "wrist", "hand")]]
        np.testing.assert_allclose(arm[:, 1:], arm[:1, 1:].repeat(4, axis=0), atol=1e-4)  # horizontal, straight
        assert (np.diff(sign * arm[:, 0]) > 0.05).all()
        foot = vertices[sign * vertices[:, 0] > 0]
        assert abs(foot[:, 1].min()) < 1e-3
        assert joints[JOINT_INDEX[f"{side}_foot"], 2] > joints[JOINT_INDEX[f"{side}_ankle"], 2] + 0.05  # faces +z
    assert vertices[:, 0].max() == pytest.approx(-vertices[:, 0].min(), abs=1e-4)


def test_skinning_against_the_formula(body: Body) -> None:
    """Every vertex by a plain loop over its weights, as in Loper et al. 2015."""
    pose, root = random_motion(1, frames=2)
    rotation, position = body.joint_frames(pose, root)
    sample = np.arange(0, len(body.vertices), 97)
    expected = np.zeros((2, len(sample), 3))
    for row, vertex in enumerate(sample):
        for joint, weight in zip(body.skin_index[vertex], body.skin_weight[vertex]):
            offset = body.bind_rotation[joint].T @ (body.vertices[vertex] - body.joints[joint])
            expected[:, row] += weight * (rotation[:, joint] @ offset + position[:, joint])
    np.testing.assert_allclose(body.posed(pose, root)[:, sample], expected, atol=2e-6)
    pinned = skin(
        body.vertices[sample], body.skin_index[sample], body.skin_weight[sample], body.joint_transforms(pose, root)
    )
    np.testing.assert_allclose(pinned, expected, atol=2e-6)


def test_posing_does_not_depend_on_the_number_of_frames() -> None:
    body = Body.load("small")
    pose, root = random_motion(2, frames=70)  # more than two chunks
    together = body.posed(pose, root)
    apart = np.concatenate([body.posed(pose[t : t + 1], root[t : t + 1]) for t in (0, 31, 32, 69)])
    np.testing.assert_allclose(together[[0, 31, 32, 69]], apart, atol=1e-6)


def test_rigid_motion_moves_everything_rigidly(body: Body) -> None:
    pose, root = random_motion(3)
    turn = axis_angle_to_matrix(np.array([0.3, -1.1, 0.7]))
    shift = np.array([0.5, -0.2, 1.5])
    pelvis = body.joints[0].astype(np.float64)
    turned = pose.copy()
    turned[:, 0] = matrix_to_axis_angle(turn @ axis_angle_to_matrix(pose[:, 0]))
    moved_root = (pelvis + root) @ turn.T + shift - pelvis
    np.testing.assert_allclose(body.posed(turned, moved_root), body.posed(pose, root) @ turn.T + shift, atol=5e-6)
    joints = body.joint_positions(pose, root)
    np.testing.assert_allclose(body.joint_positions(turned, moved_root), joints @ turn.T + shift, atol=5e-6)
    rotation, position = body.pelvis_frames(turned, moved_root)
    np.testing.assert_allclose(rotation, turn @ axis_angle_to_matrix(pose[:, 0]), atol=1e-6)
    np.testing.assert_allclose(position, joints[:, 0] @ turn.T + shift, atol=5e-6)


def test_bones_keep_their_length(body: Body) -> None:
    pose, root = random_motion(4)
    joints = body.joint_positions(pose, root)
    parents = np.array(PARENTS[1:])
    lengths = np.linalg.norm(joints[:, 1:] - joints[:, parents], axis=-1)
    rest = np.linalg.norm(body.joints[1:] - body.joints[parents], axis=-1)
    np.testing.assert_allclose(lengths, np.broadcast_to(rest, lengths.shape), atol=1e-5)


def test_skinning_transforms_carry_the_joints(body: Body) -> None:
    pose, root = random_motion(5)
    bind = np.concatenate([body.joints, np.ones((24, 1))], axis=1)
    carried = np.einsum("tjab,jb->tja", body.joint_transforms(pose, root), bind)[..., :3]
    np.testing.assert_allclose(carried, body.joint_positions(pose, root), atol=1e-5)


def test_directions_of_smpl_poses(body: Body) -> None:
    """Signs as in SMPL: a negative hip angle about x lifts the knee forward, a left elbow bends about -y."""
    pose = np.zeros((1, 24, 3))
    pose[0, JOINT_INDEX["left_hip"], 0] = -1.2
    pose[0, JOINT_INDEX["left_elbow"], 1] = -1.2
    moved = body.joint_positions(pose, ORIGIN)[0] - body.joint_positions(T_POSE, ORIGIN)[0]
    knee, wrist = JOINT_INDEX["left_knee"], JOINT_INDEX["left_wrist"]
    assert moved[knee, 2] > 0.2 and moved[knee, 1] > 0.1
    assert moved[wrist, 2] > 0.15 and abs(moved[wrist, 1]) < 1e-4


def test_mirrored_pose_mirrors_the_body(body: Body) -> None:
    pose, root = random_motion(6, frames=2)
    order = mirrored_joint_order()
    mirrored = body.joint_positions(pose[:, order] * [1, -1, -1], root * [-1, 1, 1])
    np.testing.assert_allclose(mirrored[:, order] * [-1, 1, 1], body.joint_positions(pose, root), atol=1e-4)
    distance, image = cKDTree(body.vertices).query(body.vertices * [-1, 1, 1])
    assert distance.max() < 1e-5 and (image[image] == np.arange(len(image))).all()
    surface = body.posed(pose[:, order] * [1, -1, -1], root * [-1, 1, 1])
    np.testing.assert_allclose(surface[:, image] * [-1, 1, 1], body.posed(pose, root), atol=1e-3)


def test_shape_components(body: Body) -> None:
    np.testing.assert_allclose(body.shaped(np.zeros(10)).vertices, body.vertices, atol=1e-5)
    heights = []
    for coefficient in np.linspace(-2.0, 2.0, 5):
        shaped = body.shaped([coefficient])
        rest = shaped.posed(T_POSE, ORIGIN)[0]
        assert abs(rest[:, 1].min()) < 1e-5
        assert shaped.digest == body.digest
        heights.append(np.ptp(rest[:, 1]))
    steps = np.diff(heights)
    assert (steps > 0.02).all() and np.ptp(steps) < 0.1 * steps.mean()  # grows, and evenly
    assert heights[0] > 1.5 and heights[-1] < 1.95
    # The joints move with the surface: a taller body has longer thighs in the same proportion, roughly.
    tall, short = body.shaped([2.0]), body.shaped([-2.0])
    thigh = [
        np.linalg.norm(b.joints[JOINT_INDEX["left_knee"]] - b.joints[JOINT_INDEX["left_hip"]]) for b in (tall, short)
    ]
    assert thigh[0] / thigh[1] == pytest.approx(heights[-1] / heights[0], rel=0.1)
    assert closed_surface_faults(tall.vertices, tall.faces) == []


def test_digest_is_stable(body: Body) -> None:
    """Shards name the digest of their body: a new one makes every stored simulation unusable."""
    assert body.digest == DIGESTS[body.name]


def test_bad_input_is_refused() -> None:
    body = Body.load("small")
    with pytest.raises(ValueError, match=r"'giant'.*full, small"):
        Body.load("giant")
    with pytest.raises(ValueError, match=r"pose: expected shape \[T, 24, 3\], got \[5, 22, 3\]"):
        body.posed(np.zeros((5, 22, 3)), np.zeros((5, 3)))
    with pytest.raises(ValueError, match=r"root: expected shape \[5, 3\].*got \[4, 3\]"):
        body.posed(np.zeros((5, 24, 3)), np.zeros((4, 3)))
    with pytest.raises(ValueError, match=r"pose: expected finite values.*frame 2"):
        body.posed(np.where(np.arange(4)[:, None, None] == 2, np.nan, np.zeros((4, 24, 3))), np.zeros((4, 3)))
    with pytest.raises(ValueError, match=r"beta: expected shape \[<= 10\], got \[11\]"):
        body.shaped(np.zeros(11))
    transforms = body.joint_transforms(T_POSE, ORIGIN)
    with pytest.raises(ValueError, match="skin weights"):
        skin(np.zeros((3, 3)), np.zeros((2, 4), dtype=int), np.zeros((2, 4)), transforms)
    with pytest.raises(ValueError, match=r"skin index: expected 0\.\.23, got 0\.\.24"):
        skin(np.zeros((2, 3)), np.array([[0], [24]]), np.ones((2, 1)), transforms)
    with pytest.raises(ValueError, match=r"transforms: expected shape \[T, 24, 4, 4\], got \[1, 23, 4, 4\]"):
        skin(np.zeros((2, 3)), np.zeros((2, 1), dtype=int), np.ones((2, 1)), transforms[:, :23])


def test_decimation_keeps_topology_symmetry_and_count() -> None:
    angle, level = np.meshgrid(np.linspace(0, 2 * np.pi, 25)[:-1], np.linspace(0, np.pi, 14)[1:-1])
    ring = np.stack([np.sin(level) * np.sin(angle), np.cos(level), np.sin(level) * np.cos(angle)], axis=-1)
    vertices = np.concatenate([ring.reshape(-1, 3), [[0, 1, 0], [0, -1, 0]]])
    faces = []
    for row in range(11):
        for column in range(24):
            a, b = row * 24 + column, row * 24 + (column + 1) % 24
            # Diagonals mirrored at x = 0, so that the triangles are symmetric like the points.
            quad = [(a, a + 24, b + 24), (a, b + 24, b)] if column < 12 else [(a, a + 24, b), (b, a + 24, b + 24)]
            faces += quad
    for column in range(24):
        faces.append((288, column, (column + 1) % 24))
        faces.append((289, 264 + (column + 1) % 24, 264 + column))
    faces = np.array(faces)
    assert closed_surface_faults(vertices, faces) == []
    mirror = np.linalg.norm(vertices[:, None] * [-1, 1, 1] - vertices[None], axis=-1).argmin(axis=1)
    for count in (120, 121):
        kept, small = decimate(vertices, faces, count, np.ones(len(vertices)), mirror)
        assert len(kept) == count
        assert closed_surface_faults(vertices[kept], small) == []
        assert set(mirror[kept]) == set(kept)
        assert enclosed_volume(vertices[kept], small) > 0.85 * enclosed_volume(vertices, faces)


def test_everyday_poses_do_not_cut_through_themselves() -> None:
    """Arms down, arms raised and a stride: where creased shoulders used to trap the cloth."""
    body = Body.load("full")
    poses = np.zeros((3, 24, 3))
    for side, sign in (("left", 1.0), ("right", -1.0)):
        poses[0, JOINT_INDEX[f"{side}_shoulder"]] = [0.0, 0.0, -1.3 * sign]
        poses[1, JOINT_INDEX[f"{side}_shoulder"]] = [0.0, 0.0, 1.2 * sign]
        poses[2, JOINT_INDEX[f"{side}_shoulder"]] = [0.5 * sign, 0.0, -1.2 * sign]
        poses[2, JOINT_INDEX[f"{side}_hip"]] = [-0.45 * sign, 0.0, 0.0]
    for vertices in body.posed(poses, np.zeros((3, 3))):
        assert len(self_intersecting_faces(vertices, body.faces)) == 0
