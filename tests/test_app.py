"""The app without a browser: sessions, uploads, exports, and who may connect to its server."""

from __future__ import annotations

import socket
import threading
from dataclasses import replace

import numpy as np
import pytest
import trimesh

from app.exporting import KINDS, export
from app.frames import Frames, Look
from app.materials import share_of, value_of
from app.motions import invented_motion, motion_of_file
from app.server import allowed_pages, page_address, start_server
from app.session import Session
from app.turns import Turns
from app.uploads import LARGEST, harmless, read_upload
from benchmarks.authoring import edit_rows, sequence_rows
from formats.animation_file import load_animation, write_animation_file
from pipeline.app import main
from runtime.finished_run import FinishedRun


@pytest.fixture(scope="module")
def run(smoke) -> FinishedRun:
    return FinishedRun.open(smoke.results)


@pytest.fixture
def session(run) -> Session:
    return Session(run, "skirt", "walk", frames=24)


def test_without_keyframes_a_session_is_the_base_material_and_an_inserted_keyframe_changes_nothing(session):
    before = session.look(10).garment
    key = session.insert(10)
    assert (key.frame, key.origin) == (10, "material")
    np.testing.assert_allclose(session.look(10).garment, before, atol=1e-6)
    assert session.insert(10) is session.keyframe(10)


def test_an_edit_shows_at_once_and_all_frames_are_made_again(session):
    session.remake()
    assert session.made == 1.0
    before = [session.look(frame).garment for frame in range(24)]
    low, high = session.ranges["density"]
    session.insert(0)
    session.insert_parameters(23, {"density": high})
    assert session.made == 0.0
    assert np.abs(session.look(23).garment - before[23]).max() > 1e-4
    told = []
    assert session.remake(first=12, progress=told.append)
    assert told[-1] == session.made == 1.0
    np.testing.assert_allclose(session.look(0).garment, before[0], atol=1e-6)
    # In between it passes from the one to the other.
    mixed = session.latent(0) * (1 - 10 / 23) + session.latent(23) * 10 / 23
    np.testing.assert_allclose(session.latent(10), mixed, atol=1e-5)
    session.insert_parameters(10, {"density": low})
    assert session.parameters_at(10)["density"] == low
    with pytest.raises(ValueError, match=rf"trained on {low:g} to {high:g} kg/m\^2"):
        session.insert_parameters(0, {"density": 2 * high})
    with pytest.raises(ValueError, match="not of substeps"):
        session.insert_parameters(0, {"substeps": 20})


def test_frames_made_together_are_those_made_alone(session):
    session.insert_latent(5, session.candidates(range(1))[0], "candidate")
    alone = [session.look(frame).garment for frame in (0, 5, 23)]
    session.set_refine(False)
    session.set_refine(True)
    session.remake()
    for frame, garment in zip((0, 5, 23), alone):
        np.testing.assert_allclose(session.look(frame).garment, garment, atol=1e-5)


def test_an_edit_stops_what_is_being_made(session):
    def edit(share: float) -> None:
        if not session.keyframes:
            session.insert(3)

    assert not session.remake(progress=edit)
    assert session.made < 1.0 and session.remake()


def test_a_frame_made_before_an_edit_is_not_kept_after_it():
    frames, look = Frames(2), Look(1, np.zeros((3, 3)), np.zeros((3, 3)), np.zeros(0, np.int64))
    version, there = frames.kept(1)
    assert there is None
    frames.edited()
    frames.keep(look, version)
    assert frames.kept(1)[1] is None and frames.share == 0.0
    frames.keep(look, frames.version)
    assert frames.kept(1)[1] is look and frames.share == 0.5 and list(frames.stale(1)) == [0]


