"""Figures of clothing layers, the plan of their simulations, and what a configuration may say of them."""

from __future__ import annotations

import copy

import numpy as np
import pytest

from datasets.splits import SplitRule
from evaluation.clothing_layer import Wrinkles, distribution_distance, judge_accuracy, vertex_errors
from pipeline import spec
from pipeline.config import ConfigError, check_config, load_config
from pipeline.plan import layer_clips
from tests.conftest import ROOT

# Two triangles in a plane, on the hip.
REST = np.array([[0.0, 0.0, 0.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, -1.0, 0.0]])
FACES = np.array([[0, 1, 2], [1, 0, 3]])


def folded(degrees: float) -> np.ndarray:
    """A layer that turns one of the triangles about their common edge, downwards (away from the normals)."""
    angle = np.radians(degrees)
    layer = np.zeros((1, 4, 3))
    layer[0, 3] = np.array([0.0, -np.cos(angle), -np.sin(angle)]) - REST[3]
    return layer


@pytest.fixture(scope="module")
def wrinkles() -> Wrinkles:
    return Wrinkles(REST, FACES, np.zeros(4, dtype=int))


@pytest.mark.parametrize("degrees", [-70.0, 0.0, 35.0, 120.0])
def test_the_angle_of_a_fold_is_the_one_it_was_folded_by(wrinkles, degrees):
    assert wrinkles.angles(folded(degrees))[0, 0] == pytest.approx(degrees, abs=1e-3)


def test_distributions_are_as_far_apart_as_their_angles(wrinkles):
    covered = np.ones((1, 4), dtype=bool)
    a, b = (wrinkles.distribution(wrinkles.angles(folded(d)), covered) for d in (10.2, 40.2))
    assert distribution_distance(a, b) == pytest.approx(30.0, abs=0.5)
    assert distribution_distance(a, a) == 0.0
    covered[0, 3] = False
    assert wrinkles.distribution(wrinkles.angles(folded(10.0)), covered).sum() == 0.0, "bare skin is not counted"


def test_errors_are_those_of_covered_vertices_alone():
    truth, covered = np.zeros((2, 3, 3)), np.array([[True, True, False], [True, False, False]])
    predicted = truth.copy()
    predicted[0, 0, 0], predicted[0, 2, 1] = 0.03, 5.0
    found = vertex_errors(predicted, truth, covered)
    assert found.mean == pytest.approx(0.01)
    assert found.deviation == pytest.approx(np.std([0.03, 0.0, 0.0]))
    with pytest.raises(ValueError, match="expected equal shapes"):
        vertex_errors(predicted[:1], truth, covered)


def test_the_judge_tells_what_differs_and_guesses_what_does_not():
    generator = np.random.default_rng(0)
    real, alike, other = (generator.normal(mean, 1.0, (400, 6)) for mean in (0.0, 0.0, 2.0))
    group = [k % 10 for k in range(400)]
    assert abs(judge_accuracy(real, alike, group, 0) - 0.5) < 0.06
    assert judge_accuracy(real, other, group, 0) > 0.97
    with pytest.raises(ValueError, match="at least two sequences"):
        judge_accuracy(real, alike, [0] * 400, 0)


@pytest.fixture(scope="module")
def config() -> dict:
    return load_config([ROOT / "configs" / "default.yaml"])


def test_layers_train_on_seen_clips_and_keep_some_of_held_out_takes(config):
    rule = SplitRule(**config["data"]["splits"])
    sets = [[layer_clips(config, number, body) for body in range(1, 7)] for number in range(4)]
    for clips in (clips for bodies in sets for clips in bodies):
        held_out = [rule.holds_out_take(clip.take_index) for clip in clips]
        assert (held_out.count(False), held_out.count(True)) == (12, 4)
        assert not any(rule.holds_out_label(clip.label) for clip in clips)
    assert sets[0] == sets[3] and sets[1] == sets[2]
    trained, kept = [sets[0][body - 1] for body in (1, 2, 4, 5)], [sets[0][body - 1] for body in (3, 6)]
    assert len({clip.name for clips in trained for clip in clips}) == 64, "each body shows other motions"
    assert all(clips in trained for clips in kept), "a body that is held out moves as one that is not"
    assert len({clip.name for number in (0, 1) for clip in layer_clips(config, number)}) == 128


def test_a_run_of_few_clips_gives_every_body_some(config):
    few = copy.deepcopy(config)
    few["motions"]["procedural"] |= {"labels": ["walk"], "variants": 5}
    rule = SplitRule(**few["data"]["splits"])
    for body in range(1, 7):
        held_out = [rule.holds_out_take(clip.take_index) for clip in layer_clips(few, 0, body)]
        assert any(held_out) and not all(held_out)


def test_ablations_repeat_the_paper_but_for_what_they_leave_out(config):
    variants = config["models"]["mesh_vae_gan"]["variants"]
    paper = spec.variant_settings(variants, "paper")
    for name, key in (("no-discriminator", "discriminator"), ("no-residual", "residual")):
        own = spec.variant_settings(variants, name)
        assert {k for k in own if own[k] != paper.get(k)} == {key, "kind"}
        assert own["kind"] == "paper"


@pytest.mark.parametrize(
    "where, key, value, message",
    [
        (("data", "layers"), "fabric", "coton", r"unknown fabric 'coton' \(did you mean 'cotton'\?\)"),
        (("data", "layers"), "bodies", 2, "at least bodies_every = 3"),
        (("data", "layers", "base"), "gravity", -4.0, "data.layers.base.gravity: found -4"),
        (("models", "mesh_vae_gan", "variants", "no-residual"), "like", "papper", "allowed are anchored, paper"),
        (("models", "mesh_vae_gan", "variants", "paper"), "levels", [0, 2, 4, 7], "data.layers.levels gives 0 to 6"),
        (("models", "mesh_vae_gan", "variants", "paper"), "levels", [0, 2], "found 2 for 4 widths"),
    ],
)
def test_a_mistake_in_the_configuration_is_one_sentence(config, where, key, value, message):
    wrong = copy.deepcopy(config)
    node = wrong
    for part in where:
        node = node[part]
    node[key] = value
    with pytest.raises(ConfigError, match=message):
        check_config(wrong, [("mine.yaml", wrong)])
