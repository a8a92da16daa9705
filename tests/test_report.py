"""The page: self-contained, complete, honest about what is missing, and right about which value is the best."""

from __future__ import annotations

import base64
import io
import json
import re
import xml.etree.ElementTree as ElementTree
from html.parser import HTMLParser
from pathlib import Path

import av
import numpy as np
import pytest

from evaluation.table import Row, write_table
from report import captions, plots, sections
from report.captions import CAPTIONS
from report.columns import HIGHER, LOWER, better, column_title, format_column, is_number, significant
from report.page import build_page
from report.run_files import RunFiles
from report.sections.blocks import Run
from report.sheets import write_image
from report.tables import TableView, is_reference, table_view
from report.video import write_video
from report.wide import wide_view

CONFIG = {
    "run": "made-up",
    "garments": {"skirt": {"base": {"density": 0.25}, "ranges": {"bend": {"min": 1e-5, "max": 1e-3}}}},
}

REGRESSORS: list[Row] = [
    {"garment": "skirt", "split": "unseen_motions", "method": method, "rmse_mm": error, "refined_rmse_mm": error + 0.11}
    for method, error in (
        ("simulation", 0.0),
        ("mean shape", 61.3),
        ("ridge, pose history", 24.7),
        ("PCA-20 of the truth (floor)", 3.9),
        ("regressor, <script>alert(1)</script>", 21.2),
    )
]
TABLES: dict[str, list[Row]] = {
    "simulation": [
        {"garment": "skirt", "plan": "materials", "sequences": 37, "frames": 2220, "dropped": 3, "retried": 5},
        {"garment": "skirt", "plan": "motions", "sequences": 11, "frames": 660, "dropped": 0, "retried": 1},
    ],
    "dropped": [
        {"garment": "skirt", "plan": "materials", "clip": f"walk_{i:03d}", "reason": "strain above 0.3"}
        for i in range(3)
    ],
    "shape_descriptor": [
        {"garment": "skirt", "split": "unseen_both", "method": m, "dimension": d, "rmse_mm": e}
        for m, d, e in (("descriptor, paper", 20, 8.31), ("PCA", 10, 17.2), ("PCA", 20, 9.44))
    ],
    "motion_invariant": [
        {"garment": "skirt", "split": "unseen_both", "variant": v, "quantity": "own reconstruction", "rmse_mm": e}
        for v, e in (("paper", 12.6), ("pooled", 9.15), ("motion-only", 7.77))
    ],
    "parameter_recovery": [
        {"garment": "skirt", "split": "unseen_both", "variant": v, "parameter": "bend", "r_squared": r}
        for v, r in (("paper", 0.412), ("pooled", 0.587))
    ],
    "motion_reconstruction": [{"method": "motion CVAE", "pose_rmse": 0.081}, {"method": "mean", "pose_rmse": 0.142}],
    "motion_generation": [
        {"source": "real, unseen motions", "fid": 0.31, "fid_interval": 0.02, "accuracy_percent": 92.5},
        {"source": "motion CVAE", "fid": 0.48, "fid_interval": 0.03, "accuracy_percent": 88.1},
    ],
    "garment_regressor": REGRESSORS,
    "collision_tuning": [{"garment": "skirt", "inside_before_percent": 2.31, "inside_after_percent": 1.12}],
    "timing": [
        {"garment": "skirt", "solver": s, "median_s_per_frame": t, "source": source}
        for s, t, source in (
            ("XPBD", 0.0123, "measured in this run"),
            ("implicit Euler", 0.311, "measured in this run"),
            ("garment regressor", 0.00094, "measured in this run"),
            ("ARCSim (skirt)", 3.2841, "published on other hardware: Shi 2023"),
        )
    ],
}


