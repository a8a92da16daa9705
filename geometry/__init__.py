"""Mesh topology, rotations and proximity: shared by simulation, models and evaluation.

Plain NumPy and SciPy; ``geometry.proximity`` looks surfaces up with Warp, on the CPU.
"""
