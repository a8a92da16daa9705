"""Exports, each read back by a program that is not ours; targets that are kept or whole; imports of untrusted files."""

from __future__ import annotations

import json
import os
import resource
import shutil
import struct
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest
import trimesh
from PIL import Image
from scipy.spatial.transform import Rotation

from body.model import Body
from datasets.shards import ShardHeader, ShardWriter, SimulatedSequence
from formats.animation import AnimatedMesh, Animation, dressed, plain_name
from formats.animation_file import load_animation
from formats.gltf import write_glb
from formats.keyframe import read_keyframe
from formats.morph_targets import morph_targets
from formats.motion_file import read_motion
from formats.save import FORMATS, save_animation
from motions.clip import Clip
from pipeline.export import main as export_main

FPS = 24.0
FRAMES = 10


def tube(rows: int = 6, columns: int = 12) -> tuple[np.ndarray, np.ndarray]:
    """A skirt-like tube around the y axis, outward triangles."""
    angle = np.arange(columns) * 2 * np.pi / columns
    ring = np.stack([np.cos(angle), np.zeros(columns), np.sin(angle)], axis=1)
    vertices = np.concatenate([ring * (0.2 + 0.03 * row) + [0, 1.0 - 0.08 * row, 0] for row in range(rows)])
    faces = []
    for row in range(rows - 1):
        for j in range(columns):
            a, b = row * columns + j, row * columns + (j + 1) % columns
            faces += [[a, b, a + columns], [b, b + columns, a + columns]]
    return vertices, np.array(faces)


def moving(frames: int = FRAMES, seed: int = 0) -> np.ndarray:
    """The tube turning, walking and fluttering, [T, V, 3]."""
    vertices, _ = tube()
    rng = np.random.default_rng(seed)
    flutter = np.cumsum(rng.normal(size=(frames, *vertices.shape)), axis=0) * 0.002
    turns = Rotation.from_rotvec(np.outer(np.arange(frames) * 0.05, [0, 1, 0])).as_matrix()
    path = np.stack([0.02 * np.arange(frames), np.zeros(frames), 0.03 * np.arange(frames)], axis=1)
    return (np.einsum("tij,vj->tvi", turns, vertices) + flutter + path[:, None]).astype(np.float32)


@pytest.fixture(scope="module")
def animation() -> Animation:
    vertices, faces = tube()
    uv = np.random.default_rng(1).random((len(vertices), 2))
    ball = trimesh.creation.icosphere(1, 0.15)
    body = np.asarray(ball.vertices) + [0, 0.8, 0] + 0.02 * np.arange(FRAMES)[:, None, None] * np.array([1, 0, 1.5])
    skirt = AnimatedMesh("skirt", faces, moving(), (0.9, 0.1, 0.1), "cloth", uv)
    return Animation((skirt, AnimatedMesh("body", ball.faces, body, (0.8, 0.8, 0.7), "skin")), FPS, "turning walk")


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


# --- Our own file -----------------------------------------------------------------------------------------------------


def walk(frames: int = FRAMES, fps: float = FPS) -> Clip:
    rng = np.random.default_rng(3)
    pose = 0.3 * rng.normal(size=(1, 24, 3)) + 0.01 * np.cumsum(rng.normal(size=(frames, 24, 3)), axis=0)
    pose[:, 22:] = 0.0
    root = np.stack([0.01 * np.arange(frames), np.zeros(frames), 0.02 * np.arange(frames)], axis=1)
    return Clip("walk_01", "take", "walk", pose, root, fps, "test")


def test_own_file_gives_everything_back(tmp_path: Path, animation: Animation) -> None:
    full = replace(animation, clip=walk(), notes={"garment": "skirt", "bend": 1.5e-5})
    again = load_animation(save_animation(tmp_path / "a.h5", full))
    assert (again.name, again.fps, dict(again.notes)) == (full.name, FPS, dict(full.notes))
    for mesh, found in zip(full.meshes, again.meshes):
        assert (mesh.name, mesh.material, mesh.colour) == (found.name, found.material, found.colour)
        np.testing.assert_array_equal(mesh.frames, found.frames)
        np.testing.assert_array_equal(mesh.faces, found.faces)
    np.testing.assert_array_equal(again.meshes[0].uv, full.meshes[0].uv)
    np.testing.assert_array_equal(again.clip.pose, full.clip.pose)
    np.testing.assert_array_equal(read_motion(tmp_path / "a.h5").root, full.clip.root)


def _set_attribute(name: str, value: object):
    def change(file: h5py.File) -> None:
        file.attrs[name] = value

    return change


