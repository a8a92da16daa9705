"""Drapeline's scenes for ARCSim (Narain, Samii & O'Brien 2012), a program that is neither here nor ours to ship.

In: a garment template, a body, a clip and intrinsic parameters. Out: a folder that ARCSim simulates as it stands; and,
where the program is configured, its frames and seconds.
"""
