"""Shape descriptors: the loss against dense algebra, PCA as the starting point, over-fitting, files, evaluation."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from evaluation.descriptor import descriptor_rows, interpolate_shapes
from geometry.topology import MeshTopology
from models.pca import fit_pca
from models.shape_descriptor import (
    ResidualPcaDescriptor,
    ShapeDescriptorConfig,
    decode_all,
    descriptor_loss,
    encode_all,
    fit_shape_descriptor,
    load_shape_descriptor,
    reconstruction_terms,
    save_shape_descriptor,
    set_components,
)
from models.training import TrainingSettings

CONFIGS = {
    "paper": ShapeDescriptorConfig(variant="paper", code=6, hidden=(64, 32), batch=32),
    "residual-pca": ShapeDescriptorConfig(variant="residual-pca", code=6, hidden=(64,), batch=32, components=24),
}


def cloth(frames: int = 160, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Frames of a 7x6 sheet with travelling waves [N, 42, 3] and its faces: few causes, but not in a linear space."""
    rng = np.random.default_rng(seed)
    u, v = (a.ravel() for a in np.meshgrid(np.arange(7) / 6, np.arange(6) / 5))
    rest = np.stack([u, -v, 0 * u], axis=1)
    cause = rng.uniform(-1, 1, (frames, 4))
    wave = (
        0.1 * (0.5 + cause[:, :1]) * np.sin(6 * u * (1 + cause[:, 1:2]) + 4 * v * cause[:, 3:]) * v
        + 0.1 * cause[:, 2:3] * v**2
    )
    moved = np.repeat(rest[None], frames, axis=0)
    moved[:, :, 2] += wave
    moved[:, :, 0] += 0.1 * cause[:, 3:] * v
    corner = (np.arange(5)[:, None] * 7 + np.arange(6)).ravel()
    lower = np.stack([corner, corner + 1, corner + 7], axis=1)
    upper = np.stack([corner + 1, corner + 8, corner + 7], axis=1)
    return moved.astype(np.float32), np.concatenate([lower, upper]).astype(np.int32)


def fitted(variant: str, folder, epochs: int = 3, seed: int = 0, **changes):
    vertices, faces = cloth()
    settings = TrainingSettings(**{"epochs": epochs, "learning_rate": 3e-3, "device": "cpu", "seed": seed} | changes)
    return fit_shape_descriptor(vertices, faces, CONFIGS[variant], settings, folder), vertices


def test_pca_equals_exact_decomposition():
    frames = cloth()[0].reshape(160, -1)
    pca = fit_pca(frames, 5)
    _, singular, right = np.linalg.svd(frames - frames.mean(0), full_matrices=False)
    assert np.allclose(pca.deviations, singular[:5] / np.sqrt(len(frames)), rtol=1e-4)
    assert np.allclose(np.abs(np.sum(pca.components * right[:5], axis=1)), 1.0, atol=1e-4)
    with pytest.raises(ValueError, match="have 1 to 3"):
        fit_pca(frames[:4], 4)


@pytest.mark.parametrize("variant", CONFIGS)
def test_loss_equals_dense_algebra(variant, tmp_path):
    module, vertices = fitted(variant, tmp_path, epochs=1)
    rng = np.random.default_rng(3)
    a, b = vertices[:4], vertices[:4] + rng.normal(0, 0.01, vertices[:4].shape).astype(np.float32)
    terms = descriptor_loss(module, torch.from_numpy(b), torch.from_numpy(a))
    dense = MeshTopology.from_faces(cloth()[1]).uniform_laplacian().toarray()
    vertex = np.sqrt(((b - a) ** 2).sum(-1).mean(-1)).mean()
    bent = np.einsum("ij,bjk->bik", dense, (b - a).astype(np.float64))
    laplacian = np.sqrt((bent**2).sum(-1).mean(-1)).mean()
    assert float(terms["vertex_rmse_m"]) == pytest.approx(vertex, rel=1e-4)
    assert float(terms["laplacian_rmse_m"]) == pytest.approx(laplacian, rel=1e-4)
    assert float(terms["total"]) == pytest.approx(vertex + laplacian, rel=1e-4)


def test_residual_descriptor_starts_as_pca():
    vertices, faces = cloth()
    flat = vertices.reshape(len(vertices), -1)
    module = ResidualPcaDescriptor(CONFIGS["residual-pca"], faces, 42, 24)
    pca = fit_pca(flat, 24)
    set_components(module, pca)
    expected = pca.decode(pca.encode(flat, 6))
    assert np.allclose(decode_all(module, encode_all(module, vertices)).reshape(flat.shape), expected, atol=1e-5)
    # Not whitened: descriptors are as far apart as the parts of the shapes that the components hold.
    codes = encode_all(module, vertices[:2]) * module.deviations[0].item()
    assert np.linalg.norm(codes[0] - codes[1]) == pytest.approx(np.linalg.norm(expected[0] - expected[1]), rel=1e-3)