def _replace_frames(**options):
    def change(file: h5py.File) -> None:
        del file["meshes/00/frames"]
        file["meshes/00"].create_dataset("frames", **options)

    return change


def _link_frames(file: h5py.File) -> None:
    del file["meshes/00/frames"]
    file["meshes/00/frames"] = h5py.ExternalLink("/etc/passwd", "x")


def _endless_corner(file: h5py.File) -> None:
    file["meshes/00/faces"][0, 0] = 10**6


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (_set_attribute("version", 2), "version 2, this program reads version 1"),
        (_set_attribute("format", "other"), "is no animation file"),
        (_set_attribute("fps", np.nan), "fps is nan"),
        (_set_attribute("meshes", 10**9), "allowed are 1 to"),
        (_set_attribute("notes", "[1]"), "must be a JSON object"),
        (_set_attribute("notes", "{"), "a.h5: "),
        (_replace_frames(shape=(10**6, 10**6, 3), dtype="f4"), "larger than this program reads"),
        (_replace_frames(shape=(10, 72, 3), dtype="f4", external=[("/etc/passwd", 0, 8640)]), "refers to another file"),
        (
            _replace_frames(data=np.where(np.arange(10)[:, None, None] > 3, np.inf, moving())),
            "frame 4 has a vertex that is not finite",
        ),
        (_replace_frames(data=np.zeros((10, 72, 3), "S4")), "must be an array of numbers"),
        (_replace_frames(data=np.zeros((9, 72, 3), "f4")), "same number of frames"),
        (_link_frames, "'frames' is missing"),
        (_endless_corner, "outside the 72 vertices"),
    ],
)
def test_damaged_own_files_end_in_one_sentence(tmp_path: Path, animation: Animation, change, said: str) -> None:
    path = save_animation(tmp_path / "a.h5", animation)
    with h5py.File(path, "r+") as file:
        change(file)
    with pytest.raises(ValueError, match=said) as error:
        load_animation(path)
    assert "a.h5" in str(error.value) and "\n" not in str(error.value)


def test_truncated_own_files_are_refused(tmp_path: Path, animation: Animation) -> None:
    whole = save_animation(tmp_path / "a.h5", animation).read_bytes()
    for share in (0.0, 0.1, 0.5, 0.99):
        (tmp_path / "b.h5").write_bytes(whole[: int(share * len(whole))])
        with pytest.raises(ValueError, match=r"b\.h5"):
            load_animation(tmp_path / "b.h5")


# --- Targets ----------------------------------------------------------------------------------------------------------


