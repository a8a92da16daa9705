"""Bad input ends in one sentence that names the file and the element, before any time is spent; nothing is written."""

from __future__ import annotations

import json
import re
import subprocess
import sys
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import h5py
import numpy as np
import pytest

import pipeline.simulate as stage
from body.model import Body
from body.motion_limits import check_speeds
from garments.build import build_template
from garments.spec import GarmentSpec
from garments.template import GarmentTemplate
from geometry.mesh_check import check_mesh
from motions.bvh_folder import list_takes
from motions.clip import Clip
from motions.clip_file import write_clips
from motions.procedural import generate_clip
from pipeline.stage import run_stage
from sim.motion import checked_motion
from sim.rest_state import RestState
from sim.simulate import Simulator
from tests.test_xpbd import lattice

ROOT = Path(__file__).parent.parent
MOCAP = ROOT / "mocap"
FPS = 30.0


@pytest.fixture(scope="module")
def body() -> Body:
    return Body.load("small").shaped([])


@pytest.fixture(scope="module")
def skirt(body) -> GarmentTemplate:
    return build_template(GarmentSpec("skirt", "skirt", 250), body)


# --- meshes ----------------------------------------------------------------------------------------------------------


def changed(array: np.ndarray, at: object, value: object) -> np.ndarray:
    array = array.copy()
    array[at] = value
    return array


def two_sheets(vertices: np.ndarray, faces: np.ndarray, apart: float = 0.5) -> tuple[np.ndarray, np.ndarray]:
    return np.concatenate([vertices, vertices + [0, 0, apart]]), np.concatenate([faces, faces + len(vertices)])


