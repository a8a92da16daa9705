"""GSNet and what it is compared with: any topology, roll-outs, rigid motion, losses, the regressor, training, files."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import scipy.sparse as sp
import torch
import yaml

from body.model import Body
from evaluation.wardrobe import averaged, gap_rows, stability_rows
from garments.template import GarmentTemplate
from geometry.topology import vertex_normals
from models.garment_animator import Animator, Motion
from models.garment_graph import GarmentGraph, material_row, normalized_laplacian, propagate
from models.gsnet_baselines import smoothed
from models.gsnet_examples import REFLECTION, TrainingData, WardrobeExample, mirrored_graph, mirrored_track
from models.gsnet_fitting import (
    NETWORKS,
    AnimatorTraining,
    build_animator,
    fit_animator,
    load_animator,
    save_animator,
)
from models.gsnet_losses import bend_loss, collision_loss, data_loss, distance_loss, edge_loss, gravity_loss
from models.motion_features import MotionTrack
from models.training import TrainingSettings
from pipeline.config import ConfigError, check_config, read_layers
from pipeline.spec import variant_settings

torch.set_num_threads(1)
ROOT = Path(__file__).parent.parent
LEAD, FRAMES = 5, 12
MATERIALS = ("bend", "density")
COTTON = material_row({"bend": 3e-5, "density": 0.15, "gravity": 9.81}, MATERIALS)
SMALL = {
    "gsnet": {"width": 16, "heads": 2, "hidden": (32, 32), "offsets": (0, 1, 3)},
    "gsnet_published": {"width": 16},
    "deepsd": {"width": 16, "hidden": (16,), "code": 8},
    "pbns": {"hidden": (16,), "code": 8},
    "tailornet": {"hidden": (16,), "code": 8, "prototypes": 2},
}
ANY_TOPOLOGY = ("gsnet", "gsnet_published", "deepsd", "skinning")


@pytest.fixture(scope="module")
def body() -> Body:
    return Body.load("small")


def tube(body: Body, around: int, rings: int, length: float = 0.5, name: str = "tube") -> GarmentTemplate:
    """A skirt of a tube, open at both ends, held by pelvis and thighs."""
    angle = np.arange(around)[:, None] * 2.0 * np.pi / around
    depth = np.linspace(0.0, 1.0, rings)[None]
    place = np.stack(
        [0.24 * np.cos(angle) + 0 * depth, 0 * angle - length * depth, 0.24 * np.sin(angle) + 0 * depth], -1
    )
    i, k = np.meshgrid(np.arange(around), np.arange(rings - 1), indexing="ij")
    a, b = (i * rings + k).ravel(), ((i + 1) % around * rings + k).ravel()
    faces = np.concatenate([np.stack([a, b, a + 1], 1), np.stack([b, b + 1, a + 1], 1)])
    count = around * rings
    thigh = np.broadcast_to(0.4 * depth, (around, rings)).reshape(-1)
    weight = np.stack([1.0 - thigh, thigh / 2, thigh / 2, 0 * thigh], 1)
    return GarmentTemplate(
        name=name,
        kind="skirt",
        vertices=place.reshape(-1, 3) + body.joints[0],
        faces=faces,
        pinned=np.arange(around) * rings,
        skin_index=np.tile([0, 1, 2, 3], (count, 1)),
        skin_weight=weight,
        body_name=body.name,
        body_digest=body.digest,
    )


def track(body: Body, seed: int, frames: int = FRAMES) -> MotionTrack:
    rng = np.random.default_rng(seed)
    time = np.arange(LEAD + frames)[:, None, None] / 8.0
    pose = rng.normal(0.0, 0.25, (1, 24, 3)) * np.sin(time + rng.uniform(0, 6, (1, 24, 3)))
    root = np.cumsum(rng.normal(0.0, 0.01, (LEAD + frames, 3)), axis=0)
    return MotionTrack(pose, body.joint_positions(pose, root), LEAD, 30.0)


def example(body: Body, graph: GarmentGraph, seed: int) -> WardrobeExample:
    """The skinned tube, its hem lagging behind the pelvis: what only the past tells."""
    motion = track(body, seed)
    skinning = build_animator("skinning", {"materials": MATERIALS, "body": body.digest})
    worn = skinning.dress(graph, COTTON, motion, body)
    rotation, position = motion.pelvis_frames()
    behind = np.einsum("tc,tcd->td", position[LEAD - 2 : -2] - position[LEAD:], rotation[LEAD:])
    hang = np.clip(-graph.place[:, 1:2] / 0.5, 0.0, 1.0)
    vertices = worn + 2.0 * hang[None] * behind[:, None]
    return WardrobeExample(graph, COTTON, motion, vertices.astype(np.float32))


def network(kind: str, body: Body, garments: dict[str, int] | None = None) -> Animator:
    torch.manual_seed(0)
    config = {"materials": MATERIALS, "body": body.digest, **SMALL.get(kind, {})}
    if kind in ("pbns", "tailornet"):
        config["garments"] = garments or {}
    made = build_animator(kind, config)
    with torch.no_grad():  # fresh networks are skinning or little more: shaken, so that every part speaks
        for p in made.parameters():
            p.add_(0.05 * torch.randn_like(p))
    return made.eval()


def test_the_laplacian_is_that_of_the_paper(body):
    template = tube(body, 7, 4)
    dense = normalized_laplacian(template.topology).toarray()
    adjacency = template.topology.adjacency().toarray()
    degree = adjacency.sum(1)
    for i in range(28):
        for j in range(28):
            wanted = 1.0 if i == j else -adjacency[i, j] / np.sqrt(degree[i] * degree[j])
            assert dense[i, j] == pytest.approx(wanted)
    graph = GarmentGraph.of(template, body)
    rows = torch.randn(28, 2, 3, dtype=torch.float32, requires_grad=True)
    product = propagate(graph.laplacian, rows)
    assert np.allclose(product.detach(), np.einsum("ij,jbc->ibc", dense, rows.detach()), atol=1e-5)
    weight = torch.randn_like(product)
    (product * weight).sum().backward()
    assert np.allclose(rows.grad, np.einsum("ji,jbc->ibc", dense, weight), atol=1e-5)


@pytest.mark.parametrize("kind", ANY_TOPOLOGY)
def test_one_network_dresses_garments_of_any_topology_and_order(body, kind):
    made = network(kind, body)
    for around, rings in ((9, 5), (14, 3)):
        graph = GarmentGraph.of(tube(body, around, rings), body)
        dressed = made.dress(graph, COTTON, track(body, 3), body)
        assert dressed.shape == (FRAMES, around * rings, 3)
        assert np.isfinite(dressed).all()
        order = np.random.default_rng(0).permutation(around * rings)
        shuffled = made.dress(graph.permuted(order), COTTON, track(body, 3), body)
        assert np.allclose(shuffled, dressed[:, order], atol=2e-5)


@pytest.mark.parametrize("kind", ["gsnet", "gsnet_published", "deepsd"])
def test_where_and_which_way_the_motion_goes_makes_no_difference(body, kind):
    from geometry.rotations import axis_angle_to_matrix, matrix_to_axis_angle

    made, graph, motion = network(kind, body), GarmentGraph.of(tube(body, 9, 5), body), track(body, 3)
    turn = axis_angle_to_matrix(np.array([0.0, 1.1, 0.0]))
    pose = motion.pose.copy()
    pose[:, 0] = matrix_to_axis_angle(turn @ axis_angle_to_matrix(pose[:, 0]))
    moved = MotionTrack(pose, motion.joints @ turn.T + [3.0, 0.0, -2.0], LEAD, 30.0)
    dressed = made.dress(graph, COTTON, motion, body)
    assert np.allclose(made.dress(graph, COTTON, moved, body), dressed, atol=2e-5)
    # Down is not a direction like the others.
    tilt = axis_angle_to_matrix(np.array([0.6, 0.0, 0.0]))
    pose[:, 0] = matrix_to_axis_angle(tilt @ axis_angle_to_matrix(motion.pose[:, 0]))
    tilted = made.dress(graph, COTTON, MotionTrack(pose, motion.joints @ tilt.T, LEAD, 30.0), body)
    assert (np.abs(tilted - dressed).max() > 1e-4) == (kind != "gsnet_published")


def test_a_roll_out_is_its_steps_one_by_one(body):
    made, graph = network("gsnet", body), GarmentGraph.of(tube(body, 9, 5), body)
    motion = Motion.of([track(body, 3), track(body, 4)], body)
    with torch.no_grad():  # loud enough that the memory is heard
        made.joints[-1].weight.mul_(20.0)
        made.memory.weight.mul_(5.0)
        encoding = made.encode(graph, torch.as_tensor(COTTON)[None])
        whole, previous = made.unroll(encoding, motion), None
        for frame in range(LEAD + FRAMES):
            previous = made.step(encoding, motion, frame, previous)
            if frame >= LEAD:
                assert torch.allclose(previous, whole[:, frame - LEAD], atol=2e-5)
        without = made.step(encoding, motion, LEAD + FRAMES - 1, None)
    assert not torch.allclose(previous, without, atol=1e-4), "the garment of the frame before makes no difference"


def test_the_future_of_a_motion_is_not_looked_at(body):
    graph, motion = GarmentGraph.of(tube(body, 9, 5), body), track(body, 3)
    cut = MotionTrack(motion.pose[:-4], motion.joints[:-4], LEAD, 30.0)
    for kind in ANY_TOPOLOGY:
        made = network(kind, body)
        whole, part = (made.dress(graph, COTTON, m, body) for m in (motion, cut))
        assert np.allclose(whole[:-4], part, atol=1e-5)


def test_the_material_matters_to_the_networks_that_are_told_it(body):
    graph, other = GarmentGraph.of(tube(body, 9, 5), body), COTTON + np.float32(0.5)
    for kind in ("gsnet", "gsnet_published", "deepsd"):
        made = network(kind, body)
        a, b = made.dress_all(graph, [COTTON, other], [track(body, 3)] * 2, body)
        assert np.abs(a - b).max() > 0.0
        assert np.allclose(made.dress(graph, other, track(body, 3), body), b, atol=1e-5)


def test_losses_are_those_of_a_plain_computation(body):
    template, rng = tube(body, 6, 4), np.random.default_rng(0)
    graph = GarmentGraph.of(template, body)
    vertices = template.vertices[None] + rng.normal(0, 0.02, (2, 24, 3))
    truth, points = vertices + rng.normal(0, 0.01, vertices.shape), vertices + rng.normal(0, 0.01, vertices.shape)
    normals = rng.normal(size=vertices.shape)
    normals /= np.linalg.norm(normals, axis=2, keepdims=True)
    v, t, p, n = (torch.as_tensor(x.astype(np.float32)) for x in (vertices, truth, points, normals))

    assert float(data_loss(v, t)) == pytest.approx(np.square(vertices - truth).sum(2).mean(), rel=1e-4)
    assert float(distance_loss(v, t)) == pytest.approx(np.linalg.norm(vertices - truth, axis=2).mean(), rel=1e-3)
    edges, bend, hits = [], [], []
    for frame, out, o in zip(vertices, normals, points, strict=True):
        unit = vertex_normals(frame, template.faces)
        around: dict[int, list[int]] = {}
        for i, j in template.topology.edges:
            rest = np.linalg.norm(template.vertices[i] - template.vertices[j])
            edges.append((np.linalg.norm(frame[i] - frame[j]) - rest) ** 2)
            around.setdefault(i, []).append(j)
            around.setdefault(j, []).append(i)
        bend += [np.square(unit[i] - unit[near].mean(0)).sum() for i, near in around.items()]
        hits += [min(float((frame[i] - o[i]) @ out[i]) - 0.004, 0.0) ** 2 for i in range(24)]
    assert float(edge_loss(v, graph.edges, graph.rest_lengths)) == pytest.approx(np.mean(edges), rel=1e-3)
    assert float(bend_loss(v, graph.faces, graph.edges)) == pytest.approx(np.mean(bend), rel=1e-3)
    assert float(collision_loss(v, p, n, 0.004)) == pytest.approx(np.mean(hits), rel=1e-3)
    down, mass = torch.tensor([[0.0, -9.81, 0.0]]).expand(2, -1), torch.full((24,), 0.01)
    assert float(gravity_loss(v, down, mass)) == pytest.approx(9.81 * 0.24 * vertices[..., 1].mean(), rel=1e-3)


def test_the_collision_loss_pushes_out_what_is_inside_and_nothing_else():
    vertices = torch.tensor([[0.0, -0.01, 0.0], [0.0, 0.002, 0.0], [0.0, 0.05, 0.0]], dtype=torch.float64)
    points, normals = torch.zeros(3, 3, dtype=torch.float64), torch.tensor([[0.0, 1.0, 0.0]] * 3, dtype=torch.float64)
    vertices.requires_grad_(True)
    torch.autograd.gradcheck(lambda v: collision_loss(v, points, normals, 0.004), vertices)
    collision_loss(vertices, points, normals, 0.004).backward()
    assert (vertices.grad[:2, 1] < 0).all()  # down the gradient is out of the body
    assert vertices.grad[0, 1] < vertices.grad[1, 1]
    assert (vertices.grad[2] == 0).all()


def test_the_physical_regressor_begins_as_the_projection_and_leaves_the_rest_alone(body):
    graph, made = GarmentGraph.of(tube(body, 9, 5), body), network("gsnet", body)
    fresh = build_animator("gsnet", {"materials": MATERIALS, "body": body.digest, **SMALL["gsnet"]}).regressor
    encoding = made.encode(graph, torch.as_tensor(COTTON)[None])
    vertices = torch.as_tensor(graph.vertices)[None].repeat(2, 1, 1)
    points, normals = vertices.clone(), torch.tensor([0.0, 0.0, 1.0]).expand_as(vertices).clone()
    points[0, :7, 2] += 0.01  # the body's surface lies above these
    points[0, 7:, 2] -= 0.01
    points[1, :, 2] -= 0.01
    rows = torch.zeros(2, dtype=torch.long)
    out = fresh(encoding, rows, vertices, points, normals, 0.002)
    assert torch.equal(out[1], vertices[1]) and torch.equal(out[0, 7:], vertices[0, 7:])
    assert torch.allclose(((out - points) * normals).sum(-1)[0, :7], torch.tensor(0.002), atol=1e-6)
    learned = made.regressor(encoding, rows, vertices, points, normals, 0.002)
    assert not torch.allclose(learned[0, :7], out[0, :7], atol=1e-5)
    assert torch.equal(learned[0, 7:], vertices[0, 7:])


@pytest.mark.parametrize("kind", [k for k in NETWORKS if k != "skinning"])
def test_every_network_learns(body, kind, tmp_path):
    graphs = [
        GarmentGraph.of(tube(body, 8, 4, name="short"), body),
        GarmentGraph.of(tube(body, 9, 5, 0.6, "long"), body),
    ]
    examples = [example(body, graph, seed) for graph in graphs for seed in range(4)]
    made = network(kind, body, {g.name: len(g.vertices) for g in graphs})
    training = TrainingSettings(epochs=12, learning_rate=5e-3, gradient_clip=1.0, seed=1)
    settings = AnimatorTraining(training, batch=2, loss="energies" if kind == "pbns" else "squared", physics_frames=6)
    log = fit_animator(made, examples, body, settings, tmp_path, validation=examples[:2])
    rows = [r for r in log.rows if r["split"] == "train"]
    assert rows[-1]["total"] < (0.9 if kind == "pbns" else 0.75) * rows[0]["total"]
    assert np.isfinite(log.last("validation")["error_mm"])


def test_the_past_is_learned_only_by_the_network_that_is_told_it(body, tmp_path):
    graph = GarmentGraph.of(tube(body, 8, 4), body)
    examples = [example(body, graph, seed) for seed in range(10)]
    error = {}
    for offsets, state in (((0,), False), ((0, 1, 3), True)):
        config = {"materials": MATERIALS, "body": body.digest, **SMALL["gsnet"]}
        torch.manual_seed(0)
        made = build_animator("gsnet", config | {"offsets": offsets, "garment_state": state})
        training = TrainingSettings(epochs=40, learning_rate=5e-3, gradient_clip=1.0, schedule="cosine")
        settings = AnimatorTraining(training, batch=4, physics_frames=0)
        log = fit_animator(made, examples[:8], body, settings, tmp_path / str(state), validation=examples[8:])
        error[state] = log.last("train")["error_mm"]
    assert error[True] < 0.8 * error[False]


def test_a_garment_in_the_mirror_is_a_garment(body):
    graph, motion = GarmentGraph.of(tube(body, 9, 5), body), track(body, 3)
    graph.skin_weight[:, 1] += 0.1 * graph.skin_weight[:, 2]  # held more by the left thigh than by the right one
    graph.skin_weight[:] /= graph.skin_weight.sum(1, keepdims=True)
    mirrored, other = mirrored_graph(graph), mirrored_track(motion)
    assert np.allclose(mirrored.place[:, 3:6], vertex_normals(mirrored.vertices, mirrored.topology.faces), atol=1e-5)
    assert np.array_equal(mirrored.topology.edges, graph.topology.edges)
    skinning = network("skinning", body)
    worn, seen = (skinning.dress(g, COTTON, m, body) for g, m in ((graph, motion), (mirrored, other)))
    assert np.allclose(seen, worn * REFLECTION, atol=2e-4)  # the body is its own mirror image but for rounding
    assert np.abs(seen - skinning.dress(graph, COTTON, other, body) * REFLECTION).max() > 1e-3

    one = WardrobeExample(graph, COTTON, motion, worn)
    data = TrainingData([one], body, 2, mirror=True)
    torch.manual_seed(0)
    drawn = [data.worn(skinning, np.array([0])) for _ in range(12)]
    assert 2 < sum(w.graph is graph for w in drawn) < 10
    for w in drawn:
        assert np.allclose(skinning.unroll(w.encoding, w.motion)[0], w.truth[0], atol=2e-4)
        at = int(data.contact[0])
        points, normals = data.nearest(w.graph, 0, 0, w.truth[0, at].numpy())
        side = np.ones(3) if w.graph is graph else REFLECTION
        wanted = data.nearest(graph, 0, 0, worn[at])
        assert np.allclose(points * side, wanted[0], atol=1e-3) and np.allclose(normals * side, wanted[1], atol=1e-2)


def test_networks_of_single_garments_are_not_taught_in_the_mirror(body, tmp_path):
    graph = GarmentGraph.of(tube(body, 8, 4), body)
    settings = AnimatorTraining(TrainingSettings(epochs=1), mirror=True)
    with pytest.raises(ValueError, match="tailornet: it knows a vertex by its number, so mirror must be false"):
        fit_animator(network("tailornet", body, {"tube": 32}), [example(body, graph, 0)], body, settings, tmp_path)


def test_smoothing_takes_the_detail_and_leaves_the_whole(body):
    graph = GarmentGraph.of(tube(body, 12, 8), body)
    rough = torch.as_tensor(graph.vertices) + 0.01 * torch.randn(96, 3)
    smooth = smoothed(graph, rough[None], 20)[0]
    laplacian = torch.as_tensor(sp.csr_matrix(graph.topology.uniform_laplacian()).toarray(), dtype=torch.float32)
    assert (laplacian @ smooth).norm() < 0.3 * (laplacian @ rough).norm()
    assert torch.allclose(smoothed(graph, torch.ones(1, 96, 3), 5), torch.ones(1, 96, 3), atol=1e-5)


def test_files_hold_the_whole_network_and_wrong_ones_are_refused(body, tmp_path):
    graph, motion = GarmentGraph.of(tube(body, 9, 5), body), track(body, 3)
    for kind in NETWORKS:
        made = network(kind, body, {"tube": 45})
        save_animator(tmp_path / "a.pt", made)
        again = load_animator(tmp_path / "a.pt")
        assert np.array_equal(again.dress(graph, COTTON, motion, body), made.dress(graph, COTTON, motion, body))
    made = network("gsnet", body)
    with pytest.raises(ValueError, match=r"3 material parameters are given, this gsnet takes 2 \(bend, density\)"):
        made.dress(graph, np.zeros(3, np.float32), motion, body)
    with pytest.raises(ValueError, match="sits on body 0123, this gsnet was trained on body"):
        made.dress(replace(graph, body_digest="0123"), COTTON, motion, body)
    other = Body.load("full")
    with pytest.raises(ValueError, match=f"trained on body {body.digest}, asked for body {other.digest}"):
        made.dress(graph, COTTON, motion, other)
    with pytest.raises(ValueError, match="built on body small"):
        GarmentGraph.of(tube(body, 9, 5), other)
    single = network("tailornet", body, {"tube": 45})
    with pytest.raises(ValueError, match="made for the garments tube; it cannot dress 'other'"):
        single.dress(replace(graph, name="other"), COTTON, motion, body)
    with pytest.raises(ValueError, match="'density' is needed, but is not given"):
        material_row({"bend": 1e-5}, MATERIALS)
    with pytest.raises(ValueError, match="unknown animator 'gnn'"):
        build_animator("gnn", {})
    (tmp_path / "b.pt").write_bytes(b"nothing")
    with pytest.raises(ValueError, match="not a readable model file"):
        load_animator(tmp_path / "b.pt")


def test_tables_average_what_belongs_together_and_compare_on_shared_clips():
    def row(method, split, clip, error, phi=0, garment="dress_00", category="dress"):
        return {
            "method": method, "split": split, "clip": clip, "phi": phi, "garment": garment, "category": category,
            "error_mm": error, "edge_mm": 1.0, "bend": 0.1, "collision_percent": error / 10,
        }  # fmt: skip

    rows = [row("a", "train", "c1", 4.0), row("a", "unseen_motions", "c2", 6.0), row("a", "unseen_motions", "c3", 16.0)]
    rows += [row("a", "unseen_motions", "c2", 100.0, phi=3), row("a", "new", "c2", 9.0, garment="dress_01")]
    rows += [row("b", "unseen_motions", "c2", 5.0)]
    means = averaged(rows, ("split", "method"))
    assert [(r["split"], r["method"]) for r in means] == [
        ("train", "a"), ("unseen_motions", "a"), ("new", "a"), ("unseen_motions", "b")]  # fmt: skip
    assert means[1]["error_mm"] == pytest.approx((6 + 16 + 100) / 3) and means[1]["sequences"] == 3
    a, b = gap_rows(rows, "train", "unseen_motions", "new")
    assert a["unseen_over_seen_templates"] == pytest.approx(9.0 / 6.0)  # c2 in the category's fabric alone
    assert a["test_over_train"] == pytest.approx((6 + 16 + 100) / 3 / 4)
    assert b["unseen_over_seen_templates"] is None and b["test_over_train"] is None
    losses = [
        {"epoch": e, "split": s, "error_mm": x}
        for e, s, x in ((1, "train", 9.0), (1, "validation", 8.0), (2, "validation", 4.0))
    ]
    assert [r["over_best"] for r in stability_rows("a", losses)] == [2.0, 1.0]


def test_the_ablation_differs_from_the_network_by_what_its_names_say():
    config = yaml.safe_load((ROOT / "configs/default.yaml").read_text())
    variants = config["models"]["gsnet"]["variants"]
    whole = {name: variant_settings(variants, name) for name in variants}
    steady, training = whole["steady"], whole["pose"]["training"]
    for name, changed in {
        "no-temporal": {"offsets"},
        "garment": {"offsets", "garment_state", "segment"},
        "garment-pose": {"garment_state", "segment"},
        "pose": set(),
    }.items():
        assert {k for k in whole[name] if whole[name][k] != steady.get(k)} - {"training"} == changed
        assert whole[name]["training"] == training  # all as long as each other
    assert set(NETWORKS) == {one["kind"] for one in whole.values()} | {"skinning"}
    with pytest.raises(ConfigError, match=r"variants.pose.like: found 'stedy'; allowed are anchored"):
        variants["pose"]["like"] = "stedy"
        check_config(config, read_layers([str(ROOT / "configs/default.yaml")]))
