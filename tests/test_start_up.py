"""A program of the pipeline starts without collecting garbage among its imports, and then collects as Python does."""

from __future__ import annotations

import gc
import subprocess
import sys

STAGE = """
import gc, sys
sys.argv[0] = "-m"
import pipeline
print(gc.get_threshold()[0] > 100_000)
from pipeline.stage import run_stage
run_stage(lambda job: print(gc.get_freeze_count() > 0, gc.get_threshold()))
"""


def printed(code: str, *arguments: str) -> list[str]:
    run = subprocess.run([sys.executable, "-c", code, *arguments], capture_output=True, text=True, check=True)
    return run.stdout.splitlines()


def test_garbage_is_collected_while_a_stage_works_and_not_among_its_imports():
    imports, work = printed(STAGE, "--spec", "{}", "--out", "nothing")
    assert imports == "True"
    assert work == f"True {gc.get_threshold()}"


def test_importing_the_pipeline_changes_nothing():
    assert printed("import gc, pipeline; print(gc.get_threshold())") == [str(gc.get_threshold())]
