"""ARCSim scenes: every written file is valid, the material is the same cloth, and a run's results are read back."""

from __future__ import annotations

import json
import stat
import sys
from pathlib import Path

import numpy as np
import pytest
import trimesh
from scipy.spatial.transform import Rotation

from body.model import Body, skin
from body.skeleton import JOINT_NAMES
from garments.build import build_template
from garments.spec import GarmentSpec
from geometry.proximity import closest_surface
from geometry.topology import MeshTopology, face_areas
from sim.arcsim.body_segments import body_segments, segment_error
from sim.arcsim.flattening import flatten
from sim.arcsim.results import read_frames, read_obj_vertices, read_timing
from sim.arcsim.run import arcsim_rows, find_binary, run_scene
from sim.arcsim.scene import MODULES, ArcsimSettings, write_obj, write_scene
from sim.arcsim.surface_pieces import components, is_disc, own_vertices, rims
from sim.parameters import base_parameters
from sim.rest_state import RestState

FRAMES, LEAD_IN = 10, 3


@pytest.fixture(scope="module")
def body() -> Body:
    return Body.load("small")


@pytest.fixture(scope="module")
def clip(body):
    """A skirt on a body that lifts a leg and turns."""
    template = build_template(GarmentSpec("skirt", "skirt", 320), body)
    pose = np.tile(body.bind_pose(), (FRAMES, 1, 1)).astype(np.float64)
    phase = (np.arange(FRAMES) / FRAMES) ** 2
    pose[:, 1, 0] -= 0.5 * phase
    pose[:, 0, 1] += 0.4 * phase
    root = np.zeros((FRAMES, 3))
    root[:, 2] = 0.1 * phase
    return template, body, pose, root, LEAD_IN


@pytest.fixture(scope="module")
def scene(clip, tmp_path_factory):
    settings = ArcsimSettings(settle_seconds=0.1, strain_limits=(0.95, 1.05))
    return write_scene(tmp_path_factory.mktemp("scene"), *clip, base_parameters({"wind_speed": 2.0}), settings)


