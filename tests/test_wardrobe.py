"""The wardrobe: its plan appends, its shards and templates belong together, and its splits hold out what they say."""

from __future__ import annotations

import json
from copy import deepcopy
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from datasets.shards import ShardWriter, read_header, read_sequences
from datasets.splits import TRAIN, UNSEEN_MOTIONS, SplitRule
from garments.spec import MEASURES, VERTEX_LIMITS, GarmentSpec
from garments.template import GarmentTemplate
from pipeline import make_motions, simulate_wardrobe, spec, wardrobe_plan
from pipeline.config import ConfigError, check_config, load_config
from pipeline.plan import plan_clips
from pipeline.stage import Job
from pipeline.wardrobe_data import (
    UNSEEN_BOTH,
    UNSEEN_TEMPLATES,
    WARDROBE_SPLITS,
    job_wardrobe,
    load_wardrobe,
    material_vector,
)
from sim.parameters import ENSEMBLE

CONFIGS = Path(__file__).parent.parent / "configs"


@pytest.fixture
def config() -> dict:
    return load_config([CONFIGS / "default.yaml"])


def test_every_category_has_templates_of_its_own_measures_and_resolution(config):
    names = wardrobe_plan.wardrobe_names(config)
    assert len(names) == 6 * config["wardrobe"]["templates"] == len(set(names))
    for category in wardrobe_plan.CATEGORIES:
        made = [wardrobe_plan.template_geometry(config, f"{category}_{i:02d}") for i in range(12)]
        for measure, ends in config["wardrobe"]["garments"][category]["measures"].items():
            values = [one[measure] for one in made if measure in one]
            inside = [value for value in values if measure != "sleeve" or value > 0.0]
            assert min(inside) >= ends["min"] - 1e-9 and max(inside) <= ends["max"] + 1e-9
            if len(values) == 12:
                assert max(values) - min(values) > 0.7 * (ends["max"] - ends["min"]), (category, measure)
        counts = [one["vertices"] for one in made]
        assert len(set(counts)) == 12 and max(counts) > 1.3 * min(counts)
        for one in made:
            GarmentSpec("one", **one)  # every measure is allowed
    sleeves = [wardrobe_plan.template_geometry(config, f"dress_{i:02d}") for i in range(12)]
    assert {one["sleeve"] == 0.0 for one in sleeves} == {True, False} == {"strap" in one for one in sleeves}


def test_more_templates_and_materials_change_no_earlier_one(config):
    before = {name: json.loads(wardrobe_plan.wardrobe_spec(config, name)) for name in ("dress_01", "skirt_04")}
    config["wardrobe"]["templates"] += 3
    for name, earlier in before.items():
        assert json.loads(wardrobe_plan.wardrobe_spec(config, name)) == earlier
    config["wardrobe"]["materials"] += 2
    for name, earlier in before.items():
        later = json.loads(wardrobe_plan.wardrobe_spec(config, name))
        assert later["simulations"][:-2] == earlier["simulations"] and later["geometry"] == earlier["geometry"]
    config["seed"] += 1
    assert wardrobe_plan.template_geometry(config, "dress_01") != before["dress_01"]["geometry"]


def test_a_template_has_clips_and_materials_of_its_own_and_shares_held_out_ones(config):
    settings, rule = config["wardrobe"], SplitRule(**config["data"]["splits"])
    shared = [clip.name for clip in wardrobe_plan.shared_clips(config)]
    assert len(shared) == settings["shared"] and len({name.rsplit("_", 1)[0] for name in shared}) == len(shared)
    own = {}
    for name in wardrobe_plan.wardrobe_names(config):
        pairs = wardrobe_plan.template_simulations(config, name)
        assert len(pairs) % ENSEMBLE == 0, "no lane of the simulator is left empty"
        assert [clip.name for _, clip in pairs[: len(shared)]] == shared
        assert len({clip.name for _, clip in pairs}) == len(pairs), "no clip twice on one template"
        assert [phi for phi, _ in pairs if phi] == list(range(1, settings["materials"] + 1))
        assert not any(rule.holds_out_label(clip.label) for _, clip in pairs)
        held_out = [rule.holds_out_take(clip.take_index) for _, clip in pairs[len(shared) :]]
        assert 0 < sum(held_out) < len(held_out) / 2
        own[name] = tuple(clip.name for _, clip in pairs[len(shared) :])
    assert len(set(own.values())) == len(own)
    assert set(wardrobe_plan.template_batches(config, "dress_01")) == {
        clip.index // config["motions"]["clips_per_batch"]
        for _, clip in wardrobe_plan.template_simulations(config, "dress_01")
    }


