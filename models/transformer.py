"""Transformer layers shared by the motion generator and the garment regressor (Shi 2023, sections 3.2 and 3.3).

They are the layers of Vaswani 2017 with ReLU and, as in PyTorch's own, the normalization after the residual sum. They
are written out here because a garment sequence is decoded frame by frame, which needs the keys and values of the past
frames to be kept (``KeyValueCache``), and because sequences of any length need attention by distance
(``DistanceBias``) instead of by absolute position.

Dimensions: B sequences, T frames, d width, H heads.
"""

from __future__ import annotations

import math

import torch
import torch.nn.functional as F
from torch import Tensor, nn


def sinusoidal_positions(frames: int, width: int, device: torch.device | None = None) -> Tensor:
    """Fixed position codes of Vaswani 2017, shape [frames, width]; ``width`` must be even."""
    if width % 2:
        raise ValueError(f"sinusoidal positions need an even width, got {width}")
    time = torch.arange(frames, dtype=torch.float32, device=device)[:, None]
    rate = torch.exp(torch.arange(0, width, 2, dtype=torch.float32, device=device) * (-math.log(10000.0) / width))
    return torch.stack([torch.sin(time * rate), torch.cos(time * rate)], dim=-1).reshape(frames, width)


def causal_mask(frames: int, device: torch.device | None = None) -> Tensor:
    """Additive mask, shape [frames, frames]: 0 for the present and the past, -inf for the future."""
    return torch.full((frames, frames), -math.inf, device=device).triu(1)


class DistanceBias(nn.Module):
    """Learned bias a head for each distance into the past; nothing is seen beyond ``window`` frames or in the future.

    It depends on distances alone, so that a sequence of any length is decoded as those of the training were.
    """

    def __init__(self, heads: int, window: int) -> None:
        super().__init__()
        self.window = window
        # Starts with a gentle preference for the near past, as in ALiBi (Press 2022).
        slopes = torch.linspace(0.0, 1.0, heads)[:, None]
        self.table = nn.Parameter(-slopes * torch.arange(window, dtype=torch.float32)[None, :] / 8.0)

    def forward(self, queries: Tensor, keys: Tensor) -> Tensor:
        """Additive bias, shape [H, Tq, Tk], for frame numbers ``queries [Tq]`` and ``keys [Tk]``."""
        distance = queries[:, None] - keys[None, :]
        bias = self.table[:, distance.clamp(0, self.window - 1)]
        return bias.masked_fill((distance < 0) | (distance >= self.window), -math.inf)


class Attention(nn.Module):
    """Multi-head attention with separate projections, so that keys and values can be projected once and kept."""

    def __init__(self, width: int, heads: int, dropout: float) -> None:
        super().__init__()
        if width % heads:
            raise ValueError(f"attention: width {width} is not a multiple of {heads} heads")
        self.heads, self.dropout = heads, dropout
        self.query = nn.Linear(width, width)
        self.key = nn.Linear(width, width)
        self.value = nn.Linear(width, width)
        self.output = nn.Linear(width, width)

    def keys_values(self, memory: Tensor) -> tuple[Tensor, Tensor]:
        """Keys and values [B, H, T, d/H] of ``memory [B, T, d]``."""
        return self._split(self.key(memory)), self._split(self.value(memory))

    def attend(self, x: Tensor, keys: Tensor, values: Tensor, bias: Tensor | None) -> Tensor:
        """Attend from ``x [B, Tq, d]`` to projected keys and values under an additive ``bias [(H,) Tq, Tk]``."""
        dropout = self.dropout if self.training else 0.0
        query = self._split(self.query(x))
        if bias is not None:
            bias = bias.to(query.dtype)
        mixed = F.scaled_dot_product_attention(query, keys, values, attn_mask=bias, dropout_p=dropout)
        return self.output(mixed.transpose(1, 2).flatten(2))

    def forward(self, x: Tensor, memory: Tensor, bias: Tensor | None = None) -> Tensor:
        """Attend from ``x [B, Tq, d]`` to ``memory [B, Tk, d]``."""
        return self.attend(x, *self.keys_values(memory), bias)

    def _split(self, x: Tensor) -> Tensor:
        return x.unflatten(-1, (self.heads, -1)).transpose(1, 2)


