"""Garments as displacements of the body: cast, unposed and posed again, and the levels of the body mesh under them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from body.model import Body
from datasets.layers import LayerFile, joined_layers, read_layer, write_layer
from garments.body_layer import BARE_JOINTS, BodyLayer, cast_layer, dressed_body, transfer_error, unposed
from garments.grading import graded
from garments.outfit import garment_spec, make_template
from garments.template import GarmentTemplate
from geometry.mesh_hierarchy import MeshHierarchy, build_hierarchy
from geometry.topology import MeshTopology, vertex_normals

OFFSET = 0.015


@pytest.fixture(scope="module")
def body() -> Body:
    return Body.load("small")


@pytest.fixture(scope="module")
def outfit(body) -> GarmentTemplate:
    """A long-sleeved shirt over short pants."""
    worn = [
        {"name": "pants", "kind": "pants", "vertices": 400, "length": 0.5},
        {"name": "shirt", "kind": "tshirt", "vertices": 400, "sleeve": 0.42},
    ]
    return make_template(garment_spec("longshort", {"kind": "outfit", "worn": worn}), body)


@pytest.fixture(scope="module")
def layer(outfit, body):
    return cast_layer(outfit, body)


def moves(frames: int = 3, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    generator = np.random.default_rng(seed)
    return generator.normal(0.0, 0.35, (frames, 24, 3)), generator.normal(0.0, 1.0, (frames, 3))


def offset_garment(body: Body) -> GarmentTemplate:
    """The body's own surface without hands, feet and head, moved outwards: a garment whose layer is known."""
    bare = np.isin(body.part_of_vertex, BARE_JOINTS)
    faces = body.faces[~bare[body.faces].any(axis=1)]
    used = np.unique(faces)
    vertices = (body.vertices + OFFSET * vertex_normals(body.vertices, body.faces))[used]
    return GarmentTemplate(
        "skin", "dress", vertices, np.searchsorted(used, faces), np.zeros(0, int),
        body.skin_index[used], body.skin_weight[used], body.name, body.digest,
        pieces=MeshTopology.from_faces(np.searchsorted(used, faces), len(used)).component_count(),
    )  # fmt: skip


def test_unposing_then_posing_is_the_identity(body):
    pose, root = moves()
    of = np.arange(0, len(body.vertices), 7)
    points = body.posed(pose, root)[:, of] + np.random.default_rng(1).normal(0.0, 0.03, (3, len(of), 3))
    rest = unposed(points, body, of, pose, root)
    whole = np.zeros((3, len(body.vertices), 3))
    whole[:, of] = rest - body.vertices[of]
    assert np.abs(dressed_body(body, whole, pose, root)[:, of] - points).max() < 2e-6


def test_a_naked_body_unposed_is_the_bind_pose(body):
    pose, root = moves()
    every = np.arange(len(body.vertices))
    rest = unposed(body.posed(pose, root), body, every, pose, root)
    assert np.abs(rest - body.vertices).max() < 2e-5


def test_a_joint_twisted_by_half_a_turn_is_refused(body):
    pose, root, of = np.zeros((2, 24, 3)), np.zeros((2, 3)), np.arange(len(body.vertices))
    pose[1, 18] = (np.pi, 0.0, 0.0)
    index, weight = body.skin_index.copy(), body.skin_weight.copy()
    index[7], weight[7] = (16, 18, 0, 0), (0.5, 0.5, 0.0, 0.0)
    even = replace(body, skin_index=index, skin_weight=weight)
    with pytest.raises(ValueError, match=r"frame 1: the skinning of body vertex 7 is flat .* twisted by half a turn"):
        unposed(even.posed(pose, root), even, of, pose, root)


def test_the_transfer_of_a_known_offset_gives_that_offset(body):
    garment = offset_garment(body)
    found = cast_layer(garment, body)
    clothable = ~np.isin(body.part_of_vertex, BARE_JOINTS)
    assert len(found.covered) > 0.85 * clothable.sum()
    pose, root = moves()
    worn = BodyLayer(found, body)
    bind = np.repeat(body.bind_pose()[None], 3, axis=0)
    still = np.repeat(garment.vertices[None], 3, axis=0)
    layer = worn.displacements(still, bind, np.zeros((3, 3)))
    length = np.linalg.norm(layer, axis=2)
    # The nearest point of a surface that bends away is never farther than the offset, and seldom much nearer.
    assert length.max() < OFFSET + 1e-3
    assert abs(np.median(length) - OFFSET) < 1e-3
    outwards = np.einsum("tcx,cx->tc", layer, vertex_normals(body.vertices, body.faces)[found.covered]) / length
    assert np.median(outwards) > 0.93  # the body's facets are large
    error = transfer_error(worn, _moved(garment, body, pose, root), layer, pose, root)
    assert error.figures()["mean_mm"] < 3.5


def _moved(garment: GarmentTemplate, body: Body, pose: np.ndarray, root: np.ndarray) -> np.ndarray:
    return replace(
        body, vertices=garment.vertices, skin_index=garment.skin_index, skin_weight=garment.skin_weight
    ).posed(pose, root)


def test_the_outermost_garment_is_cast_and_hands_feet_and_head_stay_bare(outfit, body, layer):
    assert not np.isin(body.part_of_vertex[layer.covered], BARE_JOINTS).any()
    owner = layer.worn
    assert np.array_equal(owner, outfit.layer[layer.points.argmax(axis=1)].ravel())
    part = body.part_of_vertex[layer.covered]
    assert (owner[np.isin(part, (13, 14, 16, 17, 9))] == 1).all(), "chest and upper arms wear the shirt"
    assert (owner[np.isin(part, (1, 2))] == 0).any(), "thighs wear the pants"
    hidden = ~layer.visible
    assert hidden.any() and (outfit.layer[hidden] == 0).all(), "only what the shirt covers is hidden"
    assert np.allclose(layer.points.sum(axis=1), 1.0)


