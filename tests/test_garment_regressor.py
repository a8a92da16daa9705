"""Garment regressors: decoding with a cache, causality, over-fitting, collision tuning, files."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from body.model import Body
from models.collision_tuning import CollisionTuning, fine_tune_collisions
from models.garment_fitting import (
    GarmentExample,
    RegressorTraining,
    _frame_training,
    build_regressor,
    fit_garment_regressor,
    load_regressor,
    save_regressor,
)
from models.garment_mirror import mirror_map, mirrored_example
from models.garment_regressor import VARIANTS, Regressor, RegressorConfig, variant_config
from models.kernel_correction import PENALTY, KernelCorrection
from models.motion_features import MotionTrack, track_features
from models.sequence_regressor import SequenceRegressor
from models.shape_code import ShapeCode
from models.training import TrainingSettings
from motions.mirror import mirror_motion

torch.set_num_threads(1)
SMALL = {"width": 16, "feed_forward": 32, "heads": 2, "bos_hidden": (16,)}
LEAD, FRAMES = 4, 12


@pytest.fixture(scope="module")
def body() -> Body:
    return Body.load("small")


def _faces(around: int, rows: int) -> np.ndarray:
    """Triangles of an open tube."""
    i, k = np.meshgrid(np.arange(around), np.arange(rows - 1), indexing="ij")
    a, b = (i * rows + k).ravel(), ((i + 1) % around * rows + k).ravel()
    return np.concatenate([np.stack([a, b, a + 1], 1), np.stack([b, b + 1, a + 1], 1)])


FACES = _faces(8, 4)
VERTICES = 32


def _track(body: Body, seed: int, frames: int = FRAMES, lead: int = LEAD) -> MotionTrack:
    rng = np.random.default_rng(seed)
    time = np.arange(lead + frames)[:, None, None] / 10.0
    pose = rng.normal(0.0, 0.3, (1, 24, 3)) * np.sin(time + rng.uniform(0, 6, (1, 24, 3)))
    root = np.cumsum(rng.normal(0.0, 0.01, (lead + frames, 3)), axis=0)
    return MotionTrack.from_motion(body, pose[lead:], root[lead:], pose[:lead], root[:lead], 30.0)


def _examples(body: Body, count: int) -> list[GarmentExample]:
    """A tube about the hips whose hem follows the knees: learnable from the pose alone."""
    angle, height = np.arange(VERTICES) // 4 * np.pi / 4, np.arange(VERTICES) % 4 / 3.0
    tube = np.stack([0.25 * np.cos(angle), 0.1 - 0.5 * height, 0.25 * np.sin(angle)], axis=1)
    examples = []
    for seed in range(count):
        track = _track(body, seed)
        knees = track.joints[:, [4, 5]].mean(1) - track.joints[:, 0]
        world = track.joints[:, None, 0] + tube + knees[:, None] * height[None, :, None] * [1.0, 0.0, 1.0]
        examples.append(GarmentExample.from_world(track, world[LEAD:]))
    return examples


def _untrained(body: Body, variant: str, **overrides) -> Regressor:
    torch.manual_seed(3)
    examples = _examples(body, 3)
    sizes = {**SMALL, **({"components": 20, "window_hidden": (64,)} if not variant.startswith("paper") else {})}
    regressor = build_regressor(variant_config(variant, VERTICES, **{**sizes, **overrides}), FACES)
    regressor.shape.fit(np.concatenate([e.vertices for e in examples]), np.random.default_rng(0))
    regressor.set_feature_scaling(
        np.concatenate([track_features(e.track, regressor.config.features) for e in examples])
    )
    return regressor.eval()


@pytest.mark.parametrize(("variant", "window"), [("paper", 0), ("steady", 5), ("steady", 32)])
def test_cached_decoding_equals_decoding_the_whole_prefix_again(body: Body, variant: str, window: int) -> None:
    model = _untrained(body, variant, attention_window=window)
    assert isinstance(model, SequenceRegressor)
    features = torch.stack([model.features(_track(body, s)) for s in (5, 6)])
    with torch.no_grad():
        cached = model.unroll(features, LEAD)
        straight = torch.zeros_like(cached) + model.straight(features, LEAD)
        memory, past = model.encode_motion(features, LEAD), model.first_token(features, LEAD)[:, None]
        for _ in range(FRAMES):
            codes = model.decode_all(memory, past, LEAD) + straight[:, : past.shape[1]]
            past = torch.cat([past, codes[:, -1:]], dim=1)
    assert cached.std() > 1e-3
    np.testing.assert_allclose(cached.numpy(), codes.numpy(), atol=1e-5)


@pytest.mark.parametrize("variant", ["steady", "window", "gru"])
def test_future_motion_does_not_change_earlier_frames(body: Body, variant: str) -> None:
    model = _untrained(body, variant)
    track = _track(body, 7)
    changed = MotionTrack(track.pose.copy(), track.joints.copy(), LEAD, 30.0)
    changed.pose[LEAD + 6 :] += 0.5
    changed.joints[LEAD + 6 :] += 0.1
    a, b = model.dress(track), model.dress(changed)
    np.testing.assert_allclose(a[:6], b[:6], atol=1e-6)
    assert np.abs(a[6:] - b[6:]).max() > 1e-5


def test_longer_sequences_than_were_trained_on(body: Body) -> None:
    track = _track(body, 8, frames=80)
    for variant in ("steady", "window", "gru"):
        assert _untrained(body, variant).dress(track).shape == (80, VERTICES, 3)
    # The paper's decoder knows absolute positions: its segments each begin anew.
    paper = _untrained(body, "paper", segment=30)
    dressed = paper.dress(track)
    assert dressed.shape == (80, VERTICES, 3)
    alone = MotionTrack(track.pose[LEAD + 30 : LEAD + 60], track.joints[LEAD + 30 : LEAD + 60], 0, 30.0)
    np.testing.assert_allclose(dressed[30:60], paper.dress(alone), atol=1e-6)


def test_fixed_start_token_is_the_mean_shape_and_a_given_start_replaces_it(body: Body) -> None:
    model = _untrained(body, "paper-fixed-bos")
    features = model.features(_track(body, 3))[None]
    token = model.first_token(features, LEAD)
    np.testing.assert_array_equal(model.shape.decode(token)[0].numpy(), model.shape.mean.numpy())
    with torch.no_grad():
        same, other = model.unroll(features, LEAD, token), model.unroll(features, LEAD, token + 1.0)
        np.testing.assert_array_equal(same.numpy(), model.unroll(features, LEAD).numpy())
    assert np.abs(other.numpy() - same.numpy()).max() > 1e-3


def test_principal_code_gives_the_same_loss_as_all_coordinates() -> None:
    rng = np.random.default_rng(0)
    low_rank = rng.normal(size=(40, 6)) @ rng.normal(size=(6, 3 * VERTICES)) * 0.05 + rng.normal(size=3 * VERTICES)
    shapes = low_rank.reshape(40, VERTICES, 3).astype(np.float32)
    losses = []
    for components in (0, 6):
        code = ShapeCode(VERTICES, components, FACES)
        code.fit(shapes, np.random.default_rng(1))
        codes = code.encode(torch.as_tensor(shapes))
        np.testing.assert_allclose(code.decode(codes).numpy(), shapes, atol=1e-4)
        losses.append([float(x) for x in code.errors(codes[:20] - codes[20:])])
    np.testing.assert_allclose(losses[0], losses[1], rtol=1e-3)


@pytest.mark.parametrize("variant", list(VARIANTS))
def test_every_variant_learns_a_small_set_and_survives_its_file(body: Body, variant: str, tmp_path: Path) -> None:
    examples = _examples(body, 4)
    sizes = {**SMALL, "width": 32, "dropout": 0.0}
    if not variant.startswith("paper"):
        sizes |= {"components": 20, "window_hidden": (64,)}
    config = variant_config(variant, VERTICES, **sizes)
    epochs = 40
    settings = RegressorTraining(
        TrainingSettings(epochs=epochs, learning_rate=5e-3, schedule="cosine", checkpoint_every=1000),
        bos_epochs=15,
        batch=24 if config.decoder == "window" else 2,
        growth_every=1000,
    )
    model, log = fit_garment_regressor(examples, FACES, config, settings, tmp_path / "run", examples[:2])
    truth = np.concatenate([e.vertices for e in examples])
    still = np.sqrt(np.square(truth - truth.mean(0)).sum(-1).mean())
    dressed = np.concatenate(model.dress_all([e.track for e in examples]))
    assert np.sqrt(np.square(dressed - truth).sum(-1).mean()) < 0.5 * still
    assert log.last("validation")["rmse_mm"] < 500.0 * still
    save_regressor(tmp_path / "model.pt", model)
    again = load_regressor(tmp_path / "model.pt")
    assert again.config == model.config
    np.testing.assert_array_equal(again.dress(examples[0].track), model.dress(examples[0].track))


def test_kernel_correction_interpolates_near_its_centres_and_fades_far_from_them() -> None:
    generator = torch.Generator().manual_seed(0)
    inputs = torch.randn(300, 5, generator=generator)
    missing = torch.stack([torch.sin(inputs[:, 0]), inputs[:, 1] * inputs[:, 2]], dim=1)
    correction = KernelCorrection(200, 5, 2)
    assert not correction(inputs).any()
    correction.fit(inputs[:200], missing[:200])
    error = (correction(inputs.view(3, 100, 5)).flatten(0, 1) - missing).square().mean(0).sqrt()
    assert (error < 0.3 * missing.std(0)).all()
    at_centres = (correction(inputs[:200]) - missing[:200]).square().mean().sqrt()
    assert at_centres < 0.1 * missing.std()
    # The normal equations, on their own: (K + penalty I) w = missing, in other words K w = missing - penalty w.
    rest = missing[:200] - PENALTY * correction.weights
    np.testing.assert_allclose(correction(inputs[:200]).numpy(), rest.numpy(), atol=2e-3)
    assert correction(100.0 * inputs[:5]).abs().max() < 1e-6
    with pytest.raises(ValueError, match="at least one centre"):
        KernelCorrection(0, 5, 2)
    with pytest.raises(ValueError, match=r"expected inputs \[200, 5\]"):
        correction.fit(inputs, missing)


def test_corrected_window_regressor_knows_what_its_network_did_not_learn(body: Body, tmp_path: Path) -> None:
    examples = _examples(body, 4)
    config = variant_config("window", VERTICES, components=20, window_hidden=(16,), dropout=0.0, centres=1000)
    settings = RegressorTraining(TrainingSettings(epochs=2, checkpoint_every=1000), batch=24)
    strange = GarmentExample(examples[0].track, examples[0].vertices + np.float32(0.5), mirrored=True)
    errors = []
    for name, centres in (("plain", 0), ("corrected", 1000)):
        chosen, lines = replace(config, centres=centres), []
        model, _ = fit_garment_regressor(
            [*examples, strange], FACES, chosen, settings, tmp_path / name, examples[:1], lines.append
        )
        dressed = np.concatenate(model.dress_all([e.track for e in examples]))
        errors.append(np.sqrt(np.square(dressed - np.concatenate([e.vertices for e in examples])).sum(-1).mean()))
    # All simulated frames are centres, mirrored ones are none.
    assert model.config.centres == 4 * FRAMES and any("corrected" in line for line in lines)
    assert errors[1] < 0.2 * errors[0]
    save_regressor(tmp_path / "model.pt", model)
    again = load_regressor(tmp_path / "model.pt")
    np.testing.assert_array_equal(again.dress(examples[0].track), model.dress(examples[0].track))
    longer = again.dress(_track(body, 2, frames=200))
    assert longer.shape == (200, VERTICES, 3) and np.isfinite(longer).all()


def test_blended_frames_keep_motion_and_shape_together(body: Body) -> None:
    torch.manual_seed(0)
    examples = _examples(body, 3)
    config = variant_config("window", VERTICES, components=20, window_hidden=())
    regressor = build_regressor(config, FACES)
    raw = np.stack([track_features(e.track, config.features) for e in examples])
    regressor.set_feature_scaling(raw.reshape(-1, raw.shape[-1]))
    regressor.shape.fit(np.concatenate([e.vertices for e in examples]), np.random.default_rng(0))
    features = torch.stack([regressor.features(e.track) for e in examples])
    with torch.no_grad():  # a linear garment: whatever lies between two of its frames is its own too
        codes = regressor.network(regressor.windows(features)[:, LEAD:])
    for blend in (0.0, 1.0):
        settings = RegressorTraining(TrainingSettings(epochs=1), batch=12, blend=blend)
        batches, loss = _frame_training(regressor, features, codes, LEAD, settings)
        found = list(batches(0, np.random.default_rng(1)))
        assert sorted(torch.cat([rows for rows, _, _ in found]).tolist()) == list(range(3 * FRAMES))
        for rows, others, share in found:
            assert sorted(others.tolist()) == sorted(rows.tolist()) and (
                blend == 0.0 or others.tolist() != rows.tolist()
            )
            assert share.max() <= blend and (blend == 0.0 or share.std() > 0.1)
            assert loss((rows, others, share))["total"] < 1e-8
    # Shapes that do not follow the motion are met between themselves, no longer at themselves.
    _, loss = _frame_training(regressor, features, torch.where(codes > 0, 1.0, -1.0), LEAD, settings)
    rows, others, share = found[0]
    assert abs(loss((rows, others, 0.0 * share))["total"] - loss((rows, others, share))["total"]) > 1e-3


@pytest.mark.parametrize("blend", [-0.1, 1.5])
def test_blend_outside_of_its_range_is_refused(blend: float) -> None:
    with pytest.raises(ValueError, match=rf"blend: must be in \[0, 1\], got {blend}"):
        RegressorTraining(blend=blend)


def test_the_same_model_is_the_same_file(body: Body, tmp_path: Path) -> None:
    regressor = build_regressor(variant_config("window", VERTICES, components=20, window_hidden=(8,)), FACES)
    for name in ("one.pt", "other.pt"):
        save_regressor(tmp_path / name, regressor)
    assert (tmp_path / "one.pt").read_bytes() == (tmp_path / "other.pt").read_bytes()


def test_start_token_is_frozen_after_its_own_training(body: Body, tmp_path: Path) -> None:
    examples = _examples(body, 4)
    config = variant_config("paper", VERTICES, **SMALL)
    weights = []
    for epochs in (1, 3):
        settings = RegressorTraining(TrainingSettings(epochs=epochs), bos_epochs=3)
        model, _ = fit_garment_regressor(examples, FACES, config, settings, tmp_path / str(epochs))
        weights.append(model.bos[0].weight.detach().numpy())
        decoder = model.garment_out.weight.detach().numpy()
    np.testing.assert_array_equal(weights[0], weights[1])
    torch.manual_seed(0)
    assert np.abs(build_regressor(config, FACES).garment_out.weight.detach().numpy() - decoder).max() > 0.0


def test_collision_tuning_moves_the_garment_out_of_the_body(body: Body, tmp_path: Path) -> None:
    model = _untrained(body, "window")
    tracks = [_track(body, s, frames=4) for s in range(20, 23)]
    # A tube so narrow that it runs through the thighs.
    model.shape.mean[:, [0, 2]] *= 0.55
    settings = CollisionTuning(
        TrainingSettings(epochs=15, learning_rate=3e-3), keep_weight=0.0, heavy_share=1.0, heavy_depth=1.0
    )
    report = fine_tune_collisions(model, tracks, body, settings, tmp_path)
    assert report.inside_before > 0.05
    assert report.inside_after < 0.5 * report.inside_before
    assert report.moved > 1e-3


def test_collision_tuning_leaves_a_hopeless_regressor_alone_and_says_so(body: Body, tmp_path: Path) -> None:
    model = _untrained(body, "window")
    model.shape.mean[:, [0, 2]] *= 0.2
    before, said = [p.clone() for p in model.parameters()], []
    report = fine_tune_collisions(
        model, [_track(body, 1)], body, CollisionTuning(heavy_share=0.0), tmp_path, progress=said.append
    )
    assert (report.motions, report.discarded, report.moved) == (1, 1, 0.0)
    assert report.inside_after == report.inside_before > 0.0
    assert "left as it was" in said[0]
    assert all(torch.equal(a, b) for a, b in zip(before, model.parameters(), strict=True))


def test_features_do_not_know_where_north_is_but_where_down_is(body: Body) -> None:
    track = _track(body, 9)
    turned = MotionTrack(track.pose.copy(), track.joints.copy(), LEAD, 30.0)
    from geometry.rotations import axis_angle_to_matrix, matrix_to_axis_angle

    for axis, same in (((0.0, 0.9, 0.0), True), ((0.9, 0.0, 0.0), False)):
        rotation = axis_angle_to_matrix(np.array(axis))
        turned.pose[:, 0] = matrix_to_axis_angle(rotation @ axis_angle_to_matrix(track.pose[:, 0]))
        turned.joints[...] = track.joints @ rotation.T
        difference = np.abs(track_features(turned, "motion") - track_features(track, "motion")).max()
        assert (difference < 1e-4) == same


def test_mirrored_example_is_the_garment_of_the_mirrored_motion(body: Body) -> None:
    # A tube whose vertices do not come in pairs, so that its mirror image has to be read off between them.
    def tube(turn: float, lean: float) -> np.ndarray:
        angle, height = (np.arange(VERTICES) // 4 + turn) * np.pi / 4, np.arange(VERTICES) % 4 / 3.0
        return np.stack([0.25 * np.cos(angle) + lean * height, 0.1 - 0.5 * height, 0.25 * np.sin(angle)], axis=1)

    weights = mirror_map(tube(0.1, 0.0), FACES)
    np.testing.assert_allclose(np.asarray(weights.sum(axis=1)).ravel(), 1.0, atol=1e-6)
    pose, root = np.random.default_rng(0).normal(0.0, 0.3, (9, 24, 3)), np.zeros((9, 3))
    track = MotionTrack.from_motion(body, pose[4:], root[4:], pose[:4], root[:4], 30.0)
    example = GarmentExample(track, np.stack([tube(0.1, lean) for lean in np.linspace(0.0, 0.2, 5)]).astype(np.float32))
    mirrored = mirrored_example(example, weights)
    again = body.joint_positions(*mirror_motion(pose, root))
    np.testing.assert_allclose(mirrored.track.joints, again, atol=1e-4)
    expected = np.stack([tube(0.1, -lean) for lean in np.linspace(0.0, 0.2, 5)])
    assert np.abs(mirrored.vertices - expected).max() < 0.02 < np.abs(example.vertices - expected).max()
    assert mirrored.mirrored and not example.mirrored
    back = mirrored_example(mirrored, weights)
    np.testing.assert_allclose(back.track.joints, track.joints, atol=1e-6)
    assert np.abs(back.vertices - example.vertices).max() < 0.03
    with pytest.raises(ValueError, match="left and right differ"):
        mirror_map(tube(0.0, 0.3), FACES)


def test_bad_input_is_named(body: Body) -> None:
    with pytest.raises(ValueError, match="unknown regressor variant 'best'"):
        variant_config("best", 10)
    with pytest.raises(ValueError, match="must rise from 0"):
        RegressorConfig(10, window_offsets=(1, 2))
    with pytest.raises(ValueError, match="regressor centres: 5 with decoder 'transformer'"):
        RegressorConfig(10, centres=5)
    with pytest.raises(ValueError, match=r"expected vertices \[12, V, 3\], got \[3, 5, 3\]"):
        GarmentExample(_track(body, 0), np.zeros((3, 5, 3), dtype=np.float32))
