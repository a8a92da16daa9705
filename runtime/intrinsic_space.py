"""The space of intrinsic parameters of a finished run's garment: shapes go in, shapes of any motion come out.

In: garments with the motion under them, intrinsic parameters, or seeds. Out: latents z, which hold what a garment is
made of and not how its wearer moves (Wang 2019, section 3.4), and garments decoded from them along motions.

Dimensions: T frames, V garment vertices, C descriptor, D signature, Z latent. Garments are in canonical frames [m].
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import cached_property

import numpy as np
import torch

from models.intrinsic_fitting import decode_frames, frame_evidence, pooled
from models.motion_features import MotionTrack
from models.motion_history import MotionHistory
from models.motion_invariant import MotionInvariantNetwork
from models.parameter_groups import GROUPS, scale_values, with_groups
from models.pooled_latent import PooledNetwork
from models.same_phi import IntrinsicFrames
from models.shape_descriptor import ShapeDescriptor, decode_all, encode_all
from runtime.finished_run import LearnedGarment
from sim.parameters import INTRINSIC_PARAMETERS

LOGARITHMIC = {p.name for p in INTRINSIC_PARAMETERS if p.logarithmic} | set(GROUPS)
_SHARED = {p.name for p in INTRINSIC_PARAMETERS if p.shared}
_BLIND = ("motion-only", "parameters")
"""Controls, which take no z from a shape."""


class IntrinsicSpace:
    """Shape descriptor and motion-invariant autoencoder of a garment, put to use.

    Args:
        garment: Garment of a finished run.

    Raises:
        ValueError: A model is missing, damaged, of another garment, or one that finds no z.
    """

    def __init__(self, garment: LearnedGarment) -> None:
        self.garment = garment
        self.descriptor: ShapeDescriptor = garment.descriptor
        self.network: MotionInvariantNetwork = garment.autoencoder
        if self.network.weights.network in _BLIND:
            raise ValueError(
                f"{garment.run.folder}: the autoencoder in use, '{self.network.config.variant}', is a control that "
                "finds no z in a shape; use 'pooled' or 'paper'"
            )
        self._check_ranges()

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Intrinsic parameters that the autoencoder was told of, products of them included, in its order."""
        base, ranges = self.garment.base_parameters, self.garment.ranges
        own = [name for name in base if name not in _SHARED and name in ranges and ranges[name][0] < ranges[name][1]]
        groups = [name for name in with_groups(base) if name in GROUPS and set(GROUPS[name]) & set(own)]
        names, told = (*own, *groups), len(self.network.parameter_mean)
        if len(names) != told:
            raise ValueError(
                f"{self.garment.run.folder}: the autoencoder of '{self.garment.name}' was told {told} parameters, the "
                f"configuration samples {len(names)}; run `snakemake all`"
            )
        return names

    @property
    def tellable(self) -> tuple[str, ...]:
        """Parameters that may be set: those of ``names`` that are not products of others."""
        return tuple(name for name in self.names if name not in GROUPS)

    def _check_ranges(self) -> None:
        """``ValueError`` where the autoencoder was told of materials that this garment is not sampled from: then it is
        another garment's, whose shapes are described by as many numbers."""
        means = self.network.parameter_mean.tolist()
        for name, mean in zip(self.names, means, strict=True):
            if name in GROUPS:
                continue
            ends = [scale_values({name: end}, LOGARITHMIC)[0] for end in self.garment.ranges[name]]
            room = 0.1 * (ends[1] - ends[0])
            if not ends[0] - room <= mean <= ends[1] + room:
                told = np.exp(mean) if name in LOGARITHMIC else mean
                low, high = self.garment.ranges[name]
                raise ValueError(
                    f"{self.garment.run.folder}: the autoencoder of '{self.garment.name}' was trained on {name} around "
                    f"{told:.3g}, this garment is sampled from {low:g} to {high:g}; it is another garment's or an "
                    "older run's, run `snakemake all`"
                )

    def signatures(self, track: MotionTrack) -> np.ndarray:
        """Motion signatures [T, D] of a track of the run's own body."""
        return MotionHistory([track], self.network.config.signature, self.network.config.window)[:]

    def of_parameters(self, parameters: Mapping[str, float] | None = None) -> np.ndarray:
        """z [Z] that intrinsic parameters have; that of the base material where none are given.

        Raises:
            ValueError: The autoencoder in use has no way from parameters to z.
        """
        network = self.network
        if not isinstance(network, PooledNetwork):
            raise ValueError(
                f"{self.garment.run.folder}: the autoencoder in use, '{network.config.variant}', knows shapes alone; "
                "give keyframes as meshes, or use 'pooled'"
            )
        known = with_groups(self.garment.base_parameters if parameters is None else parameters)
        values = scale_values({name: known[name] for name in self.names}, LOGARITHMIC)
        with torch.no_grad():
            return network.known_latent(torch.as_tensor(values, dtype=torch.float32)[None])[0].numpy()

    def candidate(self, seed: int) -> np.ndarray:
        """z [Z] drawn from the part of the space that the training materials fill; a function of the seed."""
        return self.of_parameters(self.garment.sampled_parameters(seed, 1))

    def encode(self, canonical: np.ndarray, signatures: np.ndarray) -> np.ndarray:
        """One z [Z] of the evidence of frames ``canonical [n, V, 3]`` under ``signatures [n, D]``."""
        values, weights = self.evidence(canonical, signatures)
        return pooled(self.network, values, weights)

    def evidence(self, canonical: np.ndarray, signatures: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """What each frame says of z and how sure it is: values and weights, [n, Z] each."""
        count = len(canonical)
        nothing = np.zeros(count, dtype=np.int64)
        untold = np.zeros((count, len(self.network.parameter_mean)), dtype=np.float32)
        codes = encode_all(self.descriptor, canonical)
        return frame_evidence(self.network, IntrinsicFrames(codes, signatures, nothing, nothing, untold))

    def decode(self, latents: np.ndarray, signatures: np.ndarray) -> np.ndarray:
        """Canonical garments [n, V, 3] of ``latents [n, Z]``, or one for all, under ``signatures [n, D]``."""
        return decode_all(self.descriptor, decode_frames(self.network, latents, signatures))
