"""How well shape descriptors keep a garment, beside principal components of equal dimension (Wang 2019, Fig. 6 and 7).

In: trained descriptors, training frames and test frames per split, all in the canonical frame [m]. Out: rows, one a
method, dimension and split.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from evaluation.table import Row
from geometry.topology import MeshTopology
from models.pca import fit_pca
from models.shape_descriptor import ShapeDescriptor, decode_all, encode_all

_BLOCK = 256


def descriptor_rows(
    modules: Sequence[ShapeDescriptor],
    training: np.ndarray,
    splits: Mapping[str, np.ndarray],
    dimensions: Sequence[int] = (),
    seed: int = 0,
) -> list[Row]:
    """Reconstruction errors of each descriptor, and of PCA at the descriptors' and the further ``dimensions``.

    Args:
        modules: Trained on ``training``; of one garment.
        training: Frames [N, V, 3] that the components are fitted to.
        splits: Test frames [M, V, 3] by the name of their split.
        dimensions: Further numbers of components to list.
        seed: Of the randomized decomposition.

    Returns:
        Rows with ``rmse_mm`` (RMS over the vertices of a frame, mean over the frames), ``p95_frame_rmse_mm``, and
        ``laplacian_rmse_mm`` (the same of the mesh Laplacian: the detail).
    """
    if not modules:
        raise ValueError("descriptor evaluation: at least one trained descriptor is needed")
    most = min(len(training) - 1, 3 * training.shape[1])
    wanted = sorted({m.config.code for m in modules} | set(dimensions))
    counts = [count for count in wanted if count <= most]
    laplacian = MeshTopology.from_faces(modules[0].faces.cpu().numpy(), training.shape[1]).uniform_laplacian()
    rows: list[Row] = []
    for split, frames in splits.items():
        for module in modules:
            rebuilt = _by_blocks(frames, lambda v, m=module: decode_all(m, encode_all(m, v)))
            labels = {"method": f"descriptor, {module.config.variant}", "dimension": module.config.code}
            rows.append({"split": split, **labels, **_errors(frames, rebuilt, laplacian)})
    if counts:
        pca = fit_pca(training.reshape(len(training), -1), counts[-1], seed)
        for split, frames in splits.items():
            coefficients = _by_blocks(frames, lambda v: pca.encode(v.reshape(len(v), -1)))
            for count in counts:
                rebuilt = pca.decode(coefficients[:, :count]).reshape(frames.shape)
                labels = {"method": "PCA", "dimension": count}
                rows.append({"split": split, **labels, **_errors(frames, rebuilt, laplacian)})
    return rows


def interpolate_shapes(module: ShapeDescriptor, first: np.ndarray, second: np.ndarray, steps: int) -> np.ndarray:
    """Shapes [steps, V, 3] decoded along the straight line between the descriptors of two shapes [V, 3] (Fig. 8)."""
    if steps < 2:
        raise ValueError(f"interpolation: needs at least 2 steps, got {steps}")
    codes = encode_all(module, np.stack([first, second]))
    share = np.linspace(0.0, 1.0, steps, dtype=np.float32)[:, None]
    return decode_all(module, (1.0 - share) * codes[0] + share * codes[1])


def _errors(truth: np.ndarray, rebuilt: np.ndarray, laplacian) -> Row:
    vertex, detail = [], []
    for a, b in zip(truth, rebuilt, strict=True):
        difference = b - a
        vertex.append(np.sqrt(np.mean(np.sum(difference**2, axis=1))))
        detail.append(np.sqrt(np.mean(np.sum((laplacian @ difference) ** 2, axis=1))))
    return {
        "frames": len(truth),
        "rmse_mm": 1e3 * float(np.mean(vertex)),
        "p95_frame_rmse_mm": 1e3 * float(np.percentile(vertex, 95)),
        "laplacian_rmse_mm": 1e3 * float(np.mean(detail)),
    }


def _by_blocks(frames: np.ndarray, function: Callable[[np.ndarray], np.ndarray]) -> np.ndarray:
    if len(frames) == 0:
        raise ValueError("descriptor evaluation: a split has no frames")
    return np.concatenate([function(frames[i : i + _BLOCK]) for i in range(0, len(frames), _BLOCK)])
