"""Does z hold the material and not the motion? (Wang 2019, section 4 (ii), Fig. 10 and 11, with the controls it lacks.)

In: a trained motion-invariant network, the shape descriptor below it, and frames with their simulated garments in the
canonical frame. Out: rows of transfer errors against the simulation, of the latent's variance ratio, and of how well
each intrinsic parameter can be read from z. A sequence is the run of frames with one phi and one clip.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping

import numpy as np

from evaluation.metrics import rmse
from evaluation.ridge import Ridge
from evaluation.table import Row
from models.motion_invariant import MotionInvariantNetwork, decode_frames, encode_frames
from models.same_phi import IntrinsicFrames
from models.shape_descriptor import ShapeDescriptor, decode_all

HELD_OUT_EVERY = 5
"""Every fifth training phi chooses the penalty of the regression from z to the parameters."""


def transfer_rows(
    descriptor: ShapeDescriptor,
    network: MotionInvariantNetwork,
    frames: IntrinsicFrames,
    vertices: np.ndarray,
    training: IntrinsicFrames,
    split: str,
    sources: IntrinsicFrames | None = None,
    seed: int = 0,
) -> list[Row]:
    """Errors of decoding each sequence's motion with a z from elsewhere, against its own simulation.

    Args:
        descriptor: The frozen shape descriptor that made the frames' descriptors.
        network: What is evaluated.
        frames: Test frames, in time order within a sequence.
        vertices: Their simulated garments [m], shape [N, V, 3].
        training: The network's training frames: the mean z and the mean shape of the controls come from them.
        split: Name for the rows.
        sources: Frames that z may be taken from where the split holds a phi with one clip only (default: ``frames``).
        seed: Of the choice of single frames and wrong phi.

    Returns:
        Rows with ``rmse_mm`` (root mean square over vertices and frames of a sequence, mean over sequences):
        "descriptor floor" (encoded and decoded without this network), "own reconstruction", "transfer, z of a clip"
        (mean z of another clip of the same phi), "transfer, z of one frame" (of that clip), "wrong phi, z of a clip"
        (the same clip under another phi, where there is one), "motion only, mean z" (one z for all), "mean shape"
        (the decoded mean descriptor).

    Raises:
        ValueError: no sequence has a second clip with its phi, or shapes disagree.
    """
    if len(vertices) != len(frames.descriptors):
        raise ValueError(f"transfer: {len(frames.descriptors)} frames, but {len(vertices)} garments")
    sources = frames if sources is None else sources
    generator = np.random.default_rng(seed)
    own = encode_frames(network, frames.descriptors, frames.signatures)
    pool = own if sources is frames else encode_frames(network, sources.descriptors, sources.signatures)
    mean_latent = encode_frames(network, training.descriptors, training.signatures).mean(axis=0)
    mean_descriptor = training.descriptors.mean(axis=0, keepdims=True)
    runs = sequences_of(sources)
    errors: dict[str, list[float]] = {}

    for (phi, clip), index in sequences_of(frames).items():
        others = [key for key in runs if key[0] == phi and key[1] != clip]
        if not others:
            continue
        source = runs[others[generator.integers(len(others))]]
        wrong = _wrong_phi(runs, phi, sources.clip[source[0]], generator)
        truth, signatures = vertices[index], frames.signatures[index]
        latents: dict[str, np.ndarray] = {
            "own reconstruction": own[index],
            "transfer, z of a clip": pool[source].mean(axis=0),
            "transfer, z of one frame": pool[generator.choice(source)],
        }
        if wrong is not None:
            latents["wrong phi, z of a clip"] = pool[wrong].mean(axis=0)
        latents["motion only, mean z"] = mean_latent
        predictions = {name: decode_frames(network, z, signatures) for name, z in latents.items()}
        predictions = {"descriptor floor": frames.descriptors[index], **predictions}
        predictions["mean shape"] = np.repeat(mean_descriptor, len(index), axis=0)
        for name, codes in predictions.items():
            errors.setdefault(name, []).append(rmse(decode_all(descriptor, codes), truth))
    if not errors:
        raise ValueError(f"transfer, split {split}: no parameter set has two clips, so there is nothing to transfer")
    labels = {"split": split, "variant": network.config.variant}
    return [
        {**labels, "quantity": name, "rmse_mm": 1e3 * float(np.mean(values)), "sequences": len(values)}
        for name, values in errors.items()
    ]


def variance_row(network: MotionInvariantNetwork, frames: IntrinsicFrames, split: str) -> Row:
    """Variance of z within one phi over the variance of its means across phi; 0 = motion-invariant.

    ``ratio`` is of single frames, ``clip_ratio`` of the mean z of each sequence. None with fewer than two phi, or where
    z does not vary at all.
    """
    latents = encode_frames(network, frames.descriptors, frames.signatures)
    runs = sequences_of(frames)
    means = np.stack([latents[index].mean(axis=0) for index in runs.values()])
    owners = np.array([phi for phi, _ in runs])
    return {
        "split": split,
        "variant": network.config.variant,
        "phi_count": len(np.unique(frames.phi)),
        "ratio": variance_ratio(latents, np.asarray(frames.phi)),
        "clip_ratio": variance_ratio(means, owners),
    }


def variance_ratio(latents: np.ndarray, phi: np.ndarray) -> float | None:
    """Mean variance within a phi over the variance of the phi's means, both summed over the numbers of z [N, Z]."""
    values = np.unique(phi)
    if len(values) < 2:
        return None
    within = np.mean([latents[phi == value].var(axis=0).sum() for value in values])
    across = np.stack([latents[phi == value].mean(axis=0) for value in values]).var(axis=0).sum()
    return float(within / across) if across > 1e-12 else None


