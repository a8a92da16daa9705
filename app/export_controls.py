"""Buttons that take what was made elsewhere."""

from __future__ import annotations

import threading
from typing import TYPE_CHECKING

import viser

from app.exporting import DOWNLOADED, KINDS, export

if TYPE_CHECKING:
    from app.window import Window

_MADE_FOR = {
    "glb": "GLB · Blender, three.js, the web",
    "usd": "USD · Houdini, Maya, Omniverse",
    "mp4": "MP4 · a video",
    "obj": "OBJ · a mesh a frame",
    "pc2": "PC2 · a point cache",
    "h5": "h5 · our own, without loss",
}


class ExportControls:
    """Controls of exports, in the present container.

    Args:
        window: What they control.
    """

    def __init__(self, window: Window) -> None:
        self.window, gui = window, window.server.gui
        self._busy = threading.Lock()
        gui.add_markdown(
            f"Body and garment, all frames. Written to `{window.exports}`, never over what is there; a file of at most "
            f"{DOWNLOADED // 2**20} MiB is downloaded, too."
        )
        self._buttons = {kind: gui.add_button(_MADE_FOR[kind], icon=viser.Icon.DOWNLOAD) for kind in KINDS}
        self._told = gui.add_markdown("")
        for kind, button in self._buttons.items():
            button.on_click(window.guarded(lambda event, kind=kind: self._export(event.client, kind)))

    def _export(self, client: viser.ClientHandle, kind: str) -> None:
        if not self._busy.acquire(blocking=False):
            raise ValueError("an export is being written; wait until it is done")
        try:
            with self.window.busy(client, "Export", f"writing {kind} ..."):
                path = export(self.window.session.animation(), self.window.exports, kind)
        finally:
            self._busy.release()
        self._told.content = f"Written: `{path}`"
        self.window.say(client, "Exported", str(path), "green")
        if path.is_file() and path.stat().st_size <= DOWNLOADED:
            client.send_file_download(path.name, path.read_bytes())