def test_few_clips_are_shared_out_as_far_as_they_go(config):
    config["motions"]["max_clips"] = 12
    pairs = wardrobe_plan.template_simulations(config, "top_00")
    known = {clip.name for clip in plan_clips(config["motions"])}
    assert 0 < len(pairs) <= 12 and {clip.name for _, clip in pairs} <= known


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ({"unseen": 6}, "wardrobe.unseen: found 6 of 6 templates; at least one must be left to train on"),
        ({"categories": ["hat"]}, "wardrobe.categories.0: found 'hat'; allowed are tshirt, top"),
        ({"vertices": {"min": 300, "max": 900}}, "wardrobe.vertices.min: found 300; allowed are"),
        ({"vertices": {"min": 900, "max": 700}}, "wardrobe.vertices: min 900 is above max 700"),
        ({"ranges": {"densty": {"min": 1, "max": 2}}}, "wardrobe.ranges.densty.min: unknown parameter 'densty'"),
        ({"garments": {"top": {"measures": {"sleeve": {"min": 0, "max": 0.2}}}}}, "a top has no such measure"),
        (
            {"garments": {"top": {"measures": {"ease": {"min": 0, "max": 9}}}}},
            "top.measures.ease.min: found 0; allowed",
        ),
        ({"garments": {"top": {"fabric": "cottn", "measures": {}}}}, "unknown fabric 'cottn' (did you mean 'cotton'?)"),
        ({"templates": 0}, "wardrobe.templates: found 0; allowed is a whole number from 1 to 100 templates"),
        ({"garments": {"skirt": {"measures": {}}}}, "wardrobe.categories: found 'tshirt'; allowed are the garments"),
    ],
)
def test_a_mistake_gets_one_sentence(config, change, sentence):
    layer = {"wardrobe": change}
    config["wardrobe"] = config["wardrobe"] | deepcopy(change)
    if "measures" in str(change) and "skirt" not in str(change):
        config["wardrobe"]["categories"] = list(change["garments"])
    with pytest.raises(ConfigError) as caught:
        check_config(config, [("mine.yaml", layer)])
    assert sentence in str(caught.value) and str(caught.value).startswith("mine.yaml: "), str(caught.value)


@pytest.fixture(scope="module")
def made(tmp_path_factory) -> tuple[dict, list[Path]]:
    """Two skirts, the first for tests alone, simulated by the stage itself."""
    config = load_config([CONFIGS / "default.yaml", CONFIGS / "smoke.yaml"])
    config["motions"] |= {"frames": 8, "lead_in": 6}
    config["simulation"]["settle"] = 0.2
    config["wardrobe"] |= {
        "categories": ["skirt"], "clips": 3, "materials": 2, "shared": 1, "vertices": {"min": 200, "max": 240},
    }  # fmt: skip
    folder = tmp_path_factory.mktemp("wardrobe")
    motions = folder / "batch_0000.h5"
    make_motions.main(Job(json.loads(spec.motions_spec(config, 0)), [], [str(motions)], "cpu", 1))
    shards = []
    for name in wardrobe_plan.wardrobe_names(config):
        outputs = [str(folder / f"{name}.npz"), str(folder / f"{name}.h5")]
        job_spec = json.loads(wardrobe_plan.wardrobe_spec(config, name))
        simulate_wardrobe.main(Job(job_spec, [str(motions)], outputs, "cpu", 1))
        shards.append(Path(outputs[1]))
    return config, shards


def test_shards_hold_what_was_planned(made):
    config, shards = made
    for path in shards:
        planned = wardrobe_plan.template_simulations(config, path.stem)
        sequences = list(read_sequences(path))
        assert [(s.phi, s.clip) for s in sequences] == [(phi, clip.name) for phi, clip in planned]
        template = GarmentTemplate.load(path.with_suffix(".npz"))
        assert (template.name, template.kind) == (path.stem, "skirt")
        assert len(template.vertices) == wardrobe_plan.template_geometry(config, path.stem)["vertices"]
        by_set = {s.phi: s.parameters for s in sequences}
        base = by_set.pop(0)
        for parameters in by_set.values():
            changed = {name for name in base if parameters[name] != base[name]}
            assert changed == set(config["wardrobe"]["ranges"])
    counts = [len(GarmentTemplate.load(path.with_suffix(".npz")).vertices) for path in shards]
    assert counts[0] != counts[1]


