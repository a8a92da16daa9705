"""The cleanliness survey: which clips a name stands for, and what its table says of given figures."""

from __future__ import annotations

import pytest

from benchmarks.clean_table import FIGURES, ClipReport, report_text
from benchmarks.cleanliness import find_clips
from body.model import Body

MOTIONS = {"frames": 8, "fps": 30.0, "bvh": {"labels": "labels.csv"}}
CONFIG = {"seed": 1, "motions": MOTIONS}


def _names(*names: str, variants: int = 1) -> list[str]:
    body = Body.load("small")
    return [clip.name for clip in find_clips(names, CONFIG, body, "nowhere", variants, 2)]


def test_names_of_clips():
    assert _names("walk", "jump_002") == ["walk_000", "jump_002"]
    assert _names("squat", variants=2) == ["squat_000", "squat_001"]
    with pytest.raises(ValueError, match="unknown clip 'gallop'"):
        _names("gallop")
    with pytest.raises(FileNotFoundError, match="nowhere"):
        _names("mocap")


def _report(clip: str, label: str, triangles: list[int], self_pairs: list[int], depth: float = 0.0) -> ClipReport:
    report = ClipReport("skirt", 300, clip, label)
    for inside, crossing in zip(triangles, self_pairs):
        figures = dict.fromkeys(FIGURES, 0) | {"triangles": inside, "self_pairs": crossing, "p99_strain": 0.02}
        figures |= {"hand_vertices": 2 * inside, "hand_triangles": 3 * inside}
        report.add(**figures | {"deepest_mm": depth * (inside > 0), "place": "left_knee" if inside else ""})
    return report


def test_table_of_known_figures():
    reports = [
        _report("walk_000", "walk", [0, 0, 0, 0], [0, 0, 0, 0]),
        _report("kick_000", "kick", [0, 7, 2, 0], [0, 5, 0, 3], depth=4.5),
        ClipReport("skirt", 300, "run_000", "run", failure="an edge is strained by 400%"),
    ]
    text = report_text(reports, worst=3)
    rows = {cells[0]: cells for line in text.splitlines() if (cells := line.replace("|", " ").split())}
    # label, frames, then V worst, V mean, T worst, T mean, mm of faults
    assert rows["kick"][1:7] == ["4", "0", "0.00", "7", "2.25", "4.5"]
    assert rows["kick"][-10:-7] == ["14", "21", "6.75"]  # in hands, which make no frame dirty by themselves
    assert rows["kick"][-7:] == ["5", "2.00", "3", "0", "2.0", "0.0", "25"]
    assert rows["walk"][-1] == "100" and rows["all"][1] == "8" and rows["run"][1] == "failed"
    assert "kick_000 frame 1: 0 vertices and 7 triangles inside, 4.5 mm deep at the left knee; 5 self" in text
    assert "run_000: an edge is strained by 400%" in text
    assert "walk_000" not in text.split("worst frames")[1]


def test_a_frame_has_every_figure():
    with pytest.raises(ValueError, match="figures of a frame"):
        ClipReport("skirt", 300, "walk_000", "walk").add(vertices=1)
