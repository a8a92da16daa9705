"""Exports, each read back by a program that is not ours."""

from __future__ import annotations

import json
import shutil
import struct
import subprocess
from pathlib import Path

import numpy as np
import pytest
import trimesh
from PIL import Image

from formats.animation import AnimatedMesh, Animation
from formats.gltf import write_glb
from formats.keyframe import read_keyframe
from formats.morph_targets import morph_targets
from formats.save import save_animation
from tests.moving_tube import FPS, FRAMES, moving, tube, turning_walk


@pytest.fixture(scope="module")
def animation() -> Animation:
    return turning_walk()


# --- glTF -------------------------------------------------------------------------------------------------------------

WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3}
TYPES = {5126: "<f4", 5125: "<u4"}


def glb(path: Path) -> tuple[dict, list[np.ndarray]]:
    """Document and accessors of a GLB file, checked against the rules of the format (glTF 2.0, 3.6 and 4.4)."""
    content = path.read_bytes()
    assert struct.unpack("<4sII", content[:12]) == (b"glTF", 2, len(content))
    length, kind = struct.unpack("<I4s", content[12:20])
    assert kind == b"JSON" and length % 4 == 0
    document = json.loads(content[20 : 20 + length])
    size, kind = struct.unpack("<I4s", content[20 + length : 28 + length])
    binary = content[28 + length :]
    assert kind == b"BIN\0" and size == len(binary) == document["buffers"][0]["byteLength"] and size % 4 == 0
    arrays, used = [], [0] * len(document["bufferViews"])
    for accessor in document["accessors"]:
        view = document["bufferViews"][accessor["bufferView"]]
        dtype, width = np.dtype(TYPES[accessor["componentType"]]), WIDTHS[accessor["type"]]
        start, bytes_ = view["byteOffset"] + accessor["byteOffset"], accessor["count"] * width * dtype.itemsize
        assert start % 4 == 0 and accessor["byteOffset"] + bytes_ <= view["byteLength"]
        assert view["byteOffset"] + view["byteLength"] <= size
        assert view.get("byteStride", 4 * width) == 4 * width
        used[accessor["bufferView"]] += 1
        values = np.frombuffer(binary, dtype, accessor["count"] * width, start).reshape(accessor["count"], width)
        assert values.dtype.kind != "f" or np.isfinite(values).all()
        for name, limit in (("min", values.min(axis=0)), ("max", values.max(axis=0))):
            assert name not in accessor or np.array_equal(np.float32(accessor[name]), limit)
        arrays.append(values)
    assert all(count == 1 or "byteStride" in view for count, view in zip(used, document["bufferViews"]))
    for mesh in document["meshes"]:
        for primitive in mesh["primitives"]:
            attributes = [primitive["attributes"], *primitive.get("targets", [])]
            assert all("min" in document["accessors"][a["POSITION"]] for a in attributes)
            assert len({len(arrays[i]) for a in attributes for i in a.values()}) == 1
            assert arrays[primitive["indices"]].max() < len(arrays[attributes[0]["POSITION"]])
            assert len(mesh.get("weights", [])) == len(primitive.get("targets", []))
    return document, arrays


def played(path: Path, name: str, seconds: float) -> tuple[np.ndarray, np.ndarray]:
    """Vertices and unit normals of a mesh of a GLB file at a moment, as a viewer blends them."""
    document, arrays = glb(path)
    node = next(i for i, node in enumerate(document["nodes"]) if node["name"] == name)
    mesh = document["meshes"][document["nodes"][node]["mesh"]]
    (channel,) = [c for c in document["animations"][0]["channels"] if c["target"] == {"node": node, "path": "weights"}]
    sampler = document["animations"][0]["samplers"][channel["sampler"]]
    times, weights = arrays[sampler["input"]][:, 0], arrays[sampler["output"]]
    weights = weights.reshape(len(times), len(mesh["weights"]))
    now = np.array([np.interp(seconds, times, column) for column in weights.T])
    primitive = mesh["primitives"][0]
    blended = []
    for attribute in ("POSITION", "NORMAL"):
        offsets = np.stack([arrays[target[attribute]] for target in primitive["targets"]])
        blended.append(arrays[primitive["attributes"][attribute]] + np.einsum("k,kvc->vc", now, offsets))
    return blended[0], blended[1] / np.linalg.norm(blended[1], axis=1, keepdims=True)


