"""The workflow: one command makes everything, and a change makes again what depends on it and nothing else."""

from __future__ import annotations

import csv
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from pipeline.config import load_config
from tests.conftest import CONFIG, ROOT, Workflow

TABLES = (
    "simulation",
    "dropped",
    "shape_descriptor",
    "descriptor_interpolation",
    "descriptor_projection",
    "motion_invariant",
    "parameter_recovery",
    "composition",
    "inference",
    "motion_reconstruction",
    "motion_generation",
    "motion_quality",
    "garment_regressor",
    "regressor_drift",
    "collision_tuning",
    "timing",
    "gsnet",
    "gsnet_categories",
    "gsnet_gap",
    "gsnet_stability",
    "gsnet_contact",
    "gsnet_drift",
    "gsnet_timing",
    "mesh_vae_gan",
    "mesh_vae_gan_generation",
    "layer_transfer",
    "systems",
)


def rows(path: Path) -> list[dict[str, str]]:
    with path.open(newline="") as file:
        return list(csv.DictReader(file))


def overlay(workflow: Workflow, text: str) -> str:
    """A configuration file of the user's, laid over the smoke run's."""
    path = workflow.folder / "mine.yaml"
    path.write_text(text)
    return path.name


def test_the_run_makes_every_table_and_a_self_contained_report(smoke):
    for table in TABLES:
        found = rows(smoke.results / "tables" / f"{table}.csv")
        assert found, table
    page = (smoke.results / "report.html").read_text()
    for outside in ('src="http', "src='http", 'href="http', "url(http"):
        assert outside not in page
    assert len(page) > 100_000  # pictures and videos are inside


def test_tables_hold_both_garments_and_the_baselines(smoke):
    regressors = rows(smoke.results / "tables" / "garment_regressor.csv")
    assert {row["garment"] for row in regressors} == {"skirt", "tshirt"}
    methods = {row["method"] for row in regressors}
    for baseline in ("mean shape", "linear blend skinning + mean residual", "ridge, pose history"):
        assert baseline in methods
    on_bodies = {row["method"] for row in regressors if row["split"] == "unseen_bodies"}
    assert {"regressor, window", "regressor, window, graded to the body", "regressor, conditioned"} <= on_bodies
    solvers = {row["solver"] for row in rows(smoke.results / "tables" / "timing.csv")}
    assert {"XPBD", "implicit Euler", "garment regressor"} <= solvers


def test_every_planned_simulation_is_kept_or_counted_as_dropped(smoke):
    for row in rows(smoke.results / "tables" / "simulation.csv"):
        planned = {"materials": 6 * 5, "motions": 18, "bodies": 4 * 3}[row["plan"]]
        assert int(row["sequences"]) + int(row["dropped"]) == planned


def test_nothing_is_left_to_do_after_a_run(smoke):
    assert smoke.planned_outputs(CONFIG) == set()


def test_equal_values_written_otherwise_change_nothing(smoke):
    gravity = load_config([ROOT / "configs" / "default.yaml"])["garments"]["skirt"]["ranges"]["gravity"]
    ends = f"{{min: {gravity['min']:.3f}, max: {gravity['max']:.4e}}}"
    mine = overlay(smoke, f"garments: {{skirt: {{ranges: {{gravity: {ends}}}}}}}")
    assert smoke.planned_outputs(CONFIG, mine) == set()


def test_a_material_range_makes_again_only_what_hangs_on_it(smoke):
    mine = overlay(smoke, "garments: {skirt: {ranges: {density: {max: 0.30}}}}")
    planned = smoke.planned_outputs(CONFIG, mine)
    assert "shards/skirt/materials_0000.h5" in planned
    assert "models/skirt/motion_invariant/pooled.pt" in planned
    assert "report.html" in planned
    # The base material is what it was, and so are the motions, the other garment and both templates.
    assert "shards/skirt/motions_0000.h5" not in planned
    assert not [path for path in planned if "tshirt" in path]
    assert not [path for path in planned if path.startswith(("garments/", "motions/", "models/motion"))]


def test_more_samples_simulate_only_the_new_shards(smoke):
    mine = overlay(smoke, "data: {materials: {samples: 12}}")
    shards = {path for path in smoke.planned_outputs(CONFIG, mine) if path.startswith("shards/")}
    assert shards == {"shards/skirt/materials_0001.h5", "shards/tshirt/materials_0001.h5"}


def test_other_bodies_simulate_only_their_shards(smoke):
    mine = overlay(smoke, "data: {bodies: {spread: 0.5}}")
    planned = smoke.planned_outputs(CONFIG, mine)
    shards = {path for path in planned if path.startswith("shards/")}
    assert shards == {"shards/skirt/bodies_0000.h5", "shards/tshirt/bodies_0000.h5"}
    # Of the models, only the one that is told of the body reads them.
    models = {path for path in planned if path.startswith("models/")}
    assert models == {f"models/{garment}/garment_regressor/conditioned.pt" for garment in ("skirt", "tshirt")}
    assert not [path for path in planned if path.startswith(("garments/", "motions/"))]
    assert "parts/simulation/skirt.csv" in planned


