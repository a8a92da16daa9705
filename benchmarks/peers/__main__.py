"""Runs one peer in a process of its own: ``python -m benchmarks.peers newton XPBD scene.npz run.npz``.

Exit status 3: the peer is not installed. In every case of failure the last line on the error stream says why.
"""

from __future__ import annotations

import importlib
import sys

from benchmarks.measure import pin_to_one_core
from benchmarks.peers.recording import PeerMissing
from benchmarks.scene import Scene

NOT_INSTALLED = 3


def main(module: str, variant: str, scene_path: str, out_path: str) -> int:
    """Run a peer's ``run`` on a scene; ``variant`` names its settings in the module, ``-`` its defaults."""
    pin_to_one_core()
    try:
        peer = importlib.import_module(f"benchmarks.peers.{module}")
    except PeerMissing as missing:
        print(missing, file=sys.stderr)
        return NOT_INSTALLED
    scene = Scene.load(scene_path)
    settings = () if variant == "-" else (getattr(peer, variant),)
    peer.run(scene, *settings).save(out_path)
    return 0


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