@pytest.fixture(scope="module")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("results") / "made-up"
    for name, rows in TABLES.items():
        write_table(folder / "tables" / f"{name}.csv", rows)
    losses = [
        {"epoch": e, "split": s, "total": 2.0 / e, "seconds": 0.1} for e in range(1, 6) for s in ("train", "validation")
    ]
    write_table(folder / "training" / "skirt" / "garment_regressor" / "paper" / "losses.csv", losses)
    benchmark = folder / "benchmarks" / "simulate" / "skirt_0.tsv"
    benchmark.parent.mkdir(parents=True)
    benchmark.write_text("s\th:m:s\tmax_rss\n47.5\t0:00:47\t811.2\n")
    pictures = folder / "figures" / "skirt"
    pictures.mkdir(parents=True)
    entries = []
    for kind in ("simulated", "generated"):
        frames = np.random.default_rng(1).integers(0, 255, (4, 40, 30, 3), np.uint8)
        write_video(pictures / f"{kind}.mp4", frames, 25)
        write_image(pictures / f"{kind}_poster.webp", frames[0])
        entries.append(
            {"file": f"{kind}.mp4", "kind": kind, "title": "walk <b>fast</b>", "caption": "", "alt": kind}
            | {"width": 30, "height": 40, "animated": True, "poster": f"{kind}_poster.webp"}
        )
    write_image(pictures / "refined_00.webp", np.zeros((40, 90, 3), np.uint8))
    entries.append({"file": "refined_00.webp", "kind": "refined", "width": 90, "height": 40})
    entries.append(entries[0] | {"file": "../../../secret.webp", "kind": "hero"})
    (pictures / "figures.json").write_text(
        json.dumps({"garment": "skirt", "absent": ["all were <dropped>"], "figures": entries})
    )
    return folder


@pytest.fixture(scope="module")
def page(run: Path) -> str:
    return build_page(run, CONFIG, {"clips": 12, "labels": 4})


class Elements(HTMLParser):
    """Tags with their attributes, and the text of the table cells."""

    def __init__(self, html: str) -> None:
        super().__init__()
        self.tags: list[tuple[str, dict[str, str]]] = []
        self.cells: list[str] = []
        self.open: list[str] = []
        self.feed(html)

    def handle_starttag(self, tag: str, attributes: list) -> None:
        self.tags.append((tag, {k: v or "" for k, v in attributes}))
        if tag not in ("meta", "img", "link", "br", "path", "rect", "use"):
            self.open.append(tag)
        if tag == "td":
            self.cells.append("")

    def handle_endtag(self, tag: str) -> None:
        if tag in self.open:
            while self.open.pop() != tag:
                pass

    def handle_data(self, data: str) -> None:
        if self.open and self.open[-1] == "td":
            self.cells[-1] += data


def test_the_page_needs_nothing_but_itself(page: str) -> None:
    tags = Elements(page).tags
    outside = [
        (tag, value)
        for tag, attributes in tags
        for name, value in attributes.items()
        if name in ("src", "href", "srcset", "data", "poster") and not value.startswith(("data:", "#"))
    ]
    assert outside == []
    style = re.search(r"<style>(.*?)</style>", page, re.DOTALL).group(1)
    assert "@import" not in style and "url(" not in style and "@font-face" not in style
    assert sum(tag == "img" for tag, _ in tags) == 1, "the one of another folder is left out"


def test_videos_stand_in_the_page_itself_and_wait_to_be_seen(page: str) -> None:
    videos = [attributes for tag, attributes in Elements(page).tags if tag == "video"]
    assert [v["aria-label"] for v in videos] == ["simulated", "generated"] * 2, "at the top, and in the gallery"
    for video in videos:
        assert {"muted", "loop", "playsinline", "controls"} <= set(video) and video["preload"] == "none"
        assert (video["width"], video["height"]) == ("30", "40")
        kind, data = video["src"].split(";base64,")
        assert kind == "data:video/mp4" and video["poster"].startswith("data:image/webp;base64,")
        with av.open(io.BytesIO(base64.b64decode(data))) as content:
            assert sum(1 for _ in content.decode(video=0)) == 4


def test_every_section_is_on_the_page_in_its_order_and_in_the_bar(page: str) -> None:
    tags = Elements(page).tags
    found = [attributes["id"] for tag, attributes in tags if tag == "section"]
    ours = ["gallery", "simulation", "shape-descriptor", "motion-invariant", "motion-cvae", "garment-regressor"]
    ours += ["collisions", "timing", "losses"]
    assert [name for name in found if name in ours] == ours
    assert found[0] == "run" and found[-2:] == ["configuration", "machine"]
    assert [attributes["href"] for tag, attributes in tags if tag == "a"] == [f"#{name}" for name in found]


def test_no_topic_is_written_and_forgotten() -> None:
    for package, others in ((sections, {"blocks"}), (captions, {"caption"})):
        written = {path.stem for path in Path(package.__file__).parent.glob("[!_]*.py")} - others
        assert {topic.__name__.rpartition(".")[2] for topic in package.TOPICS} == written


