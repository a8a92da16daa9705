"""Rows of a large array, computed a block at a time when one of them is first asked for, and then kept.

A user looks at one frame of a motion: what is computed for each frame alone need not be there for all of them first.
"""

from __future__ import annotations

import threading
from collections.abc import Callable

import numpy as np

BLOCK = 32
"""Rows that are computed at once."""


class LazyRows:
    """Any thread may ask; what it is given must not be changed.

    Args:
        count: Number of rows T.
        make: Rows [n, ...] of a slice of 0 to T, each of which hangs on its own number alone.
    """

    def __init__(self, count: int, make: Callable[[slice], np.ndarray]) -> None:
        self._count, self._make = count, make
        self._lock = threading.Lock()
        self._made = np.zeros(-(-count // BLOCK), dtype=bool)
        self._rows: np.ndarray | None = None

    def __getitem__(self, numbers: int | np.ndarray) -> np.ndarray:
        """The row of a number, or rows [n, ...] of ``numbers [n]``."""
        asked = np.atleast_1d(numbers)
        if not self._made[asked // BLOCK].all():
            with self._lock:
                for block in np.unique(asked // BLOCK):
                    if not self._made[block]:
                        self._compute(int(block))
        return self._rows[numbers]

    def all(self) -> np.ndarray:
        """All rows [T, ...]."""
        _ = self[np.arange(self._count)]
        return self._rows

    def _compute(self, block: int) -> None:
        part = slice(block * BLOCK, min((block + 1) * BLOCK, self._count))
        rows = self._make(part)
        if self._rows is None:
            self._rows = np.empty((self._count, *rows.shape[1:]), dtype=rows.dtype)
        self._rows[part] = rows
        self._made[block] = True
