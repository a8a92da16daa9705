"""What GSNet stages choose by themselves: networks and frames of pictures, costs; what configurations are refused."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from body.model import Body
from datasets.sequences import Sequence
from models.garment_graph import GarmentGraph
from models.gsnet_fitting import build_animator
from pipeline.config import ConfigError, load_config
from pipeline.evaluate_gsnet import _cost
from pipeline.gsnet_spec import drawn_networks
from pipeline.render_gsnet import Shown, liveliest
from report.sections.gsnet import section
from tests.test_gsnet import FRAMES, LEAD, track, tube

ROOT = Path(__file__).parent.parent
DEFAULT = ROOT / "configs/default.yaml"


def test_pictures_show_ours_beside_what_can_dress_a_garment_it_never_saw():
    config = load_config([DEFAULT])
    assert drawn_networks(config) == ["anchored", "paper", "deepsd"]
    smoke = load_config([DEFAULT, ROOT / "configs/smoke.yaml"])
    assert drawn_networks(smoke) == ["anchored", "deepsd"]


def test_a_picture_shows_the_frame_in_which_cloth_is_farthest_from_being_skinned():
    body = Body.load("small")
    template, motion = tube(body, 9, 5), track(body, 3)
    graph = GarmentGraph.of(template, body)
    skinning = build_animator("skinning", {"materials": (), "body": body.digest})
    vertices = motion.in_world(skinning.dress(graph, np.zeros(0, np.float32), motion, body))
    vertices[7] += 0.05
    lead, wanted = slice(0, LEAD), slice(LEAD, None)
    root = motion.joints[:, 0] - body.joints[0]
    sequence = Sequence(
        "skirt_00", "walk_000", "walk_000", "walk", "wardrobe", 0, "unseen", 30.0, vertices, motion.pose[wanted],
        root[wanted], motion.joints[wanted], motion.pose[lead], root[lead], motion.joints[lead], {},
    )  # fmt: skip
    assert liveliest(sequence, graph, body) == 7
    shown = Shown(None, sequence, 7, {"a": vertices + np.float32([0.003, 0.0, 0.004])})
    assert shown.figures(["a"]) == ["a 5.0"]
    assert len(vertices) == FRAMES


def test_the_cost_of_a_training_is_that_of_its_beginning_and_its_steps():
    made = build_animator("gsnet", {"materials": ("bend",), "body": "0", "width": 8, "heads": 1, "hidden": (8,)})
    rows = [
        {"split": "begin", "seconds": 4.0},
        {"split": "train", "seconds": 2.0},
        {"split": "validation", "seconds": 9.0},
        {"split": "train", "seconds": 1.5},
    ]
    assert _cost(made, rows) == {"training_s": 7.5, "parameters": sum(p.numel() for p in made.parameters())}


def test_a_variant_that_is_not_configured_is_refused(tmp_path):
    file = tmp_path / "mine.yaml"
    file.write_text("models: {gsnet: {use: stedy}}")
    with pytest.raises(ConfigError, match="found 'stedy'; allowed are the variants that are configured: anchored, "):
        load_config([DEFAULT, file])
    likes = ("steady", "no-temporal", "garment", "garment-pose", "pose")
    taken_out = ", ".join(f"{name}: null" for name in ("anchored", *likes))
    file.write_text(f"models: {{gsnet: {{variants: {{{taken_out}}}}}}}")
    with pytest.raises(ConfigError, match="use: found 'anchored'; allowed are the variants that are configured: "):
        load_config([DEFAULT, file])


class _Run:
    """A run with some tables."""

    def __init__(self, tables: dict) -> None:
        from report.run_files import RunFiles
        from report.sections.blocks import Run

        self.tables = tables
        files = RunFiles("/nowhere")
        files.table = lambda name: tables.get(name, [])
        self.run = Run(files, {})


def test_the_section_shows_the_papers_tables_and_leaves_the_ablation_to_its_own():
    methods = ("linear blend skinning", "steady", "deepsd", "no-temporal", "pose")
    figures = {"error_mm": 1.0, "edge_mm": 1.0, "bend": 0.1, "collision_percent": 2.0, "sequences": 3, "garments": 1}
    rows = [
        {"split": s, "method": m, "training_s": 2.0} | figures
        for s in ("unseen_motions", "unseen_templates")
        for m in methods
    ]
    assert section(_Run({}).run) is None
    tables = {
        "gsnet": rows,
        "gsnet_categories": [r | {"category": "top"} for r in rows],
        "gsnet_gap": [{"method": m, "train_error_mm": 1.0, "test_over_train": 1.2} for m in methods],
        "gsnet_stability": [
            {"method": "steady", "epoch": e, "validation_error_mm": 9.0 - e, "over_best": 1.0} for e in (1, 2)
        ],
    }
    made = section(_Run(tables).run)
    by_title = {block.caption.title: block for block in made.blocks if block.caption}
    shown = str(by_title["Garments of six kinds"].table)
    assert "GSNet, ours" in shown and "DeePSD" in shown and "pose alone" not in shown
    ablation = str(by_title["What the past is worth"].table)
    assert "pose alone" in ablation and "DeePSD" not in ablation
    assert "<svg" in by_title["Error over the epochs"].svg
    assert "missing" in by_title["Errors along long roll-outs"].kind
