"""Garment encoder of GSNet: from a template's mesh and material to what all frames share (Peng 2023, section 3.2).

In: garment graphs and materials. Out: ``Encoding``. ``L_n X`` takes away where a vertex is, so the encoder of our own
network keeps X beside what the neighbours hand on; the published one does not.

Dimensions: B materials, N garment vertices, K edges a vertex.
"""

from __future__ import annotations

from collections.abc import Sequence as Many
from dataclasses import dataclass, fields
from itertools import pairwise

import torch
from torch import Tensor, nn

from models.garment_graph import GarmentGraph, propagate


@dataclass(frozen=True)
class Encoding:
    """A garment in B materials, as it is kept for all frames.

    Attributes:
        skin: Of linear blend skinning, shape [B, N, 96].
        weight: The weights in it, shape [B, N, 24].
        edges: Weights of the edges from the joints, shape [B, N, K]; in ``PublishedGSNet`` K = 24.
        gram: What a message along the edges leaves in the pooled memory, shape [B, K, K].
        code: Of the whole garment, shape [B, width].
        local: What the physical regressor knows of each vertex, shape [B, N, 16].
    """

    skin: Tensor
    weight: Tensor
    edges: Tensor
    gram: Tensor
    code: Tensor
    local: Tensor

    def repeat(self, times: int) -> Encoding:
        """Each material ``times`` times in a row."""
        return Encoding(*(getattr(self, f.name).repeat_interleave(times, dim=0) for f in fields(self)))


class GarmentEncoder(nn.Module):
    """Three graph convolutions ``sigma(L_n X W + b)`` and the maximum over the vertices beside each (Peng 2023, 3.2).

    Args:
        inputs: Features of a vertex.
        width: Of each convolution.
        keep: Whether a vertex keeps its own features beside what the neighbours hand on: ``sigma(X V + (I - L_n) X W +
            b)``, the same span of operators. Without, as published, a feature that is the same everywhere is lost.
    """

    def __init__(self, inputs: int, width: int, keep: bool) -> None:
        super().__init__()
        self.keep = keep
        sizes = (inputs, width, width, width)
        self.layers = nn.ModuleList(nn.Linear(2 * a if keep else a, b) for a, b in pairwise(sizes))

    def forward(self, graph: GarmentGraph, rows: Tensor) -> Tensor:
        """Features [N, B, 2 width] of vertex features [N, B, inputs]."""
        for layer in self.layers:
            if self.keep:
                rows = torch.cat([rows, propagate(graph.neighbours, rows)], dim=2)
            else:
                rows = propagate(graph.laplacian, rows)
            rows = nn.functional.gelu(layer(rows))
        return torch.cat([rows, rows.amax(0, keepdim=True).expand_as(rows)], dim=2)


def fully_connected(inputs: int, hidden: Many[int], outputs: int) -> nn.Sequential:
    """Linear layers with GELU between them."""
    sizes = (inputs, *hidden, outputs)
    layers: list[nn.Module] = []
    for before, after in pairwise(sizes):
        layers += [nn.Linear(before, after), nn.GELU()]
    return nn.Sequential(*layers[:-1])
