"""Composing measured against the truth, and parameters told from latents: each on made-up data with a known answer."""

from __future__ import annotations

import numpy as np
import pytest

from evaluation.composition import (
    CANONICAL,
    INTRINSIC,
    ComposedSequence,
    composition_rows,
    evenly,
    keyframes_needed,
    linear,
)
from evaluation.parameter_reader import COVERAGE, Evidence, ParameterReader


def wave(frames: int = 60) -> np.ndarray:
    """A garment of four vertices that swings three times."""
    phase = 6.0 * np.pi * np.arange(frames) / frames
    return 0.1 * np.sin(phase[:, None, None] + np.arange(4)[None, :, None]) * np.ones(3)


def test_keyframes_are_spread_over_both_ends():
    np.testing.assert_array_equal(evenly(96, 2), [0, 95])
    assert len(evenly(10, 20)) == 10


def test_linear_interpolation_goes_through_its_keyframes():
    values = wave()
    keys = evenly(60, 7)
    filled = linear(values, keys)
    np.testing.assert_allclose(filled[keys], values[keys])
    np.testing.assert_allclose(filled[5], values[0] + 0.5 * (values[10] - values[0]), atol=1e-12)


def test_what_knows_the_motion_needs_fewer_keyframes():
    truth = wave()
    methods = {INTRINSIC: lambda keys: truth + 0.01, CANONICAL: lambda keys: linear(truth, keys)}
    rows = composition_rows([ComposedSequence(truth, methods, lambda garment, frame: 1)], "made up")
    found = {(r["method"], r["keyframes"]): r for r in rows}
    assert found[INTRINSIC, 2]["rmse_mm"] == pytest.approx(1e3 * 0.01 * np.sqrt(3.0))
    assert found[INTRINSIC, 2]["keyframes_for_the_same"] == 2
    assert found[INTRINSIC, 2]["inside_percent"] == pytest.approx(25.0)
    needed = found[CANONICAL, 2]["keyframes_for_the_same"]
    assert 10 <= needed <= 24  # three swings, each a dozen straight pieces
    assert found[CANONICAL, 2]["share_for_the_same_percent"] == pytest.approx(100.0 * needed / 60)
    errors = [found[CANONICAL, count]["rmse_mm"] for count in (5, 10, 20)]
    assert errors == sorted(errors, reverse=True)


def test_an_error_that_is_never_reached_has_no_number_of_keyframes():
    assert keyframes_needed({("a", 2): 3.0, ("a", 48): 2.0}, "a", 1.0) is None
    with pytest.raises(ValueError, match="no sequence"):
        composition_rows([], "none")


def made_up(sets: range, noise: float = 0.3) -> tuple[list[Evidence], dict[int, dict[str, float]]]:
    """Frames that show ``bend`` and nothing of ``hidden``; z is the logarithm of the one, with noise."""
    generator = np.random.default_rng(sets.start)
    shown, parameters = [], {}
    for phi in sets:
        log = generator.uniform(-2.0, 2.0)
        parameters[phi] = {"bend": float(np.exp(log)), "hidden": float(generator.uniform(1.0, 3.0)), "same": 1.0}
        for _ in range(4):
            values = np.column_stack([log + noise * generator.normal(size=30), generator.normal(size=30)])
            shown.append(Evidence(values.astype(np.float32), np.ones((30, 2), np.float32), phi))
    return shown, parameters


@pytest.fixture(scope="module")
def reader() -> ParameterReader:
    training, known = made_up(range(40))
    held_out, more = made_up(range(100, 120))
    return ParameterReader(training, held_out, known | more | made_up(range(200, 300))[1], {"bend"}, 1.0)


def test_what_shows_is_read_and_what_does_not_is_not_claimed(reader):
    log, count = 1.0, 30
    values = np.column_stack([np.full(count, log), np.zeros(count)]).astype(np.float32)
    found = reader.estimates(values, np.ones_like(values))
    assert set(found) == {"bend", "hidden"}
    bend, hidden = found["bend"], found["hidden"]
    assert bend.low < np.exp(log) < bend.high and bend.known > 0.7
    assert bend.value == pytest.approx(np.exp(log), rel=0.15)
    assert hidden.known < 0.1 and 1.0 <= hidden.low < hidden.value < hidden.high <= 3.0


def test_intervals_hold_as_often_as_they_say_and_frames_narrow_them(reader):
    tests, _ = made_up(range(200, 300))
    one, many = ({r["parameter"]: r for r in reader.checked(tests, frames)} for frames in (1, 16))
    for rows in (one, many):
        assert rows["bend"]["coverage_percent"] == pytest.approx(100.0 * COVERAGE, abs=8.0)
        assert rows["hidden"]["coverage_percent"] == pytest.approx(100.0 * COVERAGE, abs=10.0)
    assert many["bend"]["interval_of_range"] < 0.6 * one["bend"]["interval_of_range"]
    assert many["bend"]["r_squared"] > one["bend"]["r_squared"] > 0.8


def test_without_held_out_sets_the_training_sets_are_calibrated_on():
    training, known = made_up(range(30))
    found = ParameterReader(training, [], known, {"bend"}, 1.0)
    values = training[0].values
    estimate = found.estimates(values, np.ones_like(values))["bend"]
    assert estimate.low <= known[0]["bend"] <= estimate.high
    with pytest.raises(ValueError, match="at least 2 parameter sets"):
        ParameterReader(training[:1], [], known, {"bend"}, 1.0)
