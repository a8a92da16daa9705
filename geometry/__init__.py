"""Mesh topology, rotations and proximity: plain NumPy and SciPy, shared by simulation, models and evaluation."""
