"""Which sequences are shown, what the list of pictures says, and that a failed rendering leaves nothing."""

from __future__ import annotations

import json
from pathlib import Path

import av
import numpy as np
import pytest
from PIL import Image

from datasets.shards import ShardHeader, ShardWriter, SimulatedSequence
from datasets.splits import SplitRule
from pipeline import render
from pipeline.render import SEEN_MATERIALS, Data
from pipeline.stage import Job
from report.gallery import Dressed, Gallery, round_scale
from report.run_files import RunFiles

FACES = np.array([[0, 1, 2], [0, 2, 3]], dtype=np.int32)
SQUARE = np.array([[0, 1, 0], [0.4, 1, 0], [0.4, 1.4, 0.1], [0, 1.4, 0]], dtype=np.float32)


def write_shard(path: Path, plan: str, sequences: list[tuple[str, str, int, dict[str, float]]]) -> str:
    """A shard of (clip, label, phi, parameters)."""
    header = ShardHeader(
        "skirt", plan, "1", 0, 30.0, "{}", SQUARE, FACES, np.zeros(0, np.int32), "small", "", FACES, np.zeros(10),
        SEEN_MATERIALS, ("",) * 4, ("material",) * 4,
    )  # fmt: skip
    with ShardWriter(path, header) as writer:
        for number, (clip, label, phi, parameters) in enumerate(sequences):
            pose, root = np.zeros((3, 24, 3), np.float32), np.zeros((3, 3), np.float32)
            cloth = np.repeat(SQUARE[None], 3, axis=0) + number
            arrays = {"vertices": cloth, "pose": pose, "root": root, "joints": pose}
            arrays |= {"lead_pose": pose[:1], "lead_root": root[:1], "lead_joints": pose[:1]}
            values = dict.fromkeys(SEEN_MATERIALS, 1.0) | parameters
            writer.add(SimulatedSequence(clip, clip, number, label, phi, values, **arrays))
    return str(path)


def test_the_liveliest_labels_come_first_each_once(tmp_path: Path) -> None:
    motions = [(f"{label}_{i}", label, 0, {}) for i in range(2) for label in ("stand", "walk", "twist")]
    data = Data([write_shard(tmp_path / "m.h5", "motions", motions)], SplitRule(5, 5))
    assert [r["clip"] for r in data.lively(4)] == ["twist_0", "walk_0", "stand_0", "twist_1"]
    assert [r["clip"] for r in data.lively(4, ["walk_1", "stand_0"])] == ["walk_1", "stand_0"]
    read = data.read(data.lively(2))
    assert [s.clip for s in read] == ["twist_0", "walk_0"], "in the order asked for"
    np.testing.assert_array_equal(read[0].vertices[0], SQUARE + 2)


def test_materials_are_those_that_differ_most(tmp_path: Path) -> None:
    bends = (1e-4, 1e-5, 1.1e-4, 1e-3, 1.2e-5)
    sets = [("walk_0", "walk", phi, {"bend": bend}) for phi, bend in enumerate(bends, start=1)]
    shard = write_shard(tmp_path / "a.h5", "materials", [*sets, ("run_0", "run", 1, {})])
    chosen = Data([shard], SplitRule(5, 5)).materials()
    assert [r["phi"] for r in chosen] in ([2, 1, 4], [2, 3, 4]) and {r["clip"] for r in chosen} == {"walk_0"}
    few = write_shard(tmp_path / "b.h5", "materials", sets[:2])
    assert Data([few], SplitRule(5, 5)).materials() == []


def test_every_picture_is_listed_and_stands_where_the_list_says(tmp_path: Path) -> None:
    folder = tmp_path / "figures" / "skirt"
    folder.mkdir(parents=True)
    body = np.repeat(np.array([[[0, 0, 0], [0.3, 0, 0], [0.1, 1.6, 0.2]]], dtype=np.float32), 8, axis=0)
    cloth = SQUARE + 0.05 * np.arange(8, dtype=np.float32)[:, None, None]
    one = Dressed(cloth, body, "walk_000", "walk")
    gallery = Gallery(folder, "skirt", "skirt", FACES, np.array([[0, 1, 2]]), (64, 80), 30)
    gallery.animation("simulated", one, "a", "b")
    gallery.error(one, one.garment + 0.01, 0.02, "c", still=3, rmse_mm=17.320508)
    gallery.write(absent=["no collision"])
    listed = json.loads((folder / "figures.json").read_text())
    assert [e["file"] for e in listed["figures"]] == ["simulated_00.mp4", "error_00.mp4", "error_still_00.webp"]
    for entry in listed["figures"]:
        with Image.open(folder / entry.get("poster", entry["file"])) as image:
            assert image.size == (entry["width"], entry["height"])
        if entry["animated"]:
            with av.open(str(folder / entry["file"])) as video:
                stream = video.streams.video[0]
                assert stream.codec.name == "h264" and stream.pix_fmt == "yuv420p", "what every browser plays"
                frames = [frame.to_ndarray(format="rgb24") for frame in video.decode(video=0)]
            assert len(frames) == 8 and frames[0].shape[:2] == (entry["height"], entry["width"])
            with Image.open(folder / entry["poster"]) as poster:
                assert np.abs(frames[0].astype(int) - np.asarray(poster.convert("RGB"))).mean() < 8.0
    assert listed["figures"][1]["numbers"] == {"rmse_mm": 17.3205}
    pictures = RunFiles(tmp_path).pictures()
    assert [p.poster is not None for p in pictures] == [True, True, False]
    assert [(p.kind, p.label, p.animated) for p in pictures][:2] == [
        ("simulated", "walk", True),
        ("error", "walk", True),
    ]
    assert RunFiles(tmp_path).absent() == [("skirt", "no collision")]


def test_a_failed_rendering_leaves_the_old_pictures(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    out = tmp_path / "figures" / "skirt"
    out.mkdir(parents=True)
    (out / "old.webp").write_bytes(b"old")

    def fail(job: Job, folder: Path) -> None:
        (folder / "half.webp").write_bytes(b"half")
        raise ValueError("no picture")

    monkeypatch.setattr(render, "draw", fail)
    with pytest.raises(ValueError, match="no picture"):
        render.main(Job({}, [], [str(out)], "cpu", 1))
    assert [p.name for p in out.parent.rglob("*.webp")] == ["old.webp"] and len(list(out.parent.iterdir())) == 1
    monkeypatch.setattr(render, "draw", lambda job, folder: (folder / "new.webp").write_bytes(b"new"))
    render.main(Job({}, [], [str(out)], "cpu", 1))
    assert [p.name for p in out.parent.rglob("*.webp")] == ["new.webp"]


def test_scales_end_at_round_numbers() -> None:
    assert [round_scale(v) for v in (0.0007, 0.0031, 0.02, 0.021)] == pytest.approx([0.001, 0.005, 0.02, 0.05])