def test_glb_plays_every_frame_and_is_read_by_trimesh(tmp_path: Path, animation: Animation) -> None:
    path = save_animation(tmp_path / "a.glb", animation)
    scene = trimesh.load_scene(path, process=False)
    assert set(scene.geometry) == {"skirt", "body"}
    for mesh in animation.meshes:
        found = scene.geometry[mesh.name]
        np.testing.assert_array_equal(found.vertices.astype(np.float32), mesh.frames[0])
        np.testing.assert_array_equal(found.faces, mesh.faces)
        normals = list(mesh.normals())
        for frame in (0, 4, FRAMES - 1):
            vertices, directions = played(path, mesh.name, frame / FPS)
            np.testing.assert_allclose(vertices, mesh.frames[frame], atol=1e-5)
            np.testing.assert_allclose(directions, normals[frame], atol=1e-3)
    np.testing.assert_allclose(scene.geometry["skirt"].visual.uv, animation.mesh("skirt").uv, atol=1e-6)
    document, arrays = glb(path)
    times = arrays[document["animations"][0]["samplers"][0]["input"]][:, 0]
    np.testing.assert_allclose(times, np.arange(FRAMES) / FPS, atol=1e-6)
    body = next(mesh for mesh in document["meshes"] if mesh["name"] == "body")
    assert len(body["weights"]) == 1, "a body that only slides is one target"
    material = {m["name"]: m for m in document["materials"]}["cloth"]
    assert material["doubleSided"] and material["pbrMetallicRoughness"]["baseColorFactor"][0] == pytest.approx(
        0.787412, abs=1e-5
    )


def test_glb_passes_the_khronos_validator(tmp_path: Path, animation: Animation) -> None:
    """Where node finds the package gltf-validator (NODE_PATH); the rules above are checked everywhere."""
    script = (
        "require('gltf-validator').validateBytes(new Uint8Array(require('fs').readFileSync(process.argv[1])))"
        ".then(r => console.log(JSON.stringify(r.issues)))"
    )
    node = shutil.which("node")
    if node is None or subprocess.run([node, "-e", "require('gltf-validator')"], capture_output=True).returncode:
        pytest.skip("no gltf-validator")
    path = save_animation(tmp_path / "a.glb", animation)
    run = subprocess.run([node, "-e", script, str(path)], capture_output=True, text=True, check=True)
    issues = json.loads(run.stdout)
    assert (issues["numErrors"], issues["numWarnings"]) == (0, 0), issues


def test_long_clips_take_few_targets_and_say_how_near_they_come() -> None:
    _, faces = tube()
    mesh = AnimatedMesh("skirt", faces, moving(320))
    targets = morph_targets(mesh, tolerance=1e-3)
    assert 10 < targets.weights.shape[1] < 200 and targets.worst_rms <= 1e-3 * 1.01
    assert targets.weights.min() >= 0.0 and targets.weights.max() <= 1.0, "Blender cuts off what is outside"
    fewer = morph_targets(mesh, tolerance=1e-3, most=targets.weights.shape[1] - 1)
    assert fewer.worst_rms > 1e-3, "no more targets than are needed"


def test_a_clip_that_needs_too_many_targets_is_cut_in_time(tmp_path: Path) -> None:
    _, faces = tube()
    mesh = AnimatedMesh("skirt", faces, moving(40))
    write_glb(tmp_path / "a.glb", Animation((mesh,), FPS), most_targets=20)
    document, arrays = glb(tmp_path / "a.glb")
    names = [node["name"] for node in document["nodes"]]
    assert names == ["skirt_0", "skirt_1", "skirt_2"]
    assert all(len(piece["weights"]) <= 20 for piece in document["meshes"])
    assert len({piece["primitives"][0]["indices"] for piece in document["meshes"]}) == 1, "what does not move is shared"
    assert [node.get("scale", [1, 1, 1])[0] for node in document["nodes"]] == [1, 0, 0], (
        "at rest the first one is shown"
    )
    animation = document["animations"][0]
    switches = {}
    for channel in animation["channels"]:
        if channel["target"]["path"] == "scale":
            sampler = animation["samplers"][channel["sampler"]]
            assert sampler["interpolation"] == "STEP"
            switches[channel["target"]["node"]] = arrays[sampler["input"]][:, 0], arrays[sampler["output"]][:, 0]
    for frame in (0, 12, 13, 14, 26, 39):
        now = frame / FPS + 1e-4
        shown = [
            node for node, (times, sizes) in switches.items() if sizes[np.searchsorted(times, now, "right") - 1] == 1
        ]
        assert len(shown) == 1
        vertices, _ = played(tmp_path / "a.glb", names[shown[0]], frame / FPS)
        np.testing.assert_allclose(vertices, mesh.frames[frame], atol=4e-4)


