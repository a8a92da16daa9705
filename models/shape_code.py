"""The form in which a garment regressor handles garment shapes: all coordinates, or principal coefficients of them.

In and out: canonical vertices [..., V, 3] in metres and codes [..., K]. With ``components = 0`` a code is the scaled
offset of all 3 V coordinates from the mean shape, as in Shi 2023; otherwise it is the first ``components`` principal
coefficients of that offset, *not* whitened, so that a squared error of codes is one of vertices. Either way ``errors``
gives the two terms of the loss (Shi 2023, Eq. 3), the vertex and the Laplacian one, without going through vertices.
"""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp
import torch
from torch import Tensor, nn

from geometry.topology import MeshTopology


class ShapeCode(nn.Module):
    """Mean shape, scale and principal basis of a garment's training shapes, as buffers."""

    def __init__(self, vertices: int, components: int, faces: np.ndarray) -> None:
        super().__init__()
        if components > 3 * vertices:
            raise ValueError(f"shape code: {components} components of {3 * vertices} coordinates")
        self.vertices, self.components = vertices, components
        self.size = components or 3 * vertices
        self.register_buffer("mean", torch.zeros(vertices, 3))
        self.register_buffer("scale", torch.ones(()))
        self.register_buffer("faces", torch.as_tensor(np.asarray(faces, dtype=np.int64)))
        if components:
            self.register_buffer("basis", torch.zeros(components, 3 * vertices))
            self.register_buffer("laplacian_factor", torch.zeros(components, components))
        else:
            self.register_buffer("laplacian", _torch_sparse(_laplacian(faces, vertices)), persistent=False)

    def fit(self, vertices: np.ndarray, generator: np.random.Generator, most_shapes: int = 4000) -> None:
        """Take mean, scale and basis from canonical training shapes [N, V, 3] (thinned out for the basis)."""
        flat = vertices.reshape(len(vertices), -1)
        mean = flat.mean(0, dtype=np.float64)
        rows = flat
        if len(flat) > most_shapes:
            rows = flat[np.sort(generator.choice(len(flat), most_shapes, replace=False))]
        offset = (rows - mean).astype(np.float32)
        scale = max(float(np.sqrt(np.mean(np.square(offset, dtype=np.float64)))), 1.0e-4)
        self.mean.copy_(torch.as_tensor(mean.reshape(-1, 3), dtype=torch.float32))
        self.scale.fill_(scale)
        if not self.components:
            return
        basis = np.zeros((self.components, offset.shape[1]), dtype=np.float32)
        found = _principal_directions(offset, self.components, generator)
        basis[: len(found)] = found
        self.basis.copy_(torch.as_tensor(basis))
        # ||L B^T dc||^2 = ||R dc||^2: the Laplacian term costs K^2 instead of a sparse product over all vertices.
        fields = basis.T.reshape(self.vertices, 3 * self.components)
        bent = (_laplacian(self.faces.numpy(), self.vertices) @ fields).reshape(3 * self.vertices, self.components)
        self.laplacian_factor.copy_(torch.as_tensor(np.linalg.qr(bent, mode="r").astype(np.float32)))

    def encode(self, vertices: Tensor) -> Tensor:
        """Codes [..., K] of canonical vertices [..., V, 3]."""
        if vertices.shape[-2:] != (self.vertices, 3):
            raise ValueError(f"garment: expected vertices [..., {self.vertices}, 3], got {list(vertices.shape)}")
        offset = ((vertices - self.mean) / self.scale).flatten(-2)
        return offset @ self.basis.T if self.components else offset

    def decode(self, code: Tensor) -> Tensor:
        """Canonical vertices [..., V, 3] [m] of codes [..., K]."""
        offset = code @ self.basis if self.components else code
        return self.mean + self.scale * offset.unflatten(-1, (self.vertices, 3))

    def errors(self, difference: Tensor) -> tuple[Tensor, Tensor]:
        """Mean over vertices of squared offset and Laplacian differences of codes [..., K], in units of ``scale``^2."""
        if self.components:
            bent = difference @ self.laplacian_factor.T
            return difference.square().mean() * self.components / self.vertices, (
                bent.square().mean() * self.components / self.vertices
            )
        columns = difference.reshape(-1, self.vertices, 3).transpose(0, 1).flatten(1)  # [V, N * 3]
        bent = torch.sparse.mm(self.laplacian, columns)
        return difference.square().mean() * 3.0, bent.square().mean() * 3.0


def _principal_directions(offset: np.ndarray, count: int, generator: np.random.Generator) -> np.ndarray:
    """First principal directions [<= count, D] of centred rows, by randomized range finding (Halko 2011)."""
    sketch = min(count + 16, *offset.shape)
    # Two power iterations: the spectrum of cloth decays fast enough for that to be exact to float32.
    q = np.linalg.qr(offset.T @ (offset @ generator.standard_normal((offset.shape[1], sketch)).astype(np.float32)))[0]
    for _ in range(2):
        q = np.linalg.qr(offset.T @ (offset @ q))[0]
    _, _, v = np.linalg.svd(offset @ q, full_matrices=False)
    return (v @ q.T)[:count]


def _laplacian(faces: np.ndarray, vertices: int) -> sp.csr_matrix:
    return MeshTopology.from_faces(faces, vertices).uniform_laplacian()


def _torch_sparse(matrix: sp.csr_matrix) -> Tensor:
    coo = matrix.tocoo()
    index = torch.as_tensor(np.stack([coo.row, coo.col]).astype(np.int64))
    return torch.sparse_coo_tensor(
        index, torch.as_tensor(coo.data.astype(np.float32)), coo.shape, check_invariants=False
    )
