"""Python's garbage collector while a program of this package starts and ends: it has nothing to find there.

Importing torch, Warp and the like makes some hundred thousand objects, and hardly one goes away again. Looking through
them over and over for cycles, and once more at the very end, takes half of the time that a stage needs to start.
"""

from __future__ import annotations

import gc
import sys

_WORK = gc.get_threshold()


def before_imports() -> None:
    """Hardly collect until :func:`after_imports`, where a module of this package is started as a program."""
    if sys.argv[0] == "-m":  # so it is named while Python looks for the module of ``python -m``
        gc.set_threshold(200_000)


def after_imports() -> None:
    """Collect as usual from here on, but never among what there is already: it stays to the end."""
    gc.freeze()
    gc.set_threshold(*_WORK)


def at_the_end() -> None:
    """Spare the last collection: the process ends, and its memory with it."""
    gc.freeze()