def test_a_layer_is_the_cloth_on_another_body_too(outfit, body, layer):
    other = body.shaped(np.array([1.0, -0.5, 0.8]))
    cloth = graded(outfit, body, other).vertices[None]
    bind, root = other.bind_pose()[None], np.zeros((1, 3))
    worn = BodyLayer(layer, other)
    displacements = worn.displacements(cloth, bind, root)
    assert np.abs(worn.dressed(displacements, bind, root)[0, layer.covered] - layer.points @ cloth[0]).max() < 1e-5
    figures = transfer_error(worn, cloth, displacements, bind, root).figures()
    assert 0.0 < figures["mean_mm"] < 12.0


def test_garments_and_layers_of_another_body_are_refused(outfit, layer):
    with pytest.raises(ValueError, match="made for another body"):
        cast_layer(outfit, Body.load("full"))
    with pytest.raises(ValueError, match="made for another body"):
        BodyLayer(layer, Body.load("full"))


def layer_file(name: str, covered: list[int], body: Body, frames: int = 2) -> LayerFile:
    generator = np.random.default_rng(len(covered))
    return LayerFile(
        name, body.name, body.digest, np.array(covered), generator.normal(0, 0.02, (frames, len(covered), 3)),
        np.zeros((frames, 24, 3)), np.zeros((frames, 3)), np.zeros((frames, 10)), np.ones(frames, int),
        np.zeros(frames, int), ("train",), ("walk_000",),
    )  # fmt: skip


def test_layer_files_come_back_and_are_joined_on_the_vertices_of_all_types(tmp_path, body):
    files = [layer_file("short", [3, 5], body), layer_file("long", [3, 5, 9], body)]
    for one in files:
        write_layer(tmp_path / f"{one.type}.h5", one)
    joined = joined_layers([read_layer(tmp_path / f"{one.type}.h5") for one in files])
    assert joined.types == ("short", "long") and joined.vertices.tolist() == [3, 5, 9]
    assert joined.covered.tolist() == [[True, True, False], [True, True, True]]
    assert np.abs(joined.displacements[2:] - files[1].displacements).max() < 5e-5
    assert (joined.displacements[:2, 2] == 0).all()
    assert joined.type_index.tolist() == [0, 0, 1, 1] and joined.sequence.tolist() == [0, 0, 1, 1]
    assert len(joined.chosen(joined.type_index == 1)) == 2
    with pytest.raises(ValueError, match="each type may be given once"):
        joined_layers([files[0], files[0]])
    with pytest.raises(ValueError, match="on another body"):
        joined_layers([files[0], replace(files[1], body_digest="0")])
    (tmp_path / "broken.h5").write_bytes(b"no layer")
    with pytest.raises(ValueError, match=r"broken\.h5 cannot be read"):
        read_layer(tmp_path / "broken.h5")


@pytest.fixture(scope="module")
def hierarchy(body, layer) -> MeshHierarchy:
    count = len(layer.covered)
    return build_hierarchy(body.vertices, body.faces, layer.covered, [count // 2, count // 4, count // 8], body.digest)


def test_levels_have_the_counts_that_are_asked_for_and_are_subsets(hierarchy, layer):
    count = len(layer.covered)
    assert [len(level) for level in hierarchy.levels] == [count, count // 2, count // 4, count // 8]
    for fine, coarse in zip(hierarchy.levels, hierarchy.levels[1:]):
        assert np.isin(coarse, fine).all()


def test_rows_of_the_matrices_sum_to_one_and_kept_vertices_stay(hierarchy):
    for k in range(3):
        up, down = hierarchy.up[k], hierarchy.down(k)
        assert up.min() >= 0.0
        assert np.allclose(up.sum(axis=1), 1.0) and np.allclose(down.sum(axis=1), 1.0)
        assert np.abs(down @ up - np.eye(down.shape[0])).max() < 1e-5, "what both levels have is kept"


def test_a_smooth_field_survives_going_down_and_up(hierarchy, body):
    for k in range(1, 4):
        fine = body.vertices[hierarchy.levels[0]].astype(np.float64)
        field = np.sin(2.0 * fine)
        back = hierarchy.between(k, 0) @ (hierarchy.between(0, k) @ field)
        assert np.sqrt(np.mean((back - field) ** 2)) < (0.03, 0.06, 0.12)[k - 1] * field.std()


def test_a_hierarchy_comes_back_from_its_file(hierarchy, tmp_path):
    hierarchy.save(tmp_path / "levels.npz")
    back = MeshHierarchy.load(tmp_path / "levels.npz")
    assert back.digest == hierarchy.digest
    assert all(np.array_equal(a, b) for a, b in zip(back.levels, hierarchy.levels))
    assert all(abs(a - b).max() == 0 for a, b in zip(back.up, hierarchy.up))
    (tmp_path / "levels.npz").write_bytes(b"no levels")
    with pytest.raises(ValueError, match="not a readable mesh hierarchy"):
        MeshHierarchy.load(tmp_path / "levels.npz")


def test_levels_that_do_not_fall_are_refused(body):
    with pytest.raises(ValueError, match="must fall"):
        build_hierarchy(body.vertices, body.faces, np.arange(100), [100], body.digest)
