"""Named fabrics: sourced, inside the physical limits, and their measured stiffnesses mean the same in our energies."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import yaml

from pipeline.config import ConfigError, load_config
from pipeline.spec import garment_spec, simulate_spec
from sim.fabrics import FABRICS, SAMPLES, Fabric, base_values, fabric, kes_bending, kes_shear
from sim.parameters import base_parameters
from sim.rest_state import RestState

DEFAULT = Path(__file__).parent.parent / "configs" / "default.yaml"


@pytest.mark.parametrize("name", FABRICS)
def test_every_number_has_a_source_and_makes_a_parameter_set(name):
    cloth = fabric(name)
    assert base_parameters(cloth.values)["density"] == cloth.values["density"]
    assert {"density", "stretch", "shear", "bend"} <= set(cloth.values) == set(cloth.sources)
    for source in cloth.sources.values():
        assert source.startswith(("measured: ", "derived: ", "assumed: "))
        assert any(character.isdigit() for character in source), "a source has a year or a sample"


def test_fabrics_differ_as_one_knows_them():
    values = {name: cloth.values for name, cloth in FABRICS.items()}
    assert values["silk"]["density"] < values["cotton"]["density"] < values["denim"]["density"]
    assert values["denim"]["density"] < values["leather"]["density"]
    assert values["silk"]["bend"] < values["jersey"]["bend"] < values["denim"]["bend"] < values["leather"]["bend"]
    for knit in ("jersey", "rib_knit", "ponte"):
        assert values[knit]["stretch"] < 0.2 * values["denim"]["stretch"]


def deformed(vertices: np.ndarray, gradient: np.ndarray) -> np.ndarray:
    """In-plane deformation of a sheet in the x-y plane."""
    return np.concatenate([vertices[:, :2] @ gradient.T, vertices[:, 2:]], axis=1)


def patch() -> tuple[np.ndarray, np.ndarray]:
    """Sheet of equilateral triangles in the x-y plane."""
    rows, columns, edge = 24, 24, 0.01
    row, column = np.divmod(np.arange(rows * columns), columns)
    vertices = np.stack([(column + 0.5 * (row % 2)) * edge, -row * edge * np.sqrt(0.75), 0.0 * row], axis=1)
    faces = []
    for r in range(rows - 1):
        for c in range(columns - 1):
            a, b, d, e = (r * columns + c, r * columns + c + 1, (r + 1) * columns + c, (r + 1) * columns + c + 1)
            faces += [(a, d, b), (b, d, e)] if r % 2 == 0 else [(a, d, e), (a, e, b)]
    return vertices, np.array(faces, dtype=np.int32)


def our_membrane_energy(rest: RestState, x: np.ndarray, stretch: float, shear: float) -> float:
    """The energy of sim/kernels/membrane.py an area [J/m^2]."""
    corners = x[rest.topology.faces]
    edges = np.stack([corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]], axis=2)
    w = edges @ rest.inverse
    lengths = np.linalg.norm(w, axis=1) - 1.0
    density = stretch * (lengths**2).sum(axis=1) + shear * (w[:, :, 0] * w[:, :, 1]).sum(axis=1) ** 2
    return float((0.5 * rest.area * density).sum() / rest.area.sum())


def arcsim_membrane_energy(gradient: np.ndarray, c11: float, c12: float, c22: float, c33: float) -> float:
    """ARCSim's energy an area with the numbers of its file, which it doubles."""
    k = 2.0 * np.array([c11, c12, c22, c33])
    green = 0.5 * (gradient.T @ gradient - np.eye(2))
    uu, vv, uv = green[0, 0], green[1, 1], green[0, 1]
    return float(0.5 * k[0] * uu**2 + k[1] * uu * vv + 0.5 * k[2] * vv**2 + k[3] * uv**2)


