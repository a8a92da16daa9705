"""Losses of a clothing layer (Ma 2019, section 3.2.2): coordinates, face normals, latent distribution, adversary.

Coordinates and normals take features with the vertices outermost, ``[vertices, frames, 3]``.
"""

from __future__ import annotations

import torch
from torch import Tensor, nn


def coordinate_loss(predicted: Tensor, truth: Tensor) -> Tensor:
    """Mean absolute difference of coordinates: less smoothing than squares."""
    return (predicted - truth).abs().mean()


def unit_face_normals(vertices: Tensor, faces: Tensor) -> Tensor:
    """Unit normals [F, B, 3] of the triangles [F, 3] of vertices [V, B, 3]; of a degenerate one, zero."""
    a, b, c = (vertices[faces[:, k]] for k in range(3))
    normal = torch.linalg.cross(b - a, c - a)
    return normal / normal.norm(dim=-1, keepdim=True).clamp_min(1e-12)


def normal_loss(normals: Tensor, true_normals: Tensor) -> Tensor:
    """Mean over faces of ``1 - n . n'``."""
    return 1.0 - (normals * true_normals).sum(-1).mean()


def latent_loss(mean: Tensor, log_variance: Tensor) -> Tensor:
    """Kullback-Leibler divergence from the standard normal distribution, mean over frames [B, L]."""
    return 0.5 * (mean.square() + log_variance.exp() - 1.0 - log_variance).sum(-1).mean()


def discriminator_loss(real: Tensor, generated: Tensor) -> Tensor:
    """What the discriminator minimises: cross entropy of each patch's logit."""
    softplus = nn.functional.softplus
    return 0.5 * (softplus(-real).mean() + softplus(generated).mean())


def deception_loss(generated: Tensor) -> Tensor:
    """What the generator minimises: cross entropy of its patches against the label *real* (Goodfellow 2014)."""
    return nn.functional.softplus(-generated).mean()
