"""Losses of networks that dress a body (Peng 2023, Eq. 5-9; the same terms as in DeePSD and PBNS, Bertiche 2021).

In: predicted vertices [m], any leading shape, and what they are held against. Out: scalars. The papers write sums over
vertices or edges; these are means, so that one weight serves garments of every size. Where a paper's sum runs over the
about three edges a vertex, its weight here is 3.

Dimensions: N garment vertices, E edges, F triangles, ... any leading shape.
"""

from __future__ import annotations

import torch
from torch import Tensor, nn


def data_loss(predicted: Tensor, truth: Tensor) -> Tensor:
    """Mean squared distance [m^2] of ``predicted`` and ``truth``, [..., N, 3] (Eq. 5)."""
    return (predicted - truth).square().sum(-1).mean()


def distance_loss(predicted: Tensor, truth: Tensor) -> Tensor:
    """Mean distance [m]: the figure of the tables itself, less moved by the few frames that nothing can foresee."""
    return ((predicted - truth).square().sum(-1) + 1e-8).sqrt().mean()


def edge_loss(vertices: Tensor, edges: Tensor, rest_lengths: Tensor) -> Tensor:
    """Mean squared change of length [m^2] of ``edges [E, 2]`` with ``rest_lengths [E]`` (Eq. 6)."""
    difference = vertices[..., edges[:, 0], :] - vertices[..., edges[:, 1], :]
    return ((difference.square().sum(-1) + 1e-12).sqrt() - rest_lengths).square().mean()


def bend_loss(vertices: Tensor, faces: Tensor, edges: Tensor) -> Tensor:
    """Mean over vertices of ``|n_i - mean of the neighbours' n|^2``, unit vertex normals (Eq. 7)."""
    normals, (i, j) = unit_normals(vertices, faces), edges.T
    ones = torch.ones(2 * len(edges), device=vertices.device)
    degree = torch.zeros(vertices.shape[-2], device=vertices.device).index_add(0, torch.cat([i, j]), ones)
    summed = torch.zeros_like(normals).index_add(-2, i, normals[..., j, :]).index_add(-2, j, normals[..., i, :])
    return (normals - summed / degree.clamp_min(1.0)[:, None]).square().sum(-1).mean()


def collision_loss(vertices: Tensor, points: Tensor, normals: Tensor, margin: float) -> Tensor:
    """Mean of ``min((v - b) . n - margin, 0)^2`` [m^2] over vertices (Eq. 8).

    Args:
        vertices: Of the garment, shape [..., N, 3].
        points, normals: Nearest body vertex to each and its unit normal, shape [..., N, 3]; held fixed.
        margin: epsilon [m].
    """
    return (heights(vertices, points, normals) - margin).clamp_max(0.0).square().mean()


def gravity_loss(vertices: Tensor, gravity: Tensor, mass: Tensor) -> Tensor:
    """Mean potential energy [J] of vertices of ``mass [N]`` [kg] under ``gravity [..., 3]`` [m/s^2] (PBNS, Eq. 6)."""
    return -((vertices * gravity[..., None, :]).sum(-1) * mass).sum(-1).mean()


def heights(vertices: Tensor, points: Tensor, normals: Tensor) -> Tensor:
    """Signed heights [m], [..., N], over the body; negative is inside."""
    return ((vertices - points) * normals).sum(-1)


def unit_normals(vertices: Tensor, faces: Tensor) -> Tensor:
    """Area-weighted unit vertex normals, [..., N, 3]."""
    a, b, c = (vertices[..., faces[:, k], :] for k in range(3))
    normal = torch.linalg.cross(b - a, c - a)
    summed = torch.zeros_like(vertices)
    for k in range(3):
        summed = summed.index_add(-2, faces[:, k], normal)
    return nn.functional.normalize(summed, dim=-1, eps=1e-12)
