"""Figures of generated motions, from the features of a recognition network (Action2Motion, Guo 2020; Shi, Table 4).

In: features [N, 30] and class numbers that a recognition network gives for real and for generated motions, or joint
positions. Out: FID, recognition accuracy, diversity, multimodality, over repetitions with their 95% interval; and the
share of discontinuous sequences, which stands for the user study of Shi 2023 (Table 5).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from geometry.topology import lengths

DIVERSITY_PAIRS = 200
MULTIMODALITY_PAIRS = 20
CONTINUITY_PERCENTILE = 99.9


@dataclass(frozen=True)
class Repeated:
    """A figure over repetitions: mean and half width of its 95% confidence interval."""

    mean: float
    interval: float

    @classmethod
    def of(cls, values: list[float]) -> Repeated:
        """Normal-theory interval, 1.96 standard errors, as the published tables have it; 0 for one repetition."""
        array = np.asarray(values, dtype=np.float64)
        spread = float(array.std(ddof=1)) if np.ptp(array) > 0.0 else 0.0  # equal values leave a rounding error
        return cls(float(array.mean()), float(1.96 * spread / np.sqrt(len(array))))


def gaussian_distance(
    mean_a: np.ndarray, covariance_a: np.ndarray, mean_b: np.ndarray, covariance_b: np.ndarray
) -> float:
    """Squared Frechet distance of two Gaussians: ``|m_a - m_b|^2 + tr(C_a + C_b - 2 (C_a C_b)^(1/2))``."""
    # tr (C_a C_b)^(1/2) by eigenvalues of symmetric matrices: real, and stable when a covariance is singular.
    values, vectors = np.linalg.eigh(covariance_a)
    root = (vectors * np.sqrt(np.maximum(values, 0.0))) @ vectors.T
    eigenvalues = np.linalg.eigvalsh(root @ covariance_b @ root)
    cross = np.sqrt(np.maximum(eigenvalues, 0.0)).sum()
    apart = np.square(mean_a - mean_b).sum()
    return float(max(apart + np.trace(covariance_a) + np.trace(covariance_b) - 2.0 * cross, 0.0))


def frechet_distance(features_a: np.ndarray, features_b: np.ndarray) -> float:
    """FID: distance of the Gaussian fits of two feature sets [N, D] and [M, D]; at least two rows each."""
    for name, features in (("first", features_a), ("second", features_b)):
        if features.ndim != 2 or len(features) < 2:
            raise ValueError(f"FID: the {name} set needs shape [>= 2, D], got {list(features.shape)}")
    moments = [(f.mean(0), np.atleast_2d(np.cov(f, rowvar=False))) for f in (features_a, features_b)]
    return gaussian_distance(*moments[0], *moments[1])


def accuracy(predicted: np.ndarray, classes: np.ndarray) -> float:
    """Share of motions [N] that are recognised as what they were generated for: trace of the confusion matrix."""
    return float(np.mean(predicted == classes))


def diversity(features: np.ndarray, generator: np.random.Generator, pairs: int = DIVERSITY_PAIRS) -> float:
    """Mean distance of ``pairs`` random pairs of features [N, D]."""
    if len(features) < 2:
        raise ValueError(f"diversity: needs at least 2 motions, got {len(features)}")
    first = generator.integers(0, len(features), pairs)
    second = generator.integers(0, len(features), pairs)
    return float(np.linalg.norm(features[first] - features[second], axis=1).mean())


def multimodality(
    features: np.ndarray, classes: np.ndarray, generator: np.random.Generator, pairs: int = MULTIMODALITY_PAIRS
) -> float:
    """Mean distance of ``pairs`` random pairs of the same class, averaged over classes with at least two motions.

    The two of a pair are different motions, which matters where a class has few.
    """
    distances = []
    for number in np.unique(classes):
        members = features[classes == number]
        if len(members) < 2:
            continue
        first = generator.integers(0, len(members), pairs)
        second = (first + generator.integers(1, len(members), pairs)) % len(members)
        distances.append(np.linalg.norm(members[first] - members[second], axis=1).mean())
    if not distances:
        raise ValueError("multimodality: no class has two motions")
    return float(np.mean(distances))


def label_spread(joints: np.ndarray, classes: np.ndarray) -> float:
    """Mean joint distance [m] of two motions of the same class, over all such pairs: multimodality without a network.

    The features of a network that tells the labels apart well hardly differ within a label; joint positions do.

    Args:
        joints: Joint positions [m], shape [N, T, J, 3].
        classes: Class number of each motion, N.

    Returns:
        Mean over the classes with at least two motions; NaN without one.
    """
    spreads = []
    for number in np.unique(classes):
        members = joints[classes == number]
        distances = [lengths(members[n + 1 :] - one).mean(axis=(1, 2)) for n, one in enumerate(members)]
        if len(members) > 1:
            spreads.append(np.concatenate(distances).mean())
    return float(np.mean(spreads)) if spreads else float("nan")


def nearest_distance(joints: np.ndarray, classes: np.ndarray, known: np.ndarray, known_classes: np.ndarray) -> float:
    """Mean joint distance [m] of each motion to the nearest known one of its class: 0 for a generator that copies.

    Args:
        joints, known: Joint positions [m], shapes [N, T, J, 3] and [M, T, J, 3].
        classes, known_classes: Class numbers, N and M; every class of ``classes`` is known.
    """
    of_class = {number: known[known_classes == number] for number in np.unique(classes)}
    nearest = [
        lengths(of_class[number] - motion).mean(axis=(1, 2)).min()
        for motion, number in zip(joints, classes, strict=True)
    ]
    return float(np.mean(nearest))


def peak_accelerations(joints: np.ndarray, fps: float) -> np.ndarray:
    """Largest joint acceleration of each sequence [m/s^2], shape [N], of joints [N, T, J, 3] [m]; T at least 3."""
    return _accelerations(joints, fps).max(axis=(1, 2))


def discontinuous_share(joints: np.ndarray, real_joints: np.ndarray, fps: float) -> float:
    """Share of sequences [N, T, J, 3] whose peak acceleration exceeds the real data's 99.9th percentile."""
    limit = np.percentile(_accelerations(real_joints, fps), CONTINUITY_PERCENTILE)
    return float(np.mean(peak_accelerations(joints, fps) > limit))


def _accelerations(joints: np.ndarray, fps: float) -> np.ndarray:
    """Magnitudes [N, T - 2, J] of second differences of joints [N, T, J, 3]."""
    if joints.ndim != 4 or joints.shape[1] < 3 or joints.shape[3] != 3:
        raise ValueError(f"joints: expected shape [N, T >= 3, J, 3], got {list(joints.shape)}")
    second = joints[:, 2:] - 2.0 * joints[:, 1:-1] + joints[:, :-2]
    return lengths(second.astype(np.float64)) * fps**2
