"""Garment regressor with a memory of the motion alone: a GRU (variant ``gru``).

In: scaled motion features. Out: shape codes. The network runs through the lead-in as well, so that its memory is warm
at the first wanted frame. It never sees a garment, its own or a true one: errors cannot feed on themselves, sequences
may have any length, and what it keeps of the past is learned instead of cut off at a window.

Dimensions: B sequences, L lead-in and T wanted frames, D features, K code size.
"""

from __future__ import annotations

import numpy as np
from torch import Tensor, nn

from models.garment_regressor import Regressor, RegressorConfig


class RecurrentRegressor(Regressor):
    """Gated recurrent units over the motion (Cho 2014)."""

    def __init__(self, config: RegressorConfig, faces: np.ndarray) -> None:
        super().__init__(config, faces)
        self.memory = nn.GRU(self.input_size, config.width, config.layers, batch_first=True)
        self.out = nn.Sequential(nn.Dropout(config.dropout), nn.Linear(config.width, self.shape.size))

    def unroll(self, features: Tensor, lead: int) -> Tensor:
        """Codes [B, T, K] of scaled features [B, L + T, D]."""
        remembered, _ = self.memory(self.windows(features))
        return self.out(remembered[:, lead:]).float()
