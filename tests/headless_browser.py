"""A headless Chromium for tests, driven through its DevTools protocol: no driver has to be installed for it."""

from __future__ import annotations

import base64
import contextlib
import io
import json
import os
import shutil
import subprocess
import tempfile
import time
import urllib.request
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image
from websockets.sync.client import connect

NAMES = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "chrome")
PATIENCE = 40.0
"""Seconds that a page may take for anything."""

_OPTIONS = (
    "--headless=new",
    "--no-sandbox",
    "--no-first-run",
    "--disable-dev-shm-usage",
    "--use-angle=swiftshader",
    "--enable-unsafe-swiftshader",
    "--hide-scrollbars",
    "--remote-debugging-port=0",
)


def chromium() -> str | None:
    """Path of a Chromium, or None where there is none."""
    return next((path for path in map(shutil.which, NAMES) if path), None)


class Page:
    """A page of a browser.

    Args:
        socket: Connection to it.
    """

    def __init__(self, socket: Any) -> None:
        self._socket, self._last = socket, 0
        self.call("Page.enable")
        self.call("Runtime.enable")

    def call(self, method: str, **parameters: Any) -> dict[str, Any]:
        """A command of the DevTools protocol and its result."""
        self._last += 1
        self._socket.send(json.dumps({"id": self._last, "method": method, "params": parameters}))
        while True:
            answer = json.loads(self._socket.recv(timeout=PATIENCE))
            if answer.get("id") == self._last:
                assert "error" not in answer, f"{method}: {answer['error']}"
                return answer["result"]

    def open(self, address: str) -> None:
        """Go to an address."""
        self.call("Page.navigate", url=address)

    def reload(self) -> None:
        """Load the page again."""
        self.call("Page.reload")

    def value(self, expression: str) -> Any:
        """What a JavaScript expression is."""
        answer = self.call("Runtime.evaluate", expression=expression, returnByValue=True, awaitPromise=True)
        assert "exceptionDetails" not in answer, answer["exceptionDetails"]
        return answer["result"].get("value")

    def text(self) -> str:
        """All that can be read on the page."""
        return self.value("document.body ? document.body.innerText : ''")

    def wait_for(self, text: str) -> None:
        """Wait until a text is on the page."""
        wait_until(lambda: text in self.text(), lambda: f"the page to say {text!r}; it says {self.text()[:2000]!r}")

    def click(self, label: str) -> None:
        """Click what a label stands on, as a mouse does; of a button its beginning is enough."""
        find = (
            f"(() => {{ const label = {json.dumps(label)}, seen = e => e.offsetParent !== null; "
            "const all = selector => [...document.querySelectorAll(selector)].filter(seen); "
            "const e = all('button, label, [role=tab]').find(e => e.innerText.trim().startsWith(label)) "
            "|| all('*').reverse().find(e => (e.innerText || '').trim() === label); if (!e) return null; "
            "e.scrollIntoView({block: 'center'}); const b = e.getBoundingClientRect(); "
            "return [b.x + b.width / 2, b.y + b.height / 2]; })()"
        )
        wait_until(lambda: self.value(find) is not None, lambda: f"{label!r}; the page says {self.text()[:2000]!r}")
        x, y = self.value(find)
        for kind in ("mouseMoved", "mousePressed", "mouseReleased"):
            self.call("Input.dispatchMouseEvent", type=kind, x=x, y=y, button="left", clickCount=1)

    def press(self, key: str, ctrl: bool = False, shift: bool = False) -> None:
        """Press a key, such as "z" or "Delete", with what else is held."""
        code = f"Key{key.upper()}" if len(key) == 1 else key
        held: dict[str, Any] = {"key": key, "code": code, "modifiers": 2 * ctrl + 8 * shift}
        if len(key) == 1:
            held["windowsVirtualKeyCode"] = ord(key.upper())
        for kind in ("rawKeyDown", "keyUp"):
            self.call("Input.dispatchKeyEvent", type=kind, **held)

    def enter(self, label: str, text: str) -> None:
        """Type into the field beside a label, which its beginning names, in place of what is there."""
        find = (
            f"(() => {{ const label = {json.dumps(label)}, seen = e => e.offsetParent !== null; "
            "let e = [...document.querySelectorAll('label, div, p')].filter(seen).reverse()"
            ".find(e => (e.innerText || '').trim().startsWith(label) && !e.querySelector('input')); "
            "while (e && !e.querySelector('input:not([type=hidden])')) e = e.parentElement; if (!e) return false; "
            "const field = e.querySelector('input:not([type=hidden])'); field.scrollIntoView({block: 'center'}); "
            "field.focus(); field.select(); return document.activeElement === field; })()"
        )
        wait_until(lambda: self.value(find), lambda: f"a field {label!r}; the page says {self.text()[:2000]!r}")
        self.call("Input.insertText", text=text)
        self.value("document.activeElement.blur()")

    def choose_file(self, accepts: str, path: str) -> None:
        """Give a file to the file input that accepts these endings."""
        root = self.call("DOM.getDocument", depth=0)["root"]["nodeId"]
        found = self.call("DOM.querySelector", nodeId=root, selector=f"input[type=file][accept='{accepts}']")["nodeId"]
        assert found, f"no file input for {accepts}"
        self.call("DOM.setFileInputFiles", nodeId=found, files=[path])

    def picture(self) -> np.ndarray:
        """What is seen, uint8 [H, W, 3]."""
        png = base64.b64decode(self.call("Page.captureScreenshot", format="png")["data"])
        return np.asarray(Image.open(io.BytesIO(png)).convert("RGB"))


@contextlib.contextmanager
def browser(size: tuple[int, int] = (1280, 800)) -> Iterator[Page]:
    """A browser with one page, gone at the end."""
    path = chromium()
    assert path is not None, "no Chromium"
    with tempfile.TemporaryDirectory(prefix="chromium_", ignore_cleanup_errors=True) as profile:
        process = subprocess.Popen(
            [path, *_OPTIONS, f"--user-data-dir={profile}", f"--window-size={size[0]},{size[1]}", "about:blank"],
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            env=os.environ | {"HOME": profile},
            start_new_session=True,
        )
        try:
            port_file = Path(profile) / "DevToolsActivePort"
            wait_until(lambda: port_file.is_file() and port_file.read_text().strip(), "Chromium to start")
            port = int(port_file.read_text().split()[0])
            with urllib.request.urlopen(f"http://127.0.0.1:{port}/json", timeout=PATIENCE) as answer:
                pages = [page for page in json.load(answer) if page["type"] == "page"]
            with connect(pages[0]["webSocketDebuggerUrl"], max_size=None, open_timeout=PATIENCE) as socket:
                yield Page(socket)
        finally:
            process.terminate()
            try:
                process.wait(timeout=10)
            except subprocess.TimeoutExpired:
                process.kill()


def wait_until(there: Callable[[], object], what: str | Callable[[], str]) -> None:
    """Wait for something; says what it waited for when it does not come."""
    end = time.monotonic() + PATIENCE
    while not there():
        assert time.monotonic() < end, f"waited in vain for {what if isinstance(what, str) else what()}"
        time.sleep(0.1)
