"""The app from end to end, in a real browser: load, play, a keyframe, another shape, undo, a body, a bad file, export,
reload."""

from __future__ import annotations

import numpy as np
import pytest
import trimesh

from app.server import page_address, start_server
from app.session import Session
from app.window import Window
from formats.animation_file import load_animation
from runtime.finished_run import FinishedRun
from tests.headless_browser import Page, browser, chromium, wait_until

LAST = 15
SIZE = (1200, 640)
SCENE = (slice(60, None), slice(320, 780))
"""What is seen between notifications and panel."""
FULL_RESOLUTION = "fixedDpr=1"
"""Left to itself, viser draws fewer pixels where frames are slow, and two pictures of the same are not alike."""


@pytest.fixture
def window(smoke, tmp_path):
    server = start_server("127.0.0.1", 0, "Drapeline")
    window = Window(server, Session(FinishedRun.open(smoke.results), "skirt", "walk", LAST + 1), tmp_path / "exports")
    yield window
    window.stop()


def _seen(page: Page) -> np.ndarray:
    """The body and its surroundings, once nothing moves there any more."""
    pictures = []

    def at_rest() -> bool:
        picture = page.picture()[SCENE].astype(np.int32)
        pictures.append(picture)
        return len(pictures) > 1 and _difference(picture, pictures[-2]) < 0.01

    wait_until(at_rest, "the picture to come to rest")
    return pictures[-1]


def _difference(one: np.ndarray, other: np.ndarray) -> float:
    """Mean difference of the brightness, 0 to 255."""
    return float(np.abs(one - other).mean())


def _wider(session: Session, folder) -> str:
    """A mesh of the garment in the last frame, half as wide again."""
    vertices = session.look(LAST).garment.astype(np.float64)
    middle = vertices.mean(axis=0)
    path = folder / "wider.obj"
    trimesh.Trimesh((vertices - middle) * (1.5, 1.0, 1.5) + middle, session.faces, process=False).export(path)
    return str(path)


@pytest.mark.skipif(chromium() is None, reason="no Chromium is installed: the app's page cannot be opened")
def test_a_garment_is_authored_in_the_browser(window, tmp_path):
    session = window.session
    with browser(SIZE) as page:
        page.open(f"{page_address(window.server)}/?{FULL_RESOLUTION}")
        page.wait_for("Timeline")
        page.wait_for("no keyframe here")
        assert "Drapeline" in page.text()
        wait_until(lambda: _seen(page).std() > 8.0, "a body to be seen")
        first = _seen(page)

        # Play: the frame moves on, and the picture with it.
        page.click("Play")
        wait_until(lambda: window.frame >= 3, "the player to move on")
        page.click("Pause")
        wait_until(lambda: not window.player.playing, "the player to pause")
        page.click(">|")
        wait_until(lambda: window.frame == LAST, "the last frame")
        page.wait_for(f"Frame {LAST}")
        before, garment = _seen(page), session.look(LAST).garment
        assert _difference(first, before) > 0.3

        # A keyframe of the present shape changes nothing; a candidate takes its place.
        page.click("Insert keyframe")
        wait_until(lambda: session.keyframe(LAST) is not None, "the keyframe")
        page.wait_for("keyframe: material")
        np.testing.assert_allclose(session.look(LAST).garment, garment, atol=1e-6)
        page.click("Show 4 candidates")
        wait_until(lambda: window.scene.candidates == 4, "the candidates")
        assert _difference(before, _seen(page)) > 0.3
        page.click("2")
        page.wait_for("keyframe: candidate 2")
        assert np.abs(session.look(LAST).garment - garment).max() > 1e-5
        page.click("Send them away")
        wait_until(lambda: window.scene.candidates == 0, "the candidates to go")
        wait_until(lambda: "Send them away" not in page.text(), "the page to know it")
        candidate = _seen(page)

        # Taken back by the button, and made again by the keys; both are seen.
        page.click("Undo")
        page.wait_for("keyframe: material")
        np.testing.assert_allclose(session.look(LAST).garment, garment, atol=1e-6)
        page.press("z", ctrl=True, shift=True)
        page.wait_for("keyframe: candidate 2")
        page.press("z", ctrl=True)
        page.wait_for("keyframe: material")
        page.press("y", ctrl=True)
        page.wait_for("keyframe: candidate 2")

        # Another body, under the same keyframes, and back.
        page.click("Body")
        page.enter("1 taller", "2")
        wait_until(lambda: session.shape[0] == 2.0, "the other body")
        page.wait_for("Undo: body shape")
        wait_until(lambda: _difference(candidate, _seen(page)) > 0.5, "the body to look taller")
        page.press("z", ctrl=True)
        wait_until(lambda: session.shape[0] == 0.0, "the own body again")
        page.click("Shape")

        # A file that is no mesh is refused in one sentence; the garment's own mesh becomes the shape that is seen.
        bad = tmp_path / "bad.obj"
        bad.write_text("v 1 2 three\n")
        page.click("Mesh")
        page.choose_file(".obj,.ply", str(bad))
        page.wait_for("bad.obj")
        assert session.keyframe(LAST).origin == "candidate 2"
        page.choose_file(".obj,.ply", _wider(session, tmp_path))
        page.wait_for("keyframe: wider.obj")
        assert np.ptp(session.look(LAST).garment[:, 0]) > 1.2 * np.ptp(garment[:, 0])
        wait_until(lambda: _difference(candidate, _seen(page)) > 0.5, "the garment to look wider")

        page.click("Export")
        page.click("h5")
        wait_until(lambda: any((tmp_path / "exports").glob("*.h5")), "the export")
        page.wait_for("Written:")
        exported = load_animation(next((tmp_path / "exports").glob("*.h5")))
        np.testing.assert_array_equal(exported.mesh("skirt").frames[LAST], session.look(LAST).garment)

        # What there is, is there again.
        after = _seen(page)
        page.reload()
        page.wait_for("keyframe: wider.obj")
        wait_until(lambda: _difference(after, _seen(page)) < 0.3, "the same picture again")
        assert window.frame == LAST and not window.player.playing
