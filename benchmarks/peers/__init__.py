"""Other solvers on the benchmark's scene: each file has one function ``run(scene) -> PeerRun``.

The peers of other projects are an optional extra (``requirements-peers.txt``) in an environment of their own: Blender's
needs an older NumPy than this project. So these files import nothing but NumPy, the scene and the peer.
"""
