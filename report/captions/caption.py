"""What a caption holds."""

from __future__ import annotations

from dataclasses import dataclass

OTHER_DATA = "Other data, other garments, other machines: for orientation, not for a comparison."


@dataclass(frozen=True)
class Caption:
    """Caption of a block.

    Attributes:
        title: A few words.
        what: What is shown and how to read it.
        answers: Table or figure of a paper that it stands for.
        made: Rule, module and file that made it.
        split: Which part of the data it is measured on.
        columns: Columns of the short form of a table, in order; empty: all.
        other: True for figures that others published, on other data.
    """

    title: str
    what: str = ""
    answers: str = ""
    made: str = ""
    split: str = ""
    columns: tuple[str, ...] = ()
    other: bool = False


def made_by(rule: str, module: str, table: str) -> str:
    """Where a table comes from: rule, module, file."""
    return f"{rule} → {module} → tables/{table}.csv"