def test_no_bodies_are_simulated_where_none_are_asked_for(smoke):
    mine = overlay(smoke, "data: {bodies: {samples: 0}}")
    assert not [path for path in smoke.planned_outputs(CONFIG, mine) if path.startswith("shards/")]


def test_clips_that_are_not_simulated_are_learned_from_and_simulate_nothing(smoke):
    mine = overlay(smoke, "motions: {unsimulated: 2}")
    planned = smoke.planned_outputs(CONFIG, mine)
    assert {"motions/batch_0002.h5", "models/motion/motion_cvae/dense.pt", "models/motion/recognition.pt"} <= planned
    assert not [path for path in planned if path.startswith("shards/") or path == "motions/batch_0000.h5"]


def test_the_device_and_the_threads_change_nothing(smoke):
    mine = overlay(smoke, "compute: {device: cpu, threads: 2}")
    assert smoke.planned_outputs(CONFIG, mine) == set()


def test_a_model_setting_reruns_its_training_and_no_simulation(smoke):
    mine = overlay(smoke, "models: {motion_cvae: {variants: {dense: {training: {epochs: 21}}}}}")
    planned = smoke.planned_outputs(CONFIG, mine)
    assert "models/motion/motion_cvae/dense.pt" in planned
    assert "models/motion/motion_cvae/actor.pt" not in planned
    assert not [path for path in planned if path.startswith("shards/")]
    assert "models/skirt/shape_descriptor/paper.pt" not in planned


def test_the_plan_of_the_papers_sizes(tmp_path):
    workflow = Workflow.at(tmp_path)
    run = workflow.snakemake("all", "--dry-run", "--cores", "2", "--configfile", "configs/paper.yaml")
    assert run.returncode == 0, run.stdout[-3000:]
    stats = dict(line.split()[:2] for line in run.stdout.splitlines() if len(line.split()) == 2)
    assert int(stats["simulate"]) == 3 * (200 // 40 + -(-1812 // 96) + 64 // 4)
    assert int(stats["motions"]) == -(-1812 // 96)
    assert int(stats["garment"]) == 3


def test_a_wrong_config_ends_before_any_job(tmp_path):
    workflow = Workflow.at(tmp_path)
    mine = overlay(workflow, "garments: {skirt: {ranges: {density: {min: -1}}}}")
    run = workflow.snakemake("all", "--cores", "2", "--configfile", mine)
    assert run.returncode != 0
    assert "configuration error: mine.yaml: garments.skirt.ranges.density.min: found -1" in run.stdout
    assert "Traceback" not in run.stdout
    assert not (workflow.folder / "results").exists()


def test_jobs_are_not_started_by_the_clock(tmp_path):
    workflow = Workflow.at(tmp_path)
    targets = ["results/smoke/config.json", "results/smoke/motions/batch_0000.h5"]
    limit = ["--max-jobs-per-timespan", "1/15s"]
    run = workflow.snakemake(*targets, "--cores", "1", "--configfile", CONFIG, *limit)
    assert run.returncode == 0, run.stdout[-3000:]
    assert "Job rate limit reached" not in run.stdout
    assert all((workflow.folder / target).is_file() for target in targets)


def test_packages_are_the_ones_of_this_checkout():
    import datasets

    assert Path(datasets.__file__).parent.parent == Path(__file__).parent.parent


@pytest.mark.parametrize("stage", ["simulate", "train_motion_cvae", "report"])
def test_a_stage_explains_itself(stage):
    run = subprocess.run(
        [sys.executable, "-m", f"pipeline.{stage}", "--help"], capture_output=True, text=True, check=True
    )
    assert "--spec" in run.stdout and f"Stage ``{stage}``" in run.stdout


def test_a_damaged_input_gets_one_sentence(smoke, tmp_path):
    broken = tmp_path / "broken.h5"
    shutil.copy(smoke.results / "shards" / "skirt" / "motions_0000.h5", broken)
    with broken.open("r+b") as file:
        file.truncate(1000)
    out = [str(tmp_path / name) for name in ("a.csv", "b.csv")]
    stage = ["-m", "pipeline.evaluate_simulation", "--spec", '{"garment":"skirt"}']
    command = [sys.executable, *stage, "--out", *out, "--in", str(broken)]
    run = subprocess.run(command, capture_output=True, text=True, check=False)
    assert run.returncode == 1
    assert "broken.h5: not a readable HDF5 file" in run.stderr
    assert "Traceback" not in run.stderr
    assert not (tmp_path / "a.csv").exists()
