"""Implicit Euler cloth solver (Baraff & Witkin 1998): the baseline that everything faster is timed against."""
