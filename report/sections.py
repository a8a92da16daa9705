"""The sections of the page, in order: which table, chart and picture stands where, and what is said about it.

In: the files of a run and its configuration. Out: ``Section`` objects of blocks, which the template lays out. A table
that the run does not have becomes a sentence that says so.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from evaluation.table import Row, columns_of
from report import plots, published
from report.captions import CAPTIONS, Caption
from report.columns import is_number, significant
from report.run_files import Picture, RunFiles
from report.tables import TableView, is_reference, readable, table_view
from report.wide import wide_view
from sim.fabrics import base_values
from sim.parameters import INTRINSIC_PARAMETERS

HARDEST = ("unseen_both", "unseen_motions", "unseen_parameters", "unseen_styles", "unseen_labels")
TRANSFER_CONTROLS = "^descriptor floor|^wrong phi|^mean z|^mean shape"
CONTROL_VARIANTS = "^motion-only$|^true-parameters$"
"""Lines of the transfer table that are there to compare with."""


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
    """A chapter of the page."""

    name: str
    title: str
    lead: str
    blocks: list[Block] = field(default_factory=list)


class Sections:
    """Makes the sections of one run.

    Args:
        files: The run's files.
        config: The run's configuration.
    """

    def __init__(self, files: RunFiles, config: Mapping[str, Any]) -> None:
        self.files, self.config = files, config
        self.pictures = files.pictures()

    def all(self) -> list[Section]:
        """Every section in the order of the page."""
        return [
            self.simulation(),
            self.shape_descriptor(),
            self.motion_invariant(),
            self.motion_cvae(),
            self.garment_regressor(),
            self.collisions(),
            self.timing(),
            self.losses(),
        ]

    def simulation(self) -> Section:
        """Simulated data, what was dropped, parameter ranges, pictures."""
        blocks = [
            self._pictures("simulated"),
            self._pictures("materials"),
            *self._table("simulation", mark=False),
            *self._dropped(),
            self._ranges(),
            self._pictures("contact"),
            *(Block("note", text=f"Not shown for {garment}: {text}.") for garment, text in self.files.absent()),
        ]
        return Section(
            "simulation",
            "Simulation",
            "Extended position-based dynamics, one garment on a moving body. Every simulation settles on the body at "
            "rest, is led into its clip, and is checked against bounds of strain, penetration and speed before it "
            "may be called ground truth.",
            _present(blocks),
        )

    def shape_descriptor(self) -> Section:
        """The descriptor beside principal components."""
        rows = self.files.table("shape_descriptor")
        size = next((c for c in columns_of(rows) if c in ("dimension", "dimensions")), "")
        blocks = self._table("shape_descriptor", within=size)
        if rows and size and any(is_number(r.get("rmse_mm")) for r in rows):
            name = _first(rows, "method", "variant")
            blocks = [self._chart("descriptor_curve", lambda: plots.dimension_curves(rows, "rmse_mm", "RMSE [mm]", size, name)), *blocks]  # fmt: skip  # noqa: E501
        blocks += [
            self._pictures("descriptor_error"),
            *self._table("descriptor_interpolation", mark=False),
            self._pictures("descriptor_between"),
            *self._table("descriptor_projection", mark=False),
            self._pictures("descriptor_implausible"),
        ]
        return Section(
            "shape-descriptor",
            "Shape descriptor",
            "How few numbers describe a draped garment: an autoencoder of single frames, held against principal "
            "components of equal dimension.",
            _present(blocks),
        )

    def motion_invariant(self) -> Section:
        """The intrinsic latent and what can be read from it."""
        rows, recovery = self.files.table("motion_invariant"), self.files.table("parameter_recovery")
        transfers = [r for r in rows if r.get("quantity") and r.get("rmse_mm") is not None]
        blocks: list[Block | None] = []
        if transfers:
            view = wide_view(transfers, "quantity", "variant", "rmse_mm", TRANSFER_CONTROLS, CONTROL_VARIANTS)
            blocks.append(Block("table", CAPTIONS["motion_invariant"], view, table_view(rows, mark=False)))
        else:
            blocks += self._table("motion_invariant", controls=CONTROL_VARIANTS)
        for name, column in (("transfer_gain", "gain_share"), ("transfer_over_true", "over_true_parameters")):
            if any(is_number(r.get(column)) for r in rows):
                view = wide_view(rows, "quantity", "variant", column, control_columns=CONTROL_VARIANTS)
                blocks.append(Block("table", CAPTIONS[name], view))
        for name, column in (("latent_variance", "variance_ratio"), ("clip_latent_variance", "clip_variance_ratio")):
            ratios = _once([r for r in rows if is_number(r.get(column))], "garment", "split", "variant")
            if ratios:
                view = wide_view(
                    ratios, "garment", "variant", column, control_columns=CONTROL_VARIANTS, keys=("split",)
                )
                blocks.append(Block("table", CAPTIONS[name], view))
        if any(r.get("r_squared") is not None for r in recovery):
            shown = _some_split(recovery)
            caption = replace(CAPTIONS["recovery_bars"], split=_as_sentence(shown[0].get("split")))
            blocks.append(Block("chart", caption, svg=plots.recovery_bars(shown, "r_squared")))
            view = wide_view(recovery, "parameter", "variant", "r_squared", control_columns=CONTROL_VARIANTS)
            blocks.append(Block("table", CAPTIONS["parameter_recovery"], view, table_view(recovery, mark=False)))
        else:
            blocks += self._table("parameter_recovery")
        return Section(
            "motion-invariant",
            "Motion-invariant autoencoder",
            "What a garment is made of, apart from how its wearer moves. One latent should hold for all frames that "
            "share a parameter set, and should dress a motion that it was not taken from.",
            _present(blocks),
        )

    def motion_cvae(self) -> Section:
        """Reconstruction and generation of motions."""
        blocks = [
            self._pictures("generated"),
            *self._table("motion_reconstruction"),
            self._published("published_reconstruction", published.RECONSTRUCTION, "motion_reconstruction"),
            *self._table("motion_generation", controls="^mean pose of the label$"),
            self._published("published_generation", published.GENERATION, "motion_generation"),
            *self._table("motion_quality", mark=False),
        ]
        return Section(
            "motion-cvae",
            "Motion CVAE",
            "New motions from an action label. They are put on the ground, led into, dressed by the garment regressor "
            "and refined; nothing of them was ever simulated.",
            _present(blocks),
        )

    def garment_regressor(self) -> Section:
        """Regressors beside baselines, and the papers' figures."""
        rows = self.files.table("garment_regressor")
        blocks = [self._pictures("error")]
        if rows and any(is_number(r.get("rmse_mm")) for r in rows):
            blocks.append(
                self._chart("regressor_bars", lambda: plots.method_bars(_some_split(rows), "rmse_mm", "RMSE [mm]"))
            )
        blocks += self._table("garment_regressor")
        blocks += self._table("regressor_drift")
        blocks.append(self._published("published_regressors", published.REGRESSORS, "garment_regressor"))
        blocks.append(self._published("published_gsnet", published.REGRESSORS_GSNET, "garment_regressor"))
        return Section(
            "garment-regressor",
            "Garment regressor",
            "From body motion to garment vertices, on motions that were not trained on, with the base material. A "
            "learned regressor has to beat what needs no network.",
            _present(blocks),
        )

    def collisions(self) -> Section:
        """Before and after tuning, before and after refinement."""
        rows = self.files.table("garment_regressor")
        blocks = [self._pictures("refined"), *self._table("collision_tuning", mark=False)]
        shown = CAPTIONS["refinement"].columns
        rows = [r for r in rows if r.get("refined_rmse_mm") is not None] or rows
        if rows and any(c in columns_of(rows) for c in shown[2:]):
            blocks.append(Block("table", CAPTIONS["refinement"], table_view(rows, shown)))
        else:
            blocks.append(_missing("refinement"))
        return Section(
            "collisions",
            "Collisions",
            "First the regressor is tuned on generated motions, without ground truth, so that its garments leave the "
            "body. Then each frame is refined: what is still inside is drawn out while the garment keeps its shape.",
            _present(blocks),
        )

    def timing(self) -> Section:
        """Seconds a frame of simulators and networks."""
        rows = self.files.table("timing")
        own = [r for r in rows if not is_reference(r)]
        others = _once([r for r in rows if is_reference(r)], "solver", "vertices", "source")
        blocks: list[Block | None] = []
        if own:
            caption = CAPTIONS["timing"]
            blocks.append(self._chart("timing_bars", lambda: plots.timing_bars(rows)))
            blocks.append(
                Block("table", caption, table_view(own, caption.columns, mark=False), _full(own, caption, mark=False))
            )
        else:
            blocks.append(_missing("timing"))
        shown = ("solver", "vertices", "frames", "substeps", "median_s_per_frame", "source")
        elsewhere = [{k: r.get(k) for k in shown} for r in [*others, *published.TIMING]]
        blocks.append(self._published("published_timing", elsewhere, "timing"))
        return Section(
            "timing",
            "Time a frame",
            "Simulators and networks on the same garment, body and clip, one after the other on one thread of the "
            "machine below.",
            _present(blocks),
        )

    def losses(self) -> Section:
        """Loss curves of every training."""
        blocks: list[Block | None] = []
        for group, trainings in self.files.trainings().items():
            name = "motion models" if group == "motion" else group
            caption = Caption(f"Losses, {name}", CAPTIONS["losses"].what, made=CAPTIONS["losses"].made)
            blocks.append(
                Block("chart", caption, svg=plots.loss_curves([(f"{n}", r) for n, r in trainings], key=group))
            )
        if not blocks:
            blocks.append(Block("missing", text="No training has left its losses in this run."))
        return Section(
            "losses",
            "Loss curves",
            "The loss that each training minimised, by epoch. A validation curve that turns upwards is overfitting; "
            "one that still falls at the end would gain from more epochs.",
            _present(blocks),
        )

    def _table(self, name: str, controls: str = "", mark: bool = True, within: str = "") -> list[Block]:
        rows, caption = self.files.table(name), CAPTIONS[name]
        if not rows:
            return [_missing(name)]
        shown = [c for c in caption.columns if c in columns_of(rows)]
        # A table whose columns are others than were expected is shown as it is.
        view = table_view(rows, shown if len(shown) > 2 else None, controls=controls, mark=mark, within=within)
        return [Block("table", caption, view, _full(rows, caption, controls, mark) if len(shown) > 2 else None)]

    def _dropped(self) -> list[Block]:
        rows, made = self.files.table("dropped"), self.files.table("simulation")
        if not rows and not made:
            return [_missing("dropped")]
        lost = [r for r in rows if r.get("reason")]
        kept = sum(int(r.get("sequences") or 0) for r in made)
        attempts = self.config.get("simulation", {}).get("attempts")
        if not lost:
            return [Block("note", text=f"No simulation was dropped: all {kept} that were started are in the data.")]
        share = f"{len(lost)} of {kept + len(lost)} simulations were dropped"
        tries = f" after {attempts} attempts with ever more substeps" if attempts else ""
        text = f"{share}{tries}. They are in no training and in no test; every figure below is without them."
        return [Block("note", text=text), Block("table", CAPTIONS["dropped"], table_view(lost, CAPTIONS["dropped"].columns, mark=False))]  # fmt: skip  # noqa: E501

    def _ranges(self) -> Block | None:
        garments = self.config.get("garments", {})
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
            for name in garments:
                settings = garments[name]
                limits = settings.get("ranges", {}).get(p.name)
                base = base_values(settings).get(p.name, p.base)
                row[name] = f"{_plain(limits['min'])}\u2009–\u2009{_plain(limits['max'])}" if limits else "fixed"
                row[f"{name}, base"] = _plain(base)
            rows.append(row | {"meaning": p.meaning})
        return Block("table", CAPTIONS["ranges"], table_view(rows, mark=False, keys=()))

    def _published(self, name: str, rows: list[Row], ours: str) -> Block | None:
        """Rows of the papers, where the run has a table of its own to hold beside them."""
        if not rows or not self.files.table(ours):
            return None
        return Block("table", CAPTIONS[name], table_view(rows, keys=(), mark=False))

    def _chart(self, name: str, draw: Callable[[], str]) -> Block:
        return Block("chart", CAPTIONS[name], svg=draw())

    def _pictures(self, kind: str) -> Block | None:
        found = [p for p in self.pictures if p.kind == kind]
        return Block("pictures", CAPTIONS.get(f"pictures_{kind}"), pictures=found) if found else None