def test_a_mesh_that_stands_still_and_a_single_frame(tmp_path: Path) -> None:
    vertices, faces = tube()
    for frames in (1, 3):
        still = Animation((AnimatedMesh("skirt", faces, np.repeat(vertices[None], frames, axis=0)),), FPS)
        write_glb(tmp_path / "a.glb", still, force=True)
        document, _ = glb(tmp_path / "a.glb")
        assert "animations" not in document and "targets" not in document["meshes"][0]["primitives"][0]


# --- USD, OBJ, PC2 ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", ["usd", "usda", "usdc"])
def test_usd_is_read_by_usd(tmp_path: Path, animation: Animation, kind: str) -> None:
    from pxr import Usd, UsdGeom, UsdShade

    stage = Usd.Stage.Open(str(save_animation(tmp_path / f"a.{kind}", animation)))
    assert UsdGeom.GetStageUpAxis(stage) == "Y" and UsdGeom.GetStageMetersPerUnit(stage) == 1.0
    assert stage.GetTimeCodesPerSecond() == FPS == stage.GetFramesPerSecond()
    assert (stage.GetStartTimeCode(), stage.GetEndTimeCode()) == (0, FRAMES - 1)
    top = stage.GetDefaultPrim()
    assert top.GetName() == "turning_walk"
    for mesh in animation.meshes:
        prim = UsdGeom.Mesh(top.GetChild(mesh.name))
        np.testing.assert_array_equal(np.reshape(prim.GetFaceVertexIndicesAttr().Get(), (-1, 3)), mesh.faces)
        assert set(prim.GetFaceVertexCountsAttr().Get()) == {3} and prim.GetSubdivisionSchemeAttr().Get() == "none"
        assert len(prim.GetPointsAttr().GetTimeSamples()) == FRAMES
        normals = list(mesh.normals())
        for frame in (0, FRAMES - 1):
            np.testing.assert_allclose(prim.GetPointsAttr().Get(frame), mesh.frames[frame], atol=1e-6)
            np.testing.assert_allclose(prim.GetNormalsAttr().Get(frame), normals[frame], atol=1e-6)
            low, high = prim.GetExtentAttr().Get(frame)
            np.testing.assert_allclose(
                [low, high], [mesh.frames[frame].min(axis=0), mesh.frames[frame].max(axis=0)], 1e-5
            )
        assert prim.GetNormalsInterpolation() == "vertex"
        material, _ = UsdShade.MaterialBindingAPI(prim).ComputeBoundMaterial()
        assert material.GetPath().name == mesh.material
        colour = material.ComputeSurfaceSource()[0].GetInput("diffuseColor").Get()
        np.testing.assert_allclose(colour, mesh.linear_colour, atol=1e-6)


def test_obj_sequence_is_read_by_trimesh_and_as_keyframes(tmp_path: Path, animation: Animation) -> None:
    folder = save_animation(tmp_path / "a.obj", animation)
    assert folder == tmp_path / "a_obj" and len(list(folder.iterdir())) == 2 * FRAMES + 1
    for mesh in animation.meshes:
        path = folder / f"{mesh.name}_{FRAMES - 1:04d}.obj"
        found = trimesh.load_mesh(path, process=False, maintain_order=True)
        assert len(found.faces) == len(mesh.faces)
        same = trimesh.Trimesh(mesh.frames[-1], mesh.faces, process=False).triangles
        np.testing.assert_allclose(found.triangles, same, atol=1e-6)
        np.testing.assert_allclose(found.visual.material.diffuse[:3] / 255, mesh.linear_colour, atol=0.01)
        keyframe = read_keyframe(path, mesh.faces, mesh.frames.shape[1])
        np.testing.assert_allclose(keyframe, mesh.frames[-1], atol=1e-6)
    normals = [line.split()[1:] for line in path.read_text().splitlines() if line.startswith("vn ")]
    np.testing.assert_allclose(np.array(normals, float), list(animation.mesh("body").normals())[-1], atol=1e-4)


