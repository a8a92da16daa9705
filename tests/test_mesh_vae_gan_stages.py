"""The stages of the Mesh VAE-GAN, from shards to tables and pictures, on garments that follow the body's skin."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from body.model import Body, skin
from body.shapes import sampled_shape
from datasets.layers import read_layer
from datasets.shards import ShardWriter, SimulatedSequence
from evaluation.table import read_table
from garments.grading import graded
from garments.outfit import garment_spec, make_template
from pipeline import (
    build_mesh_hierarchy,
    evaluate_mesh_vae_gan,
    render_mesh_vae_gan,
    spec,
    train_mesh_vae_gan,
    transfer_layer,
)
from pipeline.config import load_config
from pipeline.simulate import shard_header
from pipeline.stage import Job
from report.run_files import RunFiles
from sim.parameters import base_parameters
from tests.conftest import ROOT

TYPES = ("longlong", "shortshort")
FRAMES = 5
CLIPS = (("walk", 0), ("squat", 1), ("jump", 4))  # every fifth take is held out


@pytest.fixture(scope="module")
def config() -> dict:
    run = load_config([ROOT / "configs" / "default.yaml", ROOT / "configs" / "smoke.yaml"])
    layers = run["data"]["layers"]
    types = load_config([ROOT / "configs" / "default.yaml"])["data"]["layers"]["types"]
    layers["types"] = {name: types[name] for name in TYPES}
    layers["frames_stride"] = 1
    variants = run["models"]["mesh_vae_gan"]["variants"]
    run["models"]["mesh_vae_gan"]["variants"] = {name: variants[name] for name in ("anchored", "coma-4")}
    run["report"] |= {"width": 200, "height": 280}
    return run


@pytest.fixture(scope="module")
def layers(config, tmp_path_factory) -> Path:
    """Templates, and layers of shards in which cloth follows the skin with a random wave on it."""
    folder, own = tmp_path_factory.mktemp("layers"), Body.load("small")
    generator = np.random.default_rng(0)
    for kind in TYPES:
        outfit = json.loads(spec.layer_garment_spec(config, kind))
        template = make_template(garment_spec(kind, outfit["geometry"]), own)
        template.save(folder / f"{kind}.npz")
        settings = json.loads(spec.layer_simulate_spec(config, kind))
        with ShardWriter(folder / f"{kind}_shard.h5", shard_header(settings, template, own)) as shard:
            for number in (1, 2, 3):
                shape = sampled_shape(np.zeros(0), 1.0, 1, number)
                body = own.shaped(shape)
                worn = graded(template, own, body)
                for clip, take in CLIPS:
                    pose = generator.normal(0.0, 0.25, (FRAMES, 24, 3))
                    root = np.zeros((FRAMES, 3))
                    cloth = skin(worn.vertices, worn.skin_index, worn.skin_weight, body.joint_transforms(pose, root))
                    cloth = cloth + 0.01 * np.sin(20.0 * worn.vertices + generator.normal()).astype(np.float32)
                    joints = body.joint_positions(pose, root)
                    shard.add(
                        SimulatedSequence(
                            clip, clip, take, clip, 0, base_parameters({}), cloth, pose, root, joints, pose[:1],
                            root[:1], joints[:1], {}, shape, number,
                        )
                    )  # fmt: skip
        job = _job(spec.layer_transfer_spec(config, kind), folder, [f"{kind}.npz", f"{kind}_shard.h5"],
                   [f"{kind}.h5", f"{kind}.csv"])  # fmt: skip
        transfer_layer.main(job)
    return folder


def _job(text: str, folder: Path, inputs: list[str], outputs: list[str]) -> Job:
    return Job(json.loads(text), [str(folder / n) for n in inputs], [str(folder / n) for n in outputs], "cpu", 1)


def test_every_frame_is_transferred_and_what_is_lost_is_told(layers):
    for kind in TYPES:
        layer = read_layer(layers / f"{kind}.h5")
        assert len(layer.displacements) == 3 * len(CLIPS) * FRAMES
        assert set(layer.splits) == {"train", "unseen_motions", "unseen_bodies", "unseen_bodies_and_motions"}
        assert 0.005 < np.linalg.norm(layer.displacements, axis=2).mean() < 0.06
        (row,) = read_table(layers / f"{kind}.csv")
        assert row["frames"] == len(layer.displacements) and 0.0 < row["mean_mm"] < 15.0
    long, short = (len(read_layer(layers / f"{kind}.h5").covered) for kind in TYPES)
    assert long > 1.2 * short


def test_networks_are_trained_judged_and_drawn(config, layers):
    types = [f"{kind}.h5" for kind in TYPES]
    templates = [f"{kind}.npz" for kind in TYPES]
    build_mesh_hierarchy.main(_job(spec.mesh_hierarchy_spec(config), layers, templates, ["levels.npz"]))
    for variant in ("anchored", "coma-4"):
        outputs = [f"{variant}.pt", f"{variant}/losses.csv"]
        train_mesh_vae_gan.main(_job(spec.mesh_vae_gan_spec(config, variant), layers, ["levels.npz", *types], outputs))
        assert read_table(layers / variant / "losses.csv")[-1]["error_mm"] > 0.0
    models = ["anchored.pt", "coma-4.pt"]
    tables = ["mesh_vae_gan.csv", "mesh_vae_gan_generation.csv"]
    evaluate_mesh_vae_gan.main(_job(spec.evaluate_mesh_vae_gan_spec(config), layers, [*models, *types], tables))
    rows = read_table(layers / tables[0])
    assert {row["split"] for row in rows} == set(evaluate_mesh_vae_gan.SCENARIOS)
    for split in evaluate_mesh_vae_gan.SCENARIOS:
        error = {row["method"]: row["error_mm"] for row in rows if row["split"] == split}
        assert set(error) == {"mean layer", "PCA, 8", "PCA a type, 8", "anchored", "coma-4"}
        assert error["anchored"] < error["mean layer"]
        assert error["PCA a type, 8"] < error["mean layer"]
    generated = {row["method"]: row for row in read_table(layers / tables[1])}
    assert set(generated) == {"PCA, 8, random", "anchored"}, "what has no condition cannot be asked for a pose"
    assert generated["anchored"]["time_ms_per_frame"] > 0.0
    render_mesh_vae_gan.main(
        _job(spec.render_mesh_vae_gan_spec(config), layers, ["anchored.pt", *templates, *types], ["pictures"])
    )
    listing = json.loads((layers / "pictures" / "figures.json").read_text())
    assert [figure["kind"] for figure in listing["figures"]] == ["layer_types", "layer_poses", "layer_between"]
    (layers / "figures").mkdir()
    (layers / "figures" / "mesh_vae_gan").symlink_to(layers / "pictures")
    assert len(RunFiles(layers).pictures()) == 3, "the report finds them"
    for figure in listing["figures"]:
        assert np.asarray(Image.open(layers / "pictures" / figure["file"])).std() > 5.0


def test_layers_of_other_types_than_the_spec_are_refused(config, layers):
    job = _job(spec.evaluate_mesh_vae_gan_spec(config), layers, ["shortshort.h5"], [])
    with pytest.raises(ValueError, match="layers of types shortshort, expected longlong, shortshort"):
        train_mesh_vae_gan.job_layers(job, job.inputs)