def test_a_candidate_keeps_what_it_has_beyond_its_parameters_when_a_slider_moves(session):
    candidate = session.candidates(range(7, 8))[0] + 0.3
    session.insert_latent(4, candidate, "candidate 7")
    low, high = session.ranges["bend"]
    was = session.parameters_at(4)["bend"]
    session.insert_parameters(4, {"bend": high if was < (low * high) ** 0.5 else low})
    moved = session.latent(4)
    assert np.abs(moved - candidate).max() > 1e-5
    assert session.keyframe(4).origin == "candidate 7, changed"
    session.insert_parameters(4, {"bend": was})
    np.testing.assert_allclose(session.latent(4), candidate, atol=1e-4)
    assert session.keyframe(4).origin == "candidate 7, changed"


def test_candidates_differ_and_are_functions_of_their_seed(session):
    latents = session.candidates(range(3))
    np.testing.assert_array_equal(latents[2], session.candidates(range(2, 3))[0])
    looks = session.look_of(0, latents)
    assert np.abs(looks[0].garment - looks[1].garment).max() > 1e-4
    assert session.keyframes == ()


def test_the_picture_follows_the_body(session):
    pelvis = session.clip.root + session.run.body.joints[0]
    assert np.ptp(pelvis[:, [0, 2]], axis=0).max() > 0.02
    assert np.abs(session.path - pelvis)[:, [0, 2]].max() < 0.15 and (session.path[:, 1] == 0).all()


def test_keyframes_are_moved_and_deleted(session):
    session.insert(2)
    session.insert_latent(9, session.candidates(range(1))[0], "candidate")
    with pytest.raises(ValueError, match="frame 9 has a keyframe already"):
        session.move(2, 9)
    session.move(9, 20)
    assert [key.frame for key in session.keyframes] == [2, 20]
    session.delete(2)
    assert [key.frame for key in session.keyframes] == [20]
    for wrong in (lambda: session.delete(2), lambda: session.insert(24), lambda: session.look(-1)):
        with pytest.raises(ValueError, match="frame"):
            wrong()
    assert [key.frame for key in session.keyframes] == [20]


def test_a_mesh_becomes_a_keyframe_that_looks_like_it(session, tmp_path):
    shown = session.look_of(6, session.candidates(range(3, 4)))[0].garment
    trimesh.Trimesh(shown, session.faces, process=False).export(tmp_path / "mine.obj")
    session.insert_mesh(6, tmp_path / "mine.obj")
    assert session.keyframe(6).origin == "mine.obj"
    assert np.abs(session.look(6).garment - shown).max() < 2e-3
    trimesh.creation.box().export(tmp_path / "box.ply")
    with pytest.raises(ValueError, match=r"box.ply: has 8 vertices and 12 triangles, the garment has"):
        session.insert_mesh(7, tmp_path / "box.ply")


def test_refinement_takes_the_garment_out_of_the_body(session):
    session.insert_latent(0, 6.0 * session.candidates(range(1))[0], "far out")
    session.set_refine(False)
    inside = [len(session.look(frame).inside) for frame in range(24)]
    worst = int(np.argmax(inside))
    assert inside[worst] > 0
    raw = session.look(worst)
    session.set_refine(True)
    refined = session.look(worst)
    surface = session.run.garment("skirt").refiner(session.run.body).body.at(refined.body)
    assert (surface.query(raw.garment).distance < 0).sum() == inside[worst] == len(refined.inside)
    assert (surface.query(refined.garment).distance >= 0).all()


def test_materials_go_to_another_garment_and_keyframes_to_another_motion(session):
    session.insert_parameters(5, {"density": session.ranges["density"][1]})
    session.insert_latent(23, session.candidates(range(1))[0], "candidate")
    assert session.use_garment("tshirt") == [23]
    assert [key.frame for key in session.keyframes] == [5] and session.garment == "tshirt"
    assert session.parameters_at(5)["density"] == pytest.approx(session.ranges["density"][1])
    assert session.look(5).garment.shape[0] == len(session.run.garment("tshirt").template.vertices)
    session.use_clip(invented_motion(session.run, "squat", 47, 1))
    assert session.frames == 47 and session.clip.label == "squat"
    assert [key.frame for key in session.keyframes] == [10]  # the same share of its length
    with pytest.raises(ValueError, match="allowed are 2 to"):
        invented_motion(session.run, "squat", 1, 0)
    # A page could send anything: what is no label is no file either.
    with pytest.raises(ValueError, match="known labels: squat, walk"):
        invented_motion(session.run, str(session.run.folder / "motions" / "batch_0000.h5"), 24, 0)
    assert session.frames == 47


