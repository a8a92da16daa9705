"""The Mesh VAE-GAN: its convolution, its losses, its condition, its training and what it refuses."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import scipy.sparse as sp
import torch

from body.model import Body
from datasets.layers import LayerExamples
from geometry.mesh_hierarchy import MeshHierarchy, build_hierarchy
from models.layer_losses import (
    coordinate_loss,
    deception_loss,
    discriminator_loss,
    latent_loss,
    normal_loss,
    unit_face_normals,
)
from models.mesh_convolution import ChebyshevConvolution, SparseOperator, scaled_laplacian
from models.mesh_vae_gan import MeshVaeGanConfig, pose_features
from models.mesh_vae_gan_fitting import (
    build_mesh_vae_gan,
    fit_mesh_vae_gan,
    layer_losses,
    load_mesh_vae_gan,
    save_mesh_vae_gan,
)
from models.training import TrainingSettings

TYPES = ("shortlong", "longshort")


@pytest.fixture(scope="module")
def body() -> Body:
    return Body.load("small")


@pytest.fixture(scope="module")
def hierarchy(body) -> MeshHierarchy:
    trunk = np.flatnonzero(np.isin(body.part_of_vertex, (0, 1, 2, 3, 6, 9)))
    return build_hierarchy(body.vertices, body.faces, trunk, [120, 50], body.digest)


@pytest.fixture(scope="module")
def examples(body, hierarchy) -> LayerExamples:
    """A layer that hangs on pose and type by a formula, with a hidden number that z has to carry."""
    generator = np.random.default_rng(0)
    vertices, count = hierarchy.levels[0], 240
    pose = generator.normal(0.0, 0.3, (count, 24, 3)).astype(np.float32)
    kind, hidden = generator.integers(0, 2, count), generator.normal(0.0, 1.0, count)
    place = body.vertices[vertices].astype(np.float64)
    field = 0.02 * np.sin(12.0 * place)[None] * (1.0 + 0.5 * kind[:, None, None])
    field = field + 0.02 * pose[:, 3, None, :] * np.cos(9.0 * place[None, :, :1])
    field = field + 0.01 * hidden[:, None, None] * np.sin(20.0 * place[None, :, 1:2])
    clip = np.array([f"clip_{k % 8}" for k in range(count)], dtype=object)
    return LayerExamples(
        TYPES, body.name, body.digest, vertices, np.ones((2, len(vertices)), bool), field.astype(np.float32), kind,
        np.ones(count, int), np.arange(count) % 8, pose, np.zeros((count, 3)), np.zeros((count, 10)),
        np.array(["train"] * count, dtype=object), clip,
    )  # fmt: skip


def config(body: Body, **changes) -> MeshVaeGanConfig:
    base = MeshVaeGanConfig(
        "paper", TYPES, body.name, body.digest, latent=4, widths=(4, 8), levels=(0, 2), discriminator_widths=(4, 4),
        discriminator_levels=(0, 1), components=8,
    )  # fmt: skip
    return replace(base, **changes)


SETTINGS = TrainingSettings(epochs=3, learning_rate=2e-3, device="cpu")


def test_the_convolution_is_the_polynomial_of_the_dense_laplacian():
    generator = np.random.default_rng(0)
    upper = np.triu(generator.random((30, 30)) < 0.2, 1).astype(float)
    adjacency = upper + upper.T
    degree = np.maximum(adjacency.sum(1), 1.0)
    normalized = np.diag((adjacency.sum(1) > 0).astype(float)) - adjacency / np.sqrt(np.outer(degree, degree))
    scaled = normalized - np.diag((adjacency.sum(1) > 0).astype(float))
    layer = ChebyshevConvolution(SparseOperator(scaled_laplacian(sp.csr_matrix(adjacency))), 3, 5, 4)
    with torch.no_grad():
        layer.bias.normal_()
    x = generator.normal(size=(30, 2, 3)).astype(np.float32)
    terms = [np.eye(30), scaled]
    for _ in range(2):
        terms.append(2.0 * scaled @ terms[-1] - terms[-2])
    weight = layer.weight.detach().numpy()
    expected = sum(np.einsum("vw,wbi,io->vbo", t, x, weight[k]) for k, t in enumerate(terms))
    found = layer(torch.as_tensor(x)).detach().numpy()
    assert np.abs(found - expected - layer.bias.detach().numpy()).max() < 1e-4


def test_the_gradient_of_a_sparse_product_is_the_transposes():
    matrix = sp.random(12, 9, 0.3, random_state=0, format="csr")
    operator = SparseOperator(matrix)
    x = torch.randn(9, 2, 3, requires_grad=True)
    weight = torch.randn(12, 2, 3)
    (operator(x) * weight).sum().backward()
    expected = torch.einsum("nm,nbf->mbf", torch.as_tensor(matrix.toarray(), dtype=torch.float32), weight)
    assert torch.allclose(x.grad, expected, atol=1e-5)


def test_losses_are_those_of_their_formulas():
    generator = np.random.default_rng(0)
    a, b = generator.normal(size=(2, 6, 2, 3)).astype(np.float32)
    faces = np.array([[0, 1, 2], [2, 3, 4], [1, 5, 3]])
    assert float(coordinate_loss(torch.as_tensor(a), torch.as_tensor(b))) == pytest.approx(
        np.abs(a - b).mean(), rel=1e-5
    )

    def normals(x: np.ndarray) -> np.ndarray:
        n = np.cross(x[faces[:, 1]] - x[faces[:, 0]], x[faces[:, 2]] - x[faces[:, 0]])
        return n / np.linalg.norm(n, axis=-1, keepdims=True)

    na, nb = (unit_face_normals(torch.as_tensor(x), torch.as_tensor(faces)) for x in (a, b))
    assert np.allclose(na.numpy(), normals(a), atol=1e-5)
    assert float(normal_loss(na, nb)) == pytest.approx((1.0 - (normals(a) * normals(b)).sum(-1)).mean(), rel=1e-4)
    mean, log_variance = torch.randn(5, 4), torch.randn(5, 4)
    posterior = torch.distributions.Normal(mean, (0.5 * log_variance).exp())
    reference = torch.distributions.kl_divergence(posterior, torch.distributions.Normal(0.0, 1.0)).sum(1).mean()
    assert float(latent_loss(mean, log_variance)) == pytest.approx(float(reference), rel=1e-4)
    real, fake = torch.randn(7, 3), torch.randn(7, 3)
    entropy = torch.nn.functional.binary_cross_entropy_with_logits
    both = 0.5 * (entropy(real, torch.ones_like(real)) + entropy(fake, torch.zeros_like(fake)))
    assert float(discriminator_loss(real, fake)) == pytest.approx(float(both), rel=1e-5)
    assert float(deception_loss(fake)) == pytest.approx(float(entropy(fake, torch.ones_like(fake))), rel=1e-5)


def test_each_adversary_gets_its_own_gradient_only(body, hierarchy, examples):
    module = build_mesh_vae_gan(config(body, adversarial_weight=1.0, normal_weight=0.0), hierarchy, body)
    truth = module.scaled(torch.as_tensor(examples.displacements[:6])).contiguous()
    pose, kinds = module.posed_features(examples.pose[:6]), module.type_weights([TYPES[0]] * 6)
    torch.manual_seed(0)
    layer_losses(module, truth, pose, kinds)["total"].backward()
    found = {name: p.grad.clone() for name, p in module.named_parameters() if p.grad is not None}
    # By hand: the discriminator's loss of finished layers, without the generator.
    module.zero_grad()
    torch.manual_seed(0)
    mean, spread = module.encode(truth, pose, kinds)
    made = module.decode(mean + (0.5 * spread).exp() * torch.randn_like(mean), pose, kinds)
    code = module.condition(pose, kinds).detach()
    discriminator_loss(module.discriminator(truth, code), module.discriminator(made.detach(), code)).backward()
    for name, parameter in module.discriminator.named_parameters():
        assert torch.allclose(parameter.grad, found[f"discriminator.{name}"], atol=1e-6)
    assert all(p.grad is None or not p.grad.any() for n, p in module.named_parameters() if n.startswith("generator"))
    assert any(found[n].abs().max() > 0 for n in found if n.startswith("generator"))


@pytest.mark.parametrize("changes", [{}, {"discriminator": "global"}, {"discriminator": "none"}, {"residual": False}])
def test_a_training_lowers_the_error_with_every_switch(body, hierarchy, examples, changes, tmp_path):
    _, log = fit_mesh_vae_gan(
        examples,
        hierarchy,
        body,
        config(body, **changes),
        16,
        replace(SETTINGS, epochs=6, learning_rate=1e-2),
        tmp_path,
    )
    rows = [row["error_mm"] for row in log.rows if row["split"] == "train"]
    assert rows[-1] < 0.9 * rows[0]
    assert ("discriminator" in log.last()) == (changes.get("discriminator") != "none")


@pytest.fixture(scope="module")
def anchored(body, hierarchy, examples, tmp_path_factory):
    chosen = config(body, kind="anchored", pose="6d")
    module, _ = fit_mesh_vae_gan(
        examples, hierarchy, body, chosen, 16, SETTINGS, tmp_path_factory.mktemp("anchored"), examples.chosen(slice(9))
    )
    return module


def test_the_anchored_network_is_right_where_the_layer_is_linear(anchored, examples):
    names = [TYPES[k] for k in examples.type_index]
    found = anchored.reconstruct(examples.displacements, examples.pose, names)
    error = np.linalg.norm(found - examples.displacements, axis=2).mean()
    spread = np.linalg.norm(examples.displacements - examples.displacements.mean(axis=0), axis=2).mean()
    assert error < 0.1 * spread


def test_each_type_has_components_of_its_own(body, hierarchy, examples, tmp_path):
    """Two types with four ways to fold each fit a code of four numbers; four components for both would lose half."""
    generator = np.random.default_rng(1)
    ways = 0.01 * generator.normal(size=(2, 4, *examples.displacements.shape[1:])).astype(np.float32)
    hidden = generator.normal(size=(len(examples), 4)).astype(np.float32)
    field = np.einsum("nh,nhvc->nvc", hidden, ways[examples.type_index])
    folded, names = replace(examples, displacements=field), [TYPES[k] for k in examples.type_index]
    chosen = config(body, kind="anchored", pose="6d")
    module, _ = fit_mesh_vae_gan(folded, hierarchy, body, chosen, 60, replace(SETTINGS, epochs=1), tmp_path / "two")
    found = module.reconstruct(field, examples.pose, names)
    assert np.linalg.norm(found - field) < 0.2 * np.linalg.norm(field)
    few = folded.chosen(np.flatnonzero((examples.type_index == 0) | (np.arange(len(examples)) < 6)))
    lone, _ = fit_mesh_vae_gan(few, hierarchy, body, chosen, 60, replace(SETTINGS, epochs=1), tmp_path / "few")
    assert np.isfinite(lone.generate(np.ones((1, 4)), examples.pose[:1], [TYPES[1]])).all()


def test_one_z_means_much_the_same_for_all_types(anchored, examples):
    z, pose = np.random.default_rng(3).normal(size=(12, 4)), np.repeat(examples.pose[:1], 12, axis=0)
    first, second = (anchored.generate(z, pose, [kind] * 12).reshape(12, -1) for kind in TYPES)
    agree = np.corrcoef((first - first.mean(0)).ravel(), (second - second.mean(0)).ravel())[0, 1]
    assert agree > 0.5


def test_pose_type_and_z_change_what_is_generated(anchored, examples, body, hierarchy):
    z, pose = np.random.default_rng(3).normal(size=(2, 4)), examples.pose[:2]
    first = anchored.generate(z, pose, [TYPES[0]] * 2)
    assert first.shape == (2, len(body.vertices), 3)
    bare = np.setdiff1d(np.arange(len(body.vertices)), hierarchy.levels[0])
    assert (first[:, bare] == 0).all()
    for other in (
        anchored.generate(z, pose, [TYPES[1]] * 2),
        anchored.generate(z, pose[::-1], [TYPES[0]] * 2),
        anchored.generate(-z, pose, [TYPES[0]] * 2),
    ):
        assert np.abs(other - first).max() > 1e-3
    between = anchored.generate(z, pose, np.array([[0.5, 0.5], [1.0, 0.0]]))
    assert np.abs(between[1] - first[1]).max() < 1e-5
    assert np.abs(between[0] - first[0]).max() > 1e-4


def test_an_unconditional_network_does_not_look_at_pose_or_type(body, hierarchy, examples, tmp_path):
    chosen = config(body, kind="coma", conditional=False, discriminator="none", variational=False, residual=False)
    module, _ = fit_mesh_vae_gan(examples, hierarchy, body, chosen, 60, replace(SETTINGS, epochs=1), tmp_path)
    z = np.ones((1, 4))
    assert np.array_equal(
        module.generate(z, examples.pose[:1], [TYPES[0]]), module.generate(z, examples.pose[1:2], [TYPES[1]])
    )


def test_a_network_comes_back_from_its_file(anchored, body, examples, tmp_path):
    save_mesh_vae_gan(tmp_path / "model.pt", anchored)
    back = load_mesh_vae_gan(tmp_path / "model.pt", body)
    z = np.ones((1, 4))
    again = back.generate(z, examples.pose[:1], [TYPES[0]])
    assert np.array_equal(again, anchored.generate(z, examples.pose[:1], [TYPES[0]]))


def test_what_does_not_fit_is_refused_in_one_sentence(anchored, body, hierarchy, examples, tmp_path):
    save_mesh_vae_gan(tmp_path / "model.pt", anchored)
    with pytest.raises(ValueError, match=r"model.pt: made for body small .* cannot dress full"):
        load_mesh_vae_gan(tmp_path / "model.pt", Body.load("full"))
    with pytest.raises(ValueError, match="unknown type of clothing 'cape'; this network knows shortlong, longshort"):
        anchored.generate(np.ones((1, 4)), examples.pose[:1], ["cape"])
    with pytest.raises(ValueError, match=r"expected z \[N, 4\]"):
        anchored.generate(np.ones((1, 3)), examples.pose[:1], [TYPES[0]])
    with pytest.raises(ValueError, match="finest level"):
        other = replace(examples, vertices=examples.vertices + 1)
        fit_mesh_vae_gan(other, hierarchy, body, config(body), 16, SETTINGS, tmp_path)
    with pytest.raises(ValueError, match="'fake' is not one of patch, global, none"):
        config(body, discriminator="fake")
    with pytest.raises(ValueError, match=r"levels: 7 is asked for, there are 0\.\.2"):
        build_mesh_vae_gan(config(body, levels=(0, 7)), hierarchy, body)


def test_the_heading_is_no_part_of_the_condition_but_the_tilt_is():
    pose = np.zeros((3, 24, 3))
    pose[1, 0] = (0.0, 1.2, 0.0)
    pose[2, 0] = (0.4, 0.0, 0.0)
    level, turned, tilted = pose_features(pose, "6d")
    assert np.abs(level - turned).max() < 1e-6
    assert np.abs(level - tilted).max() > 0.1
