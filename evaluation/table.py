"""Tables of results: a list of rows, one dictionary each, and its CSV file.

A column's unit is the end of its name (``rmse_mm``, ``time_s``, ``collision_rate_percent``). Columns keep the order in
which rows introduce them. Files are whole or absent.
"""

from __future__ import annotations

import csv
import io
import math
import os
from collections.abc import Iterable, Sequence
from pathlib import Path

from datasets.atomic import write_text

Cell = str | int | float | bool | None
Row = dict[str, Cell]


def columns_of(rows: Iterable[Row]) -> list[str]:
    """Column names in order of first appearance."""
    return list(dict.fromkeys(name for row in rows for name in row))


def write_table(path: str | os.PathLike, rows: Sequence[Row], digits: int = 6) -> None:
    """Write rows as CSV, atomically; numbers with ``digits`` significant digits, a missing cell empty.

    Raises:
        ValueError: No rows, or a cell that is not a string, a number, a truth value or None.
    """
    rows = list(rows)
    if not rows:
        raise ValueError(f"{path}: a table needs at least one row")
    names = columns_of(rows)
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(names)
    for row in rows:
        writer.writerow([_format(row.get(name), digits, name) for name in names])
    write_text(path, text.getvalue())


def read_table(path: str | os.PathLike) -> list[Row]:
    """Rows of a CSV written by ``write_table``; numbers and truth values get their type back.

    Raises:
        ValueError: No header, repeated columns, or a line with a wrong number of cells.
    """
    with Path(path).open(newline="", encoding="utf-8") as file:
        lines = list(csv.reader(file))
    if not lines or not lines[0]:
        raise ValueError(f"{path}: no header line")
    header = lines[0]
    if len(set(header)) != len(header):
        raise ValueError(f"{path}: a column name appears twice in {header}")
    rows = []
    for number, line in enumerate(lines[1:], start=2):
        if len(line) != len(header):
            raise ValueError(f"{path}: line {number} has {len(line)} cells, the header {len(header)}")
        rows.append({name: _parse(cell) for name, cell in zip(header, line, strict=True)})
    return rows


def merge_tables(tables: Iterable[Sequence[Row]], **constants: Cell) -> list[Row]:
    """All rows one after another; ``constants`` become leading columns of every row that does not have them."""
    return [{**constants, **row} for table in tables for row in table]


def _format(value: Cell, digits: int, column: str) -> str:
    if value is None:
        return ""
    if isinstance(value, str | bool):
        return str(value)
    if hasattr(value, "item"):
        value = value.item()  # a NumPy scalar
    if isinstance(value, bool | int):
        return str(value)
    if isinstance(value, float):
        return f"{value:.{digits}g}" if math.isfinite(value) else str(value)
    raise ValueError(f"column {column}: a cell must be a string, a number or a truth value, got {type(value).__name__}")


def _parse(text: str) -> Cell:
    if text == "":
        return None
    if text in ("True", "False"):
        return text == "True"
    if "_" in text:  # Python would read 1_000 as a number
        return text
    for kind in (int, float):
        try:
            return kind(text)
        except ValueError:
            continue
    return text