def test_sliding_feet_are_planted_under_the_same_keyframes(session, tmp_path):
    clip = session.clip
    forward = 0.3 * np.arange(clip.frames)[:, None] / clip.fps * np.array([1.0, 0.0, 0.0])  # 0.3 m/s
    session.use_clip(replace(clip, root=(clip.root + forward).astype(np.float32)))
    wider = tmp_path / "wider.obj"
    shown = session.look(9)
    trimesh.Trimesh(shown.garment + np.float32([0.0, 0.0, 0.02]), session.faces, process=False).export(wider)
    session.insert_mesh(9, wider)
    keys, asked = session.keyframes, session.look(9)
    before, after = session.plant_feet()
    assert before > 0.2 and after < 0.1 * before
    assert [key.origin for key in session.keyframes] == ["wider.obj"]
    np.testing.assert_array_equal(session.keyframes[0].detail, keys[0].detail)
    # The legs are others, the garment on them is the one that was asked for.
    assert np.abs(session.look(9).body - asked.body).max() > 0.01
    np.testing.assert_allclose(session.look(9).garment, asked.garment, atol=0.03)


def test_who_makes_frames_gives_way_to_an_edit():
    turns, made = Turns(), []

    def make() -> None:
        turns.give_way()
        made.append(1)

    with pytest.raises(KeyError), turns.edit():
        maker = threading.Thread(target=make)
        maker.start()
        maker.join(0.2)
        assert maker.is_alive() and not made
        raise KeyError
    maker.join(10.0)
    assert made == [1]


def test_what_is_saved_can_be_opened_as_a_motion(session, tmp_path):
    session.insert(3)
    animation = session.animation()
    assert animation.frames == 24 and animation.notes["keyframe_3"] == "material"
    np.testing.assert_array_equal(animation.mesh("skirt").frames[7], session.look(7).garment)
    write_animation_file(tmp_path / "a.h5", animation)
    session.use_clip(motion_of_file(session.run, tmp_path / "a.h5"))
    np.testing.assert_allclose(session.clip.pose, animation.clip.pose, atol=1e-6)


def test_exports_are_never_written_over_each_other(session, tmp_path):
    animation = session.animation()
    first, second = export(animation, tmp_path, "h5"), export(animation, tmp_path, "h5")
    assert first.name == "skirt_walk_0000.h5" and second.name == "skirt_walk_0000_2.h5"
    assert load_animation(second).name == "skirt_walk_0000_2"
    folders = [export(animation, tmp_path, kind) for kind in ("pc2", "obj", "obj")]
    assert [folder.name for folder in folders] == [
        "skirt_walk_0000_pc2",
        "skirt_walk_0000_obj",
        "skirt_walk_0000_2_obj",
    ]
    assert all(folder.is_dir() for folder in folders) and {"h5", "pc2", "obj"} <= set(KINDS)


def test_the_benchmark_times_every_kind_of_edit_and_the_whole_sequence(session):
    rows = edit_rows(session, 1, "idle") + sequence_rows(session, 1)
    assert [row["what"] for row in rows] == [
        *(f"edit: {what}, idle" for what in ("a parameter", "a candidate", "a mesh from a file", "a far keyframe")),
        *(f"edit: {what}, idle" for what in ("refinement", "undo", "body shape")),
        "all 24 frames",
        "all 24 frames, not refined",
    ]
    assert all(0 < row["best_s"] <= row["median_s"] <= row["longest_s"] for row in rows)
    assert session.refine


