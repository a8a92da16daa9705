"""The data plan: asking for more appends, and every number keeps its meaning."""

from __future__ import annotations

import json
import os
from copy import deepcopy
from pathlib import Path

import pytest

from datasets.splits import SplitRule
from pipeline import spec
from pipeline.canonical import canonical
from pipeline.config import load_config
from pipeline.plan import (
    batch_clips,
    batch_count,
    learning_batch_count,
    learning_clips,
    motion_labels,
    plan_clips,
    shard_batches,
    shard_names,
    shard_simulations,
)

CONFIGS = Path(__file__).parent.parent / "configs"
MOCAP = Path(os.environ.get("DRAPELINE_MOCAP", CONFIGS.parent / ".." / "shared" / "mocap"))

BVH = """HIERARCHY
ROOT Hips
{
  OFFSET 0 90 0
  CHANNELS 6 Xposition Yposition Zposition Zrotation Xrotation Yrotation
  End Site
  {
    OFFSET 0 10 0
  }
}
MOTION
Frames: %d
Frame Time: 0.0333333
%s"""


@pytest.fixture
def config() -> dict:
    return load_config([CONFIGS / "default.yaml", CONFIGS / "smoke.yaml"])


def test_more_variants_append_clips(config):
    fewer = plan_clips(config["motions"])
    config["motions"]["procedural"]["variants"] += 2
    more = plan_clips(config["motions"])
    assert more[: len(fewer)] == fewer and len(more) == len(fewer) + 2 * 3
    assert [clip.index for clip in more] == list(range(len(more)))
    assert len({clip.name for clip in more}) == len(more)


def test_more_seeds_append_trainings_and_change_no_other(config):
    config["models"]["garment_regressor"]["seeds"] = {"gru": 3}
    names = spec.trained_variants(config, "garment_regressor")
    assert set(names) - set(config["models"]["garment_regressor"]["variants"]) == {"gru-seed-2", "gru-seed-3"}
    first, second, third = (
        json.loads(spec.train_spec(config, "garment_regressor", "skirt", name))
        for name in ("gru", "gru-seed-2", "gru-seed-3")
    )
    assert (second["seed"], third["seed"]) == (first["seed"] + 1, first["seed"] + 2)
    assert first | {"seed": 0} == second | {"seed": 0}
    assert json.loads(spec.evaluate_spec(config, "skirt", "garment_regressor"))["variants"] == names


def test_batches_hold_every_clip_once(config):
    motions = config["motions"] | {"clips_per_batch": 5}
    held = [clip for batch in range(batch_count(motions)) for clip in batch_clips(motions, batch)]
    assert held == plan_clips(motions)


def test_clips_that_are_not_simulated_come_in_batches_of_their_own_and_change_no_other(config):
    motions = config["motions"] | {"clips_per_batch": 5, "unsimulated": 2}
    simulated, clips = plan_clips(motions), learning_clips(motions)
    assert clips[: len(simulated)] == simulated and len(clips) == 3 * len(simulated)
    assert len({clip.name for clip in clips}) == len(clips)
    assert [clip.take_index for clip in clips] == list(range(len(clips)))  # the split never moves
    held = [clip for batch in range(learning_batch_count(motions)) for clip in batch_clips(motions, batch)]
    assert held == clips
    before = [batch_clips(motions | {"unsimulated": 0}, batch) for batch in range(batch_count(motions))]
    assert [batch_clips(motions, batch) for batch in range(batch_count(motions))] == before


