"""The README's picture: as small as promised or not there, and of what a run has."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from pipeline import readme_picture
from pipeline.readme_picture import LARGEST, cycle, make_picture
from runtime.finished_run import FinishedRun


def drawn(monkeypatch: pytest.MonkeyPatch, panel: np.ndarray, below: np.ndarray) -> None:
    """Panels in the place of a run's."""
    monkeypatch.setattr(readme_picture, "_truth_and_network", lambda run, name, label, width: [(name, panel)] * 2)
    monkeypatch.setattr(readme_picture, "_fabrics", lambda *_: below)


RUN = FinishedRun(Path("nowhere"), {"garments": {"skirt": {}, "tshirt": {}, "dress": {}}, "motions": {"fps": 30}})


def test_it_holds_every_panel_and_frame(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    panel = np.zeros((6, 80, 60, 3), np.uint8)
    panel[:] += 40 * np.arange(6, dtype=np.uint8)[:, None, None, None]
    drawn(monkeypatch, panel, np.full((6, 50, 231, 3), 90, np.uint8))
    path = make_picture(RUN, tmp_path / "docs")
    assert path.name == "picture.webp" and 0 < path.stat().st_size <= LARGEST
    with Image.open(path) as image:
        assert image.size[0] == 4 * 60 + 3 * 6, "two panels of each of the first two garments"
        assert image.size[1] > 130 and image.n_frames == 6 and image.info["loop"] == 0


def test_a_cycle_begins_where_it_ends() -> None:
    time = np.arange(60) / 30.0
    swing = np.stack([np.sin(2 * np.pi * time / 1.2), np.cos(2 * np.pi * time / 1.2)], axis=1)
    pose = np.zeros((60, 24, 3))
    pose[:, 1, :2], pose[:, 0, 1] = swing, time
    found = cycle(pose, 30.0)
    assert found.stop - found.start == 36 and found.step == 2, "the turn of the whole body counts for nothing"
    assert cycle(pose[:8], 30.0) == slice(0, 8, 2), "what is too short is shown whole"


def test_what_does_not_fit_is_refused_and_leaves_nothing(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    noise = np.random.default_rng(0).integers(0, 255, (3, 80, 60, 3), np.uint8)
    drawn(monkeypatch, noise, noise)
    monkeypatch.setattr(readme_picture, "LARGEST", 1000)
    with pytest.raises(ValueError, match="larger than 1000 bytes"):
        make_picture(RUN, tmp_path)
    assert list(tmp_path.iterdir()) == []
