"""What z knows of the parameters, and how much each of them shapes the garment.

In: a trained motion-invariant network, frames, and the parameters by name. Out: R^2 of a ridge regression from z to
each parameter, and how far the garment moves with it. Groups of parameters (``models.parameter_groups``) are told like
parameters.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping

import numpy as np

from evaluation.intrinsic import ReadFrames
from evaluation.ridge import Ridge
from evaluation.table import Row
from models.intrinsic_fitting import decode_frames
from models.motion_invariant import MotionInvariantNetwork
from models.parameter_groups import scale_value, with_groups
from models.same_phi import IntrinsicFrames
from models.shape_descriptor import ShapeDescriptor, decode_all

HELD_OUT_EVERY = 5
"""Every fifth training phi chooses the penalty of the regression from z to the parameters."""
EFFECT_FRAMES = 200
"""Frames, spread evenly over the test frames, on which the effect of a parameter is measured."""


def recovery_rows(
    training: ReadFrames,
    tests: Mapping[str, ReadFrames],
    parameters: Mapping[int, Mapping[str, float]],
    logarithmic: Collection[str] = (),
) -> list[Row]:
    """R^2 of a ridge regression from the z of a sequence to each (log) intrinsic parameter.

    Fitted to the training sequences, its penalty chosen on held-out training phi. ``r_squared`` is 1 - squared error
    over the squared deviation from the test mean, so below 0 is worse than a constant; ``r_squared_of_sets`` is that of
    the mean prediction over the sequences of a phi.

    Args:
        training: Sequences that the regression learns from, read by the network that is evaluated.
        tests: Sequences of phi (and motions) that it has not seen, by split.
        parameters: Values by name, by number of the parameter set; names that do not vary in training are left out.
        logarithmic: Names that are regressed as their logarithm.
    """
    names = list(next(iter(parameters.values())))
    values = {
        phi: np.array([scale_value(p[name], name in logarithmic) for name in names]) for phi, p in parameters.items()
    }
    x, phi = training.sequence_latents()
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
        x_test, phi_test = frames.sequence_latents()
        truth = (np.stack([values[p] for p in phi_test])[:, varied] - centre) / spread
        predicted = ridge.predict(x_test)
        single = _r_squared(predicted, truth)
        sets = np.unique(phi_test)
        means = [np.stack([a[phi_test == p].mean(axis=0) for p in sets]) for a in (predicted, truth)]
        of_sets = _r_squared(*means)
        for k, column in enumerate(varied):
            rows.append(
                {
                    "split": split,
                    "parameter": names[column],
                    "logarithm": names[column] in logarithmic,
                    "r_squared": single[k],
                    "r_squared_of_sets": of_sets[k],
                    "phi_count": len(sets),
                    "sequences": len(phi_test),
                }
            )
    return rows


def effects_mm(
    descriptor: ShapeDescriptor,
    network: MotionInvariantNetwork,
    frames: IntrinsicFrames,
    names: Collection[str],
    logarithmic: Collection[str],
    base: Mapping[str, float],
    spreads: Mapping[str, float],
) -> dict[str, float]:
    """How far the garment moves when one parameter goes from one deviation below its middle to one above, halved [mm].

    Measured with the network that is given the true parameters ("true-parameters"), RMS over vertices and frames.

    Args:
        descriptor: The shape descriptor below the network.
        network: Of variant "true-parameters".
        frames: Motions to measure on.
        names: Parameters, in the order of ``frames.parameters``, groups included.
        logarithmic: Those on a logarithmic scale.
        base: Middle of each plain parameter, as a value.
        spreads: Deviation of each varied plain parameter on its scale.
    """
    rows = np.unique(np.linspace(0, len(frames.phi) - 1, EFFECT_FRAMES).astype(np.int64))
    signatures = frames.signatures[rows]
    found = {}
    for name, spread in spreads.items():
        ends = []
        for sign in (-1.0, 1.0):
            moved = base[name] * np.exp(sign * spread) if name in logarithmic else base[name] + sign * spread
            values = with_groups({**base, name: float(moved)})
            vector = np.array([scale_value(values[n], n in logarithmic) for n in names])
            shapes = IntrinsicFrames(
                frames.descriptors[rows],
                signatures,
                frames.phi[rows],
                frames.clip[rows],
                np.broadcast_to(vector, (len(rows), len(vector))),
            )
            latents, _ = ReadFrames.of(network, shapes).sequence_latents()
            ends.append(decode_all(descriptor, decode_frames(network, latents[0], signatures)))
        found[name] = 0.5e3 * float(np.sqrt(np.square(ends[1] - ends[0]).sum(-1).mean()))
    return found


def _r_squared(predicted: np.ndarray, truth: np.ndarray) -> list[float | None]:
    error = np.sum((predicted - truth) ** 2, axis=0)
    total = np.sum((truth - truth.mean(axis=0)) ** 2, axis=0)
    return [float(1.0 - e / t) if t > 1e-12 else None for e, t in zip(error, total, strict=True)]
