"""Cloth simulation: intrinsic parameters, the XPBD simulator on Warp and the implicit baseline."""
