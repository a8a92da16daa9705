"""Evaluation of the motion-invariant autoencoder: frames read once, transfers beside controls, the variance ratio."""

from __future__ import annotations

import numpy as np
import pytest

from evaluation.intrinsic import ReadFrames, against_controls, sequences_of, transfer_rows, variance_ratio
from evaluation.recovery import effects_mm
from models.intrinsic_fitting import (
    decode_frames,
    encode_frames,
    frame_evidence,
    pooled,
)
from models.parameter_groups import with_groups
from models.same_phi import IntrinsicFrames
from tests.test_motion_invariant import FRAMES, fitted, identity_descriptor


def test_frames_read_once_say_what_they_say_when_read_apart(tmp_path):
    network, training = fitted("pooled", tmp_path, 1)
    read, some = ReadFrames.of(network, training), np.arange(5, 40)
    assert np.allclose(read.at(some).single_latents(), encode_frames(network, training.at(some)), atol=1e-6)
    seen, apart = read.at(some), read.at(some).single_latents()
    for name, descriptors in seen.decoded({"of each": apart, "of one": apart[0]}).items():
        expected = decode_frames(network, apart if name == "of each" else apart[0], training.signatures[some])
        assert np.allclose(descriptors, expected, atol=1e-6)
    latents, owners = read.sequence_latents()
    for (phi, _), index, z, owner in zip(*zip(*sequences_of(training).items()), latents, owners, strict=True):
        assert phi == owner
        assert np.allclose(z, pooled(network, *frame_evidence(network, training.at(index))), atol=1e-6)


def test_variance_ratio_by_hand():
    phi = np.array([0, 0, 1, 1])
    latents = np.array([[0.0], [2.0], [10.0], [12.0]])
    assert variance_ratio(latents, phi) == pytest.approx(1.0 / 25.0)
    assert variance_ratio(latents, np.zeros(4)) is None


def test_transfer_without_a_second_clip_is_refused(tmp_path):
    network, training = fitted("cross", tmp_path, 1)
    only = sequences_of(training)[(3, 1)]
    alone = IntrinsicFrames(
        *(getattr(training, n)[only] for n in ("descriptors", "signatures", "phi", "clip", "parameters"))
    )
    training, alone = (ReadFrames.of(network, frames) for frames in (training, alone))
    with pytest.raises(ValueError, match="nothing to transfer"):
        transfer_rows(identity_descriptor(), alone, np.zeros((FRAMES, 4, 3)), training, "x")
    rows = transfer_rows(identity_descriptor(), alone, np.zeros((FRAMES, 4, 3)), training, "x", sources=training)
    assert {row["sequences"] for row in rows} == {1}


def test_true_parameters_reach_the_decoder_and_no_shape_does(tmp_path):
    """The control's z is a function of the parameters; the effect of the one that matters is found."""
    network, training = fitted("true-parameters", tmp_path, 10)
    values, _ = frame_evidence(network, training)
    for phi in range(12):
        assert np.ptp(values[training.phi == phi], axis=0).max() < 1e-5
    assert np.ptp(values, axis=0).max() > 0.1
    found = effects_mm(
        identity_descriptor(), network, training, ("stiffness",), {"stiffness"}, {"stiffness": 1.0}, {"stiffness": 1.0}
    )
    assert (
        found["stiffness"] > 300.0
    )  # mm: a deviation of log stiffness moves six of twelve coordinates by about a metre


def test_motion_only_has_no_latent(tmp_path):
    network, training = fitted("motion-only", tmp_path, 1)
    assert not encode_frames(network, training).any()
    first = decode_frames(network, np.ones(4, np.float32), training.signatures)
    assert np.array_equal(first, decode_frames(network, np.zeros(4, np.float32), training.signatures))


def test_groups_are_what_equal_motions_have_in_common():
    base = {"bend": 1e-5, "stretch": 500.0, "density": 0.2, "gravity": 9.81, "air_drag": 0.8, "time_scale": 1.0}
    heavy = base | {n: 2 * base[n] for n in ("bend", "stretch", "density", "air_drag")}
    first, second = with_groups(base), with_groups(heavy)
    groups = set(first) - set(base)
    assert len(groups) == 4 and all(first[g] == pytest.approx(second[g]) for g in groups)
    assert set(with_groups({"density": 0.2, "air_drag": 0.0})) == {"density", "air_drag"}


def test_transfers_stand_beside_their_controls():
    errors = {"motion-only": 10.0, "true-parameters": 5.0, "pooled": 6.0}
    rows = [{"variant": v, "split": "a", "quantity": "transfer, z of a clip", "rmse_mm": e} for v, e in errors.items()]
    found = against_controls([*rows, {"variant": "pooled", "split": "a", "quantity": "mean shape", "rmse_mm": 20.0}])
    assert found[2]["over_true_parameters"] == pytest.approx(1.2) and found[2]["gain_share"] == pytest.approx(0.8)
    assert found[0]["gain_share"] == 0.0 and "gain_share" not in found[3]
    assert "gain_share" not in against_controls(rows[2:])[0]
