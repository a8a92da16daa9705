"""Transformer encoder and decoder over garment sequences (Shi 2023, section 3.3; variants ``paper`` and ``steady``).

In: scaled motion features. Out: shape codes, one frame after the other, each from the past ones and the motion.
The start token (BOS) comes from an MLP that is trained first, on its own, and then frozen, or is zero.

Dimensions: B sequences, L lead-in and T wanted frames, F = L + T, D features, d width, K code size.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import torch
from torch import Tensor, nn

from models.garment_regressor import Regressor, RegressorConfig
from models.transformer import (
    DecoderLayer,
    DistanceBias,
    EncoderLayer,
    KeyValueCache,
    causal_mask,
    sinusoidal_positions,
)


class SequenceRegressor(Regressor):
    """The Transformer encoder and decoder of Shi 2023 (variants ``paper`` and ``steady``)."""

    def __init__(self, config: RegressorConfig, faces: np.ndarray) -> None:
        super().__init__(config, faces)
        c, size = config, self.shape.size
        sizes = (c.width, c.heads, c.feed_forward, c.dropout)
        self.pose_in = nn.Linear(self.input_size, c.width)
        self.encoder = nn.ModuleList(EncoderLayer(*sizes) for _ in range(c.layers))
        self.garment_in = nn.Linear(size, c.width)
        self.decoder = nn.ModuleList(DecoderLayer(*sizes) for _ in range(c.layers))
        self.garment_out = nn.Linear(c.width, size)
        self.direct = self.direct_network() if c.window_hidden else None
        self.bos = None if c.bos_target == "none" else mlp((self.feature_size, *c.bos_hidden, size))
        if c.attention_window:
            self.biases = nn.ModuleDict(
                {name: DistanceBias(c.heads, c.attention_window) for name in ("encoder", "self", "cross")}
            )

    def first_token(self, features: Tensor, lead: int) -> Tensor:
        """Code [B, K] of the frame before the first: of the mean pose (``paper``) or of the first wanted frame."""
        wanted = features[:, lead:]
        if self.bos is None:
            return features.new_zeros(len(features), self.shape.size)
        return self.bos(wanted.mean(1) if self.config.bos_target == "last" else wanted[:, 0])

    def encode_motion(self, features: Tensor, lead: int) -> Tensor:
        """Encoded motion [B, F, d]: of the wanted frames (``paper``), or of the lead-in as well."""
        windowed = self.config.attention_window > 0
        x = self.windows(features)
        x = self.pose_in(x if windowed else x[:, lead:])
        bias = self._bias("encoder", self._frames(x), self._frames(x))
        if not windowed:
            x = x + sinusoidal_positions(x.shape[1], x.shape[2], x.device)
        for layer in self.encoder:
            x = layer(x, bias)
        return x

    def straight(self, features: Tensor, lead: int) -> Tensor | float:
        """Codes [B, T, K] of the path beside the decoder; 0 where there is none."""
        return 0.0 if self.direct is None else self.direct(self.windows(features)[:, lead:])

    def predict_all(self, features: Tensor, past: Tensor, lead: int) -> Tensor:
        """Codes [B, T, K] of all wanted frames of scaled features [B, F, D], given those of the frames before each."""
        decoded = self.decode_all(self.encode_motion(features, lead), past, lead)
        return decoded + self.straight(features, lead)

    def decode_all(self, memory: Tensor, past: Tensor, lead: int) -> Tensor:
        """The decoder's codes [B, t, K] of the frames 1..t at once, given those of the frames 0..t-1 (0 is the BOS).

        ``memory`` is the encoded motion of ``encode_motion`` for a track with ``lead`` frames of lead-in.
        """
        frames = past.shape[1]
        x = self.garment_in(past)
        own, keys = self._frames(x) + lead, self._frames(memory)
        if self.config.attention_window:
            self_bias, cross_bias = self._bias("self", own, own), self._bias("cross", own, keys)
        else:
            x = x + sinusoidal_positions(frames, x.shape[2], x.device)
            self_bias, cross_bias = causal_mask(frames, x.device), None
        for layer in self.decoder:
            x = layer(x, memory, self_bias, cross_bias)
        return self.garment_out(x).float()

    def unroll(self, features: Tensor, lead: int, start: Tensor | None = None) -> Tensor:
        """Greedy auto-regressive codes [B, T, K] with a cache of keys and values, from ``start [B, K]`` or the BOS.

        A frame's output is only needed as the next frame's embedding while the sequence runs, so ``W_in W_out`` is
        folded into one d x d matrix and all shapes are put out by a single product at the end.
        """
        window = self.config.attention_window
        memory = self.encode_motion(features, lead)
        frames, numbers = features.shape[1] - lead, self._frames(memory)
        first = len(numbers) - frames
        folded = self.garment_in.weight @ self.garment_out.weight
        folded_bias = self.garment_in.weight @ self.garment_out.bias + self.garment_in.bias
        projected = [layer.cross_attention.keys_values(memory) for layer in self.decoder]
        caches = [KeyValueCache(window or None) for _ in self.decoder]
        positions = None if window else sinusoidal_positions(frames, self.config.width, memory.device)
        token = self.garment_in(self.first_token(features, lead) if start is None else start)[:, None]
        straight = self.straight(features, lead)
        beside = straight @ self.garment_in.weight.T if isinstance(straight, Tensor) else None
        outputs = []
        for t in range(frames):
            x = token if positions is None else token + positions[t]
            self_bias = cross_bias = None
            low, high = 0, len(numbers)
            now = numbers[first + t : first + t + 1]
            if window:
                low, high = max(0, first + t + 1 - window), first + t + 1
                self_bias = self._bias("self", now, numbers[max(first, low) : high])
                cross_bias = self._bias("cross", now, numbers[low:high])
            for layer, cache, (keys, values) in zip(self.decoder, caches, projected, strict=True):
                reach = (keys[:, :, low:high], values[:, :, low:high])
                x = layer.step(x, cache, reach, self_bias, cross_bias)
            outputs.append(x)
            token = x @ folded.T + folded_bias
            if beside is not None:
                token = token + beside[:, t : t + 1]
        return (self.garment_out(torch.cat(outputs, dim=1)) + straight).float()

    def _bias(self, name: str, queries: Tensor, keys: Tensor) -> Tensor | None:
        return self.biases[name](queries, keys) if self.config.attention_window else None

    @staticmethod
    def _frames(x: Tensor) -> Tensor:
        return torch.arange(x.shape[1], device=x.device)


def mlp(sizes: tuple[int, ...]) -> nn.Sequential:
    """Linear layers with ReLU between them."""
    layers: list[nn.Module] = []
    for before, after in pairwise(sizes):
        layers += [nn.Linear(before, after), nn.ReLU()]
    return nn.Sequential(*layers[:-1])
