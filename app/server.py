"""The web server of the app: on the port that was asked for or not at all, and for this machine's own pages alone.

Left to itself, viser takes the next free port where one is in use, so that a bookmark shows another program; and it
lets any web page that the browser has open connect, wherever it came from. Here neither happens.
"""

from __future__ import annotations

import contextlib
import ipaddress
import os
import re
import socket
from collections.abc import Iterator

import viser
import websockets.asyncio.server

LOOPBACK = "127.0.0.1"
PORT = 8080


def start_server(host: str, port: int, label: str) -> viser.ViserServer:
    """A running server.

    Args:
        host: Name or address to listen at; a loopback address keeps it on this machine.
        port: Port to listen at, 0 to 65535; 0 takes any free one.
        label: Title of the panel.

    Raises:
        ValueError: The port is in use, or host or port cannot be listened at; one sentence.
    """
    if not 0 <= port <= 65535:
        raise ValueError(f"--port {port}: allowed are 0 to 65535; 0 takes any free one")
    _check_free(host, port)
    with _own_pages_only(host), _chosen_port():
        server = viser.ViserServer(host, port, label=label, verbose=False)
    if port and server.get_port() != port:
        server.stop()
        raise ValueError(_in_use(host, port))
    return server


def allowed_pages(host: str) -> re.Pattern[str]:
    """Origins of the pages that may connect to a server at ``host``: its own, whatever the port.

    A tunnel may show the app under another port. A server that the network reaches is called by its addresses or by
    this machine's name; another name that leads here is a stranger's.
    """
    names = {"localhost", "127.0.0.1", "[::1]", _in_url(host)}
    if not _is_loopback(host):
        names |= {socket.gethostname().lower(), socket.getfqdn().lower()}
    listed = "|".join(re.escape(name) for name in sorted(names))
    if not _is_loopback(host):
        listed += r"|\d{1,3}(\.\d{1,3}){3}|\[[0-9a-f:]+\]"
    return re.compile(rf"https?://({listed})(:\d+)?", re.IGNORECASE)


def page_address(server: viser.ViserServer) -> str:
    """What to open in a browser."""
    host = server.get_host()
    shown = LOOPBACK if host in ("", "0.0.0.0") else "[::1]" if host == "::" else _in_url(host)
    return f"http://{shown}:{server.get_port()}"


def _check_free(host: str, port: int) -> None:
    try:
        family, kind, protocol, _, address = socket.getaddrinfo(
            host or None, port, type=socket.SOCK_STREAM, flags=socket.AI_PASSIVE
        )[0]
    except (OSError, UnicodeError) as error:
        raise ValueError(f"--host {host!r} is no name or address of this machine: {error}") from None
    with socket.socket(family, kind, protocol) as probe:
        if os.name == "posix":
            # As the server does: a port that was just given back can be taken at once.
            probe.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            probe.bind(address)
        except PermissionError:
            raise ValueError(f"--port {port} needs more rights than this user has; choose one above 1023") from None
        except OSError as error:
            if _listens(family, address):
                raise ValueError(_in_use(host, port)) from None
            raise ValueError(f"cannot listen at {host}:{port}: {error.strerror}") from None


def _listens(family: int, address: tuple) -> bool:
    with socket.socket(family, socket.SOCK_STREAM) as caller:
        caller.settimeout(1.0)
        return caller.connect_ex(address) == 0


def _in_use(host: str, port: int) -> str:
    return f"port {port} of {host} is in use by another program; choose another with --port (0 takes any free one)"


@contextlib.contextmanager
def _own_pages_only(host: str) -> Iterator[None]:
    """While the server starts, make it refuse connections from pages that are not its own."""
    serve, origins = websockets.asyncio.server.serve, [allowed_pages(host)]

    def guarded(*arguments: object, **options: object) -> websockets.asyncio.server.serve:
        return serve(*arguments, **(options | {"origins": origins}))

    websockets.asyncio.server.serve = guarded
    try:
        yield
    finally:
        websockets.asyncio.server.serve = serve


@contextlib.contextmanager
def _chosen_port() -> Iterator[None]:
    """Without the variable by which viser's own tools send every server to another port, and without its banner."""
    kept = os.environ.pop("_VISER_PORT_OVERRIDE", None)
    try:
        with open(os.devnull, "w") as nowhere, contextlib.redirect_stdout(nowhere):
            yield
    finally:
        if kept is not None:
            os.environ["_VISER_PORT_OVERRIDE"] = kept


def _is_loopback(host: str) -> bool:
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == "localhost"


def _in_url(host: str) -> str:
    return f"[{host}]" if ":" in host else host.lower()
