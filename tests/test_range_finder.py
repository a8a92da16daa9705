"""The range finder on functions whose limits are known, and its stage on a real garment."""

from __future__ import annotations

import itertools
import math
from pathlib import Path

import numpy as np
import pytest
import yaml

from body.model import Body
from evaluation.table import read_table
from garments.build import build_template
from garments.spec import GarmentSpec
from motions.clip_file import write_clips
from motions.procedural import generate_clip
from pipeline.config import load_config
from pipeline.find_ranges import fragment, liveliest, main, rounded_inwards, side_by_side
from pipeline.stage import Job
from report.ranges_plot import ranges_figure
from sim.parameters import PARAMETER_NAMES, base_parameters, parameter
from sim.range_finder import (
    CRITERIA,
    FAILED,
    FoundRange,
    Outcome,
    SearchSettings,
    find_ranges,
    judge,
    widest_common_share,
)

DEFAULT = Path(__file__).parent.parent / "configs" / "default.yaml"

BASE = base_parameters()


class Simulator:
    """Stands in for the simulator: a parameter set holds while every parameter is inside its interval."""

    def __init__(self, holds: dict[str, tuple[float, float]]):
        self.holds, self.tried, self.batches = holds, [], []

    def __call__(self, sets):
        self.batches.append(len(sets))
        self.tried += sets
        return [self.one(values) for values in sets]

    def one(self, values):
        for name, (low, high) in self.holds.items():
            if not low <= values[name] <= high:
                return Outcome({}, "p99_edge_strain", f"{name} = {values[name]:g}")
        return Outcome({})


def search(holds: dict[str, tuple[float, float]], names=None, **settings):
    simulator = Simulator(holds)
    limits = settings.pop("limits", None)
    found, trials = find_ranges(BASE, names or list(holds), simulator, SearchSettings(**settings), limits)
    return {r.parameter: r for r in found}, trials, simulator


def test_a_logarithmic_parameter_is_followed_over_decades():
    found, trials, _ = search({"bend": (3.0e-8, 2.0e-2)}, bisections=6)
    r = found["bend"]
    # After the doubled step that failed, six halvings leave a 64th of it.
    assert 3.0e-8 <= r.low < 3.0e-8 * 1.2 and 2.0e-2 / 1.2 < r.high <= 2.0e-2
    assert r.low_stop.cause == r.high_stop.cause == "p99_edge_strain"
    assert len(trials) <= 2 * (5 + 6)
    ups = [t.value for t in trials if t.value > BASE["bend"] and t.outcome.cause is None]
    assert ups[0] == pytest.approx(2.0 * BASE["bend"]) and ups[1] == pytest.approx(8.0 * BASE["bend"])


def test_a_linear_parameter_is_followed_to_its_limit():
    found, trials, _ = search({"gravity": (4.0, 100.0)}, bisections=5)
    r = found["gravity"]
    assert r.high == parameter("gravity").allowed[1] and r.high_stop is None
    assert 4.0 <= r.low < 4.3 and r.low_stop is not None
    assert max(t.value for t in trials) == parameter("gravity").allowed[1]


def test_every_value_between_the_ends_that_was_tried_holds_and_the_others_stay_at_base():
    found, trials, simulator = search({"stretch": (50.0, 5.0e4), "friction": (0.0, 0.9)})
    for trial in trials:
        r = found[trial.parameter]
        assert (trial.outcome.cause is None) == (r.low <= trial.value <= r.high)
    for values in simulator.tried:
        assert sum(values[name] != BASE[name] for name in BASE) <= 1


def test_more_bisections_come_nearer():
    gaps = []
    for bisections in (0, 2, 4, 6):
        found, _, _ = search({"density": (0.0, 1.3)}, bisections=bisections)
        gaps.append(math.log(1.3 / found["density"].high))
    assert all(later <= earlier for earlier, later in itertools.pairwise(gaps))
    assert gaps[-1] < 0.02 < gaps[0]


def test_whole_numbers_stay_whole_and_are_never_tried_twice_in_a_search():
    found, trials, _ = search({"substeps": (7.0, 40.0)}, bisections=9, limits={"substeps": (2.0, 64.0)})
    values = [t.value for t in trials]
    assert all(v == int(v) for v in values) and len(values) == len(set(values))
    assert (found["substeps"].low, found["substeps"].high) == (7.0, 40.0)


