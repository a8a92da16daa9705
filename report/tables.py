"""Rows of a table as the page shows them: grouped by garment and split, best values marked, constants lifted out.

In: rows as the evaluation wrote them. Out: a ``TableView`` of plain texts and flags, which the template lays out.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass, field

from evaluation.table import Row, columns_of
from report.columns import HIGHER, LOWER, better, column_title, format_column, is_number

GROUPS = ("garment", "split", "plan")
"""Columns that make up the heading of a group of rows; values are compared inside a group only."""

INTERVAL = "_interval"
READABLE = ("split", "plan", "stage", "parameter")
"""Columns of names that are written with underscores."""

# These see the truth, or are it: to be read beside a method, never to be better than one.
_REFERENCES = re.compile(
    r"^simulation$|of the truth|floor\)|\(reference\)|^real\b|published|not in this run", re.IGNORECASE
)


@dataclass(frozen=True)
class CellView:
    """One cell: its text, the full number as a tooltip, and whether it is the best of its group."""

    text: str
    number: bool
    full: str = ""
    best: bool = False


@dataclass(frozen=True)
class RowView:
    """One row; a reference takes no part in the search for the best value."""

    cells: list[CellView]
    reference: bool = False


@dataclass(frozen=True)
class GroupView:
    """Rows under one heading; an empty heading for a table without groups."""

    heading: str
    rows: list[RowView]


@dataclass(frozen=True)
class HeaderView:
    """A column's header: title, whether numbers stand under it, and an arrow for the better direction."""

    title: str
    number: bool
    arrow: str = ""


@dataclass(frozen=True)
class TableView:
    """A table ready for the template.

    Attributes:
        header: Columns that are shown.
        groups: Rows by group.
        constants: (title, value) of columns that hold the same everywhere.
    """

    header: list[HeaderView]
    groups: list[GroupView]
    constants: list[tuple[str, str]] = field(default_factory=list)

    @property
    def rows(self) -> int:
        """Number of rows in all groups."""
        return sum(len(g.rows) for g in self.groups)


def table_view(
    rows: Sequence[Row],
    columns: Sequence[str] | None = None,
    keys: Sequence[str] = GROUPS,
    controls: str = "",
    mark: bool = True,
    within: str = "",
) -> TableView:
    """Lay out rows.

    Args:
        rows: At least one row.
        columns: Columns to show, in order, of those that exist; default all.
        keys: Columns that group rows, where the table has them.
        controls: Pattern of further rows that take no part in the search for the best value.
        mark: Whether best values are marked at all.
        within: Column whose values have to agree for two rows to be compared, such as a number of dimensions.
    """
    names = columns_of(rows)
    keys = [k for k in keys if k in names]
    shown = [n for n in (columns or names) if n in names and n not in keys]
    intervals = {n for n in names if n.endswith(INTERVAL) and n.removesuffix(INTERVAL) in names}
    shown = [n for n in shown if n not in intervals and any(r.get(n) not in (None, "") for r in rows)]
    constants = _constants(rows, [*keys, *shown]) if len(rows) > 1 else {}
    shown = [n for n in shown if n not in constants]
    keys = [k for k in keys if k not in constants]

    texts = {n: _column_texts(rows, n, f"{n}{INTERVAL}" in intervals) for n in shown}
    numeric = {n: any(is_number(r.get(n)) for r in rows) for n in shown}
    reference = [is_reference(r, controls) for r in rows]
    groups: dict[tuple, list[int]] = {}
    for i, row in enumerate(rows):
        groups.setdefault(tuple(row.get(k) for k in keys), []).append(i)

    if all(len(members) == 1 for members in groups.values()):
        # A heading a row would be noise: the keys stay columns, and there is nothing to compare.
        mark = mark and not keys
        keys_before, keys, groups = keys, [], {(): list(range(len(rows)))}
        shown = [*keys_before, *shown]
        texts |= {n: _column_texts(rows, n, False) for n in keys_before}
        numeric |= {n: any(is_number(r.get(n)) for r in rows) for n in shown}

    views = []
    for values, members in groups.items():
        classes: dict[object, list[int]] = {}
        for i in members:
            classes.setdefault(rows[i].get(within), []).append(i)
        best = {n: {i for c in classes.values() for i in _best(rows, c, n, reference)} for n in shown} if mark else {}
        views.append(
            GroupView(
                " · ".join(readable(str(v)) for v in values if v not in (None, "")),
                [
                    RowView(
                        [
                            CellView(
                                texts[n][i],
                                numeric[n] and not isinstance(rows[i].get(n), str),
                                full_number(rows[i].get(n)),
                                i in best.get(n, ()),
                            )
                            for n in shown
                        ],
                        reference[i],
                    )
                    for i in members
                ],
            )
        )
    arrows = {LOWER: "↓", HIGHER: "↑", 0: ""}
    header = [HeaderView(column_title(n), numeric[n], arrows[better(n)] if numeric[n] and mark else "") for n in shown]
    return TableView(header, views, [(column_title(n), readable(v)) for n, v in constants.items()])


def is_reference(row: Row, controls: str = "") -> bool:
    """True for a row that shows the truth or somebody else's figures."""
    texts = [v for v in row.values() if isinstance(v, str)]
    return any(_REFERENCES.search(t) or (controls and re.search(controls, t)) for t in texts)


def readable(text: str) -> str:
    """Names of splits and plans without underscores; other texts as they are."""
    return text.replace("_", " ") if re.fullmatch(r"[a-z0-9]+(_[a-z0-9]+)+", text) else text


def _constants(rows: Sequence[Row], names: Sequence[str]) -> dict[str, str]:
    """Columns with one value in all rows that is neither a result nor the only name that a row has."""
    found = {}
    for name in names:
        values = {row.get(name) for row in rows}
        lifted = len(values) == 1 and not better(name) and not any(isinstance(v, float) for v in values)
        if lifted and name not in ("method", "solver", "variant", "parameter", "source"):
            text = format_column([rows[0].get(name)])[0]
            if text not in ("–", ""):
                found[name] = text
    return found


def _column_texts(rows: Sequence[Row], name: str, interval: bool) -> list[str]:
    """Cells of a column; with its interval, to the same decimals, where it has one above 0."""
    values = [r.get(name) for r in rows]
    texts = format_column(values)
    if name in READABLE:
        texts = [readable(t) for t in texts]
    if not interval:
        return texts
    widths = format_column([r.get(name + INTERVAL) for r in rows], like=values)
    return [f"{t} ± {w}" if r.get(name + INTERVAL) and t != "–" else t for t, w, r in zip(texts, widths, rows)]


def _best(rows: Sequence[Row], members: Sequence[int], name: str, reference: Sequence[bool]) -> set[int]:
    """Rows of a group with the best value of a column; none where there is nothing to compare."""
    direction = better(name)
    candidates = {
        i: float(rows[i][name])
        for i in members
        if direction and not reference[i] and is_number(rows[i].get(name)) and math.isfinite(rows[i][name])
    }
    if len(candidates) < 2 or len(set(candidates.values())) < 2:
        return set()
    best = max(candidates.values()) if direction == HIGHER else min(candidates.values())
    return {i for i, value in candidates.items() if value == best}


def full_number(value: object) -> str:
    """A number with six significant digits, as a tooltip."""
    return f"{value:.6g}" if isinstance(value, float) and math.isfinite(value) else ""
