"""A reader of intrinsic parameters, fitted to the frames that an autoencoder was trained on."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from datasets.codes import CodedSequence
from evaluation.parameter_reader import Evidence, ParameterReader
from models.intrinsic_fitting import frame_evidence
from models.motion_invariant import MotionInvariantNetwork
from models.parameter_groups import with_groups
from pipeline.intrinsic_data import LOGARITHMIC, all_codes, intrinsic_frames, varied_parameters

Parameters = dict[int, dict[str, float]]


def sequence_evidence(network: MotionInvariantNetwork, sequences: Sequence[CodedSequence]) -> list[Evidence]:
    """What the frames of each sequence say of z."""
    names = varied_parameters(list(sequences))
    frames = intrinsic_frames(list(sequences), all_codes(list(sequences)), network.config, names)
    values, weights = frame_evidence(network, frames)
    ends = np.cumsum([s.frames for s in sequences])[:-1]
    parts = zip(sequences, np.split(values, ends), np.split(weights, ends), strict=True)
    return [Evidence(value, weight, s.phi) for s, value, weight in parts]


def sequence_parameters(sequences: Sequence[CodedSequence], names: Sequence[str]) -> Parameters:
    """Values by name, by number of the parameter set."""
    return {s.phi: {name: with_groups(s.parameters)[name] for name in names} for s in sequences}


def fitted_reader(
    network: MotionInvariantNetwork, training: Sequence[CodedSequence], held_out: Sequence[CodedSequence]
) -> ParameterReader:
    """The reader that learns from training sequences of many materials, and is calibrated on held-out ones."""
    parameters = sequence_parameters([*training, *held_out], varied_parameters(list(training)))
    told = sequence_evidence(network, training), sequence_evidence(network, held_out) if held_out else []
    return ParameterReader(*told, parameters, LOGARITHMIC, network.prior)
