"""Training, storing and loading of GSNet and of the networks that it is compared with (Peng 2023, section 3.5).

In: garments with simulated motions, on one body. Out: a trained network and its log. A step takes a few sequences of a
few garments: data loss on what the network rehearses, edge, bend and collision losses on some of those frames, and on
the same frames, without truth, what the physical regressor makes of them. ``energies`` leaves the truth out altogether
and adds gravity (PBNS).
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch
from torch import Tensor

from body.model import Body
from geometry.topology import face_areas
from models.checkpoint import load_model, save_model
from models.garment_animator import STILL, Animator, Worn, skinned
from models.garment_graph import GarmentGraph
from models.gsnet import GSNet, GSNetConfig
from models.gsnet_anchor import AnchorSettings, anchor
from models.gsnet_baselines import BASELINES, BaselineConfig, PerGarment
from models.gsnet_examples import TrainingData, WardrobeExample
from models.gsnet_losses import (
    bend_loss,
    collision_loss,
    data_loss,
    distance_loss,
    edge_loss,
    gravity_loss,
)
from models.published_gsnet import PublishedGSNet
from models.training import Progress, TrainingLog, TrainingSettings, array_digest, prepare, train

KIND = "wardrobe_animator"
NETWORKS: dict[str, type[Animator]] = {GSNet.kind: GSNet, PublishedGSNet.kind: PublishedGSNet} | BASELINES
CENTIMETRE = 1.0e-2
"""Squared lengths are minimised in cm^2, distances in cm: of the size that gradients are clipped at."""


@dataclass(frozen=True)
class AnimatorTraining:
    """How a network is trained.

    Attributes:
        training: Epochs, steps' sizes.
        anchor: How the linear map of a network that has one is found, before the first epoch.
        loss: "squared" (Eq. 5), "distance" (the tables' figure), or "energies" (no truth at all).
        batch: Sequences of a garment in a step.
        garments_a_step: Garments in a step.
        frames: Of each sequence, for networks that take frames one by one.
        contact_frames: Frames of every clip, evenly spread, at which the body is looked at.
        physics_frames: Frames of a step, at most, that edge, bend and collision losses are computed on; 0 = none.
        edge_weight, bend_weight, collision_weight: Of the losses, in terms of squared distances [m^2].
        bend_length: Length that stands for a normal's change of 1 in the bend loss [m].
        mirror: Whether half of what is learned from is in the mirror; not for networks of single garments.
        margin: epsilon of the collision loss, and distance that the physical regressor aims at [m].
        gravity: [m/s^2], and density [kg/m^2], stiffness [N/m] of "energies".
    """

    training: TrainingSettings = field(default_factory=lambda: TrainingSettings(epochs=20, learning_rate=1e-3))
    anchor: AnchorSettings = field(default_factory=AnchorSettings)
    loss: str = "squared"
    batch: int = 4
    garments_a_step: int = 2
    frames: int = 12
    contact_frames: int = 4
    physics_frames: int = 4
    edge_weight: float = 1.0
    bend_weight: float = 1.0
    bend_length: float = 2.0e-3
    collision_weight: float = 1.0
    mirror: bool = False
    margin: float = 4.0e-3
    gravity: float = 9.81
    density: float = 0.15
    stiffness: float = 300.0

    def __post_init__(self) -> None:
        if self.loss not in ("squared", "distance", "energies"):
            raise ValueError(f"animator loss: {self.loss!r} is not one of squared, distance, energies")
        if self.loss == "energies" and self.physics_frames < 1:
            raise ValueError("animator physics_frames: energies need at least 1")


def fit_animator(
    animator: Animator,
    examples: Sequence[WardrobeExample],
    body: Body,
    settings: AnimatorTraining,
    work_dir: Path | str,
    validation: Sequence[WardrobeExample] = (),
    progress: Progress | None = None,
) -> TrainingLog:
    """Train a network in place on examples of one length, on the CPU; it is left there in eval mode.

    Args:
        animator: Made by ``build_animator``.
        examples: Training split.
        body: That of all motions.
        settings: Epochs, batches, weights.
        work_dir: Folder of this run alone; a killed run continues there.
        validation: Held-out examples, dressed free-running; their mean vertex error [mm] is logged.
        progress: Takes lines of text.

    Raises:
        ValueError: No examples, or lengths that differ.
    """
    if len({(e.track.frames, e.track.lead) for e in examples}) != 1:
        raise ValueError(f"{animator.kind}: needs training sequences of one length, got {len(examples)} of several")
    # Its steps are many small products on sparse meshes, and its examples lie in main memory: it trains on the CPU.
    settings = replace(settings, training=replace(settings.training, device="cpu"))
    prepare(settings.training)
    if settings.mirror and isinstance(animator, PerGarment):
        raise ValueError(f"{animator.kind}: it knows a vertex by its number, so mirror must be false")
    anchored = isinstance(animator, GSNet) and animator.linear is not None
    if settings.mirror and anchored:
        raise ValueError(
            f"{animator.kind}: its linear map is that of the garments as they are, so mirror must be false"
        )
    data = TrainingData(examples, body, settings.contact_frames, settings.mirror)
    data.scale(animator)
    if not any(p.requires_grad for p in animator.parameters()):
        return TrainingLog()

    def begin() -> dict[str, float]:
        return anchor(animator, data, settings.anchor)

    def batches(epoch: int, generator: np.random.Generator):
        return data.batches(settings.batch, settings.garments_a_step, generator)

    def loss(groups: list[np.ndarray]) -> dict[str, Tensor]:
        worn = [data.worn(animator, rows) for rows in groups]
        frames = data.some_frames(settings.frames, -(-settings.frames // 4) if settings.physics_frames else 0)
        terms: dict[str, list[Tensor]] = {}
        for w, rows, said in zip(worn, groups, animator.rehearse(worn, frames), strict=True):
            for name, value in _terms(animator, w, said, data, rows, settings).items():
                terms.setdefault(name, []).append(value)
        means = {name: torch.stack(values).mean() for name, values in terms.items()}
        total = sum(v for n, v in means.items() if not n.endswith("_mm"))
        return {"total": total} | {name: value.detach() for name, value in means.items()}

    def validate() -> dict[str, float]:
        errors = [_error_mm(animator, some, body) for some in _alike(validation)]
        return {"error_mm": float(np.mean(np.concatenate(errors)))}

    digest = array_digest(*(e.vertices for e in examples), *(e.track.pose for e in examples))
    return train(
        animator,
        batches,
        loss,
        settings.training,
        work_dir,
        validate=validate if validation else None,
        progress=progress,
        identity=f"{animator.config} {settings} {digest}",
        begin=begin if anchored else None,
    )


def _terms(animator: Animator, worn: Worn, said, data: TrainingData, rows: np.ndarray, s: AnimatorTraining):
    """Losses of one garment of a step, squared lengths in cm^2."""
    graph, unit = worn.graph, CENTIMETRE**2
    terms = {name: value / unit for name, value in said.terms.items()}
    truth = worn.truth[:, said.frames]
    terms["error_mm"] = 1e3 * distance_loss(said.vertices.detach(), truth)
    if s.loss == "squared":
        terms["data"] = data_loss(said.vertices, truth) / unit
    elif s.loss == "distance":
        terms["data"] = distance_loss(said.vertices, truth) / CENTIMETRE
    place = {int(f): k for k, f in enumerate(data.contact)}
    known = [(b, k, place[int(f)]) for b in range(len(rows)) for k, f in enumerate(said.frames) if int(f) in place]
    if not known or not s.physics_frames:
        if s.loss == "energies":
            raise ValueError("animator: no frame of the step is one at which the body is known")
        return terms
    chosen = [known[int(i)] for i in torch.randperm(len(known))[: s.physics_frames]]
    sequence, frame, contact = (torch.tensor(x) for x in zip(*chosen, strict=True))
    vertices = said.vertices[sequence, frame]
    found = [
        data.nearest(graph, data.clip[rows[b]], c, v)
        for b, c, v in zip(sequence.tolist(), contact.tolist(), vertices.detach().numpy(), strict=True)
    ]
    points, normals = (torch.as_tensor(np.stack(x)) for x in zip(*found, strict=True))
    physical = _physics(vertices, graph, points, normals, s)
    if s.loss == "energies":
        return terms | _energies(physical, vertices, worn, sequence, said.frames[frame], s)
    terms |= {name: value / unit for name, value in physical.items()}
    if animator.regressor is not None:
        still = vertices.detach()
        corrected = animator.regressor(worn.encoding, sequence, still, points, normals, s.margin)
        # Without truth, and without pulling at the network: the regressor learns from what it is given.
        own = _physics(corrected, graph, points, normals, s)
        terms["regressor"] = (sum(own.values()) + data_loss(corrected, still)) / unit
    return terms


def _physics(vertices: Tensor, graph: GarmentGraph, points: Tensor, normals: Tensor, s: AnimatorTraining):
    """Weighted edge, bend and collision losses [m^2] of vertices [S, N, 3]."""
    terms = {"edge": s.edge_weight * edge_loss(vertices, graph.edges, graph.rest_lengths)}
    terms["bend"] = s.bend_weight * s.bend_length**2 * bend_loss(vertices, graph.faces, graph.edges)
    terms["collision"] = s.collision_weight * collision_loss(vertices, points, normals, s.margin)
    return terms


def _energies(physical: dict[str, Tensor], vertices: Tensor, worn: Worn, sequence: Tensor, frame: Tensor, s):
    """Energies a vertex [mJ] of a garment that nobody simulated (PBNS, Bertiche 2021): springs, weight, pins."""
    graph = worn.graph
    area = float(face_areas(graph.vertices, graph.topology.faces).sum())
    now = worn.motion.wanted()
    down = now.features[sequence, frame][:, STILL - 3 : STILL]
    mass = torch.full((len(graph.vertices),), s.density * area / len(graph.vertices))
    terms = {name: 1e3 * s.stiffness * value for name, value in physical.items()}
    terms["gravity"] = 1e3 * gravity_loss(vertices, s.gravity * down, mass) / len(graph.vertices)
    if len(graph.pinned):
        pinned = torch.as_tensor(graph.pinned.astype(np.int64))
        held = skinned(graph.skin[pinned], now.transforms[sequence, frame][:, None])[:, 0]
        terms["pins"] = 1e3 * s.stiffness * data_loss(vertices[:, pinned], held)
    return terms


def _alike(examples: Sequence[WardrobeExample]) -> list[list[WardrobeExample]]:
    """Groups of one garment and one length."""
    groups: dict[tuple, list[WardrobeExample]] = {}
    for e in examples:
        groups.setdefault((id(e.graph), e.track.frames, e.track.lead), []).append(e)
    return list(groups.values())


def _error_mm(animator: Animator, some: list[WardrobeExample], body: Body) -> np.ndarray:
    """Mean vertex error [mm] of each example."""
    dressed = animator.dress_all(some[0].graph, [e.material for e in some], [e.track for e in some], body)
    return np.array([1e3 * np.linalg.norm(d - e.vertices, axis=2).mean() for d, e in zip(dressed, some, strict=True)])


def build_animator(kind: str, config: dict[str, Any]) -> Animator:
    """Untrained network of a kind; ``config`` as of ``GSNetConfig`` or ``BaselineConfig``."""
    if kind not in NETWORKS:
        raise ValueError(f"unknown animator {kind!r}; known: {', '.join(NETWORKS)}")
    made = BaselineConfig(**config) if kind in BASELINES else GSNetConfig(**config)
    return NETWORKS[kind](made)


def save_animator(path: str | os.PathLike, animator: Animator) -> None:
    """Write a trained network to one file."""
    save_model(path, KIND, {"kind": animator.kind, "config": asdict(animator.config)}, animator)


def load_animator(path: str | os.PathLike) -> Animator:
    """Read a network written by ``save_animator``; ``ValueError`` when the file is none."""
    stored = load_model(path, KIND)
    if not isinstance(stored.config.get("config"), dict):
        raise ValueError(f"{path} is damaged: it lacks the network's configuration")
    animator = build_animator(stored.config.get("kind"), stored.config["config"])
    stored.into(animator)
    return animator
