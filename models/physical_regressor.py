"""Physical regressor of GSNet: corrects the vertices inside the body, learns without truth (Peng 2023, section 3.4).

In: a garment's encoding, its vertices in a frame, the nearest points of the body. Out: corrected vertices [m].

Dimensions: S frames, N garment vertices.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import torch
from torch import Tensor, nn

from models.garment_animator import Animator
from models.garment_encoder import Encoding
from models.garment_graph import JOINTS, GarmentGraph
from models.gsnet_losses import heights

REACH = 0.1
"""Depth that counts as 1 [m]."""

Correction = Callable[[np.ndarray, np.ndarray, np.ndarray], np.ndarray]
"""From vertices, nearest body points and unit normals there, [N, 3] each [m], to corrected vertices [N, 3]."""


class PhysicalRegressor(nn.Module):
    """Corrects the vertices inside the body (Peng 2023, section 3.4).

    They form a graph with the joints, along the garment's skinning weights: joints gather what the vertices inside know
    and hand it on to them. It starts as the projection on the body and learns, without truth, what stretches and bends
    the garment less.
    """

    def __init__(self, width: int = 32) -> None:
        super().__init__()
        self.gather = nn.Linear(16 + 4, width)
        self.joints = nn.Linear(width, width)
        self.out = nn.Sequential(nn.Linear(2 * width, width), nn.GELU(), nn.Linear(width, 4))
        nn.init.zeros_(self.out[-1].weight)
        nn.init.zeros_(self.out[-1].bias)

    def forward(
        self, encoding: Encoding, rows: Tensor, vertices: Tensor, points: Tensor, normals: Tensor, margin: float
    ):
        """Corrected vertices [S, N, 3] [m] of S frames; those outside stay where they are.

        Args:
            encoding: Of the garment.
            rows: Which of its materials each frame is in, shape [S]; of one alone, it makes no difference.
            vertices: Canonical garment vertices [m], shape [S, N, 3].
            points, normals: Nearest body points and unit normals, shape [S, N, 3].
            margin: Distance from the body that is aimed at [m].
        """
        height = heights(vertices, points, normals)
        frame, vertex = torch.nonzero(height < 0.0, as_tuple=True)
        if len(frame) == 0:
            return vertices
        row, depth, normal = rows[frame] % len(encoding.local), height[frame, vertex], normals[frame, vertex]
        known = torch.cat([encoding.local[row, vertex], normal, depth[:, None] / REACH], dim=1)
        own, weight = nn.functional.gelu(self.gather(known)), encoding.weight[row, vertex]
        sent = (weight[:, :, None] * own[:, None, :]).flatten(1)
        gathered = sent.new_zeros(len(vertices), sent.shape[1]).index_add(0, frame, sent).unflatten(1, (JOINTS, -1))
        share = weight.new_zeros(len(vertices), JOINTS).index_add(0, frame, weight)
        joints = nn.functional.gelu(self.joints(gathered / (share[..., None] + 1.0)))
        back = (weight[:, None, :] @ joints[frame])[:, 0]
        attributes = self.out(torch.cat([own, back], dim=1))
        push = ((margin - depth) * (1.0 + attributes[:, 0]))[:, None] * normal
        # Not deeper in than it was, nor aside farther than it is pushed out.
        aside = torch.tanh(attributes[:, 1:]) * (margin - depth)[:, None]
        return vertices.index_put((frame, vertex), vertices[frame, vertex] + push + aside)


@torch.no_grad()
def corrector(animator: Animator, graph: GarmentGraph, material: np.ndarray, margin: float) -> Correction:
    """The physical regressor of a trained network for one garment of one material, frame by frame, in NumPy.

    Args:
        animator: With a regressor.
        graph, material: The garment and what it is made of.
        margin: Distance from the body that is aimed at [m].

    Raises:
        ValueError: The network has no physical regressor.
    """
    if animator.regressor is None:
        raise ValueError(f"{animator.kind}: it has no physical regressor")
    encoding, row = animator.encode(graph, torch.as_tensor(material)[None]), torch.zeros(1, dtype=torch.long)

    @torch.no_grad()
    def correct(vertices: np.ndarray, points: np.ndarray, normals: np.ndarray) -> np.ndarray:
        given = (torch.as_tensor(x.astype(np.float32))[None] for x in (vertices, points, normals))
        return animator.regressor(encoding, row, *given, margin)[0].numpy()

    return correct
