"""The authoring app: shape garments by hand in a browser, with the networks of a finished run.

    python -m pipeline.app
    python -m pipeline.app --run results/smoke --garment tshirt --motion walk --port 9000

Nothing is trained: the app needs a finished run, which `make all` makes (`make smoke` a tiny one). It listens at this
machine alone (127.0.0.1) unless --host says otherwise; whoever reaches it can use it, there is no password.
"""

from __future__ import annotations

import argparse
import threading
import webbrowser
from pathlib import Path

from pipeline.command import run_command
from runtime.finished_run import FinishedRun


def define(parser: argparse.ArgumentParser) -> None:
    """Options of the command."""
    parser.add_argument("--run", default="results/default", help="folder of a finished run (%(default)s)")
    parser.add_argument("--garment", help="garment to begin with; the run's first by default")
    parser.add_argument(
        "--motion", help="motion to begin with: a label, a clip of the run or a file; the first label by default"
    )
    parser.add_argument("--frames", type=int, default=240, help="length of a motion made of a label (%(default)s)")
    parser.add_argument("--seed", type=int, default=0, help="other seeds, other motions (%(default)s)")
    parser.add_argument("--out", default="exports", help="folder of exports, made where it is missing (%(default)s)")
    parser.add_argument("--host", default="127.0.0.1", help="address to listen at (%(default)s: this machine alone)")
    parser.add_argument("--port", type=int, default=8080, help="port to listen at; 0 takes any free one (%(default)s)")
    parser.add_argument("--no-browser", action="store_true", help="do not open a browser")


def serve(options: argparse.Namespace) -> None:
    """Load the run, listen, and stay until the user stops it."""
    run = FinishedRun.open(options.run)
    # The port first: loading takes longer than finding out that it is taken.
    from app.server import page_address, start_server
    from app.session import Session
    from app.window import Window

    server = start_server(options.host, options.port, f"Drapeline · {Path(options.run).name}")
    try:
        session = Session(run, options.garment, options.motion, options.frames, options.seed)
        window = Window(server, session, Path(options.out))
    except BaseException:
        server.stop()
        raise
    address = page_address(server)
    print(f"[app] {address}  (stop with Ctrl+C)", flush=True)
    if not options.no_browser:
        webbrowser.open(address)
    try:
        threading.Event().wait()
    except KeyboardInterrupt:
        print("[app] stopped")
    finally:
        window.stop()


def main(given: list[str] | None = None) -> None:
    """Command line."""
    run_command("app", __doc__, define, serve, given)


if __name__ == "__main__":
    main()
