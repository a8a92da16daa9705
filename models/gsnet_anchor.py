"""What of GSNet is linear in the motion, in closed form: where its training begins.

In: garments with simulated motions. Out: a ``GSNet`` whose linear map and whose edges are set. A ridge regression from
the motion of the last second, one a garment, is a better garment on new clips than any network that is trained as long
from random weights; but it dresses that garment alone, vertex by vertex. So, in three steps:

1. of every garment the ridge regression of what skinning leaves over, ``W_g [D, 3 N]``;
2. of all of them together the displacements that explain most, ``M [D, 3 K]``, so that ``W_g = M e_g``: a row of edges
   ``e_g [N, K]`` for every vertex of every garment. K of a few hundred leaves a thousandth of the square over;
3. the encoder learns ``e_g`` from the template. No motion is in this, so a thousand passes over the garments take no
   longer than a few epochs of training; and an encoder knows what to do with a garment that it never saw.

Distances are measured in M whitened by the covariance of the motion, so an error of an edge is an error of the cloth.
From there the network is trained as any other; the linear map stays.

Dimensions: D numbers of the last second's motion, N garment vertices, K edges a vertex.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from torch import Tensor, nn

from models.garment_animator import skinned
from models.garment_graph import GarmentGraph
from models.gsnet import REACH, GSNet
from models.gsnet_examples import TrainingData
from models.optimizers import AdamW


@dataclass(frozen=True)
class AnchorSettings:
    """How the linear part is found.

    Attributes:
        penalty: Of the ridge regressions, on features of unit spread.
        epochs: Passes of the encoder over the garments.
        learning_rate: Of the encoder at its height; it rises over a tenth of the steps and falls to nothing.
        gradient_clip: Largest norm of the gradient.
    """

    penalty: float = 0.1
    epochs: int = 300
    learning_rate: float = 3.0e-3
    gradient_clip: float = 1.0

    def __post_init__(self) -> None:
        for name in ("penalty", "learning_rate", "gradient_clip"):
            if not getattr(self, name) > 0.0:
                raise ValueError(f"gsnet anchor {name}: must be above 0, got {getattr(self, name)}")
        if self.epochs < 1:
            raise ValueError(f"gsnet anchor epochs: must be at least 1, got {self.epochs}")


@dataclass(frozen=True)
class _Sums:
    """Of one garment over its frames: features with a last one that is 1, and what skinning leaves over [m]."""

    xx: Tensor  # [D + 1, D + 1]
    xy: Tensor  # [D + 1, 3 N]
    frames: int


def anchor(network: GSNet, data: TrainingData, settings: AnchorSettings) -> dict[str, float]:
    """Set the linear map and the encoder's edges of a network from its training data; scaling must be set.

    Returns:
        ``linear_rms_mm``: what the regressions move vertices by, root mean square over training frames [mm];
        ``edges_rms_mm``: what the encoder's edges leave of that.

    Raises:
        ValueError: The network has no linear map.
    """
    if network.linear is None:
        raise ValueError("gsnet: only a network with a linear map can be anchored")
    sums = {id(graph): _sums(network, data, graph) for graph in data.graphs}
    frames = sum(s.frames for s in sums.values())
    covariance = sum(s.xx for s in sums.values()) / frames
    identity = torch.eye(len(covariance), dtype=covariance.dtype)
    root = torch.linalg.cholesky(covariance + 1e-4 * identity)
    # Whitened, each row what one vertex does, its three directions side by side.
    rows = {key: _rows(root.T @ _ridge(s, settings.penalty)) for key, s in sums.items()}
    bases = _most_common(torch.cat(list(rows.values())), network.linear.out_features // 3)
    edges = {key: (found @ bases).float() for key, found in rows.items()}
    spread = torch.cat(list(edges.values())).std()
    _set_linear(network.linear, root, bases * (spread / (network.edge_scale * REACH)))
    left = _fit_edges(network, data, {key: found / spread for key, found in edges.items()}, settings)
    moved = torch.cat(list(edges.values())).square().sum(1).mean().sqrt()
    return {"linear_rms_mm": 1e3 * float(moved), "edges_rms_mm": 1e3 * left * float(spread)}


@torch.no_grad()
def _sums(network: GSNet, data: TrainingData, graph: GarmentGraph) -> _Sums:
    """Sums of one garment, an example at a time."""
    rows = [i for i, e in enumerate(data.examples) if e.graph is graph]
    xx = xy = 0.0
    for i in rows:
        motion = data.motion.take(torch.tensor([data.clip[i]]))
        now = motion.lead + torch.arange(motion.frames)
        x = network.past(motion, now)[0]
        x = torch.cat([x, torch.ones(len(x), 1)], dim=1).double()
        y = torch.as_tensor(data.examples[i].vertices) - skinned(graph.skin, motion.transforms[:, now])[0]
        xx, xy = xx + x.T @ x, xy + x.T @ y.flatten(1).double()
    return _Sums(xx, xy, len(rows) * data.motion.frames)


def _ridge(sums: _Sums, penalty: float) -> Tensor:
    """Weights [D + 1, 3 N]; the last feature, 1, goes all but unpunished."""
    punished = torch.full((len(sums.xx),), penalty, dtype=sums.xx.dtype)
    punished[-1] = 1e-3 * penalty
    return torch.linalg.solve(sums.xx + sums.frames * punished.diag(), sums.xy)


def _rows(weights: Tensor) -> Tensor:
    """Weights [D, 3 N] as a row [3 D] a vertex."""
    return weights.unflatten(1, (-1, 3)).permute(1, 2, 0).flatten(1)


def _most_common(rows: Tensor, count: int) -> Tensor:
    """Orthonormal columns [3 D, count] that explain most of the rows [., 3 D]; zeros where the rows have no more."""
    vectors = torch.linalg.eigh(rows.T @ rows).eigenvectors[:, -count:].flip(1)
    return nn.functional.pad(vectors, (0, count - vectors.shape[1]))


@torch.no_grad()
def _set_linear(linear: nn.Linear, root: Tensor, bases: Tensor) -> None:
    """Displacements of whitened motion, columns [3 (D + 1)], as weights and bias of messages [K, 3]."""
    whitened = bases.unflatten(0, (3, -1)).permute(1, 2, 0).flatten(1)  # [D + 1, K 3]
    weights = torch.linalg.solve_triangular(root.T, whitened, upper=True)
    linear.weight.copy_(weights[:-1].T)
    linear.bias.copy_(weights[-1])


def _fit_edges(network: GSNet, data: TrainingData, edges: dict[int, Tensor], settings: AnchorSettings) -> float:
    """Teach the encoder the edges [N, K] of every garment, each in one of its materials; returns the last epoch's rms
    over vertices of what is left, all edges of a vertex together.
    """
    materials = {id(g): [torch.as_tensor(e.material) for e in data.examples if e.graph is g] for g in data.graphs}
    parameters = [*network.encoder.parameters(), *network.edges.parameters()]
    optimizer = AdamW(parameters, lr=settings.learning_rate, weight_decay=0.0, fused=True)
    steps, step, left = settings.epochs * len(data.graphs), 0, 0.0
    for _ in range(settings.epochs):
        left = 0.0
        for number in torch.randperm(len(data.graphs)).tolist():
            graph = data.graphs[number]
            some, wanted = materials[id(graph)], edges[id(graph)]
            material = some[int(torch.randint(len(some), (1,)))]
            for group in optimizer.param_groups:
                group["lr"] = settings.learning_rate * _rate(step / steps)
            features = network.encoder(graph, network.vertex_features(graph, material[None]))
            error = (network.edges(features)[:, 0] - wanted).square().sum(1).mean()
            optimizer.zero_grad(set_to_none=True)
            # Relative to the garment's own: a skirt moves ten times as far as a top, and both are to be right.
            (error / wanted.square().sum(1).mean().clamp_min(1e-6)).backward()
            nn.utils.clip_grad_norm_(parameters, settings.gradient_clip)
            optimizer.step()
            step, left = step + 1, left + float(error.detach()) / len(data.graphs)
    return math.sqrt(left)


def _rate(done: float) -> float:
    """Of the learning rate, with a part ``done`` of the steps behind: up over a tenth, then down a cosine."""
    return min(1.0, 10.0 * done + 0.01) * 0.5 * (1.0 + math.cos(math.pi * max(0.0, (done - 0.1) / 0.9)))
