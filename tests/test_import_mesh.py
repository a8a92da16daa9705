"""A user's own mesh: read, checked, dressed with skin weights; every fault names the file and the element."""

from __future__ import annotations

import json
import re
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
import trimesh

import pipeline.make_garment as stage
from body.model import Body
from garments import mesh_file
from garments.build import build_template
from garments.import_mesh import import_garment
from garments.mesh_file import read_mesh
from garments.spec import GarmentSpec, MeshGarmentSpec
from garments.template import GarmentTemplate
from pipeline import spec as specs
from pipeline.stage import run_stage
from tests.test_bad_input import changed, crossed, shrunk, two_sheets


@pytest.fixture(scope="module")
def body() -> Body:
    return Body.load("small").shaped([])


@pytest.fixture(scope="module")
def skirt(body) -> GarmentTemplate:
    return build_template(GarmentSpec("skirt", "skirt", 250), body)


def obj(vertices: np.ndarray, faces: np.ndarray) -> str:
    """Positions of full precision, and faces with texture and normal indices as modelling programs write them."""
    lines = ["# a skirt", "o skirt", "mtllib ../../secret.mtl"]
    lines += [f"v {x:.9g} {y:.9g} {z:.9g}" for x, y, z in vertices.tolist()]
    lines += ["vt 0 0", "vn 0 1 0"] + ["f " + " ".join(f"{i}/1/1" for i in face) for face in (faces + 1).tolist()]
    return "\n".join(lines)


def written(path: Path, vertices: np.ndarray, faces: np.ndarray) -> Path:
    if path.suffix == ".obj":
        path.write_text(obj(vertices, faces))
    else:
        trimesh.Trimesh(vertices, faces, process=False).export(path)
    return path


@pytest.mark.parametrize("suffix", [".obj", ".ply", ".glb"])
def test_a_mesh_becomes_the_garment_that_it_was_written_from(tmp_path, body, skirt, suffix):
    path = written(tmp_path / f"mine{suffix}", skirt.vertices, skirt.faces)
    mine = import_garment(MeshGarmentSpec("mine", str(path), "skirt"), body)
    assert (mine.name, mine.kind) == ("mine", "skirt") and mine.body_digest == body.digest
    np.testing.assert_allclose(mine.vertices, skirt.vertices, atol=1e-6)
    np.testing.assert_array_equal(mine.faces, skirt.faces)
    np.testing.assert_array_equal(mine.pinned, skirt.pinned)
    np.testing.assert_allclose(dense(mine), dense(skirt), atol=1e-3)


def dense(template: GarmentTemplate) -> np.ndarray:
    """Skin weights [V, 24]."""
    weights = np.zeros((len(template.vertices), 24))
    np.add.at(weights, (np.arange(len(weights))[:, None], template.skin_index), template.skin_weight)
    return weights


def test_what_it_is_worn_as_says_what_holds_it_and_whether_the_arms_lend_weights(tmp_path, body, skirt):
    muff = trimesh.creation.icosphere(3, 0.08)  # in front of the left hand
    path = str(written(tmp_path / "muff.obj", muff.vertices + body.joints[22] + [0.0, 0.0, 0.15], muff.faces))
    worn = import_garment(MeshGarmentSpec("muff", path, "dress"), body)
    assert len(worn.pinned) == 0 and dense(worn)[:, 16:24].sum(axis=1).mean() > 0.9
    worn = import_garment(MeshGarmentSpec("muff", path, "pants", held="none"), body)
    assert dense(worn)[:, 16:24].max() < 0.5
    path = str(written(tmp_path / "a.obj", skirt.vertices, skirt.faces))
    waist = import_garment(MeshGarmentSpec("d", path, "dress", held="waist"), body)
    assert len(waist.pinned) > 10 and np.ptp(waist.vertices[waist.pinned, 1]) < 0.031


def test_inches_and_triangles_that_face_the_body(tmp_path, body, skirt):
    path = written(tmp_path / "a.obj", skirt.vertices / np.float32(0.0254), skirt.faces[:, ::-1])
    mine = import_garment(MeshGarmentSpec("a", str(path), "skirt", scale=0.0254), body)
    np.testing.assert_allclose(mine.vertices, skirt.vertices, atol=1e-6)
    outward = np.cross(*(mine.vertices[mine.faces[:, k]] - mine.vertices[mine.faces[:, 0]] for k in (1, 2)))
    assert ((mine.vertices[mine.faces[:, 0]] * [1, 0, 1] * outward).sum(axis=1) > 0.0).mean() > 0.95


def test_obj_polygons_and_backward_indices(tmp_path):
    path = tmp_path / "quad.obj"
    path.write_text("v 0 0 0\nv 1 0 0 1.0\nv 1 1 0\nv 0 1 0\nf -4 -3 -2 -1 # a square\n")
    vertices, faces = read_mesh(path)
    assert vertices.shape == (4, 3) and faces.tolist() == [[0, 1, 2], [0, 2, 3]]