def test_uploads_are_judged_before_and_by_their_readers(session):
    def read(path):
        assert path.name == "walk.bvh"
        return path.read_bytes()

    assert read_upload("../../etc/walk.bvh", b"x", read) == b"x"
    assert harmless("C:\\temp\\..\\a b;c.OBJ") == "a_b_c.OBJ" and harmless("...") == "upload"
    with pytest.raises(ValueError, match=r"walk\.bvh: the file is empty"):
        read_upload("walk.bvh", b"", read)
    with pytest.raises(ValueError, match="at most 64 MiB"):
        read_upload("walk.bvh", bytes(LARGEST + 1), read)
    before = session.clip
    for name, content in (("a.bvh", b"HIERARCHY\nROOT x"), ("b.npz", b"PK\x03\x04 no"), ("c.h5", b"\x89HDF\r\n\x1a\n")):
        with pytest.raises(ValueError, match=rf"^{name}"):
            read_upload(name, content, lambda path: motion_of_file(session.run, path))
    with pytest.raises(ValueError, match=r"^x\.obj"):
        read_upload("x.obj", b"v 0 0 nonsense\n", lambda path: session.insert_mesh(0, path))
    assert session.clip is before and session.keyframes == ()


def test_sliders_span_the_ranges():
    for name, ends in (("bend", (2e-6, 9e-5)), ("friction", (0.2, 1.1))):
        assert value_of(name, 0.0, ends) == pytest.approx(ends[0]) and value_of(name, 1.0, ends) == pytest.approx(
            ends[1]
        )
        middle = value_of(name, 0.5, ends)
        assert share_of(name, middle, ends) == pytest.approx(0.5)
    assert value_of("bend", 0.5, (1e-6, 1e-4)) == pytest.approx(1e-5)


@pytest.mark.parametrize(
    ("host", "origin", "allowed"),
    [
        ("127.0.0.1", "http://127.0.0.1:8080", True),
        ("127.0.0.1", "http://localhost:9999", True),
        ("127.0.0.1", "https://evil.example", False),
        ("127.0.0.1", "http://127.0.0.1.evil.example", False),
        ("127.0.0.1", "http://10.0.0.7:8080", False),
        ("0.0.0.0", "http://10.0.0.7:8080", True),
        ("0.0.0.0", "http://evil.example:8080", False),
        ("::1", "http://[::1]:8080", True),
    ],
)
def test_only_own_pages_may_connect(host, origin, allowed):
    assert bool(allowed_pages(host).fullmatch(origin)) is allowed


def test_a_page_of_another_site_is_refused_by_the_running_server():
    from websockets.exceptions import InvalidStatus
    from websockets.sync.client import connect

    server = start_server("127.0.0.1", 0, "test")
    try:
        address = page_address(server).replace("http", "ws")
        with pytest.raises(InvalidStatus, match="403"):
            connect(address, origin="https://evil.example")
        import viser

        connect(address, origin=page_address(server), subprotocols=[f"viser-v{viser.__version__}"]).close()
    finally:
        server.stop()


def test_a_port_in_use_ends_with_one_sentence(smoke):
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        with pytest.raises(ValueError, match=f"port {port} of 127.0.0.1 is in use"):
            start_server("127.0.0.1", port, "test")
        with pytest.raises(SystemExit, match=rf"^\[app\] error: port {port} of 127.0.0.1 is in use.*\)$"):
            main(["--run", str(smoke.results), "--port", str(port), "--no-browser"])


def test_without_a_finished_run_the_command_says_what_to_run(tmp_path):
    with pytest.raises(SystemExit, match="no such run; `snakemake all` makes"):
        main(["--run", str(tmp_path / "none")])


def test_hosts_and_ports_that_cannot_be_are_refused():
    with pytest.raises(ValueError, match="allowed are 0 to 65535"):
        start_server("127.0.0.1", 70000, "test")
    with pytest.raises(ValueError, match="no name or address"):
        start_server("no such host", 0, "test")