def test_coefficient_loss_is_the_vertex_loss(tmp_path):
    """The loss that the residual variant trains on, without vertices, is the one of the paper on vertices."""
    module, vertices = fitted("residual-pca", tmp_path, epochs=1, learning_rate=1e-12)
    logged = (tmp_path / "losses.csv").read_text().splitlines()
    row = dict(zip(logged[0].split(","), logged[1].split(","), strict=True))
    terms = reconstruction_terms(module, vertices)
    assert float(row["vertex_rmse_m"]) == pytest.approx(terms["vertex_rmse_m"], rel=1e-3)
    assert float(row["laplacian_rmse_m"]) == pytest.approx(terms["laplacian_rmse_m"], rel=1e-2)


def test_residual_descriptor_beats_pca_of_its_size(tmp_path):
    module, vertices = fitted("residual-pca", tmp_path, epochs=60)
    flat = vertices.reshape(len(vertices), -1)
    pca = fit_pca(flat, 6)
    linear = np.sqrt((pca.decode(pca.encode(flat)) - flat).reshape(vertices.shape) ** 2).sum(-1).mean()
    learned = np.sqrt((decode_all(module, encode_all(module, vertices)) - vertices) ** 2).sum(-1).mean()
    assert learned < 0.6 * linear


def test_paper_descriptor_learns_and_keeps_its_code_in_range(tmp_path):
    module, vertices = fitted("paper", tmp_path, epochs=60)
    spread = np.sqrt(((vertices - vertices.mean(0)) ** 2).sum(-1).mean())
    assert reconstruction_terms(module, vertices)["vertex_rmse_m"] < 0.3 * spread
    codes = encode_all(module, vertices)
    assert codes.min() >= 0.0
    assert codes.max() <= 6.0
    assert (codes.std(axis=0) > 1e-3).all()


@pytest.mark.parametrize("variant", CONFIGS)
def test_same_seed_same_descriptor_and_file_round_trip(variant, tmp_path):
    first, vertices = fitted(variant, tmp_path / "a", epochs=2)
    second, _ = fitted(variant, tmp_path / "b", epochs=2)
    assert np.array_equal(encode_all(first, vertices), encode_all(second, vertices))
    save_shape_descriptor(tmp_path / "model.pt", first)
    loaded = load_shape_descriptor(tmp_path / "model.pt")
    assert loaded.config == first.config
    codes = encode_all(loaded, vertices)
    assert np.array_equal(codes, encode_all(first, vertices))
    assert np.array_equal(decode_all(loaded, codes), decode_all(first, codes))


def test_wrong_shapes_are_refused(tmp_path):
    module, _ = fitted("residual-pca", tmp_path, epochs=1)
    with pytest.raises(ValueError, match=r"expected shape \[B, 42, 3\], got \[2, 41, 3\]"):
        module.encode(torch.zeros(2, 41, 3))
    with pytest.raises(ValueError, match=r"expected shape \[B, 6\], got \[2, 5\]"):
        module.decode(torch.zeros(2, 5))
    with pytest.raises(ValueError, match="'pca' is not one of paper, residual-pca"):
        ShapeDescriptorConfig(variant="pca")


def test_rows_name_methods_and_errors(tmp_path):
    module, vertices = fitted("residual-pca", tmp_path, epochs=1)
    rows = descriptor_rows([module], vertices, {"train": vertices, "unseen_both": vertices[:9] * 1.01}, (2, 6, 9999))
    kept = [(r["split"], r["method"], r["dimension"]) for r in rows]
    assert kept[:2] == [("train", "descriptor, residual-pca", 6), ("unseen_both", "descriptor, residual-pca", 6)]
    assert ("unseen_both", "PCA", 2) in kept
    assert len(rows) == 6
    flat = vertices.reshape(len(vertices), -1)
    pca = fit_pca(flat, 6)
    difference = (pca.decode(pca.encode(flat)) - flat).reshape(vertices.shape)
    expected = 1e3 * np.sqrt((difference**2).sum(-1).mean(-1)).mean()
    found = next(r["rmse_mm"] for r in rows if (r["split"], r["method"], r["dimension"]) == ("train", "PCA", 6))
    assert found == pytest.approx(expected, rel=1e-3)


def test_interpolation_ends_at_the_reconstructions(tmp_path):
    module, vertices = fitted("residual-pca", tmp_path, epochs=1)
    path = interpolate_shapes(module, vertices[0], vertices[1], 5)
    assert np.allclose(path[[0, -1]], decode_all(module, encode_all(module, vertices[:2])), atol=1e-6)