def test_whatever_is_shown_has_a_title_and_says_what_it_is(run: Path) -> None:
    made = sections.all_sections(Run(RunFiles(run), CONFIG))
    shown = [block for section in made for block in section.blocks if block.kind in ("table", "chart", "pictures")]
    assert {block.kind for block in shown} == {"table", "chart", "pictures"}
    for block in shown:
        assert block.caption is not None and block.caption.title
        assert block.caption.what or block.caption.made or block.kind == "pictures", block.caption.title
    assert all(section.lead.endswith(".") and section.blocks for section in made)


def test_every_number_of_every_table_is_on_the_page(page: str) -> None:
    shown = set(Elements(page).cells) | set(re.findall(r"<b>([^<]*)</b>", page))
    written = {re.sub(r" ± .*", "", text) for text in shown}
    exact = {attributes.get("title") for tag, attributes in Elements(page).tags if tag == "td"}
    for name, rows in TABLES.items():
        for column in {c for row in rows for c, v in row.items() if is_number(v) and not c.endswith("_interval")}:
            for text, row in zip(format_column([r.get(column) for r in rows]), rows):
                assert text in written or f"{row[column]:.6g}" in exact, (name, column, text)
    assert "0.310 ± 0.020" in shown


def test_texts_of_the_run_are_escaped(page: str) -> None:
    assert "<script>alert" not in page and "&lt;script&gt;alert(1)" in page
    assert "<b>fast</b>" not in page and "&lt;b&gt;fast" in page
    assert sum(tag == "script" for tag, _ in Elements(page).tags) == 1


def test_losses_are_said_plainly(page: str, run: Path, tmp_path: Path) -> None:
    assert "3 of 51 simulations were dropped" in page
    assert "Not shown for skirt: all were &lt;dropped&gt;." in page
    write_table(tmp_path / "tables" / "simulation.csv", TABLES["simulation"])
    write_table(tmp_path / "tables" / "dropped.csv", [{"garment": "skirt", "clip": "none was dropped", "reason": ""}])
    assert "No simulation was dropped" in build_page(tmp_path, CONFIG)


def test_what_is_missing_is_named(tmp_path: Path) -> None:
    page = build_page(tmp_path, CONFIG)
    for name in (
        "simulation",
        "shape_descriptor",
        "motion_invariant",
        "motion_generation",
        "garment_regressor",
        "timing",
    ):
        assert f"The table “{name}” is missing" in page
    assert "Published" not in page.replace("published", ""), "papers stand beside our figures, not in their place"


def test_identifiers_are_unique(page: str) -> None:
    identifiers = [attributes["id"] for _, attributes in Elements(page).tags if "id" in attributes]
    assert len(identifiers) == len(set(identifiers))


def test_time_and_memory_of_a_stage(run: Path) -> None:
    assert RunFiles(run).stages() == [
        {"stage": "simulate", "jobs": 1, "total_s": 47.5, "longest_job_s": 47.5, "peak_memory_mb": 811.2}
    ]


def best_of(view: TableView, column: int) -> list[str]:
    return [row.cells[column].text for group in view.groups for row in group.rows if row.cells[column].best]


def test_the_best_value_is_marked_in_the_right_direction() -> None:
    rows = [{"method": m, "rmse_mm": e, "accuracy_percent": a} for m, e, a in (("a", 9.0, 50.0), ("b", 4.0, 90.0))]
    view = table_view(rows)
    assert (best_of(view, 1), best_of(view, 2)) == (["4.00"], ["90.0"])
    assert [h.arrow for h in view.header] == ["", "↓", "↑"]


def test_references_and_controls_are_never_the_best() -> None:
    view = table_view(REGRESSORS)
    assert best_of(view, 1) == ["21.2"]
    assert [row.reference for row in view.groups[0].rows] == [True, False, False, True, False]
    control = table_view([{"source": "standing still", "fid": 0.1}, *TABLES["motion_generation"]], controls="^standing")
    assert best_of(control, 1) == [], "one method alone is no contest"


def test_only_equal_dimensions_compete() -> None:
    view = table_view(TABLES["shape_descriptor"], within="dimension")
    assert best_of(view, -1) == ["8.31"]


def test_groups_compete_each_of_its_own() -> None:
    rows = [{"garment": g, "method": m, "rmse_mm": e} for g, m, e in
            (("skirt", "a", 8.0), ("skirt", "b", 9.0), ("tshirt", "a", 5.0), ("tshirt", "b", 4.0))]  # fmt: skip
    view = table_view(rows)
    assert [g.heading for g in view.groups] == ["skirt", "tshirt"]
    assert best_of(view, 1) == ["8.00", "4.00"]


