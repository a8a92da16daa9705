"""All systems side by side: what each is given, the way from a layer of the body to a garment, and the rows."""

from __future__ import annotations

import json
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from body.model import Body, skin
from datasets.sequences import Sequence
from datasets.shards import ShardHeader, ShardWriter
from evaluation.regressor import RegressorEvaluation
from evaluation.systems import System, system_rows
from garments.body_layer import cast_layer
from garments.layer_wearing import LayerWearing
from garments.outfit import garment_spec, make_template
from garments.template import GarmentTemplate
from geometry.mesh_hierarchy import build_hierarchy
from models.gsnet_fitting import build_animator
from models.mesh_vae_gan import MeshVaeGanConfig
from models.mesh_vae_gan_fitting import build_mesh_vae_gan
from pipeline import compare_systems, systems_spec
from pipeline.config import ConfigError, load_config
from pipeline.systems_data import (
    WornLayer,
    animator_predictor,
    check_shards,
    material_predictor,
    nearest_type,
    z_sources,
)
from sim.parameters import base_parameters
from tests.conftest import ROOT

FILES = [ROOT / "configs" / "default.yaml", ROOT / "configs" / "smoke.yaml"]


@pytest.fixture(scope="module")
def body() -> Body:
    return Body.load("small")


@pytest.fixture(scope="module")
def shirt(body) -> GarmentTemplate:
    return make_template(garment_spec("tshirt", {"kind": "tshirt", "vertices": 400}), body)


@pytest.fixture(scope="module")
def outfits(body) -> dict[str, GarmentTemplate]:
    """Sleeves to the wrists, and as short as those of the shirt."""
    made = {}
    for name, sleeve in (("long", 0.46), ("short", 0.16)):
        worn = [
            {"name": "pants", "kind": "pants", "vertices": 400, "length": 0.5},
            {"name": "shirt", "kind": "tshirt", "vertices": 400, "sleeve": sleeve},
        ]
        made[name] = make_template(garment_spec(name, {"kind": "outfit", "worn": worn}), body)
    return made


def waving(shirt: GarmentTemplate, body: Body, split: str = "unseen_motions", phi: int = 0, seed: int = 0) -> Sequence:
    """A shirt that follows the skin but for a smooth wave, on a turning body."""
    generator = np.random.default_rng(seed)
    pose = np.cumsum(generator.normal(0.0, 0.05, (6, 24, 3)), axis=0)
    root = np.cumsum(generator.normal(0.0, 0.02, (6, 3)), axis=0)
    transforms = body.joint_transforms(pose, root)
    vertices = skin(shirt.vertices, shirt.skin_index, shirt.skin_weight, transforms)
    phase = 9.0 * shirt.vertices[:, 1] + np.arange(6)[:, None]
    vertices = (vertices + 0.02 * np.sin(phase)[..., None]).astype(np.float32)
    joints = body.joint_positions(pose, root)
    lead = {"lead_pose": pose[:2], "lead_root": root[:2], "lead_joints": joints[:2]}
    names = {"garment": "tshirt", "clip": f"walk_{seed}", "take": f"walk_{seed}", "label": "walk", "plan": "motions"}
    motion = {"pose": pose, "root": root, "joints": joints, "parameters": base_parameters({})}
    return Sequence(**names, phi=phi, split=split, fps=30.0, vertices=vertices, **motion, **lead)


def test_a_garment_comes_back_from_its_points_over_the_body(shirt, body):
    sequence = waving(shirt, body)
    wearing = LayerWearing(shirt, body, cast_layer(shirt, body))
    points = wearing.points(sequence.vertices)
    back = wearing.garment(points, sequence.pose, sequence.root)
    # The way back does not know the wave: it is told of it by the points alone.
    assert np.linalg.norm(back - sequence.vertices, axis=2).mean() < 0.6e-3
    assert np.linalg.norm(wearing.points(back) - points, axis=2).max() < 1.5e-3


