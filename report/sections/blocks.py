"""What sections are made of, and how a topic makes them from a run: ``Run`` has a method for each kind of block.

A table that the run does not have becomes a sentence that says so; pictures that it does not have are left out.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from evaluation.table import Row, columns_of
from report.captions import CAPTIONS, Caption
from report.run_files import Picture, RunFiles
from report.tables import TableView, readable, table_view

HARDEST = ("unseen_both", "unseen_motions", "unseen_parameters", "unseen_styles", "unseen_labels")


@dataclass(frozen=True)
class Block:
    """A part of a section.

    Attributes:
        kind: ``table``, ``chart``, ``pictures``, ``note`` or ``missing``.
        caption: What stands above it.
        table, full: The table as shown, and with all of its columns.
        svg: A chart.
        pictures: Pictures side by side.
        text: Of a note, or of what is missing.
    """

    kind: str
    caption: Caption | None = None
    table: TableView | None = None
    full: TableView | None = None
    svg: str = ""
    pictures: Sequence[Picture] = ()
    text: str = ""


@dataclass(frozen=True)
class Section:
    """A chapter of the page.

    Attributes:
        name: Its anchor, unique on the page.
        title, lead: Heading and the sentence below it.
        blocks: In order; None (what a run does not have) is left out.
    """

    name: str
    title: str
    lead: str
    blocks: Sequence[Block | None] = field(default_factory=list)

    def __post_init__(self) -> None:
        object.__setattr__(self, "blocks", [block for block in self.blocks if block is not None])


class Run:
    """A run, as the topics see it.

    Args:
        files: The run's files.
        config: The run's configuration.
    """

    def __init__(self, files: RunFiles, config: Mapping[str, Any]) -> None:
        self.files, self.config = files, config
        self.found = files.pictures()

    def rows(self, name: str) -> list[Row]:
        """Rows of a table; empty where the run has none."""
        return self.files.table(name)

    def table(self, name: str, controls: str = "", mark: bool = True, within: str = "") -> list[Block]:
        """A table under its caption, in the caption's columns, all columns folded below; or that it is missing.

        Args:
            name: Of the table and of its caption.
            controls: Regular expression of methods that are there to compare with and are never the best.
            mark: Whether the best values are marked.
            within: Column within whose equal values methods compete.
        """
        rows, caption = self.rows(name), CAPTIONS[name]
        if not rows:
            return [missing(name)]
        shown = [c for c in caption.columns if c in columns_of(rows)]
        # A table whose columns are others than were expected is shown as it is.
        view = table_view(rows, shown if len(shown) > 2 else None, controls=controls, mark=mark, within=within)
        return [Block("table", caption, view, full_view(rows, caption, controls, mark) if len(shown) > 2 else None)]

    def published(self, name: str, rows: Sequence[Row], ours: str) -> Block | None:
        """Rows of the papers, where the run has a table of its own, ``ours``, to hold beside them."""
        if not rows or not self.rows(ours):
            return None
        return Block("table", CAPTIONS[name], table_view(rows, keys=(), mark=False))

    def chart(self, name: str, svg: str) -> Block:
        """A chart under its caption."""
        return Block("chart", CAPTIONS[name], svg=svg)

    def pictures(self, kind: str) -> Block | None:
        """All pictures of a kind, under the caption ``pictures_<kind>`` where there is one."""
        found = [p for p in self.found if p.kind == kind]
        return Block("pictures", CAPTIONS.get(f"pictures_{kind}"), pictures=found) if found else None


def missing(name: str) -> Block:
    """That a table is missing, and what would make it."""
    caption = CAPTIONS[name]
    return Block("missing", caption, text=f"The table “{name}” is missing from this run ({caption.made}).")


def full_view(rows: Sequence[Row], caption: Caption, controls: str = "", mark: bool = True) -> TableView | None:
    """The table with all columns, where the shown one leaves some out."""
    hidden = [c for c in columns_of(rows) if c not in caption.columns and not c.endswith("_interval")]
    return table_view(rows, controls=controls, mark=mark) if hidden and caption.columns else None


def some_split(rows: Sequence[Row]) -> list[Row]:
    """Rows of one split, the hardest that the table has."""
    splits = [r.get("split") for r in rows]
    chosen = next((s for s in HARDEST if s in splits), splits[0])
    return [r for r in rows if r.get("split") == chosen]


def once(rows: Sequence[Row], *names: str) -> list[Row]:
    """The first row of each combination of values."""
    return list({tuple(r.get(n) for n in names): r for r in reversed(rows)}.values())[::-1]


def as_sentence(split: object) -> str:
    """Name of a split, as a sentence."""
    text = readable(str(split or ""))
    return f"{text[:1].upper()}{text[1:]}." if text else ""
