"""A stage's sources are what it really loads of the project, and nothing else."""

from __future__ import annotations

import json
import subprocess
import sys

import pytest

from pipeline.sources import ROOT, stage_sources

STAGES = ("simulate", "train_shape_descriptor", "train_motion_cvae", "evaluate_garment_regressor", "report")


@pytest.mark.parametrize("stage", STAGES)
def test_every_module_that_a_stage_loads_is_among_its_sources(stage):
    code = (
        f"import json, sys; import pipeline.{stage}; "
        "print(json.dumps([m.__file__ for m in list(sys.modules.values()) if getattr(m, '__file__', None)]))"
    )
    run = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True)
    loaded = {file for file in json.loads(run.stdout.splitlines()[-1]) if file.startswith(str(ROOT))}
    own = {str(file)[len(str(ROOT)) + 1 :] for file in loaded if "/.venv/" not in file}
    assert own and own <= set(stage_sources(stage))


def test_a_simulation_does_not_hang_on_networks_nor_on_the_page():
    sources = stage_sources("simulate")
    assert "sim/kernels/membrane.py" in sources and "body/data/body_full.npz" in sources
    assert not [path for path in sources if path.startswith(("models/", "evaluation/", "report/", "sim/implicit/"))]


def test_a_training_does_not_hang_on_another_networks_code():
    assert "models/garment_regressor.py" not in stage_sources("train_shape_descriptor")
    assert "models/shape_descriptor.py" not in stage_sources("train_motion_cvae")


def test_a_training_does_not_hang_on_what_is_measured_afterwards():
    for stage in ("train_shape_descriptor", "train_motion_invariant", "train_motion_cvae", "train_mesh_vae_gan"):
        assert not [path for path in stage_sources(stage) if path.startswith("evaluation/")], stage