def read_obj(path: Path) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Vertices, texture coordinates, faces and their corners of an OBJ file; -1 for corners without ``vt``."""
    points, flat, faces, corners = [], [], [], []
    for line in path.read_text().splitlines():
        word, *rest = line.split()
        if word == "v":
            points.append([float(value) for value in rest])
        elif word == "vt":
            flat.append([float(value) for value in rest])
        else:
            assert word == "f"
            pairs = [(*(int(part) - 1 for part in corner.split("/")), -1)[:2] for corner in rest]
            faces.append([pair[0] for pair in pairs])
            corners.append([pair[1] for pair in pairs])
    return np.array(points), np.array(flat), np.array(faces), np.array(corners)


def loaded(scene, name: str = "scene.json") -> dict:
    return json.loads((scene.folder / name).read_text())


# The garment


@pytest.mark.parametrize("kind", ["skirt", "tshirt"])
def test_garment_is_laid_flat_in_panels_within_the_allowed_strain(body, kind):
    template = build_template(GarmentSpec(kind, kind, 400), body)
    rest = RestState.from_mesh(template.vertices, template.faces)
    flat = flatten(rest, allowed_strain=0.03)
    faces = rest.topology.faces
    a, b, c = (flat.uv[flat.corners[:, k]] for k in range(3))
    signed = 0.5 * ((b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0])
    assert (signed > 0.0).all()
    # Lengths of the flat edges against those of the garment: strain along edges is bounded by the principal ones.
    for k in range(3):
        i, j = faces[:, k], faces[:, (k + 1) % 3]
        ratio = np.linalg.norm(flat.uv[flat.corners[:, k]] - flat.uv[flat.corners[:, (k + 1) % 3]], axis=1)
        ratio /= np.linalg.norm(rest.vertices[i] - rest.vertices[j], axis=1)
        assert np.abs(ratio - 1.0).max() <= 0.03 + 1e-6
    assert signed.sum() == pytest.approx(rest.area.sum(), rel=0.01)
    assert flat.figures()["mean_strain"] < 0.01
    assert flat.panels <= (4 if kind == "skirt" else 60)
    # Seams: a flat point belongs to one vertex and one panel; every panel is a disc.
    for values in (faces, np.repeat(flat.panel[:, None], 3, axis=1)):
        owner = np.full(len(flat.uv), -1)
        owner[flat.corners] = values
        assert (owner[flat.corners] == values).all() and (owner >= 0).all()
    for panel in range(flat.panels):
        corners = flat.corners[flat.panel == panel]
        assert len(components(corners)) == 1
        assert is_disc(own_vertices(corners)[0]) and len(np.unique(corners)) == len(own_vertices(corners)[1])
    # The warp is up: in the flat, height runs along v.
    first = flat.panel == 0
    along_v, height = flat.uv[flat.corners[first], 1].ravel(), rest.vertices[faces[first], 1].ravel()
    slope = np.polyfit(along_v, height, 1)
    assert slope[0] > 0.5


def test_a_dome_is_cut_until_it_lies_flat():
    ball = trimesh.creation.icosphere(2, 0.2)
    ball.update_faces(ball.triangles_center[:, 1] > -0.05)
    ball.remove_unreferenced_vertices()
    rest = RestState.from_mesh(np.asarray(ball.vertices), np.asarray(ball.faces))
    coarse, fine = flatten(rest, 0.1), flatten(rest, 0.02)
    assert fine.panels > coarse.panels > 1
    assert np.abs(fine.stretch - 1.0).max() <= 0.02 + 1e-6
    with pytest.raises(ValueError, match="allowed_strain = 0: must be above 0"):
        flatten(rest, 0)


# The body


def test_segments_are_closed_outward_and_cover_the_body(body):
    segments = body_segments(body)
    assert len({segment.joint for segment in segments}) == len(segments) >= 20
    for segment in segments:
        topology = MeshTopology.from_faces(segment.faces, len(segment.vertices))
        assert not topology.boundary.any()
        a, b, c = (segment.vertices[segment.faces[:, k]] for k in range(3))
        assert np.einsum("fk,fk->", a, np.cross(b, c)) / 6.0 > 1e-6  # volume [m^3]
        np.testing.assert_array_equal(segment.vertices[: len(segment.skin)], body.vertices[segment.skin])
    covered = np.unique(np.concatenate([segment.skin for segment in segments]))
    assert len(covered) > 0.99 * len(body.vertices)


def test_segments_stand_where_the_skin_is(clip, body):
    _, _, pose, root, _ = clip
    segments = body_segments(body)
    still = segment_error(body, segments, pose[:1], root[:1])
    assert max(still.values()) < 0.02 and still["off_skin_p99_m"] < 1e-3  # lids and dropped islands
    moved = segment_error(body, segments, pose[-1:], root[-1:])
    assert moved["off_skin_p99_m"] < 0.012 and moved["beyond_skin_p99_m"] < 0.015


def test_pieces_that_touch_at_a_vertex_get_their_own_vertices():
    faces = np.array([[0, 1, 2], [0, 3, 4]])
    local, origin = own_vertices(faces)
    assert len(origin) == 6 and (origin[local] == faces).all()
    assert len(components(faces)) == 2
    assert [len(loop) for loop in rims(local)] == [3, 3]


# The scene


def test_scene_names_files_and_indices_that_exist(scene, clip):
    template, _, pose, _, _ = clip
    content = loaded(scene)
    frame_time = 1.0 / 30.0
    assert content["frame_time"] == pytest.approx(frame_time) and content["frame_steps"] == 8
    assert content["end_frame"] == 3 + FRAMES - 1  # 0.1 s of settling are 3 frames
    assert (scene.first_frame, scene.frames) == (3 + LEAD_IN, FRAMES - LEAD_IN)
    cloth = content["cloths"][0]
    assert (scene.folder / cloth["mesh"]).is_file() and (scene.folder / cloth["materials"][0]["data"]).is_file()
    assert cloth["materials"][0]["strain_limits"] == [0.95, 1.05] and "strainlimiting" not in content["disable"]
    assert set(content["disable"]) < set(MODULES) and {"remeshing", "plasticity"} <= set(content["disable"])
    assert content["gravity"] == [0.0, -9.81, 0.0]
    assert content["obs_friction"] == 0.4 and content["friction"] == 0.3
    assert content["magic"]["repulsion_thickness"] == 0.003
    used = [part["motion"] for part in [*content["handles"], *content["obstacles"]]]
    assert sorted(used) == list(range(len(content["motions"])))
    assert [part["nodes"] for part in content["handles"]] == [[int(v)] for v in template.pinned]
    for motion in content["motions"]:
        times = [key["time"] for key in motion]
        assert times[0] == 0.0 and np.diff(times).min() > 0.0 and len(times) == len(pose) + 1
        assert times[-1] == pytest.approx(content["end_frame"] * frame_time)
    assert "stretch_damping" in scene.mapping["not_carried_over"]
    assert loaded(scene, "mapping.json")["flattening"]["panels"] >= 2


def test_garment_obj_keeps_mesh_and_seams(scene, clip):
    template, body, pose, root, _ = clip
    points, flat, faces, corners = read_obj(scene.folder / "garment.obj")
    np.testing.assert_array_equal(faces, template.faces)
    transforms = body.joint_transforms(pose[:1], root[:1])
    start = skin(template.vertices, template.skin_index, template.skin_weight, transforms)
    np.testing.assert_allclose(points, start[0], atol=1e-7)
    assert corners.min() == 0 and corners.max() == len(flat) - 1
    seams = len(flat) - len(points)
    assert seams > 0  # one v, several vt
    MeshTopology.from_faces(corners)  # manifold in the plane
    lifted = np.concatenate([flat, np.zeros((len(flat), 1))], axis=1)
    np.testing.assert_allclose(face_areas(lifted, corners), face_areas(template.vertices, template.faces), rtol=0.06)


def moved_by(key: dict, points: np.ndarray) -> np.ndarray:
    """Points under a keyframe, as the program reads it."""
    transform = key["transform"]
    degrees, *axis = transform.get("rotate", [0.0, 1.0, 0.0, 0.0])
    turned = Rotation.from_rotvec(np.radians(degrees) * np.array(axis)).apply(points)
    return transform.get("scale", 1.0) * turned + transform["translate"]


def test_motions_carry_body_and_pins(scene, clip):
    template, body, pose, root, _ = clip
    content = loaded(scene)
    posed = body.posed(pose, root)
    spine = next(o for o in content["obstacles"] if o["mesh"] == "segments/spine2.obj")
    points, _, faces, _ = read_obj(scene.folder / spine["mesh"])
    rigid = body.skin_weight[:, 0] > 0.999
    own = [v for v in np.flatnonzero(rigid) if JOINT_NAMES[body.skin_index[v, 0]] == "spine2"]
    key = content["motions"][spine["motion"]][-1]
    if own:
        distance = closest_surface(posed[-1, own], moved_by(key, points), faces).distance
        assert np.abs(distance).max() < 1e-4
    pins = skin(template.vertices, template.skin_index, template.skin_weight, body.joint_transforms(pose, root))
    start = read_obj(scene.folder / "garment.obj")[0]
    for handle in content["handles"]:
        vertex = handle["nodes"][0]
        for frame in (0, -1):
            moved = moved_by(content["motions"][handle["motion"]][frame], start[vertex])
            np.testing.assert_allclose(moved, pins[frame, vertex], atol=1e-6)


def test_rotations_do_not_jump_in_sign(clip, tmp_path):
    template, body, pose, root, _ = clip
    turning = np.tile(pose[:1], (40, 1, 1))
    turning[:, 0, 1] = np.linspace(0.0, 6.2, 40)  # a full turn
    written = write_scene(tmp_path, template, body, turning, np.tile(root[:1], (40, 1)), LEAD_IN, base_parameters())
    for motion in loaded(written)["motions"]:
        turns = [key["transform"]["rotate"] for key in motion if "rotate" in key["transform"]]
        if turns:
            half = np.radians([t[0] for t in turns]) / 2.0
            axes = np.array([t[1:] for t in turns])
            quaternion = np.concatenate([np.cos(half)[:, None], np.sin(half)[:, None] * axes], axis=1)
            assert (np.einsum("kc,kc->k", quaternion[1:], quaternion[:-1]) > 0.8).all()


def test_creases_and_bad_settings(clip, tmp_path):
    written = write_scene(tmp_path / "a", *clip, base_parameters({"bend_yield": 200.0}))
    content = loaded(written)
    assert content["cloths"][0]["materials"][0]["yield_curv"] == 200.0 and "plasticity" not in content["disable"]
    assert "strainlimiting" in content["disable"]
    with pytest.raises(ValueError, match="was made for body 'small'"):
        write_scene(tmp_path / "b", clip[0], Body.load("full"), *clip[2:], base_parameters())
    with pytest.raises(ValueError, match="must lie on both sides of 1"):
        ArcsimSettings(strain_limits=(1.1, 1.2))
    with pytest.raises(ValueError, match="steps_per_frame = 0"):
        ArcsimSettings(steps_per_frame=0)
    assert not (tmp_path / "b").exists()


# Results and runs

FAKE = """#!{python}
# Stands for the program: reads the scene as documented, lets the pins follow their handles, writes frames and times.
import json, os, sys
from pathlib import Path