def bow_tie(vertices: np.ndarray, faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Two sheets that share the last vertex of the one and the first of the other, and nothing else."""
    last = len(vertices) - 1
    shift = vertices[last] - vertices[0]
    second = np.concatenate([[last], np.arange(len(vertices), 2 * len(vertices) - 1)])
    return np.concatenate([vertices, vertices[1:] + shift]), np.concatenate([faces, second[faces]])


MESH_FAULTS: dict[str, tuple[Callable, str]] = {
    "NaN": (lambda v, f: (changed(v, (3, 1), np.nan), f), "vertex 3 is not finite"),
    "two NaN": (lambda v, f: (changed(v, [3, 9], np.inf), f), r"vertex 3 is not finite \(2 such vertices\)"),
    "flat": (lambda v, f: (v[:, :2], f), r"vertices must have shape \[V, 3\], got \[20, 2\]"),
    "quads": (lambda v, f: (v, np.c_[f, f[:, 0]]), r"triangles must have shape \[F, 3\]"),
    "no triangles": (lambda v, f: (v, f[:0]), "at least 3 vertices and 1 triangle"),
    "fractions": (lambda v, f: (v, f + 0.5), "triangles must hold whole numbers"),
    "range": (
        lambda v, f: (v, changed(f, (7, 2), 20)),
        r"triangle 7 has the corners .*20, outside the 20 vertices 0\.\.19",
    ),
    "negative": (lambda v, f: (v, changed(f, (7, 2), -1)), "triangle 7 has the corners"),
    "unused": (lambda v, f: (np.concatenate([v, v[:1] + 1.0]), f), "vertex 20 belongs to no triangle"),
    "corner twice": (lambda v, f: (v, changed(f, (4, 1), f[4, 0])), "triangle 4 .* is degenerate"),
    "sliver": (lambda v, f: (changed(v, 1, 0.5 * (v[0] + v[5]) + 1e-7), f), "triangle 0 .* is degenerate, its area is"),
    "repeated": (lambda v, f: (v, np.r_[f, f[2:3, [1, 2, 0]]]), "triangles 2 and 24 have the same corners"),
    "fin": (
        lambda v, f: (np.r_[v, v[6:7] + [0, 0, 0.02]], np.r_[f, [(6, 7, 20)]]),
        r"edge between vertices 6 and 7 belongs to 3 triangles \(\d+, \d+, 24\)",
    ),
    "wound": (
        lambda v, f: (v, changed(f, 3, f[3, ::-1])),
        "triangles . and . are wound against each other at the edge",
    ),
    "bow tie": (bow_tie, "vertex 19 joins 2 parts that share no edge"),
    "pieces": (two_sheets, "falls into 2 disconnected pieces of 20, 20 vertices, 1 is allowed"),
    "same place": (lambda v, f: two_sheets(v, f, 1e-8), r"vertices 0 and 20 lie at the same place .*\(20 such pairs\)"),
}


@pytest.mark.parametrize("fault", MESH_FAULTS)
def test_a_faulty_mesh_is_refused_by_its_element(fault):
    change, message = MESH_FAULTS[fault]
    with pytest.raises(ValueError, match=message) as caught:
        RestState.from_mesh(*change(*lattice(4, 5, 0.02)))
    assert str(caught.value).startswith("garment: ")


def test_sound_meshes_pass():
    vertices, faces = lattice(4, 5, 0.02)
    check_mesh("sheet", vertices, faces)
    check_mesh("layers", *two_sheets(vertices, faces), pieces=2)
    apart = vertices + np.where(np.arange(20) == 0, 2e-6, 0.0)[:, None]
    assert RestState.from_mesh(*two_sheets(apart, faces, 0.01), pieces=2).topology.component_count() == 2


# --- motions ---------------------------------------------------------------------------------------------------------


def standing(body: Body, frames: int = 12) -> tuple[np.ndarray, np.ndarray]:
    return np.tile(body.bind_pose().astype(float), (frames, 1, 1)), np.zeros((frames, 3))


def cut(pose: np.ndarray, root: np.ndarray) -> None:
    """Two motions that were joined: the arms are up from frame 6 on."""
    pose[6:, [16, 17], 2] += np.array([1.6, -1.6])


MOTION_FAULTS: dict[str, tuple[Callable, str]] = {
    "NaN": (lambda p, r: p.__setitem__((6, 3, 1), np.nan), "pose: frame 6 is not finite"),
    "teleport": (
        lambda p, r: r.__setitem__((slice(6, None), 0), 3.0),
        r"the root jumps 3.00 m between frames 1 and 2 \(0.03 s\), that is 90 m/s",
    ),
    "small teleport": (
        lambda p, r: r.__setitem__((slice(6, None), 0), 0.3),
        "the root jumps 0.30 m between frames 1 and 2 .* velocity changes by 9 m/s",
    ),
    "one frame": (lambda p, r: r.__setitem__((7, 1), 0.2), "the root jumps 0.20 m between frames [23] and"),
    "spin": (
        lambda p, r: p.__setitem__((slice(6, None), 0), [0.0, 3.0, 0.0]),
        "the joint pelvis turns by 3.0 rad between frames 1 and 2",
    ),
    "cut": (cut, "the joint (left|right)_(hand|wrist) jumps .* m between frames 1 and 2"),
    "lead-in": (lambda p, r: r.__setitem__((slice(2, None), 0), 3.0), "between frames 1 and 2 of the lead-in"),
}


@pytest.mark.parametrize("fault", MOTION_FAULTS)
def test_a_motion_that_jumps_is_refused(body, fault):
    change, message = MOTION_FAULTS[fault]
    pose, root = standing(body)
    assert checked_motion(pose, root, 4, body, FPS)[0].shape == pose.shape
    change(pose, root)
    with pytest.raises(ValueError, match=message):
        checked_motion(pose, root, 4, body, FPS)


@pytest.mark.parametrize("label", ["jump-high", "run", "punch"])
def test_the_liveliest_generated_motions_pass(body, label):
    clip = generate_clip(label, 0, 60, FPS, 20191, body)
    check_speeds(label, clip.pose, clip.root, FPS, body.joint_positions(clip.pose, clip.root))


@pytest.mark.skipif(not MOCAP.is_dir(), reason="no recordings here")
@pytest.mark.parametrize(
    "file", ["dataset-1_dash_angry_001", "dataset-1_punch_normal_002", "dataset-1_kick_normal_001"]
)
def test_the_liveliest_recordings_pass(body, file):
    take = next(take for take in list_takes(MOCAP) if file in take.file)
    assert take.clips(30, FPS, body)


# --- the stage -------------------------------------------------------------------------------------------------------


def still_clip(body: Body, **changes) -> Clip:
    pose, root = standing(body, 8)
    return Clip(
        **({"name": "still_000", "take": "t", "label": "l", "fps": FPS, "source": "test"} | changes),
        pose=pose,
        root=root,
    )


def spec_of(**changes) -> dict:
    solver = {
        "self_contact": True,
        "settle": 0.1,
        "attempts": 1,
        "substeps_factor": 2.0,
        "bounds": {"p99_edge_strain": 9, "penetration": 9, "vertices_inside": 1, "residual_speed": 99}
        | {"triangles_inside": 2, "pinched_vertices": 1, "crossing_pairs": 10},
    }
    spec = {"garment": "skirt", "plan": "materials", "seed": 1, "body": {"resolution": "small", "shape": []}}
    spec |= {"base": {}, "ranges": {}, "simulations": [[0, "still_000", 0]], "fps": FPS, "lead_in": 4, "solver": solver}
    return spec | changes


def altered(path: Path, **arrays: np.ndarray) -> None:
    """Change arrays of a template file behind the back of its class."""
    with np.load(path) as archive:
        content = {key: archive[key] for key in archive.files}
    np.savez(path, **(content | arrays))


def edited(path: Path, dataset: str, at: object, value: float) -> None:
    with h5py.File(path, "r+") as file:
        file[f"clips/00000/{dataset}"][at] = value


@pytest.fixture
def run(tmp_path, monkeypatch, body, skirt):
    """Run the stage as its command line does; gives its exit and what it says."""
    template, motions, shard = tmp_path / "skirt.npz", tmp_path / "batch.h5", tmp_path / "out" / "shard.h5"
    skirt.save(template)
    write_clips(motions, [still_clip(body)])

    def simulated(*_):
        raise AssertionError("time was spent")

    monkeypatch.setattr(Simulator, "run", simulated)

    def start(spec: dict, inputs: Sequence[Path] = (template, motions)) -> str:
        arguments = ["--spec", json.dumps(spec), "--in", *map(str, inputs), "--out", str(shard)]
        monkeypatch.setattr(sys, "argv", ["simulate.py", *arguments, "--device", "cpu"])
        with pytest.raises(SystemExit) as exit:
            run_stage(stage.main)
        assert isinstance(exit.value.code, str)  # sys.exit prints it to stderr and exits with 1
        left = {str(path.relative_to(tmp_path)) for path in tmp_path.rglob("*") if path.is_file()}
        assert left <= {"skirt.npz", "batch.h5"} and not shard.parent.exists()
        return exit.value.code

    start.template, start.motions = template, motions
    return start


def crossed(template: GarmentTemplate) -> np.ndarray:
    """A vertex of the hem pushed through the other side of the skirt."""
    vertices = template.vertices.copy()
    lowest = int(vertices[:, 1].argmin())
    centre = vertices.mean(axis=0)
    vertices[lowest, [0, 2]] = centre[[0, 2]] - 1.3 * (vertices[lowest, [0, 2]] - centre[[0, 2]])
    return vertices


def hung_on_the_shank(template: GarmentTemplate) -> dict[str, np.ndarray]:
    """One pin of the waist follows the left shank, which the clip bends."""
    pin = template.pinned[5]
    weight = np.eye(4, dtype=np.float32)[0]
    return {
        "skin_index": changed(template.skin_index, pin, 4),
        "skin_weight": changed(template.skin_weight, pin, weight),
    }


def shrunk(vertices: np.ndarray) -> np.ndarray:
    middle = vertices.mean(axis=0)
    return middle + (vertices - middle) * np.float32([0.8, 1.0, 0.8])


TEMPLATE_FAULTS: dict[str, tuple[Callable[[GarmentTemplate], dict], str]] = {
    "NaN": (lambda t: {"vertices": changed(t.vertices, 17, np.nan)}, "vertex 17 is not finite"),
    "degenerate": (lambda t: {"faces": changed(t.faces, (9, 0), t.faces[9, 1])}, "triangle 9 .* is degenerate"),
    "pieces": (
        lambda t: dict(zip(("vertices", "faces", "skin_index", "skin_weight", "layer"), doubled(t))),
        "falls into 2 disconnected pieces of 250, 250 vertices",
    ),
    "huge index": (lambda t: {"faces": changed(t.faces.astype(np.int64), (0, 0), 2**32 + 1)}, "more than 32 bits"),
    "centimetres": (lambda t: {"vertices": t.vertices * 100}, "m large on a body of 1.* m, allowed .* in centimetres"),
    "beside": (lambda t: {"vertices": t.vertices + np.float32([3, 0, 0])}, "lies beside the body, its x runs from"),
    "crossed": (lambda t: {"vertices": crossed(t)}, r"triangles \d+ and \d+ cross each other"),
    "inside": (lambda t: {"vertices": shrunk(t.vertices)}, r"starts inside the body.* vertex \d+ by .* mm"),
    "another body": (lambda t: {"body_digest": np.array("other")}, "was made for body"),
}


def doubled(t: GarmentTemplate) -> tuple[np.ndarray, ...]:
    vertices, faces = two_sheets(t.vertices, t.faces, 0.4)
    return vertices.astype(np.float32), faces, *(np.concatenate([a, a]) for a in (t.skin_index, t.skin_weight, t.layer))


@pytest.mark.parametrize("fault", TEMPLATE_FAULTS)
def test_a_faulty_template_ends_the_stage(run, skirt, fault):
    change, message = TEMPLATE_FAULTS[fault]
    altered(run.template, **change(skirt))
    said = run(spec_of())
    assert said.startswith(f"[simulate] error: {run.template}: garment 'skirt'")
    assert re.search(message, said), said


def test_a_file_that_is_no_template_ends_the_stage(run):
    altered(run.template, pieces=np.array(0))
    assert f"{run.template}: 'pieces' must be a whole number from 1 on, got 0" in run(spec_of())
    run.template.write_bytes(run.template.read_bytes()[:200])
    assert f"{run.template}: not a readable garment template" in run(spec_of())
    run.template.unlink()
    assert f"No such file or directory: '{run.template}'" in run(spec_of())


MOTION_FILE_FAULTS: dict[str, tuple[Callable[[Path], None], str]] = {
    "NaN": (lambda f: edited(f, "pose", (5, 3, 1), np.nan), r", clip 00000: .*pose is NaN or infinite in frame 5"),
    "teleport": (lambda f: edited(f, "root", (slice(5, 8), 0), 0.4), "the root jumps 0.40 m between frames 4 and 5"),
    "cut": (
        lambda f: edited(f, "pose", (slice(5, 8), 16, 2), 1.0),
        "clip 'still_000': .*the joint left_.* jumps .* between frames 4 and 5",
    ),
    "truncated": (lambda f: f.write_bytes(f.read_bytes()[:900]), "is damaged or not an HDF5 file"),
}


@pytest.mark.parametrize("fault", MOTION_FILE_FAULTS)
def test_a_faulty_motion_ends_the_stage(run, fault):
    change, message = MOTION_FILE_FAULTS[fault]
    change(run.motions)
    said = run(spec_of())
    assert str(run.motions) in said and re.search(message, said), said


def test_motions_that_do_not_belong_to_the_run_end_the_stage(run, body):
    said = run(spec_of(simulations=[[0, "walk_000", 0]]))
    assert f"{run.motions}: clip 'walk_000' is not there" in said
    said = run(spec_of(), [run.template])
    assert "--in: a garment template and motion files are needed, got 1 files" in said
    said = run(spec_of(), [run.template, run.motions, run.motions])
    assert f"{run.motions}: clip 'still_000' is in {run.motions} too" in said
    said = run(spec_of(fps=60.0))
    assert f"{run.motions}, clip 'still_000': has 30 frames a second, the run has 60" in said


def test_pins_that_a_motion_tears_apart_end_the_stage(run, body, skirt):
    altered(run.template, **hung_on_the_shank(skirt))
    pose, root = standing(body, 20)
    pose[:, 4, 0] += np.linspace(0.0, 1.5, 20)
    write_clips(run.motions, [replace(still_clip(body), pose=pose, root=root)])
    said = run(spec_of())
    assert f"{run.motions}, clip 'still_000': the pinned vertices" in said and "times the cloth between them" in said


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"base": {"density": -0.2}}, "--spec, base: intrinsic parameter density = -0.2: allowed are 0.01 to 2 kg/m^2"),
        ({"base": {"friction": float("nan")}}, "intrinsic parameter friction = nan"),
        ({"base": {"colour": 1.0}}, "unknown intrinsic parameter 'colour'"),
        (
            {"ranges": {"gravity": [90, 99]}, "simulations": [[7, "still_000", 0]]},
            "--spec, parameter set 7: intrinsic parameter gravity = 9",
        ),
    ],
)
def test_a_parameter_outside_its_range_ends_the_stage(run, changes, message):
    assert message in run(spec_of(**changes))


def test_the_command_itself_says_one_sentence_and_leaves_nothing(tmp_path, body, skirt):
    """The same in a process of its own: exit code, stderr, no trace of the output."""
    template, motions, shard = tmp_path / "skirt.npz", tmp_path / "batch.h5", tmp_path / "out" / "shard.h5"
    skirt.save(template)
    altered(template, vertices=changed(skirt.vertices, 17, np.nan))
    write_clips(motions, [still_clip(body)])
    command = [sys.executable, "-m", "pipeline.simulate", "--spec", json.dumps(spec_of()), "--out", str(shard)]
    done = subprocess.run(
        [*command, "--in", str(template), str(motions)], cwd=ROOT, capture_output=True, text=True, check=False
    )
    assert done.returncode == 1 and "Traceback" not in done.stderr
    assert f"[simulate] error: {template}: garment 'skirt': vertex 17 is not finite" in done.stderr.splitlines()[-1]
    assert not shard.parent.exists()
