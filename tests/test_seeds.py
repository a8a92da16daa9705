"""Repeated trainings: names that come back, rows that are averaged only where they differ in the seed alone."""

from __future__ import annotations

import numpy as np
import pytest

from evaluation.seeds import average_seeds, seed_names, split_seed


def test_names_come_back():
    names = seed_names(["window", "window-20", "gru"], {"window": 3, "gru": 2})
    assert names == ["window", "window-seed-2", "window-seed-3", "window-20", "gru", "gru-seed-2"]
    assert [split_seed(name) for name in names] == [
        ("window", 1), ("window", 2), ("window", 3), ("window-20", 1), ("gru", 1), ("gru", 2)
    ]  # fmt: skip


def test_rows_of_one_seed_stay_as_they_are():
    rows = [{"method": "a", "rmse_mm": 1.0}, {"method": "b", "rmse_mm": 2.0}]
    assert average_seeds(rows, ["rmse_mm"]) == rows


def test_seeds_are_averaged_with_their_deviation():
    rows = [
        {"method": "mean shape", "split": "clips", "rmse_mm": 9.0},
        {"method": "regressor, window, tuned", "split": "clips", "rmse_mm": 1.0, "sequences": 4},
        {"method": "regressor, window-seed-2, tuned", "split": "clips", "rmse_mm": 3.0, "sequences": 4},
        {"method": "regressor, window-seed-3, tuned", "split": "clips", "rmse_mm": 5.0, "sequences": 4},
        {"method": "regressor, window, tuned", "split": "labels", "rmse_mm": 7.0, "sequences": 4},
    ]
    mean, averaged, other = average_seeds(rows, ["rmse_mm"])
    assert mean == rows[0]
    assert averaged == {
        "method": "regressor, window, tuned", "split": "clips", "rmse_mm": 3.0, "rmse_mm_seed_std": 2.0,
        "sequences": 4, "training_seeds": 3,
    }  # fmt: skip
    assert other == rows[4]


def test_a_missing_figure_is_no_zero():
    rows = [{"variant": "x", "r2": None}, {"variant": "x-seed-2", "r2": 0.5}]
    (row,) = average_seeds(rows, ["r2"])
    assert row["r2"] == 0.5 and "r2_seed_std" not in row


@pytest.mark.parametrize("number", [np.float32(2.0), np.int64(2)])
def test_numbers_of_numpy_are_numbers(number):
    (row,) = average_seeds([{"v": "x", "e": number}, {"v": "x-seed-2", "e": number + 2}], ["e"])
    assert row["e"] == pytest.approx(3.0)
