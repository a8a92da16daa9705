"""Shared fixtures: one whole smoke run, made once, in a folder of its own."""

from __future__ import annotations

import os
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path

import pytest

ROOT = Path(__file__).parent.parent
CONFIG = "configs/smoke.yaml"


@dataclass(frozen=True)
class Workflow:
    """The workflow in a folder that links to this checkout, so that results lie elsewhere."""

    folder: Path

    @classmethod
    def at(cls, folder: Path) -> Workflow:
        for entry in sorted(ROOT.iterdir()):
            if not entry.name.startswith(".") and entry.name != "results":
                (folder / entry.name).symlink_to(entry)
        return cls(folder)

    @property
    def results(self) -> Path:
        return self.folder / "results" / "smoke"

    def snakemake(self, *arguments: str) -> subprocess.CompletedProcess:
        """Run Snakemake; its output comes back as text."""
        path = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
        return subprocess.run(
            [sys.executable, "-m", "snakemake", *arguments],
            cwd=self.folder,
            env=os.environ | {"PATH": path},
            stdout=subprocess.PIPE,
            stderr=subprocess.STDOUT,
            text=True,
            check=False,
        )

    def planned_outputs(self, *configs: str, target: str = "all") -> set[str]:
        """Files that Snakemake's dry run would make, relative to the run's results."""
        run = self.snakemake(target, "--dry-run", "--cores", "2", "--configfile", *configs)
        assert run.returncode == 0, run.stdout
        lines = [line.strip() for line in run.stdout.splitlines()]
        made = [line.removeprefix("output: ").split(", ") for line in lines if line.startswith("output: ")]
        return {str(Path(path).relative_to("results/smoke")) for paths in made for path in paths}


@pytest.fixture(scope="session")
def smoke(tmp_path_factory) -> Workflow:
    """A finished smoke run."""
    workflow = Workflow.at(tmp_path_factory.mktemp("smoke"))
    run = workflow.snakemake("all", "--cores", "2", "--configfile", CONFIG)
    assert run.returncode == 0, run.stdout[-8000:]
    return workflow
