"""Self-supervised collision refinement of a garment regressor (Shi 2023, section 3.4).

In: a trained regressor and motions that nobody simulated, sampled from the motion generator. Out: the regressor, tuned
so that its garments leave the body. The motions are dressed; sequences with heavy interpenetration are discarded, since
their closest body vertices may lie on the far side; the rest are trained on with Eq. 4,
``sum max(-n . (v' - v_body), 0)``, where v_body is the closest body vertex and n its normal, without ground truth.

The paper's loss alone is blind to everything but penetration and lets the garment wander; ``keep_weight`` holds the
tuned garment to the one before tuning. 0 is the paper's.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import torch
from scipy.spatial import cKDTree
from torch import Tensor

from body.model import Body
from geometry.topology import vertex_normals
from models.garment_regressor import Regressor
from models.motion_features import MotionTrack
from models.sequence_regressor import SequenceRegressor
from models.training import Progress, TrainingSettings, array_digest, shuffled_batches, train


@dataclass(frozen=True)
class CollisionTuning:
    """How a regressor is tuned.

    Attributes:
        training: Learning rate of the size of the regressor's final one, and few epochs.
        batch: Sequences a batch.
        margin: Distance from the body that counts as free [m]; paper: 0.
        keep_weight: Weight of the squared distance to the untuned garment; paper: 0.
        heavy_share: A sequence is discarded when in some frame more than this share of its vertices is inside.
        heavy_depth: ... or a vertex is deeper inside than this [m].
    """

    training: TrainingSettings = field(default_factory=lambda: TrainingSettings(epochs=5, learning_rate=1e-4))
    batch: int = 5
    margin: float = 0.0
    keep_weight: float = 1.0
    heavy_share: float = 0.15
    heavy_depth: float = 0.05


@dataclass(frozen=True)
class CollisionReport:
    """What tuning did, on the motions that it kept (on all of them when it kept none and changed nothing).

    Attributes:
        motions, discarded: How many were given, and how many were left out.
        inside_before, inside_after: Share of garment vertices behind their closest body vertex.
        depth_before, depth_after: Mean depth of those that are [m].
        moved: Root mean squared distance between the garment before and after [m].
    """

    motions: int
    discarded: int
    inside_before: float
    inside_after: float
    depth_before: float
    depth_after: float
    moved: float


class _BodySurface:
    """Canonical body vertices and normals of the frames of one track, with a search tree a frame."""

    def __init__(self, track: MotionTrack, body: Body) -> None:
        rotation, position = (x[track.lead :] for x in track.pelvis_frames())
        world = body.posed(track.pose[track.lead :], position - body.joints[0])
        self.vertices = np.matmul(world - position[:, None], rotation).astype(np.float32)
        self.normals = vertex_normals(self.vertices, body.faces)
        self.trees = [cKDTree(frame) for frame in self.vertices]

    def closest(self, garment: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Closest body vertices and their normals, each [T, V, 3], of ``garment [T, V, 3]``."""
        index = np.stack([tree.query(frame)[1] for tree, frame in zip(self.trees, garment, strict=True)])
        frame = np.arange(len(garment))[:, None]
        return self.vertices[frame, index], self.normals[frame, index]

    def heights(self, garment: np.ndarray) -> np.ndarray:
        """Signed height over the closest body vertex [m], shape [T, V]; negative is inside."""
        vertices, normals = self.closest(garment)
        return ((garment - vertices) * normals).sum(-1)