@contextmanager
def disk_with(free: int) -> Iterator[None]:
    """No file may grow beyond ``free`` bytes: a write fails as on a full disk."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (free, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


@pytest.mark.parametrize("kind", FORMATS)
def test_a_full_disk_leaves_nothing_and_loses_nothing(tmp_path: Path, animation: Animation, kind: str) -> None:
    animation = cut(animation, 4)
    with disk_with(2000), pytest.raises(OSError, match=r"could not be written \(.+\); nothing of it was left behind"):
        save_animation(tmp_path / f"a.{kind}", animation)
    assert list(tmp_path.iterdir()) == []
    before = save_animation(tmp_path / f"a.{kind}", animation)
    kept = contents(before)
    with disk_with(2000), pytest.raises(OSError, match="could not be written"):
        save_animation(tmp_path / f"a.{kind}", animation, force=True)
    assert list(tmp_path.iterdir()) == [before] and contents(before) == kept


@pytest.mark.parametrize("kind", ["usdc", "h5", "pc2", "glb"])
def test_a_disk_that_fills_up_on_the_way_leaves_nothing(tmp_path: Path, kind: str) -> None:
    long = Animation((AnimatedMesh("skirt", tube()[1], moving(700)),), FPS)
    whole = save_animation(tmp_path / f"whole.{kind}", long)
    size = max(len(content) for content in contents(whole).values())
    with disk_with(int(0.7 * size)), pytest.raises(OSError, match="could not be written"):
        save_animation(tmp_path / f"a.{kind}", long)
    assert list(tmp_path.iterdir()) == [whole]


@pytest.mark.parametrize("kept", [slice(0, 0.6), slice(0.5, 0.6)])
def test_a_usd_file_with_a_hole_is_found_out(tmp_path: Path, animation: Animation, monkeypatch, kept: slice) -> None:
    """As after a write that failed and of which the library does not tell, as happens on a full disk."""
    from pxr import Sdf

    content = save_animation(tmp_path / "a.usdc", animation).read_bytes()
    start, end = (int(share * len(content)) for share in (kept.start, kept.stop))
    holed = content[:end] if start == 0 else content[:start] + bytes(end - start) + content[end:]
    monkeypatch.setattr(Sdf.Layer, "Export", lambda _, path: Path(path).write_bytes(holed) > 0)
    with pytest.raises(OSError, match="only a part of it could be stored"):
        save_animation(tmp_path / "b.usdc", animation)
    assert not (tmp_path / "b.usdc").exists()


def cut(animation: Animation, frames: int) -> Animation:
    return replace(animation, meshes=[replace(mesh, frames=mesh.frames[:frames]) for mesh in animation.meshes])


def contents(path: Path) -> dict[str, bytes]:
    files = sorted(path.iterdir()) if path.is_dir() else [path]
    return {file.name: file.read_bytes() for file in files}


@pytest.mark.parametrize("kind", ["glb", "obj"])
def test_what_exists_is_kept_unless_forced(tmp_path: Path, animation: Animation, kind: str) -> None:
    first = save_animation(tmp_path / f"a.{kind}", animation)
    kept = contents(first)
    shorter = cut(animation, 5)
    with pytest.raises(ValueError, match="exists and is kept; --force replaces it"):
        save_animation(tmp_path / f"a.{kind}", shorter)
    assert contents(first) == kept
    save_animation(tmp_path / f"a.{kind}", shorter, force=True)
    assert contents(first) != kept and (kind != "obj" or len(contents(first)) == 11)
    assert [path.name for path in tmp_path.iterdir()] == [first.name]


def test_a_folder_with_the_work_of_others_is_never_replaced(tmp_path: Path, animation: Animation) -> None:
    folder = save_animation(tmp_path / "a.obj", animation)
    (folder / "scene.blend").write_text("days of work")
    with pytest.raises(ValueError, match=r"holds scene\.blend"):
        save_animation(tmp_path / "a.obj", animation, force=True)
    (tmp_path / "b.glb").mkdir()
    with pytest.raises(ValueError, match="is a folder"):
        save_animation(tmp_path / "b.glb", animation, force=True)
    with pytest.raises(ValueError, match=r"unknown format; a name must end in \.h5, \.glb"):
        save_animation(tmp_path / "a.fbx", animation)


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ({"name": "9 lives"}, "must be a letter"),
        ({"faces": np.array([[0, 1, 72]])}, "outside the 72 vertices"),
        ({"frames": np.zeros((72, 3))}, r"shape \[T, V, 3\]"),
        ({"frames": np.full((2, 72, 3), np.nan)}, "not finite"),
        ({"colour": (1, 2, 3)}, "three numbers from 0 to 1"),
        ({"uv": np.zeros((3, 2))}, r"shape \[72, 2\]"),
    ],
)
def test_meshes_that_no_format_could_hold(animation: Animation, arguments: dict, said: str) -> None:
    with pytest.raises(ValueError, match=said):
        replace(animation.meshes[0], **arguments)


def test_names_are_made_plain() -> None:
    assert [plain_name(text) for text in ("walk_000", "a b/../c", "007", "ü")] == ["walk_000", "a_b_c", "m_007", "m_"]


# --- Imports ----------------------------------------------------------------------------------------------------------


def test_keyframes_of_another_mesh_are_refused_with_both_counts(tmp_path: Path) -> None:
    vertices, faces = tube()
    bent = vertices + [0, 0, 0.1]
    ply = tmp_path / "k.ply"
    trimesh.Trimesh(bent, faces, process=False).export(ply)
    np.testing.assert_allclose(read_keyframe(ply, faces, len(vertices)), bent, atol=1e-6)
    coarse = tube(5, 12)
    trimesh.Trimesh(*coarse, process=False).export(ply)
    with pytest.raises(ValueError, match="has 60 vertices and 96 triangles, the garment has 72 and 120"):
        read_keyframe(ply, faces, len(vertices))
    order = np.random.default_rng(0).permutation(len(vertices))
    trimesh.Trimesh(bent[order], np.argsort(order)[faces], process=False).export(ply)
    with pytest.raises(ValueError, match="another order"):
        read_keyframe(ply, faces, len(vertices))
    trimesh.Trimesh(100 * bent + 100, faces, process=False).export(ply)
    with pytest.raises(ValueError, match="is it in metres"):
        read_keyframe(ply, faces, len(vertices))
    ply.write_bytes(b"ply\nnonsense")
    with pytest.raises(ValueError, match=r"k\.ply: is not a readable PLY"):
        read_keyframe(ply, faces, len(vertices))
    (tmp_path / "k.obj").write_text("v 0 0 0\nv nan 0 0\nv 1 0 0\nf 1 2 3\n")
    with pytest.raises(ValueError, match="vertex 1 is not finite"):
        read_keyframe(tmp_path / "k.obj", np.array([[0, 1, 2]]), 3)
    with pytest.raises(ValueError, match=r"an \.obj or a \.ply"):
        (tmp_path / "k.stl").write_bytes(b"")
        read_keyframe(tmp_path / "k.stl", faces, 72)


@pytest.fixture(scope="module")
def body() -> Body:
    return Body.load("small")


# --- The command ------------------------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def shard(tmp_path_factory, body: Body) -> Path:
    vertices, faces = tube()
    path = tmp_path_factory.mktemp("shards") / "s.h5"
    header = ShardHeader(
        "skirt", "materials", "1", 0, FPS, "{}", vertices, faces, np.zeros(0, np.int32), "small", body.digest,
        body.faces, np.zeros(10), ("bend",), ("N m",), ("material",),
    )  # fmt: skip
    clip = walk()
    joints = body.joint_positions(clip.pose, clip.root)
    arrays = {"pose": clip.pose, "root": clip.root, "joints": joints}
    arrays |= {f"lead_{name}": array[:1] for name, array in arrays.items()}
    with ShardWriter(path, header) as writer:
        for phi, name in ((1, "walk"), (2, "walk"), (1, "run")):
            cloth = moving(seed=phi)
            writer.add(SimulatedSequence(name, name, 0, "walk", phi, {"bend": 1e-5 * phi}, vertices=cloth, **arrays))
    return path


def test_the_command_exports_a_sequence_and_the_file_that_it_wrote(tmp_path: Path, shard: Path, body: Body) -> None:
    one = ["--shard", str(shard), "--sequence", "walk:2", "--out", str(tmp_path)]
    export_main([*one, "--format", "h5,glb"])
    animation = load_animation(tmp_path / "skirt_walk_2.h5")
    np.testing.assert_array_equal(animation.mesh("skirt").frames, moving(seed=2))
    np.testing.assert_allclose(animation.mesh("body").frames, body.posed(walk().pose, walk().root), atol=1e-5)
    assert animation.notes["parameter_bend"] == pytest.approx(2e-5) and animation.clip.label == "walk"
    export_main(["--in", str(tmp_path / "skirt_walk_2.h5"), "--out", str(tmp_path / "again"), "--format", "glb"])
    assert (tmp_path / "again" / "skirt_walk_2.glb").read_bytes() == (tmp_path / "skirt_walk_2.glb").read_bytes()
    with pytest.raises(SystemExit, match="exists and is kept"):
        export_main([*one, "--format", "usd,glb"])
    assert not (tmp_path / "skirt_walk_2.usd").exists(), "looked at all targets before writing the first"


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["--sequence", "walk"], r"has 2 sequences 'walk', name one: walk:1, walk:2"),
        (["--sequence", "jump"], r"has no sequence 'jump', it has: walk:1, walk:2, run:1"),
        (["--sequence", "#9"], "has no sequence '#9'"),
        (["--sequence", "run", "--format", "fbx"], "unknown is 'fbx'; known are h5, glb"),
        ([], "--shard needs --sequence"),
    ],
)
def test_the_command_says_what_is_wrong(tmp_path: Path, shard: Path, arguments: list[str], said: str) -> None:
    with pytest.raises(SystemExit, match=said) as error:
        export_main(["--shard", str(shard), "--out", str(tmp_path / "out"), *arguments])
    assert str(error.value).startswith("[export] error: ") and not (tmp_path / "out").exists()


def test_the_command_as_a_user_runs_it(tmp_path: Path, shard: Path) -> None:
    command = [sys.executable, "-m", "pipeline.export", "--shard", str(shard)]
    listed = subprocess.run([*command, "--list"], capture_output=True, text=True, check=True)
    assert listed.stdout.splitlines() == ["#0  walk:1", "#1  walk:2", "#2  run:1"]
    failed = subprocess.run(
        [*command, "--sequence", "run", "--out", str(shard / "x")], capture_output=True, text=True, env=os.environ
    )
    assert failed.returncode == 1 and "could not be written" in failed.stderr and "Traceback" not in failed.stderr


def test_dressed_names_and_colours_its_meshes(animation: Animation) -> None:
    skirt, body = animation.meshes
    made = dressed("a", "my coat", skirt.frames, skirt.faces, body.frames, body.faces, FPS)
    assert [mesh.name for mesh in made.meshes] == ["my_coat", "body"]
    with pytest.raises(ValueError, match="must have the same number of frames, skirt has 10, body has 4"):
        dressed("a", "skirt", skirt.frames, skirt.faces, body.frames[:4], body.faces, FPS)
    with pytest.raises(ValueError, match="it has my_coat, body"):
        made.mesh("skirt")