def test_limits_are_kept_and_an_end_that_is_the_base_costs_nothing():
    found, trials, _ = search({"wind_speed": (0.0, 100.0)}, limits={"wind_speed": (0.0, 5.0)})
    assert (found["wind_speed"].low, found["wind_speed"].high) == (0.0, 5.0)
    assert all(0.0 < t.value <= 5.0 for t in trials)
    with pytest.raises(ValueError, match="substeps: limits 30 to 64 must hold the base value 24"):
        search({"substeps": (1.0, 99.0)}, limits={"substeps": (30.0, 64.0)})


def test_a_logarithmic_parameter_with_a_limit_of_zero_ends_above_it():
    found, _, _ = search({"air_drag": (0.0, 100.0)})
    assert found["air_drag"].low == pytest.approx(1.0e-3 * BASE["air_drag"])


def test_searches_run_side_by_side():
    names = ("stretch", "bend", "density", "friction")
    _, trials, simulator = search({name: parameter(name).allowed for name in names})
    assert simulator.batches[0] == 1 and simulator.batches[1] == 2 * len(names)
    assert sum(simulator.batches) == len(trials) + 1


def test_a_base_that_fails_is_said():
    with pytest.raises(ValueError, match="the base values themselves do not hold: bend = 5e-05"):
        search({"bend": (1.0e-3, 1.0)})


def test_ranges_are_narrowed_until_they_hold_together():
    """Two parameters may use up one unit of log space together, though each alone may use it all."""

    def evaluate(sets):
        def used(values):
            return sum(abs(math.log10(values[n] / BASE[n])) for n in ("bend", "stretch"))

        return [Outcome({}) if used(v) <= 1.0 else Outcome({}, FAILED, "too far") for v in sets]

    found, _ = find_ranges(BASE, ["bend", "stretch"], evaluate, SearchSettings(bisections=8))
    for r in found:
        assert math.log10(r.high / r.base) == pytest.approx(1.0, abs=0.02)
    share, held = widest_common_share(found, BASE, evaluate, sets=40, accepted=0.9, seed=3)
    assert 0.5 <= share < 0.9 and held >= 0.9
    low, high = found[0].narrowed(share)
    assert math.log(high / found[0].base) == pytest.approx(share * math.log(found[0].high / found[0].base))
    assert math.log(low / found[0].base) == pytest.approx(share * math.log(found[0].low / found[0].base))
    assert widest_common_share(found, BASE, lambda sets: [Outcome({}, FAILED, "")] * len(sets), 3, 0.5)[1] == 0.0


def test_free_parameters_are_drawn_over_their_whole_interval():
    seen = []

    def evaluate(sets):
        seen.extend(values["wind_heading"] for values in sets)
        return [Outcome({}) for _ in sets]

    widest_common_share([], BASE, evaluate, sets=30, accepted=1.0, free={"wind_heading": (-np.pi, np.pi)})
    assert min(seen) < -2.0 and max(seen) > 2.0


def test_criteria_are_judged_one_by_one():
    good = dict.fromkeys(CRITERIA, 0.5)
    bounds = dict.fromkeys(CRITERIA, 1.0)
    assert judge(good, bounds).cause is None
    for name, (label, _) in CRITERIA.items():
        outcome = judge({**good, name: 2.0}, bounds)
        assert outcome.cause == name and outcome.sentence.startswith(f"{label} 2")
        assert judge({**good, name: float("nan")}, bounds).cause == name
        assert judge({**good, name: 2.0}, {k: v for k, v in bounds.items() if k != name}).cause is None
    assert judge(good, bounds, "12 vertices are not finite") == Outcome(good, FAILED, "12 vertices are not finite")


def test_settings_that_go_nowhere_are_refused():
    for wrong in ({"factor": 1.0}, {"share": 0.0}, {"bisections": -1}):
        with pytest.raises(ValueError, match="range search: factor"):
            SearchSettings(**wrong)


FAILURE = Outcome({}, "p99_edge_strain", "p99 edge strain 0.31 above 0.25")


def test_the_fragment_is_an_overlay_that_says_units_and_what_stopped_the_search(tmp_path):
    found = [
        FoundRange("density", 0.2, 0.0123, 1.77, FAILURE, None),
        FoundRange("substeps", 24.0, 9.0, 48.0, FAILURE, None),
        FoundRange("bend", 5.0e-5, 1.0e-9, 0.0123, None, FAILURE),
        FoundRange("wind_speed", 0.0, 0.0, 10.0, None, None),
    ]
    search = {"criteria": {"penetration": 0.01, "p99_edge_strain": 0.25}}
    text = fragment("skirt", found, {"wind_heading": (-np.pi, np.pi)}, 1.0, 0.92, 12, ["run_000"], search)
    assert (
        "density: {min: 0.013, max: 1.7} # [kg/m^2] alone 0.0123 to 1.77: p99 edge strain 0.31 above 0.25 below" in text
    )
    assert "limit above" in text and "run_000" in text and "p99 edge strain 0.25, penetration 0.01 m" in text
    file = tmp_path / "found.yaml"
    file.write_text(text)
    ranges = load_config([DEFAULT, file])["garments"]["skirt"]["ranges"]
    assert ranges["bend"] == {"min": 1.0e-9, "max": 0.012} and ranges["substeps"] == {"min": 9, "max": 48}
    assert ranges["wind_speed"]["max"] == 10.0 and ranges["wind_heading"]["min"] > -np.pi


