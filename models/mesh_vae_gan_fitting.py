"""Training, storing and loading of the conditional Mesh VAE-GAN (Ma 2019, sections 3.2.2 and 4).

In: layer frames of the training split. Out: a trained network and its log. Generator and discriminator are trained in
one step: the discriminator's loss sees generated layers without their gradient, and the generator's a discriminator
whose weights are held still, so that one backward pass gives each its own gradient.
"""

from __future__ import annotations

import os
from dataclasses import asdict
from pathlib import Path

import numpy as np
import torch
from torch import Tensor
from torch.func import functional_call

from body.model import Body
from datasets.layers import LayerExamples
from geometry.mesh_hierarchy import MeshHierarchy
from models.checkpoint import load_model, save_model
from models.layer_losses import coordinate_loss, deception_loss, discriminator_loss, latent_loss, normal_loss
from models.mesh_vae_gan import (
    MeshVaeGan,
    MeshVaeGanConfig,
    hierarchy_tensors,
    pose_features,
    rebuilt_hierarchy,
    regression_inputs,
)
from models.pca import fit_pca
from models.training import (
    Progress,
    TrainingLog,
    TrainingSettings,
    array_digest,
    prepare,
    shuffled_batches,
    train,
)

KIND = "mesh_vae_gan"
FOLDS = 4
"""Parts that the training labels are divided into: what a regression on the others leaves over of each is kept."""
RIDGES = (1.0e-2, 3.0e-2, 0.1, 1.0)
"""Penalties that are tried, a share of the features' own variance."""
SAMPLED = 16
"""Every so many coordinates are looked at to choose one of them."""


def fit_mesh_vae_gan(
    examples: LayerExamples,
    hierarchy: MeshHierarchy,
    body: Body,
    config: MeshVaeGanConfig,
    batch: int,
    settings: TrainingSettings,
    work_dir: Path | str,
    validation: LayerExamples | None = None,
    progress: Progress | None = None,
) -> tuple[MeshVaeGan, TrainingLog]:
    """Train a network on the frames of the training split; returns it on the CPU in eval mode, with its log.

    Args:
        examples: Training frames.
        hierarchy: Of the body mesh; its finest level must be the examples' vertices.
        body: The run's own body.
        config: Sizes and switches.
        batch: Frames a step.
        settings: Epochs, learning rate, seed.
        work_dir: Folder of this run alone; a killed run continues there.
        validation: Held-out frames; their error [mm] is logged.
        progress: Takes lines of text.

    Raises:
        ValueError: Hierarchy, body and examples do not belong together.
    """
    _check(examples, hierarchy, body, config)
    device = prepare(settings)
    module = build_mesh_vae_gan(config, hierarchy, body)
    data = torch.as_tensor(examples.displacements)
    _set_scaling(module, data, examples)
    kinds = torch.nn.functional.one_hot(torch.as_tensor(examples.type_index), len(config.types)).float()
    if config.kind == "anchored":
        _anchor(module, data, module.posed_features(examples.pose), kinds, examples.clip, settings.seed)
    module.to(device)
    data, kinds, posed = data.to(device), kinds.to(device), module.posed_features(examples.pose)

    def batches(epoch: int, generator: np.random.Generator):
        for rows in shuffled_batches(len(examples), batch, generator):
            yield torch.as_tensor(rows, device=device)

    def loss(rows: Tensor) -> dict[str, Tensor]:
        return layer_losses(module, module.scaled(data[rows]).contiguous(), posed[rows], kinds[rows])

    def validate() -> dict[str, float]:
        names = [config.types[k] for k in validation.type_index]
        error = module.reconstruct(validation.displacements, validation.pose, names) - validation.displacements
        worn = validation.covered[validation.type_index]
        return {"error_mm": 1e3 * float(np.linalg.norm(error, axis=2)[worn].mean())}

    log = train(
        module,
        batches,
        loss,
        settings,
        work_dir,
        validate=validate if validation is not None and len(validation) else None,
        progress=progress,
        identity=f"{config} {batch} {array_digest(examples.displacements, examples.pose, examples.type_index)}",
    )
    return module.cpu(), log


