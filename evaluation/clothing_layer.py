"""Figures of clothing layers (Ma 2019, section 5): error of vertices, wrinkles, and whether a judge tells them apart.

In: layers as displacements of the active vertices [m], [N, A, 3]. Out: numbers. Wrinkles are the angles between
neighbouring faces of the clothed mesh in the unposed space: a smoothed layer has too many near zero, a noisy one too
few. The paper asked people which of two pictures is real; here a linear classifier on statistics of those angles
stands for them, and is stated as what it is.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.optimize import minimize

from geometry.topology import MeshTopology, face_normals

BINS = 720
"""Of the distribution of signed angles from -180 to 180 degrees."""

REGIONS = ((0, 1, 2, 3), (6, 9, 13, 14), (16, 17), (18, 19), (4, 5))
"""Joints whose vertices are judged together: hips and thighs, chest, upper arms, forearms, shins."""

PENALTY = 1.0e-2
"""Of the judge's squared weights; its features are standardised."""


@dataclass(frozen=True)
class VertexErrors:
    """Distances of reconstructed vertices from the true ones, over covered vertices alone.

    Attributes:
        mean, deviation: Of all vertices and frames [m] (Table 1 prints both).
    """

    mean: float
    deviation: float


def vertex_errors(predicted: np.ndarray, truth: np.ndarray, covered: np.ndarray) -> VertexErrors:
    """Errors of layers [N, A, 3] [m] where the frame's type covers the body, ``covered`` [N, A]."""
    if predicted.shape != truth.shape or covered.shape != truth.shape[:2]:
        raise ValueError(
            f"layers: expected equal shapes [N, A, 3] and covered [N, A], got {list(predicted.shape)}, "
            f"{list(truth.shape)} and {list(covered.shape)}"
        )
    distance = np.linalg.norm(predicted.astype(np.float64) - truth, axis=2)[covered]
    return VertexErrors(float(distance.mean()), float(distance.std()))


class Wrinkles:
    """Angles between neighbouring faces of a clothed mesh.

    Args:
        rest: Active vertices of the naked body in the unposed space [m], shape [A, 3].
        faces: Triangles between them, shape [F, 3].
        part: Joint of each active vertex, shape [A].
    """

    def __init__(self, rest: np.ndarray, faces: np.ndarray, part: np.ndarray) -> None:
        self.rest, self.faces = np.asarray(rest, dtype=np.float64), np.asarray(faces)
        topology = MeshTopology.from_faces(self.faces, len(self.rest))
        self.hinges, self.hinge_faces = topology.hinges, topology.hinge_faces
        self.regions = [np.isin(part[self.hinges[:, 0]], joints) for joints in REGIONS]

    def angles(self, layers: np.ndarray) -> np.ndarray:
        """Signed angles [deg] of layers [N, A, 3], shape [N, H]; positive where the cloth bends outwards."""
        found = np.empty((len(layers), len(self.hinges)), dtype=np.float32)
        for n, layer in enumerate(layers):
            vertices = self.rest + layer
            normals = face_normals(vertices, self.faces)
            a, b = normals[self.hinge_faces[:, 0]], normals[self.hinge_faces[:, 1]]
            edge = vertices[self.hinges[:, 1]] - vertices[self.hinges[:, 0]]
            edge /= np.maximum(np.linalg.norm(edge, axis=1, keepdims=True), 1e-12)
            sine = np.einsum("hc,hc->h", np.cross(a, b), edge)
            found[n] = np.degrees(np.arctan2(sine, np.einsum("hc,hc->h", a, b)))
        return found

    def distribution(self, angles: np.ndarray, covered: np.ndarray) -> np.ndarray:
        """Share of the angles [N, H] in each bin, of hinges on covered vertices [N, A] alone, shape [BINS]."""
        counted = covered[:, self.hinges].all(axis=2)
        counts, _ = np.histogram(angles[counted], bins=BINS, range=(-180.0, 180.0))
        return counts / max(1, counts.sum())

    def statistics(self, angles: np.ndarray, covered: np.ndarray) -> np.ndarray:
        """What the judge sees of each frame: of each region mean, spread and two percentiles of |angle|, [N, R * 4]."""
        counted = covered[:, self.hinges].all(axis=2)
        rows = np.zeros((len(angles), 4 * len(self.regions)))
        for n in range(len(angles)):
            for r, region in enumerate(self.regions):
                size = np.abs(angles[n, region & counted[n]])
                if len(size):
                    rows[n, 4 * r : 4 * r + 4] = (size.mean(), size.std(), *np.percentile(size, (50, 95)))
        return rows


def distribution_distance(a: np.ndarray, b: np.ndarray) -> float:
    """Earth mover's distance [deg] of two distributions of angles: the area between their cumulative curves."""
    return float(np.abs(np.cumsum(a) - np.cumsum(b)).sum() * 360.0 / BINS)


def judge_accuracy(real: np.ndarray, generated: np.ndarray, group: Sequence, seed: int) -> float:
    """Accuracy of a logistic regression that tells real from generated frames [N, D]; 0.5 = it cannot.

    It learns on half of the groups (sequences) and is asked about the others, then the other way round.

    Raises:
        ValueError: Fewer than two groups.
    """
    names = sorted(set(group))
    if len(names) < 2:
        raise ValueError(f"judge: needs frames of at least two sequences, got {len(names)}")
    order = np.random.default_rng(seed).permutation(len(names))
    half = np.isin(np.asarray([names.index(one) for one in group]), order[: len(names) // 2])
    right = [
        _asked(_learned(real[learn], generated[learn]), real[~learn], generated[~learn]) for learn in (half, ~half)
    ]
    return float(np.mean(right))


def _learned(real: np.ndarray, generated: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    rows = np.concatenate([real, generated])
    sign = np.repeat([1.0, -1.0], [len(real), len(generated)])
    mean, spread = rows.mean(axis=0), np.maximum(rows.std(axis=0), 1e-9)
    inputs = np.column_stack([(rows - mean) / spread, np.ones(len(rows))])

    def loss(weight: np.ndarray) -> tuple[float, np.ndarray]:
        margin = sign * (inputs @ weight)
        slope = -sign / (1.0 + np.exp(np.clip(margin, -500, 500)))
        value = np.logaddexp(0.0, -margin).mean() + 0.5 * PENALTY * (weight[:-1] @ weight[:-1])
        return value, inputs.T @ slope / len(rows) + PENALTY * np.append(weight[:-1], 0.0)

    return minimize(loss, np.zeros(inputs.shape[1]), jac=True, method="L-BFGS-B").x, mean, spread


def _asked(judge: tuple[np.ndarray, np.ndarray, np.ndarray], real: np.ndarray, generated: np.ndarray) -> float:
    weight, mean, spread = judge
    verdicts = [((rows - mean) / spread) @ weight[:-1] + weight[-1] for rows in (real, generated)]
    return 0.5 * float((verdicts[0] > 0).mean() + (verdicts[1] <= 0).mean())
