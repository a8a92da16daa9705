"""Rows that are computed when they are asked for."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor

import numpy as np
import pytest

from runtime.lazy_rows import BLOCK, LazyRows


def _rows(count: int) -> tuple[LazyRows, list[slice]]:
    asked: list[slice] = []

    def make(part: slice) -> np.ndarray:
        asked.append(part)
        return np.stack([np.arange(part.start, part.stop)] * 3, axis=1).astype(np.float32)

    return LazyRows(count, make), asked


def test_only_blocks_that_are_asked_for_are_computed_and_each_once():
    rows, asked = _rows(3 * BLOCK + 5)
    np.testing.assert_array_equal(rows[BLOCK + 2], [BLOCK + 2] * 3)
    np.testing.assert_array_equal(rows[np.array([3 * BLOCK + 4, BLOCK])][:, 0], [3 * BLOCK + 4, BLOCK])
    assert asked == [slice(BLOCK, 2 * BLOCK), slice(3 * BLOCK, 3 * BLOCK + 5)]
    np.testing.assert_array_equal(rows.all()[:, 1], np.arange(3 * BLOCK + 5))
    assert len(asked) == 4
    with pytest.raises(IndexError):
        rows[4 * BLOCK]


def test_threads_that_ask_at_once_get_the_same():
    rows, asked = _rows(20 * BLOCK)
    with ThreadPoolExecutor(8) as pool:
        found = list(pool.map(lambda number: rows[number][0], range(20 * BLOCK)))
    np.testing.assert_array_equal(found, np.arange(20 * BLOCK))
    assert len(asked) == 20