def test_what_no_point_speaks_for_follows_its_neighbours(shirt, body):
    sequence, layer = waving(shirt, body), cast_layer(shirt, body)
    low = body.vertices[layer.covered, 1] < np.median(body.vertices[layer.covered, 1])
    wearing = LayerWearing(shirt, body, layer, layer.covered[~low])
    assert np.array_equal(wearing.layer.covered, layer.covered[~low])
    moved = wearing.points(sequence.vertices) + [0.0, 0.0, 0.1]
    back = wearing.garment(moved, sequence.pose, sequence.root)
    assert np.abs((back - sequence.vertices).mean(axis=(0, 1)) - [0.0, 0.0, 0.1]).max() < 0.02


def test_a_layer_of_something_else_is_refused(shirt, body, outfits):
    with pytest.raises(ValueError, match="not that of garment 'tshirt'"):
        LayerWearing(shirt, body, cast_layer(outfits["long"], body))
    with pytest.raises(ValueError, match="not that of garment 'tshirt'"):
        LayerWearing(shirt, Body.load("full"), cast_layer(shirt, body))
    with pytest.raises(ValueError, match="no point of it"):
        LayerWearing(shirt, body, cast_layer(shirt, body), np.array([], dtype=int))


def test_the_type_of_clothing_is_the_one_that_covers_the_same(shirt, body, outfits):
    layer = cast_layer(shirt, body)
    kind, both = nearest_type(layer, outfits, body)
    assert kind == "short"
    outer = cast_layer(outfits["short"], body)
    assert set(both) <= set(layer.covered) & set(outer.covered[outer.worn == 1])  # and not what the pants cover
    assert len(both) > 0.7 * len(layer.covered)


