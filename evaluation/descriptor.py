"""How well shape descriptors keep a garment, beside principal components of equal dimension (Wang 2019, Fig. 6 and 7).

In: trained descriptors, training frames and test frames per split, all in the canonical frame [m]. Out: rows, one a
method, dimension and split. Shapes that no frame has: ``evaluation/descriptor_shapes.py``.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from evaluation.table import Row
from geometry.topology import MeshTopology, by_coordinate
from models.pca import fit_pca
from models.shape_descriptor import ShapeDescriptor, decode_all, encode_all

_BLOCK = 256


def descriptor_rows(
    modules: Sequence[ShapeDescriptor],
    training: np.ndarray,
    splits: Mapping[str, np.ndarray],
    dimensions: Sequence[int] = (),
    seed: int = 0,
    clips: Mapping[str, np.ndarray] | None = None,
) -> list[Row]:
    """Reconstruction errors of each descriptor, and of PCA at the descriptors' and the further ``dimensions``.

    Args:
        modules: Trained on ``training``; of one garment.
        training: Frames [N, V, 3] that the components are fitted to.
        splits: Test frames [M, V, 3] by the name of their split.
        dimensions: Further numbers of components to list.
        seed: Of the randomized decomposition.
        clips: Number of the clip of each test frame, shape [M], by the name of the split.

    Returns:
        Rows with ``hidden`` (widths of the encoder's layers), ``rmse_mm`` (RMS over the vertices of a frame, mean over
        the frames), ``over_pca`` (that over the same of PCA of equal dimension), ``p95_frame_rmse_mm``,
        ``laplacian_rmse_mm`` (of the mesh Laplacian: the detail), and where the clips are known ``clip_rmse_mm`` and
        ``clip_over_pca``: mean over the clips, so that a clip simulated under forty parameter sets weighs as much as
        one under one.
    """
    if not modules:
        raise ValueError("descriptor evaluation: at least one trained descriptor is needed")
    most = min(len(training) - 1, 3 * training.shape[1])
    wanted = sorted({m.config.code for m in modules} | set(dimensions))
    counts = [count for count in wanted if count <= most]
    laplacian = MeshTopology.from_faces(modules[0].faces.cpu().numpy(), training.shape[1]).uniform_laplacian()
    pca = fit_pca(training.reshape(len(training), -1), counts[-1], seed) if counts else None
    rows: list[Row] = []
    for split, frames in splits.items():
        of = None if clips is None else clips[split]
        linear: dict[int, Row] = {}
        coefficients = _by_blocks(frames, lambda v: pca.encode(v.reshape(len(v), -1))) if counts else None
        for count in counts:
            rebuilt = pca.decode(coefficients[:, :count]).reshape(frames.shape)
            linear[count] = _errors(frames, rebuilt, laplacian, of)
        for module in modules:
            rebuilt = _by_blocks(frames, lambda v, m=module: decode_all(m, encode_all(m, v)))
            errors = _errors(frames, rebuilt, laplacian, of)
            beside = linear.get(module.config.code)
            if beside:
                errors["over_pca"] = errors["rmse_mm"] / beside["rmse_mm"]
                if of is not None:
                    errors["clip_over_pca"] = errors["clip_rmse_mm"] / beside["clip_rmse_mm"]
            named = {"method": method_name(module), "dimension": module.config.code, "hidden": widths(module)}
            rows.append({"split": split, **named, **errors})
        rows += [{"split": split, "method": "PCA", "dimension": count, **errors} for count, errors in linear.items()]
    return rows


def method_name(module: ShapeDescriptor) -> str:
    """What a descriptor is called in tables: its variant, and whether the Laplacian term (Fig. 6) was left out."""
    without = "" if module.config.laplacian_weight else ", no Laplacian term"
    return f"descriptor, {module.config.variant}{without}"


def widths(module: ShapeDescriptor) -> str:
    """Widths of the hidden layers of a descriptor's encoder."""
    return " x ".join(str(width) for width in module.config.hidden)


def interpolate_shapes(module: ShapeDescriptor, first: np.ndarray, second: np.ndarray, steps: int) -> np.ndarray:
    """Shapes [steps, V, 3] decoded along the straight line between the descriptors of two shapes [V, 3] (Fig. 8)."""
    if steps < 2:
        raise ValueError(f"interpolation: needs at least 2 steps, got {steps}")
    codes = encode_all(module, np.stack([first, second]))
    share = np.linspace(0.0, 1.0, steps, dtype=np.float32)[:, None]
    return decode_all(module, (1.0 - share) * codes[0] + share * codes[1])


def _errors(truth: np.ndarray, rebuilt: np.ndarray, laplacian, clips: np.ndarray | None) -> Row:
    vertex, detail = [], []
    for start in range(0, len(truth), _BLOCK):
        block = slice(start, start + _BLOCK)
        difference = by_coordinate(rebuilt[block] - truth[block])
        vertex.append(_rms_of_frames(difference))
        detail.append(_rms_of_frames([laplacian @ d for d in difference]))
    vertex, detail = np.concatenate(vertex), np.concatenate(detail)
    row: Row = {
        "frames": len(truth),
        "rmse_mm": 1e3 * float(np.mean(vertex)),
        "p95_frame_rmse_mm": 1e3 * float(np.percentile(vertex, 95)),
        "laplacian_rmse_mm": 1e3 * float(np.mean(detail)),
    }
    if clips is not None:
        _, number = np.unique(clips, return_inverse=True)
        sums = np.bincount(number, weights=vertex) / np.bincount(number)
        row |= {"clips": len(sums), "clip_rmse_mm": 1e3 * float(np.mean(sums))}
    return row


def _rms_of_frames(vectors: Sequence[np.ndarray]) -> np.ndarray:
    """Root of the mean over vertices of the squared length, [T], of vectors by coordinate, [3, V, T]."""
    return np.sqrt(np.mean(sum(v * v for v in vectors), axis=0, dtype=np.float64))


def _by_blocks(frames: np.ndarray, function: Callable[[np.ndarray], np.ndarray]) -> np.ndarray:
    if len(frames) == 0:
        raise ValueError("descriptor evaluation: a split has no frames")
    return np.concatenate([function(frames[i : i + _BLOCK]) for i in range(0, len(frames), _BLOCK)])
