"""The benchmark on a tiny mesh: rows, reasons instead of crashes, the mapping of materials; never a time."""

from __future__ import annotations

import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.optimize import minimize_scalar

from benchmarks import runtime, speed, starts
from benchmarks.measure import cleanliness
from benchmarks.peers.recording import FrameClock, PeerRun, record
from benchmarks.scene import LEAD_IN, SETTLE_SECONDS, Scene, hinge_stiffness, make_scene, spring_stiffness
from body.model import Body
from garments.build import build_template
from garments.spec import GarmentSpec
from garments.template import GarmentTemplate
from models.refinement import RefinementSettings
from motions.procedural import generate_clip
from sim.rest_state import isometric_hinge_weights

FRAMES = 3


@pytest.fixture(scope="module")
def template(tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("benchmark") / "skirt.npz"
    build_template(GarmentSpec("skirt", "skirt", 250), Body.load("full")).save(path)
    return path


@pytest.fixture(scope="module")
def scene(template) -> Scene:
    return make_scene(template, FRAMES, substeps=4)


def test_every_solver_has_a_row_and_a_missing_peer_says_so(template, tmp_path):
    plan = speed.Plan(
        garments=(("skirt", 250),), worlds=(1,), substeps=8, frames=FRAMES, peers=("implicit", "newton-vbd", "blender")
    )
    # An interpreter without site-packages has no peer, whatever is installed here; NumPy it needs to get that far.
    bare = tmp_path / "bare"
    bare.write_text(f'#!/bin/sh\necho "newton: not here" >&2\nexit {speed.NOT_INSTALLED}\n')
    bare.chmod(0o755)
    rows = speed.garment_rows(replace(plan, peers_python=str(bare)), template, tmp_path)
    ours, implicit, vbd, blender = rows
    assert [row["vertices"] for row in rows] == [250] * 4
    assert ours["ratio"] == 1.0 and ours["worlds"] == 1 and ours["self"] == "off"
    for row in (ours, implicit):
        assert "note" not in row
        assert 0.0 < row["median_ms"] <= row["p95_ms"] and row["wall_ms"] > 0.0
        assert row["strain_p99_percent"] < 20.0 and row["inside_percent"] < 2.0
    assert implicit["apart_mm"] < 50.0
    assert vbd["note"] == blender["note"] == "not installed: newton: not here"
    assert "median_ms" not in vbd and "ratio" not in vbd
    assert "not installed: newton" in speed.table(rows)


def test_a_peer_module_without_its_package_ends_with_a_word(scene, tmp_path):
    path = tmp_path / "scene.npz"
    scene.save(path)
    hidden = "import sys; sys.modules['bpy'] = None; from benchmarks.peers.__main__ import main; "
    hidden += f"sys.exit(main('blender', '-', {str(path)!r}, 'unused'))"
    done = subprocess.run([sys.executable, "-c", hidden], cwd=speed.ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == speed.NOT_INSTALLED
    assert done.stderr.startswith("bpy: ") and len(done.stderr.splitlines()) == 1


def test_a_failing_peer_is_a_row_with_the_reason(scene, tmp_path):
    path = tmp_path / "scene.npz"
    replace(scene, self_contact=True).save(path)
    row = speed.peer_row(scene, path, "implicit", ("implicit", "-", sys.executable), None, tmp_path)
    assert row["note"] == "failed: ValueError: the implicit solver has no self-contact"
    row = speed.peer_row(scene, path, "blender", ("blender", "-", str(tmp_path / "nothing")), None, tmp_path)
    assert row["note"].startswith("not installed: ")


def test_starts_share_a_cache_that_begins_empty(monkeypatch, tmp_path):
    caches = []

    def run_own(job, folder, cache=None):
        caches.append(cache)
        if job.worlds == 16:
            raise starts.RowFailed("one world at a time")
        return dict.fromkeys(starts.START_TIMES, 2.0) | {"memory_mb": 300.0}

    monkeypatch.setattr(starts, "run_own", run_own)
    rows = starts.start_rows(tmp_path / "t.npz", [1, 16], tmp_path)
    assert [row["start"] for row in rows] == ["cold", "warm"] * 2
    assert caches[0] == caches[1] != caches[2] and not any(cache.exists() for cache in caches)
    assert rows[1]["total_s"] == 2.0 and rows[2]["note"] == "one world at a time"
    (row, _) = starts.memory_rows(tmp_path / "t.npz", [1], [False, True], 5, tmp_path)
    assert row == {"vertices": 12_540, "worlds": 1, "self": "off", "peak_mb": 300.0, "total_s": 2.0}


def test_scenes_and_runs_survive_their_files(scene, tmp_path):
    scene.save(tmp_path / "scene.npz")
    read = Scene.load(tmp_path / "scene.npz")
    assert read.parameters == scene.parameters and read.frames == FRAMES and read.lead_in == LEAD_IN
    for name in ("vertices", "faces", "pinned", "pins", "body", "body_faces"):
        assert np.array_equal(getattr(read, name), getattr(scene, name))
    assert len(scene.edges) == len(scene.faces) + len(scene.vertices)  # Euler's number of a tube is 0
    assert np.allclose(scene.pins[0], scene.vertices[scene.pinned], atol=1e-5)
    run = PeerRun("peer 1", "few", 7, scene.vertices[None].astype(np.float32), np.ones(1), np.ones(1))
    run.save(tmp_path / "run.npz")
    back = PeerRun.load(tmp_path / "run.npz")
    assert (back.solver, back.settings, back.steps) == ("peer 1", "few", 7)
    assert np.array_equal(back.vertices, run.vertices)


def test_a_peer_is_led_through_settling_lead_in_and_clip(scene):
    seen = []
    vertices, wall, cpu = record(
        scene, lambda start, end: seen.append((start, end)), lambda: scene.vertices + len(seen)
    )
    settle = round(SETTLE_SECONDS * scene.fps)
    assert seen[:settle] == [(0, 0)] * settle
    assert seen[settle:] == [(frame, frame + 1) for frame in range(LEAD_IN + FRAMES - 1)]
    # The last frame that is recorded comes after every step.
    assert np.allclose(vertices[-1], scene.vertices + len(seen)) and len(vertices) == len(wall) == len(cpu) == FRAMES


def test_the_clock_takes_the_recorded_frames_only():
    clock = FrameClock()
    clock.stamps = [(0.0, 0.0), (5.0, 4.0), (6.0, 4.5), (8.0, 5.5)]
    wall, cpu = clock.recorded(2)
    assert wall.tolist() == [1.0, 2.0] and cpu.tolist() == [0.5, 1.0]


def test_a_hinge_bends_like_the_sheet():
    """Energy of one hinge against that of our isometric bending, on equilateral triangles and a small angle."""
    edge, angle, bend = 0.015, 0.01, 3.0e-5
    height = np.sqrt(0.75) * edge
    flat = np.array([[0, 0, 0], [edge, 0, 0], [edge / 2, height, 0], [edge / 2, -height, 0]])
    bent = flat.copy()
    bent[3] = [edge / 2, -height * np.cos(angle), height * np.sin(angle)]
    weights = isometric_hinge_weights(flat, np.array([[0, 1, 2, 3]]))[0]
    ours = 0.5 * bend * ((weights @ bent) ** 2).sum()
    assert 0.5 * hinge_stiffness(bend) * angle**2 == pytest.approx(ours, rel=1e-4)


def test_springs_pull_like_the_sheet():
    """Equilateral lattice under uniaxial stress: the energy an area is ``stretch / 2`` a squared strain."""
    edge, stretch, strain = 0.015, 900.0, 1.0e-3
    directions = np.radians([0.0, 60.0, 120.0])

    def energy(across: float) -> float:
        springs = strain * np.cos(directions) ** 2 + across * np.sin(directions) ** 2
        stored = 0.5 * spring_stiffness(stretch) * (edge * springs) ** 2
        return stored.sum() / (np.sqrt(0.75) * edge**2)  # three springs a vertex

    least = minimize_scalar(energy, bounds=(-strain, strain), method="bounded", options={"xatol": 1e-12}).fun
    assert least == pytest.approx(0.5 * stretch * strain**2, rel=1e-4)


def test_cleanliness_sees_what_is_wrong(scene):
    still = np.repeat(scene.vertices[None], FRAMES, axis=0)
    standing = replace(scene, body=np.repeat(scene.body[:1], LEAD_IN + FRAMES, axis=0))
    clean = cleanliness(standing, still, still)
    assert clean.max_strain == 0.0 and clean.inside == 0.0 and clean.apart == 0.0
    centre = still.mean(axis=(0, 1))
    shrunk = cleanliness(standing, centre + 0.5 * (still - centre), still)
    assert shrunk.p99_strain == pytest.approx(0.5) and shrunk.apart > 0.05
    assert shrunk.inside > 0.2 and shrunk.deepest > 0.01
    still[1, 7] = np.nan
    with pytest.raises(ValueError, match="not finite from recorded frame 1 on"):
        cleanliness(standing, still)


def test_the_table_has_a_dash_for_what_is_missing_and_notes_last():
    rows = [{"solver": "a", "note": "gone"}, {"solver": "b", "median_ms": 1.23456, "deepest_mm": 12345.6}]
    head, first, second = speed.table(rows).splitlines()
    assert head.split() == ["solver", "median", "deepest", "mm", "note"]
    assert first.split() == ["a", "-", "-", "gone"] and second.split() == ["b", "1.23", "12346", "-"]


def test_memory_is_that_of_the_program_alone():
    """Not that of a launcher that holds more, as getrusage has it."""
    ballast = np.ones(60_000_000)  # 480 MB
    measured = "from benchmarks.measure import peak_memory; print(peak_memory())"
    done = subprocess.run([sys.executable, "-c", measured], cwd=speed.ROOT, capture_output=True, text=True, check=True)
    assert 10.0 < float(done.stdout) < 300.0
    assert ballast[-1] == 1.0


def test_every_figure_of_a_row_has_a_column(scene):
    titles = dict(speed.COLUMNS)
    frames = np.repeat(scene.vertices[None], FRAMES, axis=0)
    row = speed._times(np.ones(4), np.ones(4), 2) | speed._judged(scene, frames, frames)
    assert set(row) | set(speed._row(scene, "a", 1, "own parts", 1)) <= set(titles)
    assert row["median_ms"] == 1000.0 and row["world_ms"] == 500.0


def test_a_wrong_command_line_ends_in_one_sentence():
    plan, path = speed.parsed(["--garments", "pants:400", "--worlds", "1", "4", "--self-contact", "--json", "x.json"])
    assert plan.garments == (("pants", 400),) and plan.worlds == (1, 4) and plan.self_contact == (False, True)
    assert path == "x.json"
    with pytest.raises(ValueError, match=r"garment 'cape:10': expected KIND:VERTICES with a kind of skirt"):
        speed.parsed(["--garments", "cape:10"])
    with pytest.raises(ValueError, match=r"substeps 0.* at least 1, 1 and 2"):
        speed.parsed(["--substeps", "0"])


def test_runtime_sums_its_parts_and_finds_vertices_inside(template):
    body = Body.load("full")
    clip = generate_clip("walk", 0, 4, 30.0, 0, body)
    small = GarmentTemplate.load(template)
    rows = runtime.animation_rows(body, small, clip, repetitions=1)
    times = {(row["part"], row["model"]): row["median_ms"] for row in rows}
    parts = times["draw poses", "paper"] + times["body", "-"] + times["garment", "paper"]
    assert times["label to dressed body", "paper"] == pytest.approx(parts)
    assert times["the same, feet planted", "ours"] > times["label to dressed body", "ours"] > 0.0
    refined = runtime.refinement_row(body, small, clip, repetitions=1)
    assert refined["vertices"] == 250 and refined["median_ms"] > 0.0
    assert int(refined["model"].removesuffix(" inside")) > 0
    tight = runtime.refinement_row(body, small, clip, repetitions=1, settings=RefinementSettings(edges=True))
    assert refined["first_ms"] > 0.0 and tight["median_ms"] > 0.0
    shown = {row["part"] for row in rows} | {refined["part"], tight["part"], "decode from the intrinsic space"}
    assert runtime.GOALS.keys() <= shown