def test_the_layer_of_a_network_is_worn_by_the_garment(shirt, body, outfits):
    layer = cast_layer(shirt, body)
    kind, both = nearest_type(layer, outfits, body)
    active = np.unique(np.concatenate([cast_layer(one, body).covered for one in outfits.values()]))
    hierarchy = build_hierarchy(body.vertices, body.faces, active, [len(active) // 2], body.digest)
    config = MeshVaeGanConfig(
        "anchored", tuple(outfits), body.name, body.digest, latent=4, widths=(4,), levels=(1,), discriminator="none"
    )
    network = build_mesh_vae_gan(config, hierarchy, body).eval()
    sequence, wearing = waving(shirt, body), LayerWearing(shirt, body, layer, both)
    # Untrained, it says its mean: here, where the cloth is on the bind pose.
    at_rest = wearing.points(shirt.vertices[None])[0] - body.vertices[wearing.layer.covered]
    network.mean[np.searchsorted(active, wearing.layer.covered)] = network.mean.new_tensor(at_rest)
    worn = WornLayer(network, body, kind, wearing)
    found = worn.predict(sequence)
    assert found.shape == sequence.vertices.shape
    # A layer that does not move is skinned cloth: what is missing is the wave, of amplitude 20 mm.
    still = sequence.vertices - np.float32(0.02) * np.sin(9.0 * shirt.vertices[:, 1] + np.arange(6)[:, None])[..., None]
    assert np.linalg.norm(found - still, axis=2).mean() < 6e-3
    assert np.linalg.norm(worn.reconstructed(sequence) - still, axis=2).mean() < 6e-3
    # Told the mean of the garment's own clips, it knows of a hem that always hangs 30 mm lower.
    lower = replace(sequence, vertices=found - np.float32([0.0, 0.03, 0.0]))
    fitted = worn.with_mean_residual([lower])
    assert np.linalg.norm(fitted.predict(lower) - lower.vertices, axis=2).mean() < 8e-3


def test_a_network_of_another_body_is_refused(shirt, body):
    animator = build_animator("gsnet", {"materials": ("bend",), "body": "another", "hidden": (8, 8), "heads": 1})
    with pytest.raises(ValueError, match="trained on body another, asked for body"):
        animator_predictor(animator, shirt, body)


def test_simulations_of_another_garment_or_body_are_refused(shirt, body, tmp_path):
    def shard(name: str, template: GarmentTemplate, digest: str) -> str:
        shared = {"plan": "motions", "solver_version": "1", "seed": 1, "fps": 30.0, "spec": "{}", "pinned": np.zeros(0)}
        shared |= {"body_name": "small", "body_faces": body.faces, "body_shape": np.zeros(0)}
        shared |= {f"parameter_{kind}": () for kind in ("names", "units", "groups")}
        mesh = {"template_vertices": template.vertices, "template_faces": template.faces}
        with ShardWriter(tmp_path / f"{name}.h5", ShardHeader(template.name, body_digest=digest, **shared, **mesh)):
            return str(tmp_path / f"{name}.h5")

    own = shard("own", shirt, body.digest)
    check_shards([own], shirt)
    for name, template, digest in (
        ("body", shirt, "another"),
        ("name", replace(shirt, name="blouse"), body.digest),
        ("cut", replace(shirt, vertices=1.01 * shirt.vertices), body.digest),
    ):
        with pytest.raises(ValueError, match=rf"{name}\.h5: simulations of garment '\w+' on body \w+, expected"):
            check_shards([own, shard(name, template, digest)], shirt)


def test_z_never_comes_from_a_test_sequence():
    def coded(phi: int, split: str, plan: str = "materials") -> SimpleNamespace:
        return SimpleNamespace(phi=phi, split=split, plan=plan, parameters=base_parameters({}))

    base, base_test = coded(0, "train", "motions"), coded(0, "unseen_motions", "motions")
    shown, test, others = coded(5, "unseen_parameters"), coded(5, "unseen_both"), coded(1, "train")
    sources = z_sources([base, base_test, shown, test, others])
    assert sources == [base, shown]
    # Of a material that nothing was shown in, the network has nothing to say.
    assert material_predictor(SimpleNamespace(), SimpleNamespace(), sources, ())(SimpleNamespace(phi=10)) is None


def test_rows_hold_errors_of_garment_and_layer_and_what_each_costs(shirt, body):
    wearing = LayerWearing(shirt, body, cast_layer(shirt, body))
    test = [waving(shirt, body, seed=0), waving(shirt, body, "unseen_both", 5, seed=1)]

    def off(sequence: Sequence) -> np.ndarray | None:
        return sequence.vertices + np.float32([0.003, 0.0, 0.004]) if sequence.phi == 0 else None

    def at_points(sequence: Sequence) -> np.ndarray | None:
        return wearing.points(sequence.vertices) + [0.0, 0.01, 0.0] if sequence.phi == 0 else None

    systems = [
        System("baseline", "simulation", lambda s: s.vertices, "the truth", timed=False),
        System("A 2020", "paper", off, "motion", True, costs={"parameters": 7, "training_s": 2.0}),
        System("B 2021", "ours", off, "pose", False, points=at_points),
    ]
    rows = system_rows(test, systems, body, shirt, wearing, RegressorEvaluation(frames_stride=2))
    assert [(r["split"], r["method"]) for r in rows] == [
        ("unseen_motions", "simulation"), ("unseen_motions", "paper"), ("unseen_motions", "ours"),
        ("unseen_both", "simulation"),
    ]  # fmt: skip
    truth, ours, own_points = rows[:3]
    assert truth["error_mm"] == 0.0 and truth["time_ms_per_frame"] is None
    assert ours["error_mm"] == pytest.approx(5.0, rel=1e-3) and ours["layer_error_mm"] == pytest.approx(5.0, rel=1e-3)
    assert own_points["layer_error_mm"] == pytest.approx(10.0, rel=1e-3) and 9.0 < own_points["error_mm"] < 11.0
    assert ours["time_ms_per_frame"] > 0.0 and ours["parameters"] == 7 and ours["published"] is True
    assert ours["edge_mm"] == pytest.approx(truth["edge_mm"]) and ours["bend"] == pytest.approx(truth["bend"], rel=1e-4)


def test_what_diverges_is_held_and_seen(shirt, body):
    wearing = LayerWearing(shirt, body, cast_layer(shirt, body))

    def exploding(sequence: Sequence) -> np.ndarray:
        vertices = sequence.vertices.copy()
        vertices[3], vertices[4, 0], vertices[5] = 1e30, np.nan, -np.inf
        return vertices

    systems = [System("A 2020", "paper", exploding, "motion"), System("A 2020", "ours", lambda s: s.vertices, "motion")]
    rows = system_rows([waving(shirt, body)], systems, body, shirt, wearing, RegressorEvaluation(frames_stride=2))
    assert 1e3 < rows[0]["error_mm"] < 2e4 and np.isfinite(rows[0]["layer_error_mm"])
    assert rows[0]["collision_percent"] is None  # none of it is inside the body, which is no merit
    assert rows[1]["error_mm"] == 0.0 and rows[1]["collision_percent"] is not None


def test_what_cannot_be_compared_is_refused_in_one_sentence(shirt, body):
    wearing = LayerWearing(shirt, body, cast_layer(shirt, body))
    one = System("A 2020", "paper", lambda s: s.vertices, "motion")
    settings = RegressorEvaluation()
    with pytest.raises(ValueError, match="no test sequence of garment 'tshirt'"):
        system_rows([], [one], body, shirt, wearing, settings)
    with pytest.raises(ValueError, match="the same name"):
        system_rows([waving(shirt, body)], [one, one], body, shirt, wearing, settings)
    with pytest.raises(ValueError, match="garment 'tshirt': got a sequence of 'skirt'"):
        system_rows([replace(waving(shirt, body), garment="skirt")], [one], body, shirt, wearing, settings)


def test_the_garment_of_the_comparison_is_a_tshirt(tmp_path):
    overlay = tmp_path / "mine.yaml"
    overlay.write_text("systems: {garment: skirt}\n")
    with pytest.raises(ConfigError, match=r"mine.yaml: systems.garment: found 'skirt'; allowed .* tshirt or ''"):
        load_config([*FILES, overlay])
    overlay.write_text("systems: {garment: ''}\n")
    assert systems_spec.compared_garment(load_config([*FILES, overlay])) == ""


def test_the_comparison_knows_what_each_was_trained_on():
    config = load_config(FILES)
    spec = json.loads(systems_spec.compare_systems_spec(config))
    assert tuple(compare_systems.PAPERS) == systems_spec.MODELS  # the order of the inputs
    assert spec["variants"]["garment_regressor"] == ["paper", "window", "conditioned"]
    assert all(used in spec["variants"][model] for model, used in spec["use"].items())
    trained = spec["trained_on"]
    # Of 18 clips, six of a label that is held out and three of held-out takes (every fifth).
    takes = [i for i in range(18) if i % 3 != 2]
    held_out = sum(
        i % config["data"]["splits"]["takes_every"] == config["data"]["splits"]["takes_every"] - 1 for i in takes
    )
    assert trained["own motions"] == [1, len(takes) - held_out]
    assert trained["own, all"][1] > trained["own materials"][1] > 0
    wardrobe = config["wardrobe"]
    seen = len(wardrobe["categories"]) * (wardrobe["templates"] - wardrobe["unseen"])
    assert trained["wardrobe"][0] == seen
    assert 0 < trained["wardrobe"][1] <= seen * (wardrobe["clips"] + wardrobe["materials"])
    # Of three bodies two are trained on, in every outfit.
    layers = config["data"]["layers"]
    assert trained["layers"] == [len(layers["types"]), len(layers["types"]) * 2 * layers["clips"]]
