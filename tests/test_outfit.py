"""Garments worn over each other: built clean, told apart, saved, kept in their order while they move, and refused."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from body.model import Body
from garments.outfit import LAYER_GAP, garment_spec, laid_over, make_template, worn_together
from garments.quality import crossing_triangles
from garments.spec import GarmentSpec, OutfitSpec
from garments.template import GarmentTemplate
from geometry.proximity import closest_surface
from motions.lead_in import lead_in
from motions.procedural import generate_clip
from pipeline import spec
from pipeline.config import ConfigError, check_config, load_config
from sim.body_parts import own_parts, worn_parts
from sim.parameters import base_parameters
from sim.settings import SimulationSettings
from sim.simulate import Simulator
from tests.test_self_contact import DT, Cloth, sheet, together

PANTS = {"name": "pants", "kind": "pants", "vertices": 450, "ease": 0.014}
SHIRT = {"name": "tshirt", "kind": "tshirt", "vertices": 400, "ease": 0.008, "flare": 0.0}


@pytest.fixture(scope="module")
def body() -> Body:
    return Body.load("small")


@pytest.fixture(scope="module")
def parts(body) -> dict[str, GarmentTemplate]:
    return {
        one["name"]: make_template(garment_spec(one["name"], {k: v for k, v in one.items() if k != "name"}), body)
        for one in (PANTS, SHIRT)
    }


@pytest.fixture(scope="module")
def outfit(parts) -> GarmentTemplate:
    """A tight shirt that would lie in the pants were it not lifted over them."""
    return worn_together("dressed", [parts["pants"], parts["tshirt"]])


def test_an_outfit_is_its_garments_in_one_mesh(outfit, parts):
    assert (outfit.kind, outfit.worn, outfit.worn_as) == ("outfit", ("pants", "tshirt"), ("pants", "tshirt"))
    assert outfit.pieces == 2
    start = 0
    for number, one in enumerate(parts.values()):
        mine = outfit.layer == number
        assert mine.sum() == len(one.vertices)
        assert np.array_equal(outfit.faces[outfit.face_layer == number] - start, one.faces)
        assert np.array_equal(outfit.skin_weight[mine], one.skin_weight)
        start += len(one.vertices)
    assert np.array_equal(outfit.pinned, parts["pants"].pinned), "the shirt hangs on the shoulders"


def test_the_outer_garment_is_lifted_where_it_would_lie_in_the_inner_one(outfit, parts):
    apart = parts["pants"], parts["tshirt"]
    merged = np.concatenate([one.vertices for one in apart])
    assert len(crossing_triangles(merged, outfit.faces)) > 50, "unless it is lifted"
    assert len(crossing_triangles(outfit.vertices, outfit.faces)) == 0
    assert np.array_equal(outfit.vertices[outfit.layer == 0], parts["pants"].vertices)
    shirt = outfit.vertices[outfit.layer == 1]
    hits = closest_surface(shirt, parts["pants"].vertices, parts["pants"].faces)
    over = (hits.barycentric > 1e-6).all(axis=1) & (np.abs(hits.distance) < 0.05)
    assert over.sum() > 50
    assert hits.distance[over].min() > 0.999 * LAYER_GAP
    moved = np.linalg.norm(shirt - parts["tshirt"].vertices, axis=1)
    assert 0.002 < moved.max() < 0.03
    assert np.array_equal(shirt[shirt[:, 1] > 1.25], parts["tshirt"].vertices[shirt[:, 1] > 1.25]), "only near the hem"
    edges = parts["tshirt"].topology.edges
    change = np.linalg.norm(shirt[edges[:, 0]] - shirt[edges[:, 1]], axis=1)
    change /= np.linalg.norm(np.subtract(*parts["tshirt"].vertices[edges.T]), axis=1)
    assert 0.8 < change.min() < change.max() < 1.3


@pytest.mark.parametrize("order", [("tshirt", "pants"), ("tshirt", "twin")])
def test_other_orders_are_clean_too(parts, order):
    """Tucked in, and a shirt over one of exactly its size."""
    worn = [parts.get(name) or replace(parts["tshirt"], name=name) for name in order]
    made = worn_together("other", worn)
    assert len(crossing_triangles(made.vertices, made.faces)) == 0
    assert np.array_equal(made.vertices[made.layer == 0], worn[0].vertices)


def test_what_is_clear_stays_as_it_is(parts):
    pants = parts["pants"]
    away = pants.vertices.astype(np.float64) + [0.0, 3.0, 0.0]
    assert np.array_equal(laid_over(away, pants.faces, pants.vertices.astype(np.float64), pants.faces), away)


def test_an_outfit_survives_its_file(outfit, parts, tmp_path):
    outfit.save(tmp_path / "outfit.npz")
    again = GarmentTemplate.load(tmp_path / "outfit.npz")
    assert (again.worn, again.worn_as, again.pieces) == (outfit.worn, outfit.worn_as, 2)
    assert np.array_equal(again.layer, outfit.layer)
    with np.load(tmp_path / "outfit.npz") as archive:
        content = dict(archive)
    parts["pants"].save(tmp_path / "pants.npz")
    assert GarmentTemplate.load(tmp_path / "pants.npz").worn == ("pants",)
    for broken, message in (
        ({"layer": np.zeros(3, dtype=int)}, "'layer' must have shape \\[850\\], got \\[3\\]"),
        ({"layer": 2 * content["layer"]}, "'layer' must have every value of 0..1, one for each garment worn, got 0, 2"),
        ({"layer": np.arange(850) % 2}, "triangle 0 has corners in different layers"),
        ({"worn": np.array(["one", "one"])}, "'worn' must name each garment once"),
        ({"worn_as": np.array([1, 2])}, "'worn' and 'worn_as' must be lists of texts"),
    ):
        np.savez(tmp_path / "broken.npz", **content | broken)
        with pytest.raises(ValueError, match=f"broken.npz: .*{message}"):
            GarmentTemplate.load(tmp_path / "broken.npz")


def test_each_garment_meets_the_body_by_its_own_rule(body, parts, outfit):
    """Both legs are one to a skirt and two to pants; what two garments see alike is there once."""
    kinds, layer = ("pants", "skirt"), outfit.layer
    skins = (body.faces, body.skin_index, body.skin_weight)
    together_ = worn_parts(kinds, layer, *skins, outfit.skin_index, outfit.skin_weight)
    for number, kind in enumerate(kinds):
        mine = layer == number
        alone = own_parts(kind, *skins, outfit.skin_index[mine], outfit.skin_weight[mine])
        for row, expected in zip(together_.owned[mine], alone.owned):
            assert (row >= 0).sum() == (expected >= 0).sum()
            for a, b in zip(row[row >= 0], expected[expected >= 0]):
                assert np.array_equal(together_.faces[a], alone.faces[b])
    twins = worn_parts(("pants", "pants"), layer, *skins, outfit.skin_index, outfit.skin_weight)
    assert len({faces.tobytes() for faces in twins.faces}) == len(twins.faces)


def test_the_shirt_stays_over_the_pants_while_walking(body):
    """No crossing between the two at the end of any frame, and nothing of the hem under the waist."""
    worn = [PANTS | {"vertices": 700}, {"name": "tshirt", "kind": "tshirt", "vertices": 600}]
    outfit = make_template(garment_spec("dressed", {"kind": "outfit", "worn": worn}), body)
    clip = generate_clip("walk", 0, 20, 30.0, 3, body)
    lead_pose, lead_root = lead_in(clip, body, 12)
    simulator = Simulator(outfit, body, SimulationSettings(device="cpu", settle_seconds=0.5))
    pose, root = np.concatenate([lead_pose, clip.pose]), np.concatenate([lead_root, clip.root])
    result = simulator.run(pose, root, 12, base_parameters({"substeps": 32}))
    assert result.failure is None
    pants = outfit.layer == 0
    inner = outfit.faces[outfit.face_layer == 0]
    for frame in result.vertices[::3]:
        crossed = crossing_triangles(frame, outfit.faces)
        assert (outfit.face_layer[crossed[:, 0]] == outfit.face_layer[crossed[:, 1]]).all()
        hits = closest_surface(frame[~pants], frame[pants], inner)
        over = (hits.barycentric > 1e-6).all(axis=1) & (np.abs(hits.distance) < 0.02)
        assert over.sum() > 30
        assert (hits.distance[over] > 0.0).all()


def test_an_outer_layer_that_comes_from_below_is_not_shot_away():
    """It meets the inner side of a slope: drawing crossings apart and the order of the layers must not fight."""
    slope, faces = sheet(9, 9, 0.03)
    angle = np.radians(50.0)
    turn = np.array([[np.cos(angle), np.sin(angle), 0.0], [-np.sin(angle), np.cos(angle), 0.0], [0.0, 0.0, 1.0]])
    slope = slope @ turn.T
    top = slope[slope[:, 1].argmax()]
    small, small_faces = sheet(4, 4, 0.02)
    points, triangles = together((slope, faces), (small + [top[0] - 0.04, top[1] - 0.024, 0.0], small_faces))
    layer = np.repeat([0, 1], [len(slope), len(small)])
    cloth = Cloth(points, triangles, pinned=range(len(slope)), layer=layer, self_friction=0.0)
    speed = np.zeros((len(points), 3))
    speed[len(slope) :, 0] = 1.0
    cloth.put(cloth.v, speed)
    fastest = 0.0
    for _ in range(20):
        cloth.run(8 * DT)
        fastest = max(fastest, np.linalg.norm(cloth.get(cloth.v)[0], axis=1).max())
    assert 1.0 < fastest < 3.0


def test_configurations_describe_outfits():
    config = load_config(["configs/default.yaml", "configs/smoke.yaml", "configs/outfit.yaml"])
    geometry = spec.garment_geometry(config, "dressed")
    made = garment_spec("dressed", geometry)
    assert isinstance(made, OutfitSpec)
    assert [(one.name, one.kind, one.vertices) for one in made.worn] == [
        ("pants", "pants", 1200),
        ("tshirt", "tshirt", 400),
    ]
    assert made.worn[1].ease == config["garments"]["tshirt"]["ease"]
    before = spec.garment_spec(config, "dressed")
    config["garments"]["tshirt"]["fabric"] = "silk"
    assert spec.garment_spec(config, "dressed") == before, "a material is no part of a template"
    config["garments"]["tshirt"]["ease"] = 0.02
    assert spec.garment_spec(config, "dressed") != before


@pytest.mark.parametrize(
    ("worn", "message"),
    [
        (["tshirt"], "garments.dressed.worn"),
        (["tshirt", "hat"], "garments.dressed.worn.1: found 'hat'; allowed are skirt, tshirt"),
        (["tshirt", "dressed"], "garments.dressed.worn.1: found 'dressed'; allowed are skirt, tshirt"),
        (["tshirt", "tshirt"], "two garments are called 'tshirt'; each needs a name of its own"),
        ([{"kind": "pants", "vertices": 450, "ease": 9}, "tshirt"], "garments.dressed.worn.0.ease: found 9"),
        (
            [{"kind": "pants", "vertices": 450, "fabric": "silk"}, "tshirt"],
            "worn.0.fabric: a garment of an outfit has no",
        ),
        ([{"kind": "outfit"}, "tshirt"], "worn.0.kind: found 'outfit'; an outfit is worn over no other"),
        ([{"kind": "mesh", "file": "none.obj", "worn_as": "pants"}, "tshirt"], "worn.0.file: 'none.obj' is no file"),
    ],
)
def test_a_mistake_in_an_outfit_gets_one_sentence(worn, message):
    config = load_config(["configs/default.yaml", "configs/outfit.yaml"])
    config["garments"]["dressed"]["worn"] = worn
    with pytest.raises(ConfigError) as caught:
        check_config(config, [("mine.yaml", config)])
    assert message in str(caught.value), str(caught.value)


def test_each_garment_has_its_colour():
    from report.render import GARMENT_COLOURS, worn_colours

    colours = worn_colours(("pants", "tshirt", "tshirt", "dress"), np.array([1, 0, 2, 3, 0]))
    assert np.array_equal(colours[[0, 1, 4]], [GARMENT_COLOURS[kind] for kind in ("tshirt", "pants", "pants")])
    assert len(np.unique(colours[[0, 1, 2]], axis=0)) == 3, "a second shirt has another colour than the first"


def test_an_outfit_is_two_garments_of_different_names():
    shirt = GarmentSpec("shirt", "tshirt", 400)
    with pytest.raises(ValueError, match="outfit 'x': 'worn' must list at least two garments, got 1"):
        OutfitSpec("x", (shirt,))
    with pytest.raises(ValueError, match="outfit 'x': two garments are called 'shirt'"):
        OutfitSpec("x", (shirt, shirt))


def test_what_cannot_be_laid_over_is_refused(parts):
    """A shirt turned inside out has no outside to be lifted to."""
    inside_out = replace(parts["tshirt"], faces=parts["tshirt"].faces[:, ::-1])
    with pytest.raises(ValueError, match=r"outfit 'bad': 'tshirt' cannot be laid over 'pants': it would have to be"):
        worn_together("bad", [parts["pants"], inside_out])
    with pytest.raises(ValueError, match="'tshirt' was made for another body than 'pants'"):
        worn_together("bad", [parts["pants"], replace(parts["tshirt"], body_digest="another")])
