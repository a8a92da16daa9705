"""Simulations outside the bounds are tried again, together, with more substeps."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import pytest

from motions.clip import Clip
from pipeline.ensembles import Planned, simulate_all
from sim.bounds import out_of_bounds
from sim.parameters import base_parameters
from sim.result import SimulationResult

BOUNDS = {"p99_edge_strain": 0.3, "penetration": 0.01, "vertices_inside": 0.01, "residual_speed": 0.5}
BOUNDS |= {"triangles_inside": 0.1, "pinched_vertices": 0.03, "crossing_pairs": 0.25}
INSIDE = {"p99_edge_strain": 0.3, "deepest_penetration_m": 0.01, "vertices_inside": 2.0, "residual_speed_m_s": 0.5}
INSIDE |= {"triangles_inside_sampled": 20.0, "pinched_vertices": 6.0, "crossing_pairs": 50.0}  # of 200 vertices
SOLVER = {"attempts": 3, "substeps_factor": 2.0, "bounds": BOUNDS}


@dataclass
class Judge:
    """In place of a simulator: strain falls with substeps, from where the density says; groups are noted."""

    own: bool
    groups: list = field(default_factory=list)

    def run_worlds(self, worlds, lead_in):
        self.groups.append((self.own, len(worlds), {w.parameters["substeps"] for w in worlds}))
        results = []
        for world in worlds:
            strain = world.parameters["density"] * 10.0 / world.parameters["substeps"]
            quality = dict.fromkeys(INSIDE, 0.0) | {"p99_edge_strain": strain}
            results.append(SimulationResult(np.zeros((len(world.pose) - lead_in, 5, 3)), quality))
        return results


def planned(clips: int, densities: list[float]) -> list[Planned]:
    lead = np.zeros((2, 24, 3)), np.zeros((2, 3))
    still = [
        Clip(
            name=f"c{k}", take=f"c{k}", label="x", pose=np.zeros((4, 24, 3)), root=np.zeros((4, 3)), fps=30.0, source=""
        )
        for k in range(clips)
    ]
    base = base_parameters({"substeps": 10})
    return [Planned(p, clip, 0, lead, base | {"density": d}) for clip in still for p, d in enumerate(densities)]


@pytest.mark.parametrize("own", [False, True])
def test_failures_of_all_groups_are_tried_again_together(own):
    judges = {flag: Judge(flag) for flag in (False, True)}
    frames = []
    work = planned(3, [0.1] * 17 + [0.5, 1.0])  # strains 0.1; 0.5, then 0.25; 1, 0.5, then 0.25
    outcomes = list(simulate_all(judges.__getitem__, work, own, SOLVER, frames.append))
    groups = judges[False].groups + judges[True].groups
    first = [g for g in groups if g[2] == {10}]
    assert [n for _, n, _ in first] == ([16, 16, 16, 9] if own else [16, 3] * 3)
    assert all(g[0] == own for g in first)
    assert [g for g in groups if g[2] != {10}] == [(True, 6, {20.0}), (True, 3, {40.0})]
    assert len(outcomes) == 57 and frames == [6] * 57
    assert all(outcome.result.failure is None for outcome in outcomes)
    by_density = {o.planned.parameters["density"]: (o.attempts, o.parameters["substeps"]) for o in outcomes}
    assert by_density == {0.1: (1, 10), 0.5: (2, 20.0), 1.0: (3, 40.0)}
    assert {(o.planned.clip.name, o.planned.phi) for o in outcomes} == {(p.clip.name, p.phi) for p in work}


def test_what_no_attempt_brings_inside_says_why():
    judges = {flag: Judge(flag) for flag in (False, True)}
    (outcome,) = simulate_all(judges.__getitem__, planned(1, [2.0]), False, SOLVER, lambda n: None)
    assert outcome.attempts == 3 and outcome.result.failure == "p99 edge strain 0.5 above 0.3"


@pytest.mark.parametrize(
    ("figure", "value", "message"),
    [
        ("p99_edge_strain", 0.31, "p99 edge strain 0.31 above 0.3"),
        ("deepest_penetration_m", 0.011, "penetration 0.011 m above 0.01 m"),
        ("vertices_inside", 3.0, "share of vertices inside the body 0.015 above 0.01"),
        ("triangles_inside_sampled", 21.0, "triangles inside the body 0.105 a vertex above 0.1 a vertex"),
        ("pinched_vertices", 7.0, "share of vertices that are pinched 0.035 above 0.03"),
        ("crossing_pairs", 51.0, "crossing pairs 0.255 a vertex above 0.25 a vertex"),
        ("crossing_pairs", float("nan"), "crossing pairs nan"),
        ("residual_speed_m_s", 0.6, "residual speed 0.6 m/s above 0.5 m/s"),
    ],
)
def test_every_bound_has_its_sentence(figure, value, message):
    assert out_of_bounds(INSIDE, BOUNDS, 200) is None
    assert message in out_of_bounds(INSIDE | {figure: value}, BOUNDS, 200)
    without = {name: count for name, count in INSIDE.items() if name != "crossing_pairs"}
    assert out_of_bounds(without, BOUNDS, 200) is None  # without self-contact none are counted
