"""A long table turned wide: one column a variant, so that what is to be compared stands side by side."""

from __future__ import annotations

import math
import re
from collections.abc import Sequence

from evaluation.table import Row
from report.columns import HIGHER, better, column_title, format_column, is_number
from report.tables import GROUPS, CellView, GroupView, HeaderView, RowView, TableView, full_number, readable


def wide_view(
    rows: Sequence[Row],
    line: str,
    column: str,
    value: str,
    controls: str = "",
    control_columns: str = "",
    keys: Sequence[str] = GROUPS,
) -> TableView:
    """One row a ``line`` and group, one column a ``column``, ``value`` in the cells; the best of each row is marked.

    Args:
        rows: The long table; rows without a number in ``value`` are left out.
        line: Column whose values name the rows.
        column: Column whose values name the columns.
        value: Column with the numbers.
        controls: Pattern of lines that are shown to compare with and have no best value.
        control_columns: Pattern of columns that take no part in the search for the best value.
        keys: Columns that group rows, where the table has them.
    """
    rows = [r for r in rows if is_number(r.get(value))]
    keys = [k for k in keys if any(r.get(k) for r in rows)]
    columns = list(dict.fromkeys(str(r[column]) for r in rows))
    found: dict[tuple, dict[str, dict[str, float]]] = {}
    for r in rows:
        group = found.setdefault(tuple(r.get(k) for k in keys), {})
        group.setdefault(str(r[line]), {})[str(r[column])] = r[value]
    texts = dict(zip(map(id, rows), format_column([r[value] for r in rows])))
    text = {(tuple(r.get(k) for k in keys), str(r[line]), str(r[column])): texts[id(r)] for r in rows}

    groups = []
    for key, lines in found.items():
        views = []
        for name, cells in lines.items():
            is_control = bool(controls and re.search(controls, name))
            best = set() if is_control else _best(cells, better(value), control_columns)
            views.append(
                RowView(
                    [CellView(readable(name), number=False)]
                    + [
                        CellView(text.get((key, name, c), "–"), True, full_number(cells.get(c)), c in best)
                        for c in columns
                    ],
                    is_control,
                )
            )
        groups.append(GroupView(" · ".join(readable(str(k)) for k in key if k), views))
    header = [HeaderView(column_title(line), number=False)] + [HeaderView(readable(c), number=True) for c in columns]
    return TableView(header, groups)


def _best(cells: dict[str, float], direction: int, control_columns: str) -> set[str]:
    known = {
        c: v for c, v in cells.items() if math.isfinite(v) and not (control_columns and re.search(control_columns, c))
    }
    if not direction or len(set(known.values())) < 2:
        return set()
    best = max(known.values()) if direction == HIGHER else min(known.values())
    # A coefficient of determination below nought is no success, though it be the largest.
    return set() if direction == HIGHER and best <= 0 else {c for c, v in known.items() if v == best}
