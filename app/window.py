"""The page: a session, its picture and its controls, shared by every browser that opens it.

One user works on one machine, so there is one session: what a page shows after a reload, or a second page, is what
there is. Whatever goes wrong in a control is said on the page that it was used on, and ends nothing.
"""

from __future__ import annotations

import contextlib
import functools
import logging
import threading
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import TypeVar

import viser

from app.body_controls import BodyControls
from app.export_controls import ExportControls
from app.garment_controls import GarmentControls
from app.keyframe_controls import KeyframeControls, KeyframeList
from app.motion_controls import MotionControls
from app.player import Player
from app.redo import Redo
from app.scene import Scene
from app.session import Session
from app.shape_controls import ShapeControls
from app.timeline import Timeline
from app.undo_controls import UndoControls
from app.view_controls import ViewControls

T = TypeVar("T")

_log = logging.getLogger(__name__)


class Window:
    """The app on a server.

    Args:
        server: Where it is shown.
        session: What is worked on.
        exports: Folder that exports go to.
    """

    def __init__(self, server: viser.ViserServer, session: Session, exports: Path) -> None:
        self.server, self.session, self.exports = server, session, exports
        self.frame = 0
        self._showing = threading.RLock()
        gui = server.gui
        gui.configure_theme(show_logo=False, show_share_button=False, brand_color=(37, 110, 122), control_width="large")
        gui.main_panel.dock_right()
        gui.main_panel.set_width(400)
        self.scene = Scene(server)
        self.timeline = Timeline(self)
        self.undo = UndoControls(self)
        tabs = gui.add_tab_group()
        with tabs.add_tab("Shape", viser.Icon.SHIRT):
            self.garments = GarmentControls(self)
            self.keys = KeyframeControls(self)
            self.shapes = ShapeControls(self)
            self.key_list = KeyframeList(self)
        with tabs.add_tab("Body", viser.Icon.USER):
            self.body = BodyControls(self)
        with tabs.add_tab("Motion", viser.Icon.WALK):
            self.motions = MotionControls(self)
        with tabs.add_tab("View", viser.Icon.EYE):
            self.view = ViewControls(self)
        with tabs.add_tab("Export", viser.Icon.DOWNLOAD):
            self.export = ExportControls(self)
        self.redo = Redo(session, lambda: self.frame, self.timeline.progress, self._failed)
        self.player = Player(session.clip.fps, self._advance, self._failed)
        self._dressed: str | None = None
        self._dress()
        self.edited()

    def stop(self) -> None:
        """End its threads and the server."""
        self.player.stop()
        self.redo.stop()
        self.server.stop()

    def show(self, frame: int | None = None) -> None:
        """Show a frame, the present one where None: as it is now, made at once where it is stale."""
        with self._showing:
            self.frame = min(self.frame if frame is None else frame, self.session.frames - 1)
            look = self.session.look(self.frame)
            self.scene.show(look, self.session.path[look.frame], self.session.refine)
            self.view.say_inside(len(look.inside))

    def go(self, frame: int) -> None:
        """Show a frame and what there is to be done at it; candidates were those of another."""
        self.scrub(frame)
        self.timeline.at(self.frame)

    def scrub(self, frame: int) -> None:
        """As :meth:`go`, with the slider of the timeline left where the user holds it."""
        if frame != self.frame:
            self.scene.clear_candidates()
        self.show(frame)
        self._at()

    def edited(self, dragged: str | None = None, body_dragged: bool = False) -> None:
        """After an edit: show it on the present frame, then make all others again.

        Args:
            dragged: Parameter whose slider the user holds: that is left where it is.
            body_dragged: Whether the user holds a slider of the body: all of them are left where they are.
        """
        self.show()
        self.redo.ask()
        self.timeline.marks()
        self.key_list.follow()
        self._at(dragged)
        self.body.follow(body_dragged)
        self.undo.follow()

    def change(self, work: Callable[[], T], body_dragged: bool = False) -> T:
        """Take another garment, body or motion by ``work``, and show it; nothing is shown while they are exchanged."""
        with self._showing:
            result = work()
            self._dress()
        self.edited(body_dragged=body_dragged)
        return result

    def step_back(self, undo: bool) -> None:
        """Undo, or redo, and show the frame where it was."""
        self.pause()
        with self._showing:
            step = self.session.undo() if undo else self.session.redo()
            if step.frame is not None:
                self.frame = step.frame
            self._dress()
        self.edited()
        self.timeline.at(self.frame)
        self.garments.follow()
        self.motions.follow()
        self.view.follow()

    def play(self, on: bool) -> None:
        """Play or pause."""
        self.scene.clear_candidates()
        self.player.play(on)
        self.timeline.playing(on)
        if not on:
            self.go(self.frame)

    def pause(self) -> None:
        """Play no more."""
        if self.player.playing:
            self.play(False)

    @contextlib.contextmanager
    def busy(self, client: viser.ClientHandle, title: str, text: str) -> Iterator[None]:
        """Say on one page what is being done, as long as it is."""
        note = client.add_notification(title, text, loading=True, with_close_button=False)
        try:
            yield
        finally:
            note.remove()

    def guarded(self, callback: Callable) -> Callable:
        """A callback whose errors are said on the page that it came from."""

        @functools.wraps(callback)
        def careful(event: object) -> None:
            if getattr(event, "client", None) is None:
                return  # set by this program, not by a user
            try:
                callback(event)
            except (ValueError, OSError) as error:
                self.say(event.client, "That cannot be done", str(error), "red")
            except Exception as error:
                _log.exception("in a control of the app")
                self.say(event.client, "An unexpected error", f"{type(error).__name__}: {error}", "red")

        return careful

    def say(self, client: viser.ClientHandle, title: str, text: str, colour: str | None = None) -> None:
        """A notification on one page."""
        client.add_notification(title, text, color=colour, auto_close_seconds=12.0)

    def _dress(self) -> None:
        session = self.session
        self.frame = min(self.frame, session.frames - 1)
        self.scene.clear_candidates()
        if session.garment != self._dressed:
            self.scene.dress(session.garment, session.faces, session.run.body.faces, session.look(self.frame))
            self.shapes.build()
            self._dressed = session.garment

    def _at(self, dragged: str | None = None) -> None:
        """What there is and can be done at the frame that is shown."""
        self.keys.at(self.frame)
        self.key_list.at(self.frame)
        self.shapes.at(self.frame, dragged)

    def _advance(self, steps: int) -> None:
        self.show((self.frame + steps) % self.session.frames)
        self.timeline.at(self.frame)

    def _failed(self, error: Exception) -> None:
        if not isinstance(error, ValueError | OSError):
            _log.error("behind the app", exc_info=error)
        for client in self.server.get_clients().values():
            self.say(client, "That cannot be done", str(error), "red")
