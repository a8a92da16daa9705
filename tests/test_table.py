"""Tables survive the way to a file and back."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from evaluation.table import columns_of, merge_tables, read_table, write_table


def test_round_trip_keeps_values_types_and_column_order(tmp_path: Path) -> None:
    rows = [
        {"method": "ridge, history", "split": "unseen_both", "rmse_mm": 31.25, "frames": 60, "refined": True},
        {"method": 'say "x"', "split": "train", "rmse_mm": np.float32(1.5), "frames": np.int64(8), "extra_s": 0.001},
    ]
    path = tmp_path / "out" / "table.csv"
    write_table(path, rows)
    back = read_table(path)
    assert list(back[0]) == ["method", "split", "rmse_mm", "frames", "refined", "extra_s"] == columns_of(rows)
    assert back[0] == {**rows[0], "extra_s": None}
    assert back[1] == {
        "method": 'say "x"',
        "split": "train",
        "rmse_mm": 1.5,
        "frames": 8,
        "refined": None,
        "extra_s": 0.001,
    }
    assert type(back[1]["frames"]) is int and type(back[1]["rmse_mm"]) is float


def test_names_that_look_like_numbers_in_python_stay_names(tmp_path: Path) -> None:
    write_table(tmp_path / "t.csv", [{"clip": "1_000", "nothing": None, "value": float("nan")}])
    row = read_table(tmp_path / "t.csv")[0]
    assert row["clip"] == "1_000" and row["nothing"] is None and np.isnan(row["value"])


def test_failed_write_leaves_the_old_file(tmp_path: Path) -> None:
    path = tmp_path / "t.csv"
    write_table(path, [{"a": 1}])
    with pytest.raises(ValueError, match="column a: a cell must be"):
        write_table(path, [{"a": 2}, {"a": [1, 2]}])
    assert read_table(path) == [{"a": 1}]
    assert [p.name for p in tmp_path.iterdir()] == ["t.csv"]


def test_merge_puts_constants_in_front() -> None:
    merged = merge_tables([[{"a": 1}], [{"a": 2, "garment": "own"}]], garment="skirt")
    assert merged == [{"garment": "skirt", "a": 1}, {"garment": "own", "a": 2}]
    assert columns_of(merged) == ["garment", "a"]


def test_damaged_files_are_refused(tmp_path: Path) -> None:
    path = tmp_path / "t.csv"
    path.write_text("a,b\n1,2\n3\n")
    with pytest.raises(ValueError, match="line 3 has 1 cells, the header 2"):
        read_table(path)
    path.write_text("a,a\n1,2\n")
    with pytest.raises(ValueError, match="twice"):
        read_table(path)
    path.write_text("")
    with pytest.raises(ValueError, match="no header"):
        read_table(path)
    with pytest.raises(ValueError, match="at least one row"):
        write_table(path, [])
