"""What a trained network left over of its training set, put back by kernel ridge regression.

In: inputs of the network and what its output lacks at some training frames, the centres. Out: a correction of its
output at any input. A network that is stopped before it learns its training set by heart has far more left over there
than noise; most of that is the same for motions that are close to each other. So the rest is interpolated: one linear
system in closed form, seconds where the network would take minutes, and with less harm to new motions than longer
training. Far from every centre the correction fades to nothing and the network stands alone: it extrapolates better.
It is the mean of a Gaussian process whose prior mean is the network.

Source: Rasmussen, Williams 2006, "Gaussian processes for machine learning", section 2.7 (a fitted prior mean) and
Eq. 4.18 with gamma = 1 (exponential kernel: where contact begins and ends, cloth has kinks; smoother kernels are no
better).

Dimensions: n centres, D inputs, K outputs.
"""

from __future__ import annotations

import torch
from torch import Tensor, nn

REACH = 1.5
"""Length scale of the kernel, in root mean squared norms of an input."""

PENALTY = 0.1
"""Variance of what cannot be interpolated over that of what can."""

BLOCK = 2048
"""Inputs whose distances to all centres are held at once."""


class KernelCorrection(nn.Module):
    """Exponential kernel ridge regression on ``count`` centres; zero everywhere until it is fitted.

    Centres and weights are buffers: what trains a network by gradients leaves them alone.
    """

    def __init__(self, count: int, inputs: int, outputs: int) -> None:
        super().__init__()
        if count < 1:
            raise ValueError(f"kernel correction: needs at least one centre, got {count}")
        self.register_buffer("centres", torch.zeros(count, inputs))
        self.register_buffer("weights", torch.zeros(count, outputs))
        self.register_buffer("length", torch.ones(()))

    @torch.no_grad()
    def fit(self, inputs: Tensor, missing: Tensor) -> None:
        """Take the centres [n, D] and solve for their weights: near them the correction is close to ``missing [n, K]``.

        Raises:
            ValueError: Other shapes than the module was built for.
        """
        if inputs.shape != self.centres.shape or missing.shape != self.weights.shape:
            raise ValueError(
                f"kernel correction: expected inputs {list(self.centres.shape)} and outputs "
                f"{list(self.weights.shape)}, got {list(inputs.shape)} and {list(missing.shape)}"
            )
        self.length.copy_((REACH * inputs.square().sum(1).mean().sqrt()).clamp_min(1.0e-6))
        self.centres.copy_(inputs / self.length)
        kernel = _kernel(self.centres, self.centres)
        kernel.diagonal().add_(PENALTY)
        self.weights.copy_(torch.cholesky_solve(missing, torch.linalg.cholesky(kernel)))

    def forward(self, inputs: Tensor) -> Tensor:
        """Corrections [..., K] at inputs [..., D]."""
        rows = (inputs / self.length).flatten(0, -2)
        found = torch.cat([_kernel(block, self.centres) @ self.weights for block in rows.split(BLOCK)])
        return found.unflatten(0, inputs.shape[:-1])


def _kernel(a: Tensor, b: Tensor) -> Tensor:
    """Kernel values [N, M] between the rows of ``a [N, D]`` and ``b [M, D]``, in units of the length scale."""
    square = torch.addmm((b * b).sum(1)[None], a, b.T, alpha=-2.0).add_((a * a).sum(1)[:, None]).clamp_min_(0.0)
    return square.sqrt_().neg_().exp_()