def _full(rows: Sequence[Row], caption: Caption, controls: str = "", mark: bool = True) -> TableView | None:
    """The table with all columns, where the shown one leaves some out."""
    hidden = [c for c in columns_of(rows) if c not in caption.columns and not c.endswith("_interval")]
    return table_view(rows, controls=controls, mark=mark) if hidden and caption.columns else None


def _some_split(rows: Sequence[Row]) -> list[Row]:
    """Rows of one split, the hardest that the table has."""
    splits = [r.get("split") for r in rows]
    chosen = next((s for s in HARDEST if s in splits), splits[0])
    return [r for r in rows if r.get("split") == chosen]


def _first(rows: Sequence[Row], *names: str) -> str:
    return next((n for n in names if n in columns_of(rows)), names[0])


def _once(rows: Sequence[Row], *names: str) -> list[Row]:
    """The first row of each combination of values."""
    return list({tuple(r.get(n) for n in names): r for r in reversed(rows)}.values())[::-1]


def _as_sentence(split: object) -> str:
    text = readable(str(split or ""))
    return f"{text[:1].upper()}{text[1:]}." if text else ""


def _plain(value: float) -> str:
    """A configured number as it was written, small ones as a power of ten."""
    return f"{value:g}" if value == 0 or abs(value) >= 1e-3 else significant(value, 1)


def _missing(name: str) -> Block:
    caption = CAPTIONS[name]
    return Block("missing", caption, text=f"The table “{name}” is missing from this run ({caption.made}).")


def _present(blocks: Sequence[Block | None]) -> list[Block]:
    return [b for b in blocks if b is not None]