def fine_tune_collisions(
    regressor: Regressor,
    tracks: Sequence[MotionTrack],
    body: Body,
    settings: CollisionTuning,
    work_dir: Path | str,
    progress: Progress | None = None,
) -> CollisionReport:
    """Tune a regressor in place on unlabelled motions of one length; returns what changed.

    Raises:
        ValueError: No motions, or motions of different lengths.
    """
    if len({(len(t.pose), t.lead) for t in tracks}) != 1:
        raise ValueError(f"collision tuning: needs motions of one length and lead-in, got {len(tracks)} motions")
    surfaces = [_BodySurface(track, body) for track in tracks]
    garments = regressor.dress_all(list(tracks))
    heights = [s.heights(g) for s, g in zip(surfaces, garments, strict=True)]
    kept = [
        i
        for i, h in enumerate(heights)
        if (h < 0.0).mean(1).max() <= settings.heavy_share and h.min() >= -settings.heavy_depth
    ]
    if not kept:
        # No error: a barely trained regressor, as in a smoke run, has nothing that could be tuned.
        if progress is not None:
            progress(
                f"all {len(tracks)} motions have over {settings.heavy_share:.0%} of the garment or a vertex deeper "
                f"than {settings.heavy_depth} m inside the body: the regressor is left as it was"
            )
        share, depth = _inside(heights)
        return CollisionReport(len(tracks), len(tracks), share, share, depth, depth, 0.0)
    lead = tracks[0].lead
    device = regressor.feature_mean.device
    features = torch.stack([regressor.features(tracks[i]) for i in kept])
    before = torch.as_tensor(np.stack([garments[i] for i in kept]), device=device)
    with torch.no_grad():
        codes = regressor.shape.encode(before)

    def batches(epoch: int, generator: np.random.Generator) -> Iterator[np.ndarray]:
        return shuffled_batches(len(kept), settings.batch, generator)

    def loss(rows: np.ndarray) -> dict[str, Tensor]:
        code = _predict(regressor, features[rows], lead)
        garment = regressor.shape.decode(code)
        found = [surfaces[kept[r]].closest(g) for r, g in zip(rows, garment.detach().cpu().numpy(), strict=True)]
        closest, normal = (torch.as_tensor(np.stack(x), device=device) for x in zip(*found, strict=True))
        height = ((garment - closest) * normal).sum(-1)
        collision = (settings.margin - height).clamp_min(0.0).sum(-1).mean()
        keep, _ = regressor.shape.errors(code - codes[rows])
        return {
            "total": collision + settings.keep_weight * keep,
            "collision": collision.detach(),
            "keep": keep.detach(),
        }

    trained = {name: p.requires_grad for name, p in regressor.named_parameters()}
    for name, parameter in regressor.named_parameters():
        parameter.requires_grad_(not name.startswith("bos."))
    identity = f"{settings} {array_digest(before.cpu().numpy())}"
    train(regressor, batches, loss, settings.training, work_dir, progress=progress, identity=identity)
    for name, parameter in regressor.named_parameters():
        parameter.requires_grad_(trained[name])
    regressor.cpu()
    after = regressor.dress_all([tracks[i] for i in kept])
    new_heights = [surfaces[i].heights(g) for i, g in zip(kept, after, strict=True)]
    moved = np.sqrt(np.mean([np.square(a - garments[i]).sum(-1).mean() for i, a in zip(kept, after, strict=True)]))
    (share, depth), (new_share, new_depth) = _inside([heights[i] for i in kept]), _inside(new_heights)
    discarded = len(tracks) - len(kept)
    return CollisionReport(len(tracks), discarded, share, new_share, depth, new_depth, float(moved))


def _predict(regressor: Regressor, features: Tensor, lead: int) -> Tensor:
    """Free-running codes [B, T, K] with gradients: an auto-regressive decoder gets its own roll-out as its past."""
    if not isinstance(regressor, SequenceRegressor):
        return regressor.unroll(features, lead)
    with torch.no_grad():
        own = regressor.unroll(features, lead)
        past = torch.cat([regressor.first_token(features, lead).float()[:, None], own[:, :-1]], dim=1)
    return regressor.predict_all(features, past, lead)


def _inside(heights: list[np.ndarray]) -> tuple[float, float]:
    """Share of vertices inside, and their mean depth [m]."""
    whole = np.concatenate([h.ravel() for h in heights])
    inside = whole[whole < 0.0]
    return len(inside) / len(whole), float(-inside.mean()) if len(inside) else 0.0