command, scene, out = sys.argv[1:]
assert command == "simulateoffline" and os.environ["OMP_NUM_THREADS"] == "1"
scene, out = json.loads(Path(scene).read_text()), Path(out)
for obstacle in scene["obstacles"]:
    assert Path(obstacle["mesh"]).is_file()
assert json.loads(Path(scene["cloths"][0]["materials"][0]["data"]).read_text())["density"] > 0
lines = Path(scene["cloths"][0]["mesh"]).read_text().splitlines()
start = [[float(w) for w in line.split()[1:]] for line in lines if line.startswith("v ")]
rest = [line for line in lines if not line.startswith("v ")]
limited = "strainlimiting" not in scene["disable"]
times = []
for frame in range(scene["end_frame"] + 1):
    now = [list(p) for p in start]
    for handle in scene["handles"]:
        keys = scene["motions"][handle["motion"]]
        key = min(keys, key=lambda k: abs(k["time"] - frame * scene["frame_time"]))
        for node in handle["nodes"]:
            now[node] = [a + b for a, b in zip(start[node], key["transform"]["translate"])]
    text = ["v %g %g %g" % tuple(p) for p in now] + ["ny 0 0 0"] + rest
    (out / ("%04d_00.obj" % frame)).write_text("\\n".join(text) + "\\n")
    if frame:
        times.append("0.25 %g %g 0.125 0 0 0 0" % (0.5 + frame, 2.0 * limited))
