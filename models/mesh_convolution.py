"""Convolution on meshes: sparse products, Chebyshev filters, residual blocks (Defferrard 2016; Ma 2019, section 3.2).

Features lie with the vertices outermost, ``[vertices, frames, features]``: a sparse matrix over the vertices then
multiplies one dense block, and a layer's weights another, without a copy in between.
"""

from __future__ import annotations

import warnings

import numpy as np
import scipy.sparse as sp
import torch
from torch import Tensor, nn

SLOPE = 0.1
"""Of the leaky rectifier for negative numbers."""


class SparseOperator(nn.Module):
    """A constant sparse matrix [n, m] that multiplies features [m, B, F]; its gradient is the transpose's product.

    It is no part of a module's state: it follows from the mesh, which a model file holds once.
    """

    def __init__(self, matrix: sp.spmatrix) -> None:
        super().__init__()
        self.shape = matrix.shape
        for name, one in (("forth", matrix.tocsr()), ("back", matrix.T.tocsr())):
            one.sort_indices()
            self.register_buffer(f"{name}_rows", torch.as_tensor(one.indptr.astype(np.int64)), persistent=False)
            self.register_buffer(f"{name}_columns", torch.as_tensor(one.indices.astype(np.int64)), persistent=False)
            self.register_buffer(f"{name}_values", torch.as_tensor(one.data.astype(np.float32)), persistent=False)
        self._made: dict[tuple, Tensor] = {}

    def matrix(self, name: str) -> Tensor:
        """The matrix ("forth") or its transpose ("back") on the device of the buffers."""
        values = getattr(self, f"{name}_values")
        key = (name, values.device, values.data_ptr())
        if key not in self._made:
            shape = self.shape if name == "forth" else self.shape[::-1]
            parts = (getattr(self, f"{name}_rows"), getattr(self, f"{name}_columns"), values)
            self._made = {k: v for k, v in self._made.items() if k[0] != name}
            with warnings.catch_warnings():  # that the kind of tensor is new
                warnings.simplefilter("ignore", UserWarning)
                self._made[key] = torch.sparse_csr_tensor(*parts, size=shape, check_invariants=False)
        return self._made[key]

    def forward(self, features: Tensor) -> Tensor:
        return _Product.apply(features, self)

    def __getstate__(self) -> dict:
        return self.__dict__ | {"_made": {}}


class _Product(torch.autograd.Function):
    @staticmethod
    def forward(ctx, features: Tensor, operator: SparseOperator) -> Tensor:
        ctx.operator = operator
        return _times(operator.matrix("forth"), features)

    @staticmethod
    def backward(ctx, gradient: Tensor) -> tuple[Tensor, None]:
        return _times(ctx.operator.matrix("back"), gradient), None


def _times(matrix: Tensor, features: Tensor) -> Tensor:
    product = matrix @ features.reshape(len(features), -1)
    return product.view(len(product), *features.shape[1:])


def scaled_laplacian(adjacency: sp.spmatrix) -> sp.csr_matrix:
    """Normalized graph Laplacian moved to the interval [-1, 1] of Chebyshev polynomials: ``2 L / 2 - I``, [n, n].

    With the bound 2 on the largest eigenvalue, ``L = I - D^-1/2 A D^-1/2`` becomes ``-D^-1/2 A D^-1/2``.
    """
    degree = np.asarray(adjacency.sum(axis=1)).ravel()
    half = sp.diags(1.0 / np.sqrt(np.maximum(degree, 1.0)))
    return (-(half @ adjacency @ half)).tocsr()


class ChebyshevConvolution(nn.Module):
    """``sum_k T_k(L) X W_k + b`` with Chebyshev polynomials T_k, k below ``order`` (Ma 2019, eq. 4).

    Args:
        laplacian: What ``scaled_laplacian`` gives, shared by the layers of one level.
        inputs, outputs: Features at a vertex.
        order: Number of polynomials: a filter reaches ``order - 1`` rings.
    """

    def __init__(self, laplacian: SparseOperator, inputs: int, outputs: int, order: int) -> None:
        super().__init__()
        self.laplacian = laplacian
        self.order = order
        self.weight = nn.Parameter(torch.empty(order, inputs, outputs))
        self.bias = nn.Parameter(torch.zeros(outputs))
        nn.init.normal_(self.weight, std=(1.0 / (inputs * order)) ** 0.5 * 2.0**0.5)

    def forward(self, features: Tensor) -> Tensor:
        total = torch.addmm(self.bias, features.flatten(0, 1), self.weight[0])
        below, polynomial = None, features
        for k in range(1, self.order):
            product = self.laplacian(polynomial)
            below, polynomial = polynomial, product if k == 1 else 2.0 * product - below
            total = total + polynomial.flatten(0, 1) @ self.weight[k]
        return total.view(*features.shape[:2], -1)


class MeshBlock(nn.Module):
    """Two convolutions with a shortcut around them (He 2016; Ma 2019, appendix B), or the same two in a row."""

    def __init__(self, laplacian: SparseOperator, inputs: int, outputs: int, order: int, residual: bool) -> None:
        super().__init__()
        self.first = ChebyshevConvolution(laplacian, inputs, outputs, order)
        self.second = ChebyshevConvolution(laplacian, outputs, outputs, order)
        self.residual = residual
        self.shortcut = nn.Linear(inputs, outputs, bias=False) if residual and inputs != outputs else nn.Identity()

    def forward(self, features: Tensor) -> Tensor:
        inner = self.second(nn.functional.leaky_relu(self.first(features), SLOPE))
        if self.residual:
            inner = inner + self.shortcut(features)
        return nn.functional.leaky_relu(inner, SLOPE)