def test_shards_hold_every_simulation_once(config):
    config["data"]["materials"] |= {"samples": 8, "samples_per_shard": 2, "clips": 5, "own_clips": False}
    config["motions"]["clips_per_batch"] = 4
    shards = shard_names(config, ("materials", "motions"))
    pairs = [(phi, clip.name) for shard in shards for phi, clip in shard_simulations(config, shard)]
    clips = [clip.name for clip in plan_clips(config["motions"])]
    assert len(pairs) == len(set(pairs))
    held_out = {*config["data"]["splits"]["styles"], *config["data"]["splits"]["labels"]}
    first = [clip.name for clip in plan_clips(config["motions"]) if clip.label not in held_out][:5]
    assert set(pairs) == {(0, c) for c in clips} | {(phi, c) for phi in range(1, 9) for c in first}
    # A shard is given exactly the motion files that hold its clips.
    for shard in shard_names(config):
        needed = {clip.name for _, clip in shard_simulations(config, shard)}
        given = {c.name for batch in shard_batches(config, shard) for c in batch_clips(config["motions"], batch)}
        assert needed <= given


def test_sixteen_parameter_sets_have_clips_of_their_own(config):
    config = load_config([CONFIGS / "default.yaml"])
    config["data"]["materials"] |= {"samples": 80, "samples_per_shard": 16, "clips": 10, "own_clips": True}
    held_out = {*config["data"]["splits"]["styles"], *config["data"]["splits"]["labels"]}
    used = {}
    for shard in shard_names(config)[:5]:
        pairs = [(phi, clip.name) for phi, clip in shard_simulations(config, shard)]
        assert len(set(pairs)) == len(pairs) == 160
        used[shard] = {name for _, name in pairs}
        assert len(used[shard]) == 10, "sets that are simulated together share their clips"
        assert not {clip.label for _, clip in shard_simulations(config, shard)} & held_out
        given = {c.name for batch in shard_batches(config, shard) for c in batch_clips(config["motions"], batch)}
        assert used[shard] <= given
    assert len(set.union(*used.values())) == 50
    config["data"]["materials"] |= {"samples": 96, "clips": 12}
    for shard, names in used.items():  # more sets and more clips append
        assert names < {clip.name for _, clip in shard_simulations(config, shard)}


def test_bodies_have_clips_of_their_own_and_more_of_them_append():
    config = load_config([CONFIGS / "default.yaml"])
    config["data"]["bodies"] |= {"samples": 8, "samples_per_shard": 4, "clips": 16}
    shards = shard_names(config, ("bodies",))
    assert shards == ["bodies_0000", "bodies_0001"] and set(shards) < set(shard_names(config))
    before = {shard: spec.simulate_spec(config, "skirt", shard) for shard in shards}
    pairs = [(number, clip) for shard in shards for number, clip in shard_simulations(config, shard)]
    assert [number for number, _ in pairs] == [number for number in range(1, 9) for _ in range(16)]
    rule = SplitRule(**config["data"]["splits"])
    splits = {}
    for number, clip in pairs:
        splits.setdefault(rule.split(0, clip.take_index, clip.label, number), set()).add((number, clip.take))
    assert set(splits) == {"train", "unseen_motions", "unseen_bodies", "unseen_bodies_and_motions"}
    bodies = {split: {number for number, _ in found} for split, found in splits.items()}
    takes = {split: {take for _, take in found} for split, found in splits.items()}
    assert not (bodies["train"] | bodies["unseen_motions"]) & (bodies["unseen_bodies"])
    assert not (takes["train"] | takes["unseen_bodies"]) & (takes["unseen_motions"])
    assert len({clip.name for _, clip in pairs}) > 100, "bodies do not share their clips"
    config["data"]["bodies"] |= {"samples": 12}
    assert {shard: spec.simulate_spec(config, "skirt", shard) for shard in shards} == before
    config["data"]["bodies"] |= {"samples": 0}
    assert shard_names(config, ("bodies",)) == []


def test_a_variant_like_another_differs_where_it_says_so():
    config = load_config([CONFIGS / "default.yaml", CONFIGS / "long.yaml"])
    pooled, shorter = (
        json.loads(spec.train_spec(config, "motion_invariant", "skirt", name)) for name in ("pooled", "pooled-window-1")
    )
    assert shorter["window"] == 1 and shorter["model"].pop("window") == 1 and shorter["model"].pop("kind") == "pooled"
    assert shorter["model"]["training"].pop("epochs") < pooled["model"]["training"].pop("epochs")
    assert shorter["model"] == pooled["model"]


