"""The range finder on functions whose limits are known, and its stage on a real garment."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest

from sim.parameters import base_parameters, parameter
from sim.range_finder import (
    CRITERIA,
    FAILED,
    Outcome,
    SearchSettings,
    find_ranges,
    judge,
    widest_common_share,
)

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