def layer_losses(module: MeshVaeGan, truth: Tensor, pose: Tensor, types: Tensor) -> dict[str, Tensor]:
    """All losses of a batch (Ma 2019, eq. 5 to 9): features [A, N, 3] in network units, pose [N, P], types [N, K]."""
    config = module.config
    mean, log_variance = module.encode(truth, pose, types)
    z = mean
    if config.variational and module.training:
        z = mean + (0.5 * log_variance).exp() * torch.randn_like(mean)
    generated = module.decode(z, pose, types)
    coordinates = coordinate_loss(generated, truth)
    terms = {"coordinates": coordinates.detach(), "error_mm": 1e3 * module.scale * _distance(generated, truth)}
    total = coordinates
    if config.normal_weight > 0.0:
        with torch.no_grad():
            wanted = module.normals(truth)
        normals = normal_loss(module.normals(generated), wanted)
        total = total + config.normal_weight * normals
        terms["normals"] = normals.detach()
    if config.variational:
        latent = latent_loss(mean, log_variance)
        total = total + config.kl_weight * latent
        terms["latent"] = latent.detach()
    if config.discriminator != "none":
        code = module.condition(pose, types).detach() if config.conditional else None
        judge = module.discriminator
        still = {name: value.detach() for name, value in judge.named_parameters()}
        deception = deception_loss(functional_call(judge, still, (generated, code)))
        judged = discriminator_loss(judge(truth, code), judge(generated.detach(), code))
        total = total + config.adversarial_weight * deception + judged
        terms |= {"deception": deception.detach(), "discriminator": judged.detach()}
    return {"total": total, **terms}


def build_mesh_vae_gan(config: MeshVaeGanConfig, hierarchy: MeshHierarchy, body: Body) -> MeshVaeGan:
    """Untrained network for a body; ``ValueError`` in one sentence where it is for another one."""
    _check_body("mesh VAE-GAN", config, body)
    module = MeshVaeGan(config, hierarchy, body.vertices[hierarchy.levels[0]])
    module.body_vertices = len(body.vertices)
    return module


def save_mesh_vae_gan(path: str | os.PathLike, module: MeshVaeGan) -> None:
    """Write a trained network, with the levels of its mesh, to one file."""
    save_model(path, KIND, asdict(module.config), module, hierarchy_tensors(module.hierarchy))


def load_mesh_vae_gan(path: str | os.PathLike, body: Body) -> MeshVaeGan:
    """Read a network written by ``save_mesh_vae_gan``.

    Raises:
        ValueError: The file is none, damaged, or its network dresses another body.
    """
    stored = load_model(path, KIND)
    config = MeshVaeGanConfig(**stored.config)
    _check_body(str(path), config, body)
    if "level_count" not in stored.extra:
        raise ValueError(f"{path} is damaged: it lacks the levels of the body mesh")
    module = build_mesh_vae_gan(config, rebuilt_hierarchy(config, stored.extra), body)
    stored.into(module)
    return module


def _set_scaling(module: MeshVaeGan, data: Tensor, examples: LayerExamples) -> None:
    module.mean.copy_(data.mean(0))
    module.scale.copy_((data - module.mean).square().mean().sqrt().clamp_min(1e-6))
    raw = torch.as_tensor(pose_features(examples.pose, module.config.pose))
    module.pose_mean.copy_(raw.mean(0))
    # A joint that never moves would be blown up by the first clip in which it does.
    module.pose_spread.copy_(raw.std(0).clamp_min(0.05))


