"""Warp kernels of the XPBD solver: one file a concept, one constraint a thread, no state of their own.

Every module is compiled without adjoints (``enable_backward``), which halves the time of a cold start.
"""