def test_specs_hold_what_determines_a_job_and_nothing_else(config):
    before = {shard: spec.simulate_spec(config, "skirt", shard) for shard in shard_names(config)}
    changed = deepcopy(config)
    changed["compute"] = {"device": "cuda", "threads": 8}
    changed["models"]["motion_cvae"]["variants"]["dense"]["latent"] = 1
    changed["motions"]["unsimulated"] = 7
    changed["data"]["splits"]["bodies_every"] = 3
    changed["garments"]["tshirt"]["ranges"]["density"]["max"] = 0.2
    assert {shard: spec.simulate_spec(changed, "skirt", shard) for shard in shard_names(config)} == before
    changed["garments"]["skirt"]["ranges"]["density"]["max"] = 0.2
    after = {shard: spec.simulate_spec(changed, "skirt", shard) for shard in shard_names(config)}
    assert [shard for shard in before if before[shard] != after[shard]] == ["materials_0000"]
    changed["data"]["bodies"] |= {"spread": 0.5}
    last = {shard: spec.simulate_spec(changed, "skirt", shard) for shard in shard_names(config)}
    assert [shard for shard in before if last[shard] != after[shard]] == ["bodies_0000"]
    assert spec.garment_spec(changed, "skirt") == spec.garment_spec(config, "skirt")


def test_canonical_text_of_equal_values_is_equal():
    assert canonical({"b": 30.0, "a": [1e-3, 2]}) == canonical({"a": [0.001, 2.0], "b": 30})
    assert json.loads(canonical({"x": 0.1})) == {"x": 0.1}
    assert canonical({"x": 0.1}) != canonical({"x": 0.1000001})


def test_the_papers_labels_and_frames():
    motions = load_config([CONFIGS / "default.yaml", CONFIGS / "paper.yaml"])["motions"]
    assert len(motion_labels(motions)) == 66
    frames = len(plan_clips(motions)) * motions["frames"]
    assert frames - motions["frames"] < 108_705 <= frames


def test_recordings_are_interleaved_and_cut_into_windows(config, tmp_path):
    lengths = {"walk_a": 40, "walk_b": 20, "run_a": 33, "run_b": 16, "bow_a": 100}
    for name, frames in lengths.items():
        (tmp_path / f"{name}.bvh").write_text(BVH % (frames, "0 90 0 0 0 0\n" * frames))
    rows = [f"{name}.bvh,{name.split('_')[0]}" for name in sorted(lengths)]
    (tmp_path / "labels.csv").write_text("file,label\n" + "\n".join(rows) + "\n")
    motions = config["motions"] | {"source": "bvh", "frames": 16, "fps": 30}
    motions["bvh"] = {"folder": str(tmp_path), "labels": "labels.csv", "clips_per_take": 2, "takes_per_label": 2}
    clips = plan_clips(motions)
    # One take of each label first, second windows last, and no label with a single take.
    assert [c.name for c in clips] == ["run_a_000", "walk_a_000", "run_b_000", "walk_b_000", "run_a_001", "walk_a_001"]
    assert [c.take_index for c in clips] == [0, 1, 2, 3, 0, 1]
    assert motion_labels(motions) == ["run", "walk"]


@pytest.mark.skipif(not (MOCAP / "labels.csv").is_file(), reason="the motion capture folder is not there")
def test_the_real_recordings_fill_a_plan(config):
    config = load_config([CONFIGS / "default.yaml"])
    motions = config["motions"] | {"source": "bvh", "max_clips": 168}
    motions["bvh"] = {"folder": str(MOCAP), "labels": "labels.csv", "clips_per_take": 2, "takes_per_label": 5}
    clips = plan_clips(motions)
    assert len(clips) == 168 and len(motion_labels(motions)) > 10
