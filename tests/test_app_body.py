"""Body shapes in the app: which a run's models know, what they measure, and that the garment is on them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from app.body_shape import BodyShapes, measures
from app.motions import invented_motion
from app.server import start_server
from app.session import Session
from app.window import Window
from body.model import Body
from runtime.composing import Composer
from runtime.finished_run import FinishedRun


@pytest.fixture(scope="module")
def run(smoke) -> FinishedRun:
    return FinishedRun.open(smoke.results)


def _with(run: FinishedRun, bodies: dict | None = None, variants: dict | None = None) -> FinishedRun:
    """The run, had it been configured otherwise."""
    config = dict(run.config)
    if bodies is not None:
        config["data"] = dict(config["data"]) | {"bodies": bodies}
    if variants is not None:
        models = dict(config["models"])
        config["models"] = models | {"garment_regressor": dict(models["garment_regressor"]) | {"variants": variants}}
    return replace(run, config=config)


def test_shapes_reach_as_far_as_bodies_were_sampled(run):
    shapes = BodyShapes(run)
    assert shapes.ends == ((-2.0, 2.0),) * 5 and not shapes.told
    assert shapes.checked([0.0] * 5) is None
    np.testing.assert_array_equal(shapes.checked([1.5, 0, 0, 0, -2]), [1.5, 0, 0, 0, -2])
    with pytest.raises(ValueError, match=r"body shape 2: the models were trained on -2 to 2 .* not on 2\.5"):
        shapes.checked([0, 2.5, 0, 0, 0])
    with pytest.raises(ValueError, match="has 5 numbers here, not 2"):
        shapes.checked([0, 0])
    around = BodyShapes(replace(run, config=dict(run.config) | {"body": {"resolution": "small", "shape": [2.0]}}))
    assert around.ends[0] == (0.0, 3.0) and around.checked([2.0, 0, 0, 0, 0]) is None


@pytest.mark.parametrize(
    ("changed", "told"),
    [
        ({"bodies": {"samples": 0, "spread": 1.0}}, "was simulated on one body"),
        ({"bodies": {}}, "was simulated on one body"),
        ({"variants": {"window": {}}}, "trained no model that was told of the body"),
    ],
)
def test_a_run_of_one_body_says_so_and_offers_no_sliders(run, tmp_path, changed, told):
    other = _with(run, **changed)
    session = Session(other, "skirt", "walk", 8)
    assert session.shapes.ends == () and told in session.shapes.told
    with pytest.raises(ValueError, match=told):
        session.use_shape([0.0] * 5)
    server = start_server("127.0.0.1", 0, "test")
    window = Window(server, session, tmp_path)
    try:
        assert window.body.sliders == [] and told in window.body.explained.content
    finally:
        window.stop()


def test_another_body_wears_the_same_keyframes(run):
    session = Session(run, "skirt", "walk", 24)
    own = session.look(9)
    session.insert_latent(3, session.candidates(range(5, 6))[0], "candidate 5")
    latent = session.latent(3)
    shape = np.array([-1.5, 0.5, 0.0, 0.0, 1.0])
    session.use_shape(shape)
    look = session.look(9)
    assert np.ptp(look.body[:, 1]) < np.ptp(own.body[:, 1]) - 0.03
    np.testing.assert_array_equal(session.shape, shape)
    np.testing.assert_array_equal(session.latent(3), latent)
    # As the commands do it.
    composer = Composer(session._keys.composer.space, session._keys.composer.worn.given, shape)
    composer.use(session.keyframes)
    np.testing.assert_allclose(look.garment, composer.frame(9).vertices, atol=1e-5)
    np.testing.assert_allclose(look.body, composer.frame(9).body, atol=1e-6)
    animation = session.animation()
    assert [animation.notes[f"shape_{number}"] for number in range(5)] == shape.tolist()
    np.testing.assert_allclose(animation.mesh("body").frames[9], look.body, atol=1e-6)
    session.use_shape([0.0] * 5)
    session.delete(3)
    np.testing.assert_allclose(session.look(9).garment, own.garment, atol=1e-6)


def test_a_body_keeps_through_motions_and_garments(run):
    session = Session(run, "skirt", "walk", 12)
    session.use_shape([1.0, 0.0, 0.0, 0.0, 0.0])
    session.use_garment("tshirt")
    session.use_clip(invented_motion(run, "squat", 10, 0))
    assert session.shape[0] == 1.0 and session.clip.label == "squat"


def test_measures_are_those_of_people():
    body = Body.load("full")
    own = measures(body)
    assert 1.6 < own["height"] < 1.8
    assert 0.6 < own["waist"] < own["hips"] < 1.1 and own["waist"] < own["chest"] < 1.1
    taller, slimmer = measures(body.shaped([2.0])), measures(body.shaped([0, 0, 0, 0, 2.0]))
    assert taller["height"] > own["height"] + 0.05
    assert all(slimmer[name] < own[name] - 0.02 for name in ("chest", "waist", "hips"))
    wider = replace(body, vertices=body.vertices * np.float32([1.1, 1.0, 1.1]), joints=body.joints)
    assert measures(wider)["waist"] == pytest.approx(1.1 * own["waist"], rel=1e-4)
