"""Families of motions: what is done, as curves on a stage."""