def test_stretch_and_shear_store_the_energy_that_arcsim_stores():
    """Small strains of a sample that is equally stiff along both yarns."""
    sample = SAMPLES["white-dots-on-blk"]
    c11, c22, c33 = sample.stretching
    rest = RestState.from_mesh(*patch())
    for gradient in (np.array([[1.004, 0.0], [0.0, 1.0]]), np.array([[1.0, 0.004], [0.004, 1.0]])):
        ours = our_membrane_energy(rest, deformed(rest.vertices, gradient), sample.stretch, sample.shear)
        assert ours == pytest.approx(arcsim_membrane_energy(gradient, c11, 0.0, c22, c33), rel=0.02)


def test_bend_stores_the_energy_that_arcsim_stores():
    """A sheet rolled to a cylinder; ke of one value in all directions."""
    rest, radius, ke = RestState.from_mesh(*patch()), 0.1, 4.0e-5
    vertices = rest.vertices
    rolled = np.stack([radius * np.sin(vertices[:, 0] / radius), vertices[:, 1], 0.0 * vertices[:, 2]], axis=1)
    rolled[:, 2] = radius * (1.0 - np.cos(vertices[:, 0] / radius))
    i, j, k, m = (rolled[rest.hinges[:, c]] for c in range(4))
    normals = np.cross(j - i, k - i), np.cross(m - i, j - i)
    areas = sum(np.linalg.norm(n, axis=1) / 2.0 for n in normals)
    cosine = (normals[0] * normals[1]).sum(axis=1) / np.prod([np.linalg.norm(n, axis=1) for n in normals], axis=0)
    angle = np.arccos(np.clip(cosine, -1.0, 1.0))
    length = np.linalg.norm(j - i, axis=1)
    theirs = (ke * length**2 * angle**2 / (8.0 * areas)).sum()

    curvature = np.einsum("hi,hik->hk", rest.hinge_weights, rolled[rest.hinges])
    ours = 0.5 * (ke / 4.0) * (curvature**2).sum()
    assert ours == pytest.approx(theirs, rel=0.02)


def test_units_of_the_kawabata_system():
    assert kes_bending(1.0) == pytest.approx(9.80665e-5)
    assert kes_shear(1.0) == pytest.approx(56.19, rel=1e-3)


def test_a_fabric_that_hides_a_source_or_a_wrong_number_is_refused():
    with pytest.raises(ValueError, match="every value needs a source"):
        Fabric("lead", "", {"density": 0.2}, {})
    with pytest.raises(ValueError, match=r"fabric 'lead': density = 200.0: allowed are 0\.01 to 2"):
        Fabric("lead", "", {"density": 200.0}, {"density": "assumed: 0"})
    with pytest.raises(
        ValueError, match=r"unknown fabric 'denin' \(did you mean 'denim'\?\); allowed are cotton, denim"
    ):
        fabric("denin")


def config_with(tmp_path: Path, garment: dict) -> dict:
    file = tmp_path / "mine.yaml"
    file.write_text(yaml.safe_dump({"garments": {"mine": {"kind": "skirt", "vertices": 600} | garment}}))
    return load_config([DEFAULT, file])


def test_a_fabric_is_below_base_and_above_the_default(tmp_path):
    mine = config_with(tmp_path, {"fabric": "denim", "base": {"density": 0.4}})["garments"]["mine"]
    values = base_values(mine)
    assert values["density"] == 0.4
    assert values["bend"] == FABRICS["denim"].values["bend"]
    assert "gravity" not in values


def test_specs_hold_the_numbers_of_the_fabric_and_not_its_name(tmp_path):
    plain = config_with(tmp_path, {})
    denim = config_with(tmp_path, {"fabric": "denim"})
    written = config_with(tmp_path, {"base": dict(FABRICS["denim"].values)})
    shard = "motions_0000"
    assert simulate_spec(denim, "mine", shard) == simulate_spec(written, "mine", shard)
    assert simulate_spec(denim, "mine", shard) != simulate_spec(plain, "mine", shard)
    assert garment_spec(denim, "mine") == garment_spec(plain, "mine")


def test_an_unknown_fabric_gets_one_sentence(tmp_path):
    with pytest.raises(ConfigError) as error:
        config_with(tmp_path, {"fabric": "denin"})
    assert "mine.yaml: garments.mine.fabric: unknown fabric 'denin' (did you mean 'denim'?); allowed are" in str(
        error.value
    )
