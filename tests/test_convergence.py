"""The report of convergence: artificial stretch falls as it should, and what is left is the material's own."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks.convergence import (
    Run,
    apart,
    artificial_stretch_law,
    convergence_figure,
    extrapolated,
    hanging_sheet,
    main,
    material_stretch,
    order_of_convergence,
    report_rows,
    simulate,
)
from body.model import Body
from evaluation.table import read_table
from sim.compile import compile_kernels

SUBSTEPS = (8, 16, 32, 64)


@pytest.fixture(scope="module")
def sheet() -> list[Run]:
    """A tiny hanging sheet over substeps, of soft cloth whose own stretch can be seen."""
    compile_kernels("cpu")
    scene = hanging_sheet(8, Body.load("small"), height=0.24, width=0.09, stretch=100.0, shear=50.0)
    return simulate(scene, SUBSTEPS)


def test_artificial_stretch_falls_with_the_square_of_the_time_step(sheet):
    assert order_of_convergence(sheet, extrapolated(sheet)) == pytest.approx(2.0, abs=0.25)


def test_artificial_stretch_is_near_its_known_law(sheet):
    material = extrapolated(sheet)
    for run in sheet[:2]:
        assert 0.4 < (run.stretch - material) / artificial_stretch_law(run) < 1.1


def test_what_is_left_is_the_stretch_of_the_material(sheet):
    scene = sheet[0].scene
    density, gravity, stretch = (scene.parameters[name] for name in ("density", "gravity", "stretch"))
    analytic = material_stretch(scene)
    # Lumped masses: half a row of eight hangs on the pins themselves.
    assert analytic == pytest.approx(density * gravity * 0.24**2 / (2.0 * stretch), rel=0.05)
    assert extrapolated(sheet) == pytest.approx(analytic, rel=0.08)


def test_runs_come_nearer_to_the_finest(sheet):
    distances = [apart(run, sheet[-1]) for run in sheet]
    assert distances == sorted(distances, reverse=True) and distances[-1] == 0.0
    coarse = hanging_sheet(4, Body.load("small"), height=0.24, width=0.09, stretch=100.0, shear=50.0)
    other = simulate(coarse, [64])[0]
    # Another mesh of the same sheet: told apart by how it moved, not by where its vertices are.
    assert apart(other, sheet[-1]) < distances[0]


def test_strain_falls_with_substeps(sheet):
    strains = [run.p99_strain for run in sheet]
    assert strains == sorted(strains, reverse=True)


def test_the_table_and_the_plot_hold_every_run(sheet):
    rows = report_rows([sheet])
    assert [row["substeps"] for row in rows] == list(SUBSTEPS)
    for row in rows:
        assert row["stretch_mm"] == pytest.approx(row["artificial_mm"] + row["material_extrapolated_mm"])
        assert np.isfinite([row["artificial_law_mm"], row["material_analytic_mm"], row["from_finest_mm"]]).all()
    assert len(convergence_figure(rows).axes) == 3


def test_the_command_writes_both(tmp_path, capsys):
    main(["--out", str(tmp_path), "--rows", "4", "--skirt", "--substeps", "4", "8"])
    assert [row["substeps"] for row in read_table(tmp_path / "convergence.csv")] == [4, 8]
    assert (tmp_path / "convergence.png").stat().st_size > 5000
    assert "hanging sheet" in capsys.readouterr().out
