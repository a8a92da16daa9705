"""Section: simulated data, what was dropped, parameter ranges, pictures."""

from __future__ import annotations

from evaluation.table import Row
from report.captions import CAPTIONS
from report.columns import significant
from report.sections.blocks import Block, Run, Section, missing
from report.tables import table_view
from sim.fabrics import base_values
from sim.parameters import INTRINSIC_PARAMETERS


def section(run: Run) -> Section:
    """The ground truth."""
    return Section(
        "simulation",
        "Simulation",
        "Extended position-based dynamics, one garment on a moving body. Every simulation settles on the body at "
        "rest, is led into its clip, and is checked against bounds of strain, penetration and speed before it "
        "may be called ground truth.",
        [
            run.pictures("contact"),
            run.pictures("material"),
            *run.table("simulation", mark=False),
            *_dropped(run),
            _ranges(run),
            *(Block("note", text=f"Not shown for {garment}: {text}.") for garment, text in run.files.absent()),
        ],
    )


def _dropped(run: Run) -> list[Block]:
    rows, made = run.rows("dropped"), run.rows("simulation")
    if not rows and not made:
        return [missing("dropped")]
    lost = [r for r in rows if r.get("reason")]
    kept = sum(int(r.get("sequences") or 0) for r in made)
    attempts = run.config.get("simulation", {}).get("attempts")
    if not lost:
        return [Block("note", text=f"No simulation was dropped: all {kept} that were started are in the data.")]
    share = f"{len(lost)} of {kept + len(lost)} simulations were dropped"
    tries = f" after {attempts} attempts with ever more substeps" if attempts else ""
    text = f"{share}{tries}. They are in no training and in no test; every figure below is without them."
    caption = CAPTIONS["dropped"]
    return [Block("note", text=text), Block("table", caption, table_view(lost, caption.columns, mark=False))]


def _ranges(run: Run) -> Block | None:
    garments = run.config.get("garments", {})
    if not garments:
        return None
    rows = []
    for p in INTRINSIC_PARAMETERS:
        row: Row = {
            "parameter": p.name.replace("_", " "),
            "unit": "" if p.unit == "1" else p.unit.replace("^2", "²").replace("^3", "³"),
            "group": p.group,
            "drawn": "log-uniform" if p.logarithmic else "uniform",
        }
        for name, settings in garments.items():
            limits = settings.get("ranges", {}).get(p.name)
            base = base_values(settings).get(p.name, p.base)
            row[name] = f"{_plain(limits['min'])}\u2009–\u2009{_plain(limits['max'])}" if limits else "fixed"
            row[f"{name}, base"] = _plain(base)
        rows.append(row | {"meaning": p.meaning})
    return Block("table", CAPTIONS["ranges"], table_view(rows, mark=False, keys=()))


def _plain(value: float) -> str:
    """A configured number as it was written, small ones as a power of ten."""
    return f"{value:g}" if value == 0 or abs(value) >= 1e-3 else significant(value, 1)
