"""Garment regressor without a garment state: an MLP from the recent motion (variant ``window``).

In: scaled motion features. Out: shape codes. The features of the current and of some past frames, closer together near
the present, go side by side into a fully connected network. What it gives for a frame depends on the motion up to that
frame alone: it cannot drift, takes sequences of any length, and needs no roll-out in training, so that its batches are
random single frames. It cannot know what the motion does not tell, such as which way a skirt has caught on a knee.

What the trained network leaves over on its own motions is put back by a ``KernelCorrection`` on the same windows.

Dimensions: B sequences, L lead-in and T wanted frames, D features, K code size, W numbers of a window.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import torch
from torch import Tensor

from models.garment_regressor import Regressor, RegressorConfig
from models.kernel_correction import KernelCorrection


class WindowRegressor(Regressor):
    """Fully connected network over a window of past motion, and its correction where ``config.centres`` says so."""

    def __init__(self, config: RegressorConfig, faces: np.ndarray) -> None:
        super().__init__(config, faces)
        self.network = self.direct_network()
        self.correction = self._correction(config.centres) if config.centres else None

    def unroll(self, features: Tensor, lead: int) -> Tensor:
        """Codes [B, T, K] of scaled features [B, L + T, D]."""
        windows = self.windows(features)[:, lead:]
        codes = self.network(windows).float()
        return codes if self.correction is None else codes + self.correction(windows)

    @torch.no_grad()
    def correct(self, windows: Tensor, codes: Tensor) -> None:
        """Fit the correction to what the network lacks at training windows [n, W] of codes [n, K]; n goes to config."""
        correction = self._correction(len(windows)).to(windows.device)
        correction.fit(windows, codes - torch.cat([self.network(block).float() for block in windows.split(4096)]))
        self.correction, self.config = correction, replace(self.config, centres=len(windows))

    def _correction(self, centres: int) -> KernelCorrection:
        return KernelCorrection(centres, self.input_size, self.shape.size)
