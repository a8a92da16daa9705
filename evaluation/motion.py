"""Tables of the motion generators: reconstruction of unseen motions, and generation (Shi 2023, Tables 3, 4, 5 and 8).

In: the generators by name, a recognition network trained on the training split, and the poses of both splits. Out: rows
of tables. Poses are compared with the root at rest, since the generators make poses alone.

N motions, T frames.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from itertools import cycle

import numpy as np
import torch

from body.model import Body
from evaluation.metrics import hausdorff
from evaluation.motion_metrics import (
    Repeated,
    accuracy,
    discontinuous_share,
    diversity,
    frechet_distance,
    label_spread,
    multimodality,
    nearest_distance,
)
from evaluation.sted import Sted, StedParameters
from evaluation.table import Row
from geometry.rotations import matrix_from_6d, matrix_to_6d, matrix_to_axis_angle
from geometry.topology import MeshTopology
from models.body_layer import BodyLayer
from models.motion_generator import MotionGenerator
from models.recognition import RecognitionNetwork

HAUSDORFF_STRIDE = 10
MESH_MOTIONS = 20
REPETITIONS = 20
LEAST_MOTIONS = 128
Generators = Mapping[str, MotionGenerator]


@dataclass(frozen=True)
class MotionSet:
    """Motions of one split.

    Attributes:
        pose6d: 6-D poses, shape [N, T, 24, 6].
        labels: Label of each, N.
        fps: Frame rate [Hz].
    """

    pose6d: np.ndarray
    labels: tuple[str, ...]
    fps: float

    def __post_init__(self) -> None:
        if self.pose6d.ndim != 4 or self.pose6d.shape[2:] != (24, 6) or len(self.labels) != len(self.pose6d):
            raise ValueError(
                f"motion set: expected poses [N, T, 24, 6] and N labels, "
                f"got {list(self.pose6d.shape)} and {len(self.labels)}"
            )


def reconstruction_rows(
    models: Generators, train: MotionSet, test: MotionSet, body: Body, sted: StedParameters | None = None
) -> list[Row]:
    """Errors of reconstructed unseen motions (Tables 3 and 8), a row a method; means over the test split's sequences.

    The generators are held against two ways that learn nothing: the mean pose of the label's training motions, standing
    still, and the label's training motion that comes nearest to the one to be reconstructed. Hausdorff distance and
    STED, which are costly, are taken on at most ``MESH_MOTIONS`` motions, evenly chosen.
    """
    methods: dict[str, Callable[[], np.ndarray]] = {
        name: lambda model=model: model.reconstruct(test.pose6d, test.labels) for name, model in models.items()
    }
    methods["mean pose of the label"] = lambda: mean_poses(train, test)
    methods["nearest training motion of the label"] = lambda: _nearest_motions(train, test)
    compare = Sted(MeshTopology.from_faces(body.faces, len(body.vertices)), sted)
    count, layer = len(test.pose6d), BodyLayer(body)
    on_meshes = np.unique(np.linspace(0, count - 1, min(MESH_MOTIONS, count)).round().astype(int))
    reconstructed = {name: method() for name, method in methods.items()}
    distances: dict[str, list[float]] = {name: [] for name in methods}
    edge_differences: dict[str, list[float]] = {name: [] for name in methods}
    for n in on_meshes:
        true_mesh = _vertices(test.pose6d[n], body)
        true_edges = compare.beside(true_mesh)
        for name, poses in reconstructed.items():
            mesh = _vertices(poses[n], body)
            distances[name].append(hausdorff(mesh, true_mesh, HAUSDORFF_STRIDE))
            edge_differences[name].append(true_edges.compare(mesh).sted)
    true_joints = joint_tracks(test.pose6d, layer)
    rows: list[Row] = []
    for name, poses in reconstructed.items():
        vertex = [_vertex_rmse(layer, a, b) for a, b in zip(poses, test.pose6d, strict=True)]
        rows.append(
            {
                "method": name,
                "pose_rmse": float(np.sqrt(np.square(poses - test.pose6d).mean((1, 2, 3))).mean()),
                "joint_error_m": float(np.linalg.norm(joint_tracks(poses, layer) - true_joints, axis=-1).mean()),
                "vertex_rmse_m": float(np.mean(vertex)),
                "hausdorff_m": float(np.mean(distances[name])),
                "sted": float(np.mean(edge_differences[name])),
                "motions": count,
                "mesh_motions": len(on_meshes),
                "sted_parameters": compare.parameters.label,
                "hausdorff_every_frames": HAUSDORFF_STRIDE,
                "body": body.name,
                "split": "unseen motions",
                "training_motions": len(train.labels),
            }
        )
    return rows


def generation_rows(
    models: Generators,
    recognition: RecognitionNetwork,
    train: MotionSet,
    test: MotionSet,
    body: Body,
    seed: int,
    repetitions: int = REPETITIONS,
) -> list[Row]:
    """Figures of generated motions beside real ones (Tables 4 and 5), with 95% intervals over repetitions.

    FID is taken against the *training* split, the larger one, and every row with as many motions as the test split has,
    with its labels: FID grows as samples get fewer, so only equal numbers compare. Where the test split has fewer than
    ``LEAST_MOTIONS``, the other figures of drawn and of generated motions come from a multiple, so that every label has
    pairs for its multimodality. Rows: motions of the test split; motions drawn from the training split; the label's
    mean pose, standing still, as a control that must fail; and the generators'.
    """
    frames = train.pose6d.shape[1]
    real = recognition.describe(train.pose6d)[0]
    layer = BodyLayer(body)
    real_joints = joint_tracks(train.pose6d, layer)
    known = {name: number for number, name in enumerate(recognition.config.labels)}
    asked = test.labels * math.ceil(LEAST_MOTIONS / len(test.labels))

    def drawn_from_train(repetition: int) -> np.ndarray:
        # In turn from a shuffled deck a label: a motion comes twice only when its label has no further one.
        generator = np.random.default_rng([seed, repetition])
        labels = np.array(train.labels)
        decks = {label: cycle(generator.permutation(_members(labels, label))) for label in sorted(set(asked))}
        return train.pose6d[[next(decks[label]) for label in asked]]

    sources: dict[str, tuple[Callable[[int], np.ndarray], int]] = {
        "real, unseen motions": (lambda _: test.pose6d, repetitions),
        "real, training motions": (drawn_from_train, repetitions),
        "mean pose of the label": (lambda _: mean_poses(train, test), 1),
    }
    for name, model in models.items():
        sources[name] = (lambda r, model=model: model.sample(asked, frames, sampling(seed, r)), repetitions)
    own_classes, train_classes = (np.array([known[label] for label in split.labels]) for split in (test, train))
    own = slice(len(own_classes))
    rows: list[Row] = []
    for name, (source, count) in sources.items():
        figures: dict[str, list[float]] = {}
        for repetition in range(count):
            poses = source(repetition)
            features, predicted = recognition.describe(poses)
            classes = np.tile(own_classes, len(poses) // len(own_classes))
            joints = joint_tracks(poses, layer)
            generator = np.random.default_rng([seed, repetition, 1])
            found = {
                "fid": frechet_distance(features[own], real),
                "accuracy_percent": 100.0 * accuracy(predicted, classes),
                "diversity": diversity(features, generator),
                "multimodality": multimodality(features, classes, generator) if _has_pairs(classes) else float("nan"),
                "label_spread_m": label_spread(joints, classes),
                "nearest_training_m": nearest_distance(joints[own], own_classes, real_joints, train_classes),
                "discontinuous_percent": 100.0 * discontinuous_share(joints, real_joints, train.fps),
            }
            for key, value in found.items():
                figures.setdefault(key, []).append(value)
        row: Row = {"source": name}
        for key, values in figures.items():
            repeated = Repeated.of(values)
            row[key] = repeated.mean if np.isfinite(repeated.mean) else None
            row[f"{key}_interval"] = repeated.interval if np.isfinite(repeated.interval) else None
        rows.append(
            {
                **row,
                "motions": len(poses),
                "repetitions": count,
                "fid_motions": len(own_classes),
                "judge_training_motions": len(train.labels),
            }
        )
    judged = next(row["accuracy_percent"] for row in rows if row["source"] == "real, unseen motions")
    return [{**row, "judge_accuracy_percent": judged} for row in rows]


def sampling(seed: int, repetition: int) -> torch.Generator:
    """Randomness of a repetition: every generator draws from the same state."""
    return torch.Generator().manual_seed(1000 * seed + repetition)


def _has_pairs(classes: np.ndarray) -> bool:
    return np.unique(classes, return_counts=True)[1].max() > 1


def _orthonormal(pose6d: np.ndarray) -> np.ndarray:
    return matrix_to_6d(matrix_from_6d(pose6d)).astype(np.float32)


def mean_poses(train: MotionSet, test: MotionSet) -> np.ndarray:
    """For each test motion the mean pose of the training motions of its label, held for all frames [N, T, 24, 6]."""
    labels = np.array(train.labels)
    means = {label: _orthonormal(train.pose6d[_members(labels, label)].mean((0, 1))) for label in set(test.labels)}
    return np.stack([np.broadcast_to(means[label], test.pose6d.shape[1:]) for label in test.labels])


def _nearest_motions(train: MotionSet, test: MotionSet) -> np.ndarray:
    """For each test motion the training motion of its label with the smallest pose error, [N, T, 24, 6]."""
    labels, found = np.array(train.labels), []
    for pose, label in zip(test.pose6d, test.labels, strict=True):
        members = train.pose6d[_members(labels, label)]
        found.append(members[np.square(members - pose).mean((1, 2, 3)).argmin()])
    return np.stack(found)


def _members(labels: np.ndarray, label: str) -> np.ndarray:
    members = np.flatnonzero(labels == label)
    if not len(members):
        raise ValueError(f"label {label!r} has no motion in the training split")
    return members


def axis_angle(pose6d: np.ndarray) -> np.ndarray:
    """Axis-angle poses [..., 24, 3] [rad] of 6-D poses [..., 24, 6]."""
    return matrix_to_axis_angle(matrix_from_6d(pose6d))


def _vertex_rmse(layer: BodyLayer, pose6d: np.ndarray, truth: np.ndarray) -> float:
    """Root of the mean squared vertex distance [m] of two motions [T, 24, 6], root at rest, by the closed form."""
    with torch.no_grad():
        one, other = (layer.rotation_chain(torch.as_tensor(np.array(x, dtype=np.float32))) for x in (pose6d, truth))
        return float(layer.mean_squared_pose_error(one, other).sqrt())


def _vertices(pose6d: np.ndarray, body: Body) -> np.ndarray:
    """Body vertices [T, B, 3] [m] of poses [T, 24, 6], root at rest."""
    return body.posed(axis_angle(pose6d), np.zeros((len(pose6d), 3)))


def joint_tracks(pose6d: np.ndarray, layer: BodyLayer) -> np.ndarray:
    """Joints [N, T, 24, 3] [m] of poses [N, T, 24, 6], root at rest."""
    with torch.no_grad():
        return layer.joint_positions(layer.global_rotations(torch.as_tensor(np.array(pose6d)))).numpy()
