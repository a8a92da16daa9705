"""Trainings that are repeated from other seeds: their names, and the average of their rows.

A variant that is trained from three seeds has three models: ``window``, ``window-seed-2`` and ``window-seed-3``. An
evaluation makes a row of each, as of any variant, and lays those together here that differ in the seed alone.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from numbers import Integral

import numpy as np

from evaluation.table import Cell, Row, columns_of

_SEED = re.compile(r"-seed-([1-9][0-9]*)\b")


def seed_names(variants: Iterable[str], seeds: Mapping[str, int]) -> list[str]:
    """Names of all trainings: each variant, then its repetitions as many as ``seeds`` asks for beyond the first."""
    return [
        variant if number == 1 else f"{variant}-seed-{number}"
        for variant in variants
        for number in range(1, seeds.get(variant, 1) + 1)
    ]


def split_seed(name: str) -> tuple[str, int]:
    """The variant of a training and the number of its seed, from 1: ``window-seed-3`` is ``("window", 3)``."""
    found = _SEED.search(name)
    return (name[: found.start()], int(found.group(1))) if found and found.end() == len(name) else (name, 1)


def average_seeds(rows: Sequence[Row], spread: Sequence[str]) -> list[Row]:
    """Rows that differ in the seed of a training alone become one: the mean of each figure, and how far seeds differ.

    Texts and whole numbers (a dimension, a number of sequences) say what a row is about; other numbers are figures.

    Args:
        rows: Rows of a table; the name of a repeated training may stand anywhere in a text.
        spread: Columns of numbers whose sample standard deviation over seeds is given too, as ``<column>_seed_std``.

    Returns:
        Rows in their order; averaged ones with ``training_seeds``, the number of trainings.
    """
    groups: dict[tuple, list[Row]] = {}
    for row in rows:
        plain = {key: _SEED.sub("", cell) if isinstance(cell, str) else cell for key, cell in row.items()}
        marks = tuple((key, cell) for key, cell in plain.items() if isinstance(cell, str | Integral))
        groups.setdefault(marks, []).append(plain)
    return [_averaged(group, spread) if len(group) > 1 else group[0] for group in groups.values()]


def _averaged(group: list[Row], spread: Sequence[str]) -> Row:
    row: Row = {}
    for key in columns_of(group):
        cells = [member.get(key) for member in group]
        row[key] = _mean(cells)
        if key in spread and all(_is_number(cell) for cell in cells):
            row[f"{key}_seed_std"] = float(np.std(cells, ddof=1))
    return row | {"training_seeds": len(group)}


def _mean(cells: list[Cell]) -> Cell:
    if all(cell == cells[0] for cell in cells):
        return cells[0]
    known = [cell for cell in cells if _is_number(cell)]
    return float(np.mean(known)) if known else None


def _is_number(cell: Cell) -> bool:
    return cell is not None and not isinstance(cell, str | bool)
