"""Regressors that are told material and body, and those in the space of a shape descriptor: learning, use, files."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from body.model import Body
from datasets.sequences import Sequence
from models.conditioned_regressor import (
    ConditionColumns,
    ConditionedExample,
    ConditionedRegressor,
    Conditions,
    fit_conditioned_regressor,
    load_conditioned_regressor,
    save_conditioned_regressor,
)
from models.descriptor_fitting import fit_shape_descriptor
from models.descriptor_regressor import (
    fit_descriptor_regressor,
    load_descriptor_regressor,
    save_descriptor_regressor,
)
from models.frame_fitting import CodedExamples
from models.garment_fitting import GarmentExample, RegressorTraining, build_regressor
from models.garment_regressor import Regressor, variant_config
from models.motion_features import MotionTrack, sequence_track, track_features
from models.sequence_regressor import SequenceRegressor
from models.shape_descriptor import ShapeDescriptor, ShapeDescriptorConfig, encode_all
from models.training import TrainingSettings
from pipeline.garment_predictors import load_variant, regressor_predictor, started_predictor, told_predictor

torch.set_num_threads(1)
LEAD, FRAMES, VERTICES = 4, 12, 32
BASE = Conditions({"bend": 1.0, "gravity": 9.81}, (0.0, 0.0))


@pytest.fixture(scope="module")
def body() -> Body:
    return Body.load("small")


def _tube() -> np.ndarray:
    angle, height = np.arange(VERTICES) // 4 * np.pi / 4, np.arange(VERTICES) % 4 / 3.0
    return np.stack([0.25 * np.cos(angle), 0.1 - 0.5 * height, 0.25 * np.sin(angle)], axis=1)


def _faces() -> np.ndarray:
    i, k = np.meshgrid(np.arange(8), np.arange(3), indexing="ij")
    a, b = (i * 4 + k).ravel(), ((i + 1) % 8 * 4 + k).ravel()
    return np.concatenate([np.stack([a, b, a + 1], 1), np.stack([b, b + 1, a + 1], 1)])


def _sequence(body: Body, seed: int, bend: float = 1.0, girth: float = 0.0) -> Sequence:
    """A tube about the hips: its hem follows the knees, the more so the limper it is, and it is as wide as its body."""
    rng = np.random.default_rng(seed)
    time = np.arange(LEAD + FRAMES)[:, None, None] / 10.0
    pose = rng.normal(0.0, 0.3, (1, 24, 3)) * np.sin(time + rng.uniform(0, 6, (1, 24, 3)))
    root = np.cumsum(rng.normal(0.0, 0.01, (LEAD + FRAMES, 3)), axis=0)
    joints = body.joint_positions(pose, root)
    hang = np.arange(VERTICES) % 4 / 3.0
    knees = joints[:, [4, 5]].mean(1) - joints[:, 0]
    moved = knees[:, None] * hang[None, :, None] * [1.0, 0.0, 1.0] * (1.0 - 0.9 * np.log(bend))
    world = joints[:, :1] + _tube() * [1.0 + 0.2 * girth, 1.0, 1.0 + 0.2 * girth] + moved
    return Sequence(
        garment="tube",
        clip=f"clip{seed}",
        take=f"clip{seed}",
        label="walk",
        plan="materials",
        phi=seed,
        split="train",
        fps=30.0,
        vertices=world[LEAD:].astype(np.float32),
        pose=pose[LEAD:],
        root=root[LEAD:],
        joints=joints[LEAD:],
        lead_pose=pose[:LEAD],
        lead_root=root[:LEAD],
        lead_joints=joints[:LEAD],
        parameters={"bend": bend, "gravity": 9.81},
        shape=np.array([girth, 0.0]),
    )


def _example(sequence: Sequence) -> ConditionedExample:
    garment = GarmentExample.from_world(sequence_track(sequence), sequence.vertices)
    return ConditionedExample(garment, Conditions(sequence.parameters, sequence.shape))


def _settings(epochs: int) -> RegressorTraining:
    training = TrainingSettings(epochs=epochs, learning_rate=5e-3, schedule="cosine", checkpoint_every=1000)
    return RegressorTraining(training, batch=32, growth_every=1000)


def _config(components: int = 20):
    return variant_config("window", VERTICES, components=components, window_hidden=(64,), dropout=0.0)


@pytest.fixture(scope="module")
def conditioned(body: Body, tmp_path_factory: pytest.TempPathFactory) -> ConditionedRegressor:
    rng = np.random.default_rng(5)
    drawn = zip(np.exp(rng.uniform(-1, 1, 24)), rng.uniform(-1, 1, 24))
    examples = [_example(_sequence(body, seed % 2, bend, girth)) for seed, (bend, girth) in enumerate(drawn)]
    run = tmp_path_factory.mktemp("conditioned")
    return fit_conditioned_regressor(
        examples, BASE, ("bend", "gravity"), _faces(), _config(), _settings(40), run, examples[:2]
    )


def _error(predicted: np.ndarray, sequence: Sequence) -> float:
    return float(np.sqrt(np.square(predicted - sequence.vertices).sum(-1).mean()))


def test_conditioned_regressor_uses_material_and_body(body: Body, conditioned: ConditionedRegressor) -> None:
    assert conditioned.columns == ConditionColumns(("bend",), ("bend",), (0,))
    told = regressor_predictor(conditioned)
    for bend, girth in ((2.0, 0.0), (0.5, 0.0), (1.0, 0.8), (1.0, -0.8)):
        sequence = _sequence(body, 1, bend, girth)
        ignored = told_predictor(conditioned, lambda _: BASE)(sequence)
        assert _error(told(sequence), sequence) < 0.7 * _error(ignored, sequence)


def test_coefficients_of_few_bodies_are_not_taken() -> None:
    bodies = [Conditions({"bend": 1.0 + i}, (0.1 * i, 0.2 * i)) for i in range(7)]
    assert ConditionColumns.varied(bodies, ()).shape == (0, 1)
    assert ConditionColumns.varied(bodies[:6], ()).shape == ()
    assert ConditionColumns.varied(bodies[:6], ()).parameters == ("bend",)


def test_conditioned_regressor_dresses_base_material_where_nothing_is_said(
    body: Body, conditioned: ConditionedRegressor
) -> None:
    track = sequence_track(_sequence(body, 2))
    np.testing.assert_allclose(conditioned.dress(track), conditioned.dress_under(track, BASE), atol=1e-6)
    # Missing shape coefficients are zero, and what varied nowhere in training is not looked at.
    short = Conditions({"bend": 1.0, "gravity": 1.62}, ())
    np.testing.assert_array_equal(conditioned.dress_under(track, short), conditioned.dress_under(track, BASE))
    far, farther = (conditioned.dress_under(track, Conditions({"bend": b})) for b in (1e9, 1e12))
    np.testing.assert_array_equal(far, farther)


def test_conditioned_regressor_survives_its_file(body: Body, conditioned: ConditionedRegressor, tmp_path: Path) -> None:
    save_conditioned_regressor(tmp_path / "model.pt", conditioned)
    again = load_variant("conditioned-seed-2", str(tmp_path / "model.pt"))
    assert again.columns == conditioned.columns
    track, stiff = sequence_track(_sequence(body, 1)), Conditions({"bend": 2.0}, (0.5,))
    np.testing.assert_array_equal(again.dress_under(track, stiff), conditioned.dress_under(track, stiff))
    with pytest.raises(ValueError, match="expected 'descriptor_regressor'"):
        load_descriptor_regressor(tmp_path / "model.pt")
    with pytest.raises(ValueError, match="does not exist"):
        load_conditioned_regressor(tmp_path / "none.pt")


def test_bad_conditions_are_named(body: Body, conditioned: ConditionedRegressor, tmp_path: Path) -> None:
    track = sequence_track(_sequence(body, 1))
    with pytest.raises(ValueError, match="parameter 'bend' is needed"):
        conditioned.dress_under(track, Conditions({"gravity": 9.81}))
    for bad in (0.0, -1.0, float("nan")):
        with pytest.raises(ValueError, match="'bend' must be above 0"):
            conditioned.dress_under(track, Conditions({"bend": bad}))
    with pytest.raises(ValueError, match="no training examples"):
        fit_conditioned_regressor([], BASE, (), _faces(), _config(), _settings(1), tmp_path)
    one = _example(_sequence(body, 1))
    with pytest.raises(ValueError, match="config says 31 vertices"):
        fit_conditioned_regressor([one], BASE, (), _faces(), replace(_config(), vertices=31), _settings(1), tmp_path)
    with pytest.raises(ValueError, match="expected codes"):
        CodedExamples([one.garment.track], np.zeros((1, 3, 2), np.float32), np.zeros((1, 0), np.float32))


def test_few_bodies_among_many_parameter_sets_are_not_held_as_unusual() -> None:
    conditions = [Conditions({"bend": b}, (0.0,)) for b in np.linspace(1.0, 2.0, 60)]
    conditions += [Conditions({"bend": 1.5}, (g,)) for g in (-1.5, 1.0, 1.5)]
    columns = ConditionColumns.varied(conditions, ())
    regressor = ConditionedRegressor(_config(), _faces(), columns)
    regressor.set_condition_scaling(columns.rows(conditions), columns.rows([BASE])[0])
    told = regressor.standardised(columns.rows([Conditions({"bend": 1.5}, (g,)) for g in (1.5, 1.8)]))
    assert told[0, 1] < told[1, 1] < 2.0


def test_a_parameter_that_is_left_out_is_not_told() -> None:
    four = [Conditions({"bend": b, "substeps": 10 * b}, (10 * b, 0.0)) for b in (1.0, 2.0, 3.0, 4.0)]
    columns = ConditionColumns.varied(four, {"bend"}, without={"substeps"})
    assert columns == ConditionColumns(("bend",), ("bend",), (0,))
    np.testing.assert_allclose(columns.rows(four)[:2], [[0.0, 10.0], [np.log(2.0), 20.0]], rtol=1e-6)


@pytest.fixture(scope="module", params=["paper", "residual-pca"])
def descriptor(body: Body, request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> ShapeDescriptor:
    shapes = np.concatenate([_example(_sequence(body, seed)).garment.vertices for seed in range(4)])
    config = ShapeDescriptorConfig(request.param, code=6, hidden=(32,), batch=16, components=12)
    settings = TrainingSettings(epochs=40, learning_rate=3e-3, checkpoint_every=1000)
    return fit_shape_descriptor(shapes, _faces(), config, settings, tmp_path_factory.mktemp("descriptor"))


def test_descriptor_space_regressor_learns_and_survives_its_file(
    body: Body, descriptor: ShapeDescriptor, tmp_path: Path
) -> None:
    sequences = [_sequence(body, seed) for seed in range(4)]
    examples = [_example(s).garment for s in sequences]
    codes = np.stack([encode_all(descriptor, e.vertices) for e in examples])
    before = {name: value.clone() for name, value in descriptor.state_dict().items()}
    regressor = fit_descriptor_regressor(
        [e.track for e in examples], codes, descriptor, _config(), _settings(40), tmp_path / "run", examples[:1]
    )
    for name, value in regressor.shape.descriptor.state_dict().items():
        assert torch.equal(value, before[name]), name
    truth = np.concatenate([e.vertices for e in examples])
    still = np.sqrt(np.square(truth - truth.mean(0)).sum(-1).mean())
    dressed = np.concatenate(regressor.dress_all([e.track for e in examples]))
    assert np.sqrt(np.square(dressed - truth).sum(-1).mean()) < 0.6 * still
    # Decoded codes of the truth are what the descriptor itself gives back.
    vertices = torch.as_tensor(examples[0].vertices)
    with torch.no_grad():
        through = regressor.shape.decode(regressor.shape.encode(vertices))
        torch.testing.assert_close(through, descriptor(vertices), atol=1e-5, rtol=1e-4)
        torch.testing.assert_close(regressor.shape.encode(vertices[None])[0], regressor.shape.encode(vertices))
    save_descriptor_regressor(tmp_path / "model.pt", regressor)
    again = load_variant("descriptor-space", str(tmp_path / "model.pt"))
    np.testing.assert_array_equal(again.dress(examples[0].track), regressor.dress(examples[0].track))


def _untrained(sequences: list[Sequence], variant: str) -> Regressor:
    torch.manual_seed(3)
    sizes = {"width": 16, "feed_forward": 32, "heads": 2, "bos_hidden": (16,), "segment": 5}
    regressor = build_regressor(variant_config(variant, VERTICES, **sizes), _faces())
    tracks: list[MotionTrack] = [sequence_track(s) for s in sequences]
    regressor.set_feature_scaling(np.concatenate([track_features(t, regressor.config.features) for t in tracks]))
    regressor.shape.fit(np.concatenate([_example(s).garment.vertices for s in sequences]), np.random.default_rng(0))
    return regressor.eval()


def test_sequences_dressed_together_are_dressed_as_alone(body: Body) -> None:
    sequences = [_sequence(body, seed) for seed in range(3)]
    regressor = _untrained(sequences, "paper")
    assert isinstance(regressor, SequenceRegressor)
    for predictor in (regressor_predictor, started_predictor):
        together, alone = predictor(regressor, sequences), predictor(regressor)
        for sequence in (sequences[1], sequences[0], sequences[2], sequences[1]):
            np.testing.assert_allclose(together(sequence), alone(sequence), atol=1e-5)
    first = started_predictor(regressor, sequences)(sequences[0])[0]
    np.testing.assert_allclose(first, sequences[0].vertices[0], atol=1e-4)