def test_splits_hold_out_templates_and_takes(made):
    config, shards = made
    learning = wardrobe_plan.wardrobe_learning(config)
    inputs = [str(p) for path in reversed(shards) for p in (path, path.with_suffix(".npz"))]
    job = Job(learning, [*inputs, "other.h5"], [], "cpu", 1)
    first, second = job_wardrobe(job)
    assert (first.number, second.number, first.unseen, second.unseen) == (0, 1, True, False)
    assert (first.category, first.template.name) == ("skirt", "skirt_00")
    rule = SplitRule(**config["data"]["splits"])
    takes = {clip.name: clip.take_index for clip in plan_clips(config["motions"])}
    for garment, seen, new in ((first, UNSEEN_TEMPLATES, UNSEEN_BOTH), (second, TRAIN, UNSEEN_MOTIONS)):
        assert {s.split for s in garment.sequences} == {seen, new}
        for sequence in garment.sequences:
            assert (sequence.split == new) == rule.holds_out_take(takes[sequence.clip])
            assert sequence.vertices.shape == (8, len(garment.template.vertices), 3)
        assert len(garment.in_split(seen, new)) == len(garment.sequences)
    [trained] = job_wardrobe(job, (TRAIN,))
    assert trained.template.name == "skirt_01" and {s.split for s in trained.sequences} == {TRAIN}
    shared = {clip.name for clip in wardrobe_plan.shared_clips(config)}
    assert shared <= {s.clip for s in first.in_split(UNSEEN_BOTH)} & {s.clip for s in second.in_split(UNSEEN_MOTIONS)}
    names = learning["wardrobe"]["materials"]
    vectors = np.array([material_vector(s, names) for s in second.sequences])
    assert vectors.shape == (len(second.sequences), 6) and len(np.unique(vectors, axis=0)) == 3


def test_what_does_not_belong_together_is_refused(made, tmp_path):
    config, shards = made
    rule = SplitRule(**config["data"]["splits"])
    with pytest.raises(ValueError, match="split 'test' is not one of train"):
        load_wardrobe(shards, rule, 1, ("test",))
    with pytest.raises(ValueError, match="no simulated sequence in splits train"):
        load_wardrobe(shards[:1], rule, 1, (TRAIN,))
    with pytest.raises(ValueError, match="garment 'skirt_00' is in another shard too"):
        load_wardrobe([shards[0], shards[0]], rule, 1)
    path = tmp_path / "skirt_00.h5"
    path.write_bytes(shards[0].read_bytes())
    with pytest.raises(FileNotFoundError):
        load_wardrobe([path], rule, 1)
    template = GarmentTemplate.load(shards[0].with_suffix(".npz"))
    for wrong in (
        GarmentTemplate.load(shards[1].with_suffix(".npz")),
        replace(template, body_digest="another"),
        replace(template, vertices=template.vertices + np.float32(1e-3)),
    ):
        wrong.save(path.with_suffix(".npz"))
        with pytest.raises(ValueError, match=r"skirt_00.npz: not the template that .*skirt_00.h5 was simulated with"):
            load_wardrobe([path], rule, 1)
    header = read_header(shards[0])
    for change, sentence in (
        ({"plan": "motions"}, "a shard of the plan 'motions', not of the wardrobe"),
        ({"garment": "coat"}, "'coat' is no template of a wardrobe; they are called <category>_<number>"),
    ):
        with ShardWriter(path, replace(header, **change)):
            pass
        replace(template, name=change.get("garment", template.name)).save(path.with_suffix(".npz"))
        with pytest.raises(ValueError, match=sentence):
            load_wardrobe([path], rule, 1)


def test_a_mesh_that_misses_a_bound_is_made_with_more_vertices_or_less_ease(monkeypatch):
    asked = []

    def build(spec: GarmentSpec, body: object) -> int:
        asked.append(spec.vertices)
        if len(asked) < 3:
            raise ValueError("garment 'x': the smallest angle is 5.0 degrees: ask for more vertices")
        return spec.vertices

    monkeypatch.setattr(simulate_wardrobe, "build_template", build)
    assert simulate_wardrobe.sampled_template("x", {"kind": "skirt", "vertices": 1000}, None) == 1061
    assert asked == [1000, 1030, 1061]
    eases = []

    def loose(spec: GarmentSpec, body: object) -> float:
        eases.append(spec.ease)
        if len(eases) < 3:
            raise ValueError("garment 'x': its openings run into each other (6 instead of 4): lower ease and close")
        return spec.ease

    monkeypatch.setattr(simulate_wardrobe, "build_template", loose)
    shirt = {"kind": "tshirt", "vertices": 1000, "ease": 0.02}
    assert simulate_wardrobe.sampled_template("x", shirt, None) == eases[-1] == pytest.approx(0.0128)
    assert shirt["ease"] == 0.02
    with pytest.raises(ValueError, match="passes the ankles"):
        monkeypatch.setattr(simulate_wardrobe, "build_template", _too_long)
        simulate_wardrobe.sampled_template("x", {"kind": "skirt", "vertices": 1000}, None)


def _too_long(spec: GarmentSpec, body: object) -> None:
    raise ValueError(f"garment '{spec.name}': 'length' 1.3 m passes the ankles")


def test_kinds_and_categories_agree():
    assert set(wardrobe_plan.CATEGORIES) == set(MEASURES) == set(VERTEX_LIMITS)
    assert set(WARDROBE_SPLITS) == {TRAIN, UNSEEN_MOTIONS, UNSEEN_TEMPLATES, UNSEEN_BOTH}
    for name in ("hat_01", "dress", "dress_x"):
        with pytest.raises(ValueError, match="is no template of a wardrobe"):
            wardrobe_plan.category_and_number(name)