@pytest.mark.parametrize("value", [0.0123, 1.77, 3.0e-9, 9.99e5, 0.0, 100.0, -1.234])
def test_rounding_never_widens_a_range(value):
    for base in (value * 3.0 + 1.0, value * 3.0 - 10.0):
        rounded = rounded_inwards(value, base)
        assert min(value, base) <= rounded <= max(value, base)
        assert rounded == pytest.approx(value, rel=0.1)


def test_sets_with_the_same_substeps_run_side_by_side():
    groups = side_by_side([24] * 20 + [30, 24, 30])
    assert sorted(index for group in groups for index in group) == list(range(23))
    assert sorted(map(len, groups)) == [2, 5, 16]
    assert [20, 22] in groups


def test_the_liveliest_clips_are_those_of_the_part_that_the_garment_covers():
    body = Body.load("small")
    clips = [generate_clip(label, 0, 30, 30.0, 1, body) for label in ("walk", "wave-left", "run", "walk")]
    skirt = build_template(GarmentSpec("skirt", "skirt", 300), body)
    shirt = build_template(GarmentSpec("tshirt", "tshirt", 400), body)
    assert [clip.label for clip in liveliest(clips, skirt, body, 3, 20)] == ["run", "walk", "wave-left"]
    assert liveliest(clips, shirt, body, 1, 20)[0].label != "walk"
    assert [clip.frames for clip in liveliest(clips, skirt, body, 2, 20)] == [20, 20]


def test_the_stage_finds_that_limp_cloth_fails_and_writes_all_three(tmp_path):
    body = Body.load("small")
    build_template(GarmentSpec("skirt", "skirt", 250), body).save(tmp_path / "skirt.npz")
    write_clips(tmp_path / "batch.h5", [generate_clip("walk", 0, 12, 30.0, 1, body)])
    config = load_config([DEFAULT])
    search = config["ranges"] | {
        "clips": 1,
        "frames": 8,
        "bisections": 1,
        "parameters": ["stretch", "density", "wind_speed", "gravity"],
        "limits": {"stretch": {"min": 1.0, "max": 1.0e5}, "density": {"min": 0.1, "max": 1.0}},
        "criteria": config["ranges"]["criteria"] | {"p99_edge_strain": 0.1},
        "together": {"sets": 4, "accepted": 0.75},
    }
    spec = {"garment": "skirt", "seed": 1, "body": {"resolution": "small", "shape": []}, "base": {"stretch": 500.0}}
    spec |= {"fps": 30.0, "lead_in": 6, "settle": 0.3, "self_contact": False, "ranges": search}
    outputs = [str(tmp_path / f"skirt.{kind}") for kind in ("yaml", "csv", "svg")]
    main(Job(spec, [str(tmp_path / "skirt.npz"), str(tmp_path / "batch.h5")], outputs, "cpu", 1))
    ranges = yaml.safe_load(Path(outputs[0]).read_text())["garments"]["skirt"]["ranges"]
    assert set(ranges) == {"stretch", "density", "wind_speed", "gravity", "wind_heading"}
    assert 1.0 < ranges["stretch"]["min"] < 500.0
    rows = read_table(outputs[1])
    failed = [row["value"] for row in rows if not row["holds"]]
    assert 1.0 in failed and {row["cause"] for row in rows if not row["holds"]} <= {*CRITERIA, FAILED}
    assert "<svg" in Path(outputs[2]).read_text() and "stretch" in Path(outputs[2]).read_text()


def test_the_plot_has_a_row_for_every_parameter():
    names = list(PARAMETER_NAMES)
    found, trials, _ = search({name: parameter(name).allowed for name in names})
    figure = ranges_figure("skirt", list(found.values()), trials, 0.5)
    assert len(figure.axes) == len(names)
    for axes, name in zip(figure.axes, names):
        values = [t.value for t in trials if t.parameter == name]
        low, high = axes.get_xlim()
        assert low <= min(values) and max(values) <= high