def read_pc2(path: Path) -> tuple[np.ndarray, float, float]:
    content = path.read_bytes()
    signature, version, points, start, rate, samples = struct.unpack("<12siiffi", content[:32])
    assert (signature, version) == (b"POINTCACHE2\0", 1) and len(content) == 32 + 12 * points * samples
    return np.frombuffer(content, "<f4", offset=32).reshape(samples, points, 3), start, rate


def test_point_cache_moves_the_obj_beside_it(tmp_path: Path, animation: Animation) -> None:
    folder = save_animation(tmp_path / "a.pc2", animation)
    for mesh in animation.meshes:
        samples, start, rate = read_pc2(folder / f"{mesh.name}.pc2")
        np.testing.assert_array_equal(samples, mesh.frames)
        assert (start, rate) == (0.0, 1.0)
        rest = read_keyframe(folder / f"{mesh.name}.obj", mesh.faces, samples.shape[1])
        np.testing.assert_allclose(rest, samples[0], atol=1e-6)


# --- Pictures ---------------------------------------------------------------------------------------------------------


def test_pictures_have_the_right_length_size_and_content(tmp_path: Path, animation: Animation) -> None:
    import av

    from formats.pictures import SIZE, drawn

    images = list(drawn(animation))
    with av.open(str(save_animation(tmp_path / "a.mp4", animation))) as video:
        stream = video.streams.video[0]
        assert stream.average_rate == FPS and stream.codec_context.name == "h264"
        assert (stream.width, stream.height) == SIZE
        assert float(stream.duration * stream.time_base) == pytest.approx(FRAMES / FPS, abs=1e-3)
        decoded = [frame.to_ndarray(format="rgb24") for frame in video.decode(stream)]
    assert len(decoded) == FRAMES
    moved = np.abs(images[0].astype(int) - images[-1]).mean()
    for picture, original in zip(decoded, images):
        assert np.abs(picture.astype(int) - original).mean() < 2.0
    assert moved > 3.0, "the first and the last picture differ, so the order was tested"
    head = (tmp_path / "a.mp4").read_bytes()
    assert 0 < head.find(b"moov") < head.find(b"mdat"), "plays while it loads"

    with Image.open(save_animation(tmp_path / "a.gif", animation)) as gif:
        durations = []
        for frame in range(gif.n_frames):
            gif.seek(frame)
            durations.append(gif.info["duration"])
        last = np.asarray(gif.convert("RGB")).astype(int)
        assert gif.n_frames == FRAMES and gif.info["loop"] == 0 and gif.size == SIZE
    assert sum(durations) == pytest.approx(1000 * FRAMES / FPS, abs=10)
    assert np.abs(last - images[-1]).mean() < 6.0

    with Image.open(save_animation(tmp_path / "a.png", animation)) as sheet:
        assert sheet.width > 5 * 300 and sheet.height > 2 * 400


def test_a_fast_gif_leaves_frames_out_and_a_cloth_alone_is_drawn(tmp_path: Path, animation: Animation) -> None:
    alone = Animation(animation.meshes[:1], 120.0)
    with Image.open(save_animation(tmp_path / "a.gif", alone)) as gif:
        assert gif.n_frames == 4
        durations = []
        for frame in range(4):
            gif.seek(frame)
            durations.append(gif.info["duration"])
        assert min(durations) >= 20 and sum(durations) == pytest.approx(1000 * 4 * 3 / 120, abs=10)
        red = np.asarray(gif.convert("RGB")).astype(int)
    assert (red[..., 0] - red[..., 2] > 60).mean() > 0.02
    body = Animation(animation.meshes[1:], 30.0)
    with Image.open(save_animation(tmp_path / "b.gif", body)) as gif:
        assert np.asarray(gif.convert("L")).std() > 5