@pytest.mark.parametrize(
    ("name", "content", "message"),
    [
        ("a.obj", b"v 0 0 0\nv 1 0\n", r"a\.obj, line 2: a vertex needs 3 numbers, found '1 0'"),
        ("a.obj", b"v 0 0 0\nf 1 2 3\n", r"a\.obj, line 2: the face names vertex 2, 1 vertices stand before it"),
        ("a.obj", b"v 0 0 0\nf 1 1\n", "line 2: a face needs at least 3 corners"),
        ("a.obj", b"v 0 0 0\nf 0 1 1\n", "line 2: the face names vertex 0"),
        ("a.obj", b"v 0 0 0\nf x/1 1 1\n", "line 2: a face's corner must begin with a whole number, found 'x/1'"),
        ("a.obj", b"v 0 0 0\n", "holds no triangles"),
        ("a.obj", b"\xff\xfe\x00", "not a text file"),
        ("a.ply", b"ply\nformat ascii 1.0\nelement vertex 9\n", "not a readable PLY mesh"),
        ("a.glb", b"glTF" + bytes(40), "not a readable GLB mesh"),
        ("a.stl", b"solid", r"must end in \.obj, \.ply, \.glb"),
    ],
)
def test_files_that_are_no_mesh(tmp_path, name, content, message):
    (tmp_path / name).write_bytes(content)
    with pytest.raises(ValueError, match=message) as caught:
        read_mesh(tmp_path / name)
    assert str(caught.value).startswith(str(tmp_path / name))


def test_files_that_are_too_large(tmp_path, monkeypatch, skirt):
    path = written(tmp_path / "a.obj", skirt.vertices, skirt.faces)
    monkeypatch.setattr(mesh_file, "MAX_VERTICES", 249)
    with pytest.raises(ValueError, match=r"a\.obj: 250 vertices, at most 249 are read"):
        read_mesh(path)
    monkeypatch.setattr(mesh_file, "MAX_BYTES", 1000)
    with pytest.raises(ValueError, match=r"a\.obj: 0 MiB, at most 0 MiB is read"):
        read_mesh(path)


MESHES: dict[str, tuple[Callable[[GarmentTemplate], tuple[np.ndarray, np.ndarray]], str]] = {
    "NaN": (lambda t: (changed(t.vertices, (12, 0), np.nan), t.faces), "vertex 12 is not finite"),
    "centimetres": (
        lambda t: (t.vertices * 100, t.faces),
        "the mesh is .* m large on a body of 1.* is it in centimetres",
    ),
    "tiny": (lambda t: (t.vertices / 100, t.faces), "the mesh is 0.0.* m large on a body of 1.* allowed are 0.1"),
    "beside": (lambda t: (t.vertices[:, [0, 2, 1]] * [1, -1, 1] + [0, 0, 3], t.faces), "beside the body, its z"),
    "degenerate": (lambda t: (t.vertices, changed(t.faces, (9, 0), t.faces[9, 1])), "triangle 9 .* is degenerate"),
    "split seams": (lambda t: two_sheets(t.vertices, t.faces, 0.0), "vertices 0 and 250 lie at the same place"),
    "pieces": (lambda t: two_sheets(t.vertices, t.faces, 0.4), "falls into 2 disconnected pieces of 250, 250"),
    "crossed": (lambda t: (crossed(t), t.faces), r"triangles \d+ and \d+ cross each other"),
    "inside": (lambda t: (shrunk(t.vertices), t.faces), r"starts inside the body, vertex \d+ by .* mm"),
}


@pytest.mark.parametrize("fault", MESHES)
def test_a_faulty_mesh_ends_the_stage(tmp_path, monkeypatch, skirt, fault):
    change, message = MESHES[fault]
    path, out = written(tmp_path / "coat.obj", *change(skirt)), tmp_path / "out" / "coat.npz"
    geometry = {"kind": "mesh", "file": str(path), "worn_as": "skirt"}
    spec = {"garment": "coat", "geometry": geometry, "body": {"resolution": "small", "shape": []}}
    monkeypatch.setattr(
        sys, "argv", ["make_garment.py", "--spec", json.dumps(spec), "--out", str(out), "--in", str(path)]
    )
    with pytest.raises(SystemExit) as caught:
        run_stage(stage.main)
    said = caught.value.code
    assert said.startswith(f"[make_garment] error: {path}: ") and re.search(message, said), said
    assert not out.parent.exists()


def test_a_ball_in_front_has_neither_a_top_nor_a_waist(tmp_path, body):
    ball = trimesh.creation.icosphere(2, 0.2)
    path = written(tmp_path / "ball.obj", ball.vertices + body.joints[0] + [0.0, 0.0, 0.5], ball.faces)
    with pytest.raises(ValueError, match=r"ball\.obj: the mesh is closed, so it has no topmost opening"):
        import_garment(MeshGarmentSpec("ball", str(path), "skirt"), body)
    with pytest.raises(ValueError, match=r"ball\.obj: no vertex is near the waist .* at a height of 1\."):
        import_garment(MeshGarmentSpec("ball", str(path), "skirt", held="waist"), body)


def test_the_specification_is_checked():
    with pytest.raises(ValueError, match="'worn_as' must be one of skirt, pants, tshirt, top, jumpsuit, dress"):
        MeshGarmentSpec("low", "low.obj", "hat")
    with pytest.raises(ValueError, match="'held' must be one of none, top, waist"):
        MeshGarmentSpec("low", "low.obj", "skirt", held="hem")
    with pytest.raises(ValueError, match="'scale' must lie in"):
        MeshGarmentSpec("low", "low.obj", "skirt", scale=float("nan"))


def test_the_files_content_is_an_input_of_the_template():
    config = {"garments": {"coat": {"kind": "mesh", "file": "coat.obj"}, "skirt": {"kind": "skirt"}}}
    assert specs.garment_files(config, "coat") == ["coat.obj"] and specs.garment_files(config, "skirt") == []
    rule = (Path(specs.__file__).parent / "rules" / "data.smk").read_text()
    assert "spec.garment_files(config, w.garment)" in rule