def recovery_rows(
    network: MotionInvariantNetwork,
    training: IntrinsicFrames,
    tests: Mapping[str, IntrinsicFrames],
    parameters: Mapping[int, Mapping[str, float]],
    logarithmic: Collection[str] = (),
) -> list[Row]:
    """R^2 of a ridge regression from the mean z of a sequence to each (log) intrinsic parameter.

    Fitted to the training sequences, its penalty chosen on held-out training phi. ``r_squared`` is 1 - squared error
    over the squared deviation from the test mean, so below 0 is worse than a constant.

    Args:
        network: What is evaluated.
        training: Sequences that the regression learns from.
        tests: Sequences of phi (and motions) that it has not seen, by split.
        parameters: Values by name, by number of the parameter set; names that do not vary in training are left out.
        logarithmic: Names that are regressed as their logarithm.
    """
    names = list(next(iter(parameters.values())))
    values = {phi: np.array([_value(p[name], name in logarithmic) for name in names]) for phi, p in parameters.items()}
    x, phi = _sequence_latents(network, training)
    y = np.stack([values[p] for p in phi])
    varied = np.flatnonzero(y.std(axis=0) > 1e-9)
    held_out = np.isin(phi, np.unique(phi)[HELD_OUT_EVERY - 1 :: HELD_OUT_EVERY])
    # In units of the training set: one penalty is chosen for all parameters, and their sizes differ by 1e8.
    centre, spread = y[:, varied].mean(axis=0), y[:, varied].std(axis=0)
    ridge = Ridge()
    ridge.add(x[~held_out], (y[~held_out][:, varied] - centre) / spread)
    if held_out.any():
        ridge.add(x[held_out], (y[held_out][:, varied] - centre) / spread, held_out=True)
    ridge.fit()
    rows: list[Row] = []
    for split, frames in tests.items():
        x_test, phi_test = _sequence_latents(network, frames)
        truth = (np.stack([values[p] for p in phi_test])[:, varied] - centre) / spread
        error = np.sum((ridge.predict(x_test) - truth) ** 2, axis=0)
        total = np.sum((truth - truth.mean(axis=0)) ** 2, axis=0)
        for k, column in enumerate(varied):
            rows.append(
                {
                    "split": split,
                    "variant": network.config.variant,
                    "parameter": names[column],
                    "logarithm": names[column] in logarithmic,
                    "r_squared": float(1.0 - error[k] / total[k]) if total[k] > 1e-12 else None,
                    "phi_count": len(np.unique(phi_test)),
                    "sequences": len(phi_test),
                }
            )
    return rows


def sequences_of(frames: IntrinsicFrames) -> dict[tuple[int, int], np.ndarray]:
    """Frame numbers of each (phi, clip), in the order of the data."""
    keys = np.stack([np.asarray(frames.phi), np.asarray(frames.clip)], axis=1)
    unique, inverse = np.unique(keys, axis=0, return_inverse=True)
    inverse = inverse.reshape(-1)
    return {(int(p), int(c)): np.flatnonzero(inverse == i) for i, (p, c) in enumerate(unique)}


def _wrong_phi(
    runs: Mapping[tuple[int, int], np.ndarray], phi: int, clip: int, generator: np.random.Generator
) -> np.ndarray | None:
    """A sequence of the source's clip under another phi; of any clip where that clip has no other."""
    strangers = [key for key in runs if key[0] != phi]
    same_clip = [key for key in strangers if key[1] == clip]
    chosen = same_clip or strangers
    return runs[chosen[generator.integers(len(chosen))]] if chosen else None


def _sequence_latents(network: MotionInvariantNetwork, frames: IntrinsicFrames) -> tuple[np.ndarray, np.ndarray]:
    latents = encode_frames(network, frames.descriptors, frames.signatures)
    runs = sequences_of(frames)
    return np.stack([latents[index].mean(axis=0) for index in runs.values()]), np.array([phi for phi, _ in runs])


def _value(value: float, logarithm: bool) -> float:
    return float(np.log(value)) if logarithm else float(value)