def _anchor(module: MeshVaeGan, data: Tensor, pose: Tensor, types: Tensor, clips: np.ndarray, seed: int) -> None:
    """Set the regression of ``anchored`` and the bases of what it leaves over on clips it was not fitted to."""
    flat = ((data - module.mean) / module.scale).flatten(1).numpy()
    inputs = regression_inputs(pose, types).numpy().astype(np.float64)
    labels = [clip.rsplit("_", 1)[0] for clip in clips.tolist()]  # another clip of a label is hardly unseen
    names = sorted(set(labels))
    fold = np.array([names.index(label) % FOLDS for label in labels])
    if len(names) < 2:  # nothing unseen to learn from
        fold = np.arange(len(clips)) % FOLDS
    penalised = np.ones(inputs.shape[1])
    penalised[:: pose.shape[1] + 1] = 1e-6  # the constant of each type
    grams, products = [], []
    for k in range(FOLDS):
        rows = fold == k
        grams.append(inputs[rows].T @ inputs[rows])
        products.append(inputs[rows].astype(np.float32).T @ flat[rows])
    gram, product = sum(grams), sum(products)

    def left_over(ridge: float, columns: slice) -> np.ndarray:
        rest = np.empty_like(flat[:, columns])
        for k in range(FOLDS):
            rows, others = fold == k, int((fold != k).sum())
            solved = np.linalg.solve(
                gram - grams[k] + np.diag(ridge * others * penalised), product[:, columns] - products[k][:, columns]
            )
            rest[rows] = flat[rows][:, columns] - inputs[rows].astype(np.float32) @ solved.astype(np.float32)
        return rest

    kind = types.argmax(1).numpy()
    every = slice(None, None, SAMPLED)  # a sample of the coordinates tells which penalty is best
    ridge = min(RIDGES, key=lambda one: _unexplained(left_over(one, every), kind, fold, module.config.latent))
    solved = np.linalg.solve(gram + np.diag(ridge * len(flat) * penalised), product)
    # The best low rank of the predictions, not of the weights: directions that the data never take cost nothing.
    root = np.linalg.cholesky(gram / len(flat) + 1e-6 * np.eye(len(gram))).T
    weighted = root @ solved
    _, vectors = np.linalg.eigh(weighted @ weighted.T)
    rank = min(module.config.components, len(gram))
    vectors = vectors[:, ::-1][:, :rank]
    module.regression[:, :rank] = torch.as_tensor(np.linalg.solve(root, vectors), dtype=torch.float32)
    module.directions[:rank] = torch.as_tensor(vectors.T @ weighted, dtype=torch.float32)
    _set_bases(module, left_over(ridge, slice(None)), kind, seed)


def _unexplained(rest: np.ndarray, kind: np.ndarray, fold: np.ndarray, length: int) -> float:
    """Sum of squares of what neither the regression nor components of the other clips say of each fold's clips."""
    total = 0.0
    for k in range(FOLDS):
        for one in np.unique(kind):
            own, others = rest[(fold == k) & (kind == one)], rest[(fold != k) & (kind == one)]
            if len(own) and len(others):
                _, vectors = np.linalg.eigh(others.T @ others)
                own = own - own @ vectors[:, -length:] @ vectors[:, -length:].T
            total += float(np.square(own).sum())
    return total


def _set_bases(module: MeshVaeGan, rest: np.ndarray, kind: np.ndarray, seed: int) -> None:
    """Each type's components of what the regression leaves over, [N, 3 A], times their deviations.

    Any turn of z leaves it standard normal, so each basis is turned as near as can be to the first one (Procrustes).
    """
    latent, shared, first = module.config.latent, None, None
    for number in range(len(module.config.types)):
        own = rest[kind == number]
        if len(own) > latent:
            pca = fit_pca(own, latent, seed)
        else:  # too few frames have that many components; those of all types stand in
            pca = shared = shared or fit_pca(rest, latent, seed)
        basis = np.maximum(pca.deviations, 1e-4)[:, None] * pca.components
        first = basis if first is None else first
        left, _, right = np.linalg.svd(first @ basis.T)
        basis = (left @ right) @ basis
        module.bases[number] = torch.as_tensor(basis)
        module.inverses[number] = torch.as_tensor(np.linalg.inv(basis @ basis.T))


def _distance(a: Tensor, b: Tensor) -> Tensor:
    return (a - b).detach().norm(dim=-1).mean()


def _check(examples: LayerExamples, hierarchy: MeshHierarchy, body: Body, config: MeshVaeGanConfig) -> None:
    if not len(examples):
        raise ValueError("mesh VAE-GAN: no training frames")
    if examples.types != config.types:
        known = ", ".join(config.types)
        raise ValueError(f"mesh VAE-GAN: the frames have types {', '.join(examples.types)}, the network {known}")
    if not examples.body_digest == hierarchy.digest == body.digest:
        raise ValueError(
            f"mesh VAE-GAN: frames of body {examples.body_digest} and a hierarchy of {hierarchy.digest} cannot train "
            f"a network for {body.name} ({body.digest})"
        )
    if not np.array_equal(examples.vertices, hierarchy.levels[0]):
        raise ValueError("mesh VAE-GAN: the hierarchy's finest level is not the vertices that the types cover")


def _check_body(what: str, config: MeshVaeGanConfig, body: Body) -> None:
    if config.body_digest != body.digest:
        raise ValueError(
            f"{what}: made for body {config.body_name} ({config.body_digest}), it cannot dress {body.name} "
            f"({body.digest})"
        )