def test_a_wide_table_marks_the_best_of_each_row_among_those_that_compete() -> None:
    view = wide_view(TABLES["motion_invariant"], "quantity", "variant", "rmse_mm", control_columns="^motion-only$")
    (row,) = view.groups[0].rows
    assert [(c.text, c.best) for c in row.cells[1:]] == [("12.60", False), ("9.15", True), ("7.77", False)]
    negative = [r | {"r_squared": v} for r, v in zip(TABLES["parameter_recovery"], (-0.2, -0.9))]
    (row,) = wide_view(negative, "parameter", "variant", "r_squared").groups[0].rows
    assert not any(c.best for c in row.cells)


@pytest.mark.parametrize(
    ("name", "title", "direction"),
    [
        ("rmse_mm", "RMSE [mm]", LOWER),
        ("vertex_rmse_m", "Vertex RMSE [m]", LOWER),
        ("median_s_per_frame", "Median [s/frame]", LOWER),
        ("accuracy_percent", "Accuracy [%]", HIGHER),
        ("r_squared", "R²", HIGHER),
        ("refined_collision_rate_percent", "Refined: collisions [%]", LOWER),
        ("discontinuous_percent", "Discontinuous [%]", LOWER),
        ("diversity", "Diversity", 0),
        ("bend", "Bend", 0),
        ("frames", "Frames", 0),
        ("parameter_sets", "Parameter sets", 0),
        ("sted_parameters", "STED parameters", 0),
        ("frames_stride", "Frames stride", 0),
    ],
)
def test_columns(name: str, title: str, direction: int) -> None:
    assert (column_title(name), better(name)) == (title, direction)


def test_numbers_are_aligned_and_readable() -> None:
    assert format_column([61.34, 4.8, None]) == ["61.3", "4.8", "–"]
    assert format_column([12345, 7]) == ["12\u202f345", "7"]
    assert format_column([3.2841, 0.00094]) == ["3.28", "0.000940"]
    assert format_column([float("nan"), -0.25]) == ["–", "−0.250"]
    assert significant(8e-5, 1) == "0.00008" and significant(1.5e-7) == "1.50·10⁻⁷"


def test_charts_are_well_formed_pictures() -> None:
    losses = [{"epoch": e, "split": "train", "total": 1.0 / e} for e in range(1, 5)]
    drawn = {
        "loss": plots.loss_curves([("a", losses), ("b", losses[:1])], "skirt"),
        "bars": plots.method_bars(REGRESSORS, "rmse_mm", "RMSE [mm]"),
        "dimension": plots.dimension_curves(TABLES["shape_descriptor"], "rmse_mm", "RMSE [mm]", "dimension"),
        "timing": plots.timing_bars(TABLES["timing"]),
        "recovery": plots.recovery_bars(TABLES["parameter_recovery"], "r_squared"),
    }
    for name, text in drawn.items():
        root = ElementTree.fromstring(text)
        assert root.tag == "{http://www.w3.org/2000/svg}svg" and root.get("viewBox"), name
        assert all(i.startswith(name) for i in (e.get("id") for e in root.iter()) if i), name
        assert "currentColor" in text and "http://www.w3.org/1999" not in text, name
    assert "ridge, pose history" in drawn["bars"] and "alert(1)" in drawn["bars"] and "<script" not in drawn["bars"]
    assert "residual" not in drawn["dimension"] and "PCA" in drawn["dimension"]
    assert drawn["loss"] == plots.loss_curves([("a", losses), ("b", losses[:1])], "skirt"), "same data, same picture"


def test_every_table_of_the_workflow_has_a_caption() -> None:
    rules = (Path(__file__).parents[1] / "pipeline" / "rules" / "evaluate.smk").read_text(encoding="utf-8")
    tables = re.findall(r'"(\w+)"', re.search(r"TABLES = \[(.*?)\]", rules, re.DOTALL).group(1))
    assert len(tables) >= 10 and set(tables) <= set(CAPTIONS)


@pytest.mark.parametrize("method", ["simulation", "simulated again (chaos floor)", "PCA-200 of the truth (floor)"])
def test_what_sees_the_truth_is_no_rival(method):
    assert is_reference({"method": method}) and not is_reference({"method": "regressor, window"})
