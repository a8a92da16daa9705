"""Progress lines: count, rate, time left; and one sentence where a stage fails."""

from __future__ import annotations

import io
import subprocess
import sys

from pipeline import progress
from pipeline.progress import Progress
from pipeline.training_job import TrainingProgress


class Clock:
    """A clock that the test turns."""

    def __init__(self) -> None:
        self.now = 0.0

    def monotonic(self) -> float:
        return self.now


def test_a_line_tells_count_rate_and_time_left(monkeypatch):
    clock, text = Clock(), io.StringIO()
    monkeypatch.setattr(progress, "time", clock)
    count = Progress("simulate skirt", 100, "frames", interval=5.0, stream=text)
    for _ in range(20):
        clock.now += 0.5
        count()
    lines = text.getvalue().splitlines()
    assert lines[0] == "[simulate skirt] 10/100 frames, 2/s, 45 s left"
    assert len(lines) == 2  # one line each five seconds, not one a step
    clock.now += 90.0
    count.done = 100
    count.finish()
    assert text.getvalue().splitlines()[-1] == "[simulate skirt] 100/100 frames, 1/s, 1 min 40 s"


def test_training_lines_tell_the_time_left(monkeypatch, capsys):
    clock = Clock()
    monkeypatch.setattr("pipeline.training_job.time", clock)
    say = TrainingProgress("motion CVAE")
    for epoch in (1, 3):
        say(f"epoch {epoch}/11: train total 0.5")
        clock.now += 4.0
    assert capsys.readouterr().out.splitlines()[-1].endswith("epoch 3/11: train total 0.5, 0.5 epochs/s, 16 s left")


def test_a_failing_stage_says_one_sentence(tmp_path):
    missing = tmp_path / "missing.csv"
    missing.write_text("a,a\n1,2\n")
    command = ["-m", "pipeline.join_tables", "--spec", "null", "--out", str(tmp_path / "t.csv"), "--in", str(missing)]
    run = subprocess.run([sys.executable, *command], capture_output=True, text=True, check=False)
    assert run.returncode == 1
    assert run.stderr.startswith("[join_tables] error: ") and "a column name appears twice" in run.stderr
    assert "Traceback" not in run.stderr and not (tmp_path / "t.csv").exists()