class FeedForward(nn.Sequential):
    """Position-wise network: d -> hidden -> d with ReLU."""

    def __init__(self, width: int, hidden: int, dropout: float) -> None:
        super().__init__(nn.Linear(width, hidden), nn.ReLU(), nn.Dropout(dropout), nn.Linear(hidden, width))


class EncoderLayer(nn.Module):
    """Self-attention and feed-forward, each with a residual and a normalization after it."""

    def __init__(self, width: int, heads: int, hidden: int, dropout: float) -> None:
        super().__init__()
        self.attention = Attention(width, heads, dropout)
        self.feed_forward = FeedForward(width, hidden, dropout)
        self.norms = nn.ModuleList(nn.LayerNorm(width) for _ in range(2))
        self.dropout = nn.Dropout(dropout)

    def forward(self, x: Tensor, bias: Tensor | None = None) -> Tensor:
        """Map ``x [B, T, d]`` to the same shape."""
        x = self.norms[0](x + self.dropout(self.attention(x, x, bias)))
        return self.norms[1](x + self.dropout(self.feed_forward(x)))


class KeyValueCache:
    """Keys and values of the frames decoded so far, of one attention: [B, H, t, d/H], at most ``window`` of them."""

    def __init__(self, window: int | None = None) -> None:
        self.window = window
        self.keys: Tensor | None = None
        self.values: Tensor | None = None

    def append(self, keys: Tensor, values: Tensor) -> tuple[Tensor, Tensor]:
        """Add the keys and values of a new frame; returns all that are kept."""
        if self.keys is not None and self.values is not None:
            keys, values = torch.cat([self.keys, keys], dim=2), torch.cat([self.values, values], dim=2)
        if self.window is not None:
            keys, values = keys[:, :, -self.window :], values[:, :, -self.window :]
        self.keys, self.values = keys, values
        return keys, values


class DecoderLayer(nn.Module):
    """Causal self-attention, cross-attention to the encoded poses, and feed-forward."""

    def __init__(self, width: int, heads: int, hidden: int, dropout: float) -> None:
        super().__init__()
        self.self_attention = Attention(width, heads, dropout)
        self.cross_attention = Attention(width, heads, dropout)
        self.feed_forward = FeedForward(width, hidden, dropout)
        self.norms = nn.ModuleList(nn.LayerNorm(width) for _ in range(3))
        self.dropout = nn.Dropout(dropout)

    def forward(self, x: Tensor, memory: Tensor, self_bias: Tensor | None, cross_bias: Tensor | None) -> Tensor:
        """Map ``x [B, T, d]`` to the same shape, all frames at once (training)."""
        x = self.norms[0](x + self.dropout(self.self_attention(x, x, self_bias)))
        x = self.norms[1](x + self.dropout(self.cross_attention(x, memory, cross_bias)))
        return self.norms[2](x + self.dropout(self.feed_forward(x)))

    def step(
        self,
        x: Tensor,
        cache: KeyValueCache,
        memory: tuple[Tensor, Tensor],
        self_bias: Tensor | None,
        cross_bias: Tensor | None,
    ) -> Tensor:
        """Map one frame ``x [B, 1, d]``, given the cache of the past frames and the projected ``memory``."""
        keys, values = cache.append(*self.self_attention.keys_values(x))
        x = self.norms[0](x + self.dropout(self.self_attention.attend(x, keys, values, self_bias)))
        x = self.norms[1](x + self.dropout(self.cross_attention.attend(x, *memory, cross_bias)))
        return self.norms[2](x + self.dropout(self.feed_forward(x)))
