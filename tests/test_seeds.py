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


def test_whole_numbers_tell_rows_apart():
    rows = [{"method": "PCA", "dimension": d, "rmse_mm": 10.0 / d} for d in (25, 50)]
    assert average_seeds(rows, ["rmse_mm"]) == rows


def test_numbers_of_numpy_are_numbers():
    rows = [{"v": "x", "e": np.float32(2.0), "n": np.int64(3)}, {"v": "x-seed-2", "e": np.float32(4.0), "n": 3}]
    (row,) = average_seeds(rows, ["e"])
    assert row["e"] == pytest.approx(3.0) and row["n"] == 3
