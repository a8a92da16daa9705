"""The plan of bodies: sampled shapes, garments graded to them, and shards that say which body is whose."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from body.model import Body
from body.shapes import SAMPLED, sampled_shape, scaled_root
from datasets.sequences import load_sequences
from datasets.shards import read_dropped
from datasets.splits import SplitRule
from garments.build import build_template
from garments.grading import graded
from garments.outfit import worn_together
from garments.quality import CLEARANCE, crossing_triangles
from garments.spec import GarmentSpec
from garments.template import GarmentTemplate
from geometry.proximity import closest_surface
from geometry.topology import edge_lengths, face_angles
from motions.clip_file import write_clips
from motions.procedural import generate_clip
from pipeline import simulate, simulation_inputs
from pipeline.canonical import canonical
from pipeline.stage import Job

KINDS = {"skirt": 300, "tshirt": 400, "pants": 450}
EXTREMES = [[2.0, 2.0, 2.0, 2.0, 2.0], [-2.0, -2.0, -2.0, -2.0, -2.0], [2.0, 0.0, -2.0, -2.0, -2.0]]


@pytest.fixture(scope="module")
def body() -> Body:
    return Body.load("small")


@pytest.fixture(scope="module")
def templates(body: Body) -> dict[str, GarmentTemplate]:
    made = {kind: build_template(GarmentSpec(kind, kind, count), body) for kind, count in KINDS.items()}
    return made | {"outfit": worn_together("outfit", [made["pants"], made["tshirt"]])}


def test_shapes_are_even_bounded_and_a_function_of_seed_and_number():
    own = np.array([0.5, 0, 0, 0, 0, 0, -1.0])
    many = np.array([sampled_shape(own, 1.0, 7, number) for number in range(1, 401)])
    np.testing.assert_array_equal(many[4], sampled_shape(own, 1.0, 7, 5))
    np.testing.assert_array_equal(sampled_shape(own, 1.0, 7, 0), own)
    assert not np.allclose(many[4], sampled_shape(own, 1.0, 8, 5))
    around = many[:, :SAMPLED] - own[:SAMPLED]
    assert np.abs(around).max() <= 2.0 and np.abs(sampled_shape([3.0], 1.5, 7, 2)).max() <= 3.0
    assert (many[:, SAMPLED:] == own[SAMPLED:]).all(), "what is not sampled stays"
    # The standard deviation of a normal distribution cut off at two of its own is 0.88.
    np.testing.assert_allclose(around.mean(axis=0), 0.0, atol=0.05)
    np.testing.assert_allclose(around.std(axis=0), 0.88, atol=0.02)
    np.testing.assert_allclose(np.corrcoef(around.T), np.eye(SAMPLED), atol=0.1)
    half = np.array([sampled_shape(own, 0.5, 7, number) for number in (1, 2)])[:, :SAMPLED] - own[:SAMPLED]
    np.testing.assert_allclose(half, 0.5 * around[:2], atol=1e-4)
    # The first eight, of which the default run holds out two, reach from slight to heavy.
    assert around[:8, 0].min() < -1.0 and around[:8, 0].max() > 1.0


def test_standing_feet_stand_on_another_body(body):
    bend = np.zeros((1, 24, 3))
    bend[:, (1, 2), 0], bend[:, (4, 5), 0], bend[:, (7, 8), 0] = -0.6, 1.2, -0.6  # both knees bent, feet flat
    lowest = body.posed(bend, np.zeros((1, 3)))[..., 1].min()
    own = np.array([[0.3, -lowest, 0.5]])
    plain, scaled = [], []
    for shape in EXTREMES:
        other = body.shaped(shape)
        root = scaled_root(own, body, other)
        plain.append(abs(other.posed(bend, own)[..., 1].min()))
        scaled.append(abs(other.posed(bend, root)[..., 1].min()))
        assert root[0, 0] / 0.3 == pytest.approx(root[0, 2] / 0.5), "a step keeps its direction"
    assert sum(scaled) < 0.3 * sum(plain) and max(scaled) < 0.008


@pytest.mark.parametrize("kind", [*KINDS, "outfit"])
def test_grading_keeps_the_mesh_and_the_ease(kind, templates, body):
    template = templates[kind]
    edges = template.topology.edges
    gap = closest_surface(template.vertices, body.vertices, body.faces).distance
    for shape in [*EXTREMES, *(sampled_shape([], 1.0, 1, number) for number in range(1, 5))]:
        other = body.shaped(shape)
        cut = graded(template, body, other)
        for name in ("faces", "pinned", "skin_index", "skin_weight", "layer"):
            np.testing.assert_array_equal(getattr(cut, name), getattr(template, name))
        hits = closest_surface(cut.vertices, other.vertices, other.faces)
        assert hits.distance.min() > CLEARANCE
        assert len(crossing_triangles(cut.vertices, cut.faces)) == 0
        assert np.degrees(face_angles(cut.vertices, cut.faces).min()) > 15.0
        # Ease is kept: not only is nothing inside, nothing stands away from the body either.
        assert np.abs(np.median(hits.distance - gap)) < 0.003
        np.testing.assert_allclose(hits.distance[cut.pinned], gap[cut.pinned], atol=0.005)
        stretch = edge_lengths(cut.vertices, edges) / edge_lengths(template.vertices, edges)
        assert stretch.min() > 0.5 and stretch.max() < 1.8
    assert graded(template, body, body.shaped([])) is template


def test_a_heavier_body_gets_a_wider_and_longer_garment(templates, body):
    skirt, heavy = templates["skirt"], body.shaped([2.0])
    cut = graded(skirt, body, heavy)

    def waist(garment: GarmentTemplate) -> float:
        ring = next(r for r in garment.topology.boundary_loops() if set(r) == set(garment.pinned))
        points = garment.vertices[ring]
        return float(np.linalg.norm(points - np.roll(points, 1, axis=0), axis=1).sum())

    assert waist(cut) > 1.08 * waist(skirt)
    assert np.ptp(cut.vertices[:, 1]) > 1.02 * np.ptp(skirt.vertices[:, 1])


def test_grading_is_between_shapes_of_one_body(templates, body):
    with pytest.raises(ValueError, match=r"garment 'skirt': made for body small .* they must be one body"):
        graded(templates["skirt"], body, Body.load("full"))


@pytest.fixture(scope="module")
def shard_job(tmp_path_factory, templates, body) -> Job:
    folder = tmp_path_factory.mktemp("bodies")
    clips = [generate_clip("walk", variant, 8, 30.0, 3, body) for variant in range(2)]
    templates["skirt"].save(folder / "skirt.npz")
    write_clips(folder / "clips.h5", clips)
    spec = {
        "garment": "skirt",
        "plan": "bodies",
        "seed": 3,
        "body": {"resolution": "small", "shape": []},
        "base": {"substeps": 8},
        "spread": 1.0,
        "simulations": [[2, clips[0].name, 0], [2, clips[1].name, 3], [4, clips[1].name, 3]],
        "fps": 30.0,
        "lead_in": 8,
        "solver": {
            "self_contact": False,
            "settle": 0.2,
            "attempts": 1,
            "substeps_factor": 2.0,
            "bounds": {
                "p99_edge_strain": 0.5,
                "penetration": 0.01,
                "vertices_inside": 0.01,
                "triangles_inside": 0.2,
                "pinched_vertices": 0.05,
                "crossing_pairs": 1.0,
                "residual_speed": 5.0,
            },
        },
    }
    paths = [str(folder / name) for name in ("skirt.npz", "clips.h5")]
    return Job(
        spec=json.loads(canonical(spec)),
        outputs=[str(folder / "bodies_0000.h5")],
        inputs=paths,
        device="cpu",
        threads=1,
    )


def test_a_shard_says_which_body_is_whose(shard_job, templates, body):
    simulate.main(shard_job)
    rule = SplitRule(5, 4, bodies_every=4)
    assert load_sequences(shard_job.outputs, rule) == []
    found = load_sequences(shard_job.outputs, rule, plans=("bodies",))
    assert read_dropped(shard_job.outputs[0]) == []
    splits = [(s.body_index, s.split) for s in found]
    assert splits == [(2, "train"), (2, "unseen_motions"), (4, "unseen_bodies_and_motions")]
    for s in found:
        np.testing.assert_array_equal(s.shape, sampled_shape([], 1.0, 3, s.body_index))
        assert s.phi == 0
        its = body.shaped(s.shape)
        np.testing.assert_allclose(s.joints, its.joint_positions(s.pose, s.root), atol=1e-6)
        # Recomposed with its own body, nothing is inside and the waistband is where the graded template has it.
        posed = its.posed(s.pose, s.root)
        for frame in (0, s.frames - 1):
            assert closest_surface(s.vertices[frame], posed[frame], its.faces).distance.min() > -1e-3
        cut = graded(templates["skirt"], body, its)
        rest = edge_lengths(cut.vertices, cut.topology.edges)
        strain = edge_lengths(s.vertices[-1], cut.topology.edges) / rest - 1.0
        assert np.abs(np.percentile(strain, (5, 95))).max() < 0.15
    first, _, other = found
    assert np.abs(first.vertices[0] - other.vertices[0]).max() > 0.01


def test_what_a_sampled_body_cannot_do_is_dropped_with_its_reason(shard_job, monkeypatch, tmp_path):
    def refuse(template, own, other):
        raise ValueError("garment 'skirt', graded to another body: triangles 1 and 2 cross each other")

    job = replace(shard_job, outputs=[str(tmp_path / "a.h5")])
    monkeypatch.setattr(simulation_inputs, "graded", refuse)
    simulate.main(job)
    dropped = read_dropped(job.outputs[0])
    assert [(d.body_index, d.clip) for d in dropped] == [(n, name) for n, name, _ in job.spec["simulations"]]
    assert "triangles 1 and 2 cross" in dropped[0].reason and dropped[0].attempts == 0
    assert load_sequences(job.outputs, SplitRule(5, 4), plans=("bodies",)) == []
    assert Path(job.outputs[0]).is_file()
