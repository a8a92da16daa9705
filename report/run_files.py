"""What a run left behind, as the page reads it: tables, losses, benchmarks, pictures. A missing file is no error.

In: the folder ``results/<run>``. Everything in it was written by the other stages; texts are shown, never executed.
"""

from __future__ import annotations

import csv
import json
import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from evaluation.table import Row, read_table

STAGE_ORDER = (
    "garment",
    "motions",
    "simulate",
    "train_shape_descriptor",
    "train_descriptor_curve",
    "encode_shapes",
    "train_motion_invariant",
    "train_recognition",
    "train_motion_cvae",
    "train_garment_regressor",
    "fine_tune_regressor",
    "evaluate_simulation",
    "evaluate_shape_descriptor",
    "evaluate_motion_invariant",
    "evaluate_motion",
    "evaluate_garment_regressor",
    "time_solvers",
    "render",
    "render_descriptor",
)

MEDIA_TYPES = {
    ".png": "image/png",
    ".webp": "image/webp",
    ".jpg": "image/jpeg",
    ".svg": "image/svg+xml",
    ".mp4": "video/mp4",
}


@dataclass(frozen=True)
class Picture:
    """A picture of the page, still or moving.

    Attributes:
        garment: Whose picture it is.
        file: Where it lies.
        kind: What it shows, as the stage that drew it names it: ``simulated``, ``error``, ``descriptor_error`` ...
        title, caption, alt: Texts; ``alt`` says what is to be seen.
        width, height: Size [px].
        animated: Whether it moves.
        poster: Still that stands in the place of a video until it plays.
        label, clip: Motion that is shown.
        numbers: Figures of the picture by column name, such as ``rmse_mm``.
    """

    garment: str
    file: Path
    kind: str
    title: str = ""
    caption: str = ""
    alt: str = ""
    width: int = 0
    height: int = 0
    animated: bool = False
    poster: Path | None = None
    label: str = ""
    clip: str = ""
    numbers: dict[str, Any] = field(default_factory=dict)


class RunFiles:
    """Reader of ``results/<run>``.

    Args:
        folder: The run's folder.
    """

    def __init__(self, folder: str | Path) -> None:
        self.folder = Path(folder)

    def table(self, name: str) -> list[Row]:
        """Rows of a table; of its parts where the whole was not joined yet; empty when there is none."""
        whole = self.folder / "tables" / f"{name}.csv"
        paths = [whole] if whole.exists() else sorted((self.folder / "parts" / name).glob("*.csv"))
        return [row for path in paths for row in read_table(path)]

    def shard_files(self) -> list[Path]:
        """All shards."""
        return sorted((self.folder / "shards").glob("*/*.h5"))

    def trainings(self) -> dict[str, list[tuple[str, list[Row]]]]:
        """Loss tables by garment (or ``motion``): (model and variant on two lines, rows)."""
        found: dict[str, list[tuple[str, list[Row]]]] = {}
        paths = sorted((self.folder / "training").rglob("losses.csv"))
        paths += sorted((self.folder / "models").rglob("losses.csv"))
        for path in paths:
            group, *rest = path.relative_to(self.folder).parts[1:-1]
            parts = [part.removesuffix("_training").replace("_", " ") for part in rest]
            name = "\n".join(filter(None, [parts[0], " · ".join(parts[1:])]))
            rows = read_table(path)
            if any(_finite_positive(r.get("total")) for r in rows):
                found.setdefault(group, []).append((name, rows))
        return dict(sorted(found.items(), key=lambda item: (item[0] != "motion", item[0])))

    def stages(self) -> list[Row]:
        """Time and memory of each stage from the workflow's benchmark files, in the order of the workflow."""
        stages: dict[str, list[dict[str, str]]] = {}
        root = self.folder / "benchmarks"
        for path in sorted(root.rglob("*.tsv")):
            stage = path.relative_to(root).parts[0].removesuffix(".tsv")
            with path.open(newline="", encoding="utf-8") as file:
                stages.setdefault(stage, []).extend(csv.DictReader(file, delimiter="\t"))
        order = {name: i for i, name in enumerate(STAGE_ORDER)}
        rows = []
        for stage in sorted(stages, key=lambda s: (order.get(s, len(order)), s)):
            seconds = [_number(r.get("s")) for r in stages[stage]]
            rows.append(
                {
                    "stage": stage,
                    "jobs": len(seconds),
                    "total_s": sum(seconds),
                    "longest_job_s": max(seconds),
                    "peak_memory_mb": max(_number(r.get("max_rss")) for r in stages[stage]) or None,
                }
            )
        return rows

    def pictures(self) -> list[Picture]:
        """Pictures of all garments, in the order of their lists; those whose file is missing are left out."""
        pictures = []
        for listing in self._listings():
            content = json.loads(listing.read_text(encoding="utf-8"))
            for entry in content["figures"]:
                file = listing.parent / Path(entry["file"]).name
                if file.suffix in MEDIA_TYPES and file.is_file():
                    fields = {k: v for k, v in entry.items() if k in Picture.__dataclass_fields__}
                    poster = listing.parent / Path(str(entry.get("poster") or "-")).name
                    shown = poster.suffix in MEDIA_TYPES and poster.is_file()
                    fields |= {"file": file, "poster": poster if shown else None}
                    pictures.append(Picture(**fields | {"garment": content["garment"]}))
        return pictures

    def absent(self) -> list[tuple[str, str]]:
        """(garment, what no picture could be made of, and why)."""
        found = []
        for listing in self._listings():
            content = json.loads(listing.read_text(encoding="utf-8"))
            found += [(content["garment"], text) for text in content.get("absent", [])]
        return found

    def _listings(self) -> list[Path]:
        return sorted((self.folder / "figures").glob("[!.]*/figures.json"))

    def newest(self) -> float:
        """Time of the newest table [s since 1970]; 0 without tables."""
        return max((p.stat().st_mtime for p in (self.folder / "tables").glob("*.csv")), default=0.0)


def _number(text: str | None) -> float:
    """A benchmark's number; the workflow writes ``-`` or ``NA`` for a job too short to be sampled."""
    try:
        value = float(text or "")
    except ValueError:
        return 0.0
    return value if math.isfinite(value) else 0.0


def _finite_positive(value: object) -> bool:
    return isinstance(value, int | float) and math.isfinite(value) and value > 0