(out / "timing").write_text("\\n".join(times) + "\\n")
"""


@pytest.fixture(scope="module")
def program(tmp_path_factory) -> str:
    return make_program(tmp_path_factory.mktemp("bin") / "arcsim", FAKE.format(python=sys.executable))


def make_program(path: Path, text: str) -> str:
    path.write_text(text)
    path.chmod(path.stat().st_mode | stat.S_IXUSR)
    return str(path)


def test_a_run_gives_frames_and_seconds(program, scene, clip):
    template, body, pose, root, _ = clip
    run = run_scene(program, scene)
    assert run.vertices.shape == (FRAMES - LEAD_IN, 320, 3) and run.vertices.dtype == np.float32
    pins = skin(template.vertices, template.skin_index, template.skin_weight, body.joint_transforms(pose, root))
    np.testing.assert_allclose(run.vertices[:, template.pinned], pins[LEAD_IN:, template.pinned], atol=1e-4)
    assert run.seconds.shape == (FRAMES - LEAD_IN, len(MODULES))
    first = 3 + LEAD_IN
    np.testing.assert_allclose(run.seconds[:, 1], 0.5 + first + np.arange(FRAMES - LEAD_IN))
    np.testing.assert_allclose(run.seconds[:, 2], 2.0)


def test_rows_for_the_timing_table(program, clip):
    template, body, pose, root, lead_in = clip
    rows = arcsim_rows(
        program, template, body, pose, root, lead_in, base_parameters(), frames=4, warm_up=2,
        settings=ArcsimSettings(settle_seconds=0.0),
    )  # fmt: skip
    assert [row["solver"] for row in rows] == ["ARCSim, no strain limits", "ARCSim, strain limits 0.95-1.05"]
    plain, limited = rows
    assert plain["vertices"] == 320 and plain["frames"] == 4 and plain["substeps"] == 8
    numbers = lead_in + 2 + np.arange(4)
    assert plain["median_s_per_frame"] == pytest.approx(np.median(0.25 + 0.5 + numbers + 0.125))
    assert limited["median_s_per_frame"] - plain["median_s_per_frame"] == pytest.approx(2.0)
    assert limited["strainlimiting_s_per_frame"] == 2.0 and "strainlimiting_s_per_frame" not in plain
    assert plain["source"] == "measured in this run"
    with pytest.raises(ValueError, match="105 frames are needed"):
        arcsim_rows(program, *clip, base_parameters(), frames=100, warm_up=2, settings=ArcsimSettings())


def test_what_goes_wrong_is_said_in_one_sentence(scene, tmp_path):
    with pytest.raises(ValueError, match="there is no such program, or it is not executable"):
        find_binary(str(tmp_path / "none"))
    failing = make_program(tmp_path / "failing", "#!/bin/sh\necho 'collision did not converge'\nexit 1\n")
    with pytest.raises(ValueError, match="ended with status 1: collision did not converge"):
        run_scene(failing, scene)
    silent = make_program(tmp_path / "silent", "#!/bin/sh\nexit 0\n")
    with pytest.raises(ValueError, match=r"left no file .*timing"):
        run_scene(silent, scene)
    slow = make_program(tmp_path / "slow", "#!/bin/sh\nexec sleep 30\n")
    with pytest.raises(ValueError, match=r"was stopped after 0.2 s"):
        run_scene(slow, scene, timeout=0.2)


def test_broken_results_are_refused(tmp_path):
    mesh = tmp_path / "0000_00.obj"
    write_obj(mesh, np.array([[0.0, 1.0, 2.0], [1e-9, -3.25, 4.0]]), np.zeros((0, 3), int))
    np.testing.assert_array_equal(read_obj_vertices(mesh), [[0.0, 1.0, 2.0], [1e-9, -3.25, 4.0]])
    with pytest.raises(ValueError, match="2 vertices, the garment has 3: was remeshing switched on"):
        read_frames(tmp_path, 3, 0, 1)
    with pytest.raises(ValueError, match=r"0001_00.obj: missing; frames 0 to 1 are needed"):
        read_frames(tmp_path, 2, 0, 2)
    mesh.write_text("v 0 1 two\n")
    with pytest.raises(ValueError, match="line 1: expected 'v x y z', found 'v 0 1 two'"):
        read_obj_vertices(mesh)
    mesh.write_text("vt 0 1\nv 0 1 nan\n")
    with pytest.raises(ValueError, match="line 2: vertex 0 is not finite"):
        read_obj_vertices(mesh)
    mesh.write_text("vt 0 1\n")
    with pytest.raises(ValueError, match="no vertex in it"):
        read_obj_vertices(mesh)
    timing = tmp_path / "timing"
    for text, said in (("1 2 3\n", "line 1: expected 8 times"), ("", "no frame"), ("0 0 0 0 0 0 0 -1\n", "line 1")):
        timing.write_text(text)
        with pytest.raises(ValueError, match=said):
            read_timing(timing)
