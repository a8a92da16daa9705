"""Shape descriptors: the loss against dense algebra, PCA as the starting point, over-fitting, files, evaluation."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
import torch

from evaluation.descriptor import descriptor_rows, interpolate_shapes, method_name
from evaluation.descriptor_shapes import PLAUSIBLE, NearestFrames, interpolation_rows, projection_rows
from geometry.topology import MeshTopology
from models import descriptor_fitting
from models.descriptor_fitting import PrincipalFrames, fit_shape_descriptor, set_components
from models.pca import fit_pca
from models.shape_descriptor import (
    ResidualPcaDescriptor,
    ShapeDescriptorConfig,
    decode_all,
    descriptor_loss,
    encode_all,
    load_shape_descriptor,
    reconstruction_terms,
    save_shape_descriptor,
)
from models.training import TrainingSettings
from pipeline.evaluate_shape_descriptor import curve_modules, held_out_pairs
from pipeline.train_descriptor_curve import curve_sections

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
    assert kept[:2] == [("train", "descriptor, residual-pca", 6), ("train", "PCA", 2)]
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


def sheet(columns: int, rows: int, frames: int = 24) -> tuple[np.ndarray, np.ndarray]:
    """Frames of a waving sheet of any resolution and its faces."""
    u, v = (a.ravel() for a in np.meshgrid(np.arange(columns) / columns, np.arange(rows) / rows))
    phase = np.linspace(0, 5, frames)[:, None]
    moved = np.stack([u + 0 * phase, 0 * phase - v, 0.1 * np.sin(5 * u + phase) * v], axis=-1)
    corner = (np.arange(rows - 1)[:, None] * columns + np.arange(columns - 1)).ravel()
    lower = np.stack([corner, corner + 1, corner + columns], axis=1)
    upper = np.stack([corner + 1, corner + columns + 1, corner + columns], axis=1)
    return moved.astype(np.float32), np.concatenate([lower, upper]).astype(np.int32)


@pytest.mark.parametrize("variant", CONFIGS)
def test_one_architecture_for_any_resolution(variant, tmp_path):
    """Only the outermost layers know the number of vertices; a file of one garment is refused for another."""
    settings = TrainingSettings(epochs=1, device="cpu", learning_rate=1e-4)
    inner = {}
    for columns, rows in ((40, 20), (66, 50)):
        vertices, faces = sheet(columns, rows)
        module = fit_shape_descriptor(vertices, faces, CONFIGS[variant], settings, tmp_path / f"{columns}")
        assert module(torch.from_numpy(vertices[:3])).shape == (3, columns * rows, 3)
        sizes = {name: tuple(p.shape) for name, p in module.named_parameters()}
        inner[columns] = {n: s for n, s in sizes.items() if 3 * columns * rows not in s}
        save_shape_descriptor(tmp_path / f"{columns}.pt", module)
    assert inner[40] == inner[66]
    assert len(inner[40]) >= 6
    with pytest.raises(ValueError, match=r"40.pt describes a garment of 800 vertices and 1482 triangles, not this one"):
        load_shape_descriptor(tmp_path / "40.pt", faces)
    other = sheet(40, 20)[1][:, [1, 2, 0]]
    with pytest.raises(ValueError, match="connected otherwise: train a descriptor for it"):
        load_shape_descriptor(tmp_path / "40.pt", other)
    assert load_shape_descriptor(tmp_path / "40.pt", sheet(40, 20)[1]).vertex_count == 800


def test_no_laplacian_term_is_named_and_changes_what_is_learned(tmp_path):
    vertices, faces = cloth()
    settings = TrainingSettings(epochs=40, learning_rate=3e-3, device="cpu")
    frames = PrincipalFrames.of(vertices, faces, 24, 0)
    made = {}
    for weight in (1.0, 0.0):
        config = dataclasses.replace(CONFIGS["residual-pca"], laplacian_weight=weight)
        made[weight] = fit_shape_descriptor(vertices, faces, config, settings, tmp_path / f"{weight}", frames=frames)
    assert method_name(made[0.0]) == "descriptor, residual-pca, no Laplacian term"
    assert method_name(made[1.0]) == "descriptor, residual-pca"
    detail = {w: reconstruction_terms(m, vertices)["laplacian_rmse_m"] for w, m in made.items()}
    assert detail[1.0] < 0.95 * detail[0.0]


def test_shared_components_give_the_same_descriptor(tmp_path):
    alone, vertices = fitted("residual-pca", tmp_path / "a", epochs=2)
    settings = TrainingSettings(epochs=2, learning_rate=3e-3, device="cpu")
    frames = PrincipalFrames.of(vertices, cloth()[1], 24, 0)
    shared = fit_shape_descriptor(
        vertices, cloth()[1], CONFIGS["residual-pca"], settings, tmp_path / "b", frames=frames
    )
    assert np.array_equal(encode_all(alone, vertices), encode_all(shared, vertices))


def test_clips_weigh_alike_in_the_mean_over_clips(tmp_path):
    module, vertices = fitted("residual-pca", tmp_path, epochs=1)
    test = np.concatenate([vertices[:30], vertices[30:31] * 1.2])
    clips = {"unseen_motions": np.repeat([4, 7], [30, 1])}
    rows = descriptor_rows([module], vertices, {"unseen_motions": test}, (6,), 0, clips)
    errors = [descriptor_rows([module], vertices, {"x": part}, (6,))[0]["rmse_mm"] for part in (test[:30], test[30:])]
    assert rows[0]["clip_rmse_mm"] == pytest.approx(np.mean(errors), rel=1e-4)
    assert rows[0]["rmse_mm"] == pytest.approx((30 * errors[0] + errors[1]) / 31, rel=1e-4)
    assert rows[0]["over_pca"] == pytest.approx(rows[0]["rmse_mm"] / rows[1]["rmse_mm"], rel=1e-6)


def test_interpolation_is_held_against_the_straight_way(tmp_path):
    """A sheet that turns: the straight way of its vertices shrinks it, by cos(angle / 2) in the middle."""
    template, faces = (a[0] if a.ndim == 3 else a for a in cloth(1))
    edges = MeshTopology.from_faces(faces).edges
    turn = np.deg2rad(90)
    matrix = np.array([[np.cos(turn), 0, np.sin(turn)], [0, 1, 0], [-np.sin(turn), 0, np.cos(turn)]])
    first, second = template[None], (template @ matrix.T)[None].astype(np.float32)
    module, _ = fitted("residual-pca", tmp_path, epochs=1)
    learned, straight = interpolation_rows([module], first, second, template, edges, steps=3)
    assert straight["method"] == "straight way of each vertex"
    assert straight["ends_p99_strain_percent"] == pytest.approx(0.0, abs=1e-3)
    along = np.linalg.norm((first + second)[0][edges[:, 0]] - (first + second)[0][edges[:, 1]], axis=1) / 2
    rest = np.linalg.norm(template[edges[:, 0]] - template[edges[:, 1]], axis=1)
    assert straight["p99_strain_percent"] == pytest.approx(100 * np.percentile(np.abs(along / rest - 1), 99), rel=1e-3)
    assert straight["edge_deviation_percent"] == pytest.approx(100 * np.mean(np.abs(along - rest) / rest), rel=1e-2)
    assert (learned["method"], learned["dimension"], learned["pairs"]) == ("descriptor, residual-pca", 6, 1)
    with pytest.raises(ValueError, match="at least 3 steps"):
        interpolation_rows([module], first, second, template, edges, steps=2)
    with pytest.raises(ValueError, match="expected pairs of frames"):
        interpolation_rows([module], first, second[:0], template, edges)


def test_implausible_shapes_become_plausible(tmp_path):
    module, vertices = fitted("residual-pca", tmp_path, epochs=60)
    topology = MeshTopology.from_faces(cloth()[1])
    template = cloth(1)[0][0]
    pca = fit_pca(vertices.reshape(len(vertices), -1), 6)
    rows = projection_rows([module], pca, vertices, vertices[:20], template, topology.edges)
    by = {(r["shape"], r["method"]): r for r in rows}
    assert len({r["shape"] for r in rows}) == 5
    # Moved into the range of the training's codes, the worst becomes better, and what was right stays nearly as it is.
    ours, mended = (by["inflated", f"descriptor, residual-pca{end}"] for end in ("", f", {PLAUSIBLE}"))
    assert mended["nearest_mm"] < 0.9 * ours["nearest_mm"]
    assert mended["p99_strain_percent"] < 0.7 * ours["p99_strain_percent"]
    assert by["as simulated", f"descriptor, residual-pca, {PLAUSIBLE}"]["moved_mm"] < 15
    for shape in ("noise", "pulled out"):
        given, ours = by[shape, "as given"], by[shape, "descriptor, residual-pca"]
        assert given["moved_mm"] == 0.0
        assert ours["p99_strain_percent"] < given["p99_strain_percent"]
        assert ours["nearest_mm"] < given["nearest_mm"]
        assert by[shape, "nearest training frame"]["nearest_mm"] == pytest.approx(0.0, abs=1e-4)
    # What no training frame held must not send the network anywhere: the result stays as near as PCA brings it.
    for shape in {r["shape"] for r in rows}:
        assert by[shape, "descriptor, residual-pca"]["nearest_mm"] < 2 * by[shape, "PCA"]["nearest_mm"]


def test_components_of_some_frames_describe_all(monkeypatch):
    """Found from every second frame, they hold the others nearly as well, and every frame keeps its own error."""
    vertices, faces = cloth()
    flat = vertices.reshape(len(vertices), -1)
    monkeypatch.setattr(descriptor_fitting, "_MOST_FRAMES", 80)
    frames = PrincipalFrames.of(vertices, faces, 12, 0)
    assert frames.coefficients.shape == (160, 12)
    inside = frames.pca.decode(frames.coefficients.numpy())
    outside = np.square(flat - inside).sum(axis=1)
    assert frames.rest.numpy() == pytest.approx(outside, rel=1e-2, abs=1e-5)
    best = fit_pca(flat, 12)
    least = np.square(flat - best.decode(best.encode(flat))).sum()
    assert least < outside.sum() < 2.0 * least


def test_nearest_frame_is_the_nearest():
    frames, _ = cloth(50)
    search = NearestFrames(frames)
    found, distance = search.nearest(frames[[7, 31]] + np.float32(0.001))
    assert np.array_equal(found, frames[[7, 31]])
    assert distance == pytest.approx(np.full(2, 0.001 * np.sqrt(3)), rel=1e-3)


def test_encoding_goes_down_the_error_of_the_decoder(tmp_path):
    """On shapes unlike those of the training the steps help, and never does a frame become worse by them."""
    module, _ = fitted("residual-pca", tmp_path, epochs=60)
    unlike = torch.from_numpy(cloth(40, seed=5)[0] * np.float32([1.0, 1.0, 1.6]))
    target = (unlike.flatten(1) - module.mean) @ module.components.T
    with torch.no_grad():
        guess, code = module.code_of(target), module.encode(unlike)
        before, after = ((module.coefficients_of(c) - target).square().sum(1) for c in (guess, code))
    assert (after <= before * (1 + 1e-5)).all()
    assert float(after.mean()) < 0.97 * float(before.mean())
    assert not code.requires_grad


def test_curve_holds_every_length_and_one_without_laplacian_term():
    model = {"code": 50, "hidden": [512], "components": 512, "laplacian_weight": 1.0}
    without = {"no-laplacian": {**model, "laplacian_weight": 0.0}}
    plain = {"25": {**model, "code": 25}, "100": {**model, "code": 100}}
    assert curve_sections(model, {"codes": [25, 100], "epochs": 3}) == plain | without
    wide = curve_sections(model, {"codes": [25], "hidden": [900], "components": 700, "epochs": 3})
    assert wide == {"25": {**model, "code": 25, "hidden": [900], "components": 700}} | without


def test_fewer_components_leave_more_outside(tmp_path):
    vertices, faces = cloth()
    all_of_them = PrincipalFrames.of(vertices, faces, 24, 0)
    few = all_of_them.first(10)
    flat = vertices.reshape(len(vertices), -1)
    missed = flat - few.pca.decode(few.pca.encode(flat))
    np.testing.assert_allclose(few.rest.numpy(), (missed**2).sum(1), rtol=1e-3, atol=1e-7)
    np.testing.assert_allclose(few.coefficients.numpy(), few.pca.encode(flat), atol=1e-5)
    laplacian = MeshTopology.from_faces(faces, vertices.shape[1]).uniform_laplacian()
    bent = [laplacian @ c for c in (few.coefficients.numpy() @ few.pca.components).reshape(vertices.shape)]
    by_factor = (few.coefficients @ few.laplacian_factor).square().sum(1).numpy()
    np.testing.assert_allclose(by_factor, np.square(bent).sum((1, 2)), rtol=1e-3, atol=1e-8)
    assert all_of_them.first(99).coefficients.shape == all_of_them.coefficients.shape


def test_curve_is_sorted_and_of_this_garment(tmp_path):
    vertices, faces = cloth()
    settings = TrainingSettings(epochs=1, device="cpu")
    for name, changes in {"12": {"code": 12}, "6": {}, "no-laplacian": {"laplacian_weight": 0.0}}.items():
        config = dataclasses.replace(CONFIGS["residual-pca"], **changes)
        module = fit_shape_descriptor(vertices, faces, config, settings, tmp_path / "work" / name)
        (tmp_path / "curve").mkdir(exist_ok=True)
        save_shape_descriptor(tmp_path / "curve" / f"{name}.pt", module)
    found = [(m.config.code, m.config.laplacian_weight) for m in curve_modules(tmp_path / "curve", faces)]
    assert found == [(6, 1.0), (6, 0.0), (12, 1.0)]
    with pytest.raises(ValueError, match="not this one of 4 vertices and 1 triangles"):
        curve_modules(tmp_path / "curve", np.array([[0, 1, 3]]))


def test_pairs_are_of_two_clips():
    frames = np.arange(20, dtype=np.float32)[:, None, None] * np.ones((1, 3, 3), np.float32)
    clips = {"few": np.zeros(4, int), "many": np.repeat([0, 1, 2, 3], 5)}
    split, first, second = held_out_pairs({"few": frames[:4], "many": frames}, clips, 0)
    assert split == "many"
    assert (clips["many"][first[:, 0, 0].astype(int)] != clips["many"][second[:, 0, 0].astype(int)]).all()
