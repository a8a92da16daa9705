"""Garment regressor without a garment state: an MLP from the recent motion (variant ``window``).

In: scaled motion features. Out: shape codes. The features of the current and of some past frames, closer together near
the present, go side by side into a fully connected network. What it gives for a frame depends on the motion up to that
frame alone: it cannot drift, takes sequences of any length, and needs no roll-out in training, so that its batches are
random single frames. It cannot know what the motion does not tell, such as which way a skirt has caught on a knee.

Dimensions: B sequences, L lead-in and T wanted frames, D features, K code size.
"""

from __future__ import annotations

import numpy as np
from torch import Tensor

from models.garment_regressor import Regressor, RegressorConfig


class WindowRegressor(Regressor):
    """Fully connected network over a window of past motion."""

    def __init__(self, config: RegressorConfig, faces: np.ndarray) -> None:
        super().__init__(config, faces)
        self.network = self.direct_network()

    def unroll(self, features: Tensor, lead: int) -> Tensor:
        """Codes [B, T, K] of scaled features [B, L + T, D]."""
        return self.network(self.windows(features)[:, lead:]).float()
