"""Shapes that no frame of the data has: between two frames (Wang 2019, Fig. 8) and implausible ones (Fig. 9).

In: trained descriptors, frames [m] in the canonical frame, the template. Out: rows, one a method and kind of shape.
What cloth could be is judged by the strain of its edges against the template: it hardly stretches or shrinks.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from evaluation.descriptor import method_name
from evaluation.metrics import edge_strain
from evaluation.table import Row
from geometry.topology import edge_lengths
from models.pca import Pca
from models.plausible_codes import PlausibleCodes
from models.shape_descriptor import ShapeDescriptor, decode_all, encode_all

NOISE = 0.010
"""Standard deviation of the noise on every vertex [m]."""
PULL, PULLED_RADIUS = 0.20, 0.10
"""How far a place is pulled out, and how wide it is [m]."""
INFLATION = 1.5
"""Growth of an inflated garment across its axis [1]."""

PLAUSIBLE = "plausible code"
"""What the option of the projection is called in tables and pictures."""


def interpolation_rows(
    modules: Sequence[ShapeDescriptor],
    first: np.ndarray,
    second: np.ndarray,
    template: np.ndarray,
    edges: np.ndarray,
    steps: int = 5,
) -> list[Row]:
    """Strain of shapes between the frames ``first`` and ``second`` [P, V, 3], beside a straight way of each vertex.

    Args:
        modules: Descriptors of one garment.
        template, edges: Rest shape [V, 3] [m] and the edges to measure [E, 2].
        steps: Shapes of a path, the two ends among them.

    Returns:
        Rows with the absolute strain of the shapes between the ends (``p50_strain_percent``, ``p99_strain_percent``),
        that of the ends as the method has them, and ``edge_deviation_percent``: how far edge lengths are from a
        straight change of their length from one simulated end to the other; mean over edges, of the rest length.
    """
    if steps < 3:
        raise ValueError(f"interpolation: needs at least 3 steps, for one between the ends, got {steps}")
    if first.shape != second.shape or len(first) == 0:
        raise ValueError(f"interpolation: expected pairs of frames, got {list(first.shape)} and {list(second.shape)}")
    shares = np.linspace(0.0, 1.0, steps, dtype=np.float32)
    rest = edge_lengths(template, edges)
    ends = edge_lengths(first, edges), edge_lengths(second, edges)

    def row(method: str, dimension: int | None, path: Callable[[float], np.ndarray]) -> Row:
        shapes = [path(float(share)) for share in shares]
        between, own = np.concatenate(shapes[1:-1]), np.concatenate([shapes[0], shapes[-1]])
        inside, outside = edge_strain(between, template, edges), edge_strain(own, template, edges)
        expected = np.concatenate([(1 - s) * ends[0] + s * ends[1] for s in shares[1:-1]])
        return {
            "method": method,
            "dimension": dimension,
            "pairs": len(first),
            "p50_strain_percent": 100 * inside.p50,
            "p99_strain_percent": 100 * inside.p99,
            "ends_p50_strain_percent": 100 * outside.p50,
            "ends_p99_strain_percent": 100 * outside.p99,
            "edge_deviation_percent": 100 * float(np.mean(np.abs(edge_lengths(between, edges) - expected) / rest)),
        }

    rows = []
    for module in modules:
        a, b = encode_all(module, first), encode_all(module, second)
        between = row(
            method_name(module), module.config.code, lambda s, a=a, b=b, m=module: decode_all(m, _mix(a, b, s))
        )
        rows.append(between)
    rows.append(row("straight way of each vertex", None, lambda s: _mix(first, second, s)))
    return rows


def implausible_shapes(frames: np.ndarray, template: np.ndarray, seed: int = 0) -> dict[str, np.ndarray]:
    """Shapes [N, V, 3] that cloth cannot have, by what was done to ``frames [N, V, 3]`` in the canonical frame."""
    generator = np.random.default_rng(seed)
    count = frames.shape[1]
    noisy = frames + generator.normal(0.0, NOISE, frames.shape)
    centre = frames.mean(axis=1, keepdims=True)
    place = generator.integers(count, size=len(frames))
    near = np.linalg.norm(template[None] - template[place][:, None], axis=2)
    away = frames[np.arange(len(frames)), place] - centre[:, 0]
    away /= np.maximum(np.linalg.norm(away, axis=1, keepdims=True), 1e-9)
    pulled = frames + PULL * np.exp(-0.5 * (near / PULLED_RADIUS) ** 2)[..., None] * away[:, None]
    inflated = centre + (frames - centre) * np.array([INFLATION, 1.0, INFLATION])
    other = frames[generator.permutation(len(frames))]
    torn = np.where((template[:, 0] < np.median(template[:, 0]))[None, :, None], frames, other)
    shapes = {"noise": noisy, "pulled out": pulled, "inflated": inflated, "halves of two frames": torn}
    return {name: shape.astype(np.float32) for name, shape in shapes.items()}


def projection_rows(
    modules: Sequence[ShapeDescriptor],
    pca: Pca | None,
    training: np.ndarray,
    frames: np.ndarray,
    template: np.ndarray,
    edges: np.ndarray,
    seed: int = 0,
) -> list[Row]:
    """Implausible shapes as they are, through each descriptor and PCA, and as the nearest frame of ``training``.

    Each descriptor stands there twice: as it is, and with its code moved to the nearest one that ``training`` holds
    plausible. The frames themselves are among the shapes, ``as simulated``: what is plausible should stay as it is.

    Returns:
        Rows with the strain, ``moved_mm`` (RMS distance to the shape as given) and ``nearest_mm`` (RMS distance to the
        nearest training frame, the smaller the more like the data); means over shapes.
    """
    search = NearestFrames(training)
    rows = []
    plausible = [PlausibleCodes.of(encode_all(m, training)) for m in modules]
    for kind, shapes in {"as simulated": frames, **implausible_shapes(frames, template, seed)}.items():
        methods: list[tuple[str, int | None, np.ndarray]] = [("as given", None, shapes)]
        for module, near in zip(modules, plausible, strict=True):
            codes, name, length = encode_all(module, shapes), method_name(module), module.config.code
            methods.append((name, length, decode_all(module, codes)))
            methods.append((f"{name}, {PLAUSIBLE}", length, decode_all(module, near.nearest(codes))))
        if pca is not None:
            flat = pca.decode(pca.encode(shapes.reshape(len(shapes), -1)))
            methods.append(("PCA", len(pca.components), flat.reshape(shapes.shape)))
        methods.append(("nearest training frame", None, search.nearest(shapes)[0]))
        for method, dimension, result in methods:
            strain = edge_strain(result, template, edges)
            moved = np.sqrt(np.mean(np.sum((result - shapes) ** 2, axis=2), axis=1))
            rows.append(
                {
                    "shape": kind,
                    "method": method,
                    "dimension": dimension,
                    "shapes": len(shapes),
                    "p50_strain_percent": 100 * strain.p50,
                    "p99_strain_percent": 100 * strain.p99,
                    "moved_mm": 1e3 * float(np.mean(moved)),
                    "nearest_mm": 1e3 * float(np.mean(search.nearest(result)[1])),
                }
            )
    return rows


class NearestFrames:
    """Finds the nearest of the frames [N, V, 3] by the RMS distance of their vertices."""

    def __init__(self, frames: np.ndarray) -> None:
        self.frames = frames
        self._mean = frames.mean(axis=0, dtype=np.float64).astype(np.float32)
        self._flat = (frames - self._mean).reshape(len(frames), -1)
        self._squares = np.einsum("nd,nd->n", self._flat, self._flat)

    def nearest(self, shapes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """The nearest frame [M, V, 3] and its RMS distance [m], shape [M], of each of ``shapes [M, V, 3]``."""
        flat = (shapes - self._mean).reshape(len(shapes), -1)
        chosen = self.frames[np.argmin(self._squares - 2.0 * flat @ self._flat.T, axis=1)]
        return chosen, np.sqrt(np.mean(np.sum((chosen - shapes) ** 2, axis=2), axis=1))


def _mix(a: np.ndarray, b: np.ndarray, share: float) -> np.ndarray:
    return (1.0 - share) * a + share * b
