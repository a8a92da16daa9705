"""The implicit solver on a dressed body: beside XPBD, its time, and what it refuses."""

from __future__ import annotations

import numpy as np
import pytest

from body.model import Body
from garments.build import build_template
from garments.spec import GarmentSpec
from geometry.proximity import closest_surface
from sim.body_parts import whole_body
from sim.implicit.body_surface import BodySurface
from sim.implicit.settings import ImplicitSettings
from sim.implicit.simulate import simulate_clip_implicit
from sim.parameters import base_parameters
from sim.simulate import simulate_clip
from sim.timing import PUBLISHED_ARCSIM, time_solvers


@pytest.fixture(scope="module")
def dressed():
    body = Body.load("small")
    template = build_template(GarmentSpec("skirt", "skirt", 320), body)
    frames, lead_in = 14, 6
    pose = np.tile(body.bind_pose(), (frames, 1, 1))
    phase = np.clip(np.arange(frames) / frames, 0.0, 1.0) ** 2
    pose[:, 1, 0] -= 0.5 * phase
    pose[:, 2, 0] += 0.3 * phase
    root = np.zeros((frames, 3))
    root[:, 2] = 0.1 * phase
    return template, body, pose, root, lead_in


def test_dressed_body_keeps_the_skirt_outside_and_agrees_with_xpbd(dressed):
    template, body, pose, root, lead_in = dressed
    parameters = base_parameters({"substeps": 48, "bend": 1e-3})  # stiff enough not to fall into other folds
    settings = ImplicitSettings()
    result = simulate_clip_implicit(*dressed, parameters, settings)
    frames = len(pose) - lead_in
    assert result.failure is None
    assert result.vertices.shape == (frames, 320, 3) and result.vertices.dtype == np.float32
    assert result.frame_seconds.shape == (frames,) and (result.frame_seconds > 0).all()
    assert sum(result.timing.values()) == pytest.approx(result.frame_seconds.sum(), rel=0.2)
    assert result.quality["vertices_inside"] == 0
    assert result.quality["p99_edge_strain"] < 0.1
    surface = body.posed(pose[-1:], root[-1:])[0]
    inside = closest_surface(result.vertices[-1], surface, body.faces).distance < -5e-4
    inside[template.pinned] = False
    assert not inside.any()

    # The same cloth in a wholly different method: apart by a small share of the way that the skirt went.
    other = simulate_clip(*dressed, parameters)
    apart = np.linalg.norm(result.vertices - other.vertices, axis=2)
    moved = np.linalg.norm(result.vertices[-1] - result.vertices[0], axis=1)
    assert np.sqrt((apart**2).mean()) < 0.05 * np.sqrt((moved**2).mean())


def test_timing_has_a_row_for_each_solver(dressed):
    template, body, pose, root, _ = dressed
    rows = time_solvers(
        template,
        body,
        pose,
        root,
        2,
        base_parameters({"substeps": 4}),
        frames=3,
        implicit=ImplicitSettings(),
        warm_up=1,
    )
    assert [row["solver"].split(",")[0] for row in rows] == ["XPBD"] + ["XPBD with self-contact"] * 2 + [
        "implicit Euler"
    ] * 2
    for row in rows:
        assert row["frames"] == 3 and row["vertices"] == 320 and row["threads"] == 1
        assert 0.0 < row["median_s_per_frame"] <= row["p95_s_per_frame"]
    published = [row for rows_of_kind in PUBLISHED_ARCSIM.values() for row in rows_of_kind]
    assert all("measured in this run" not in row["source"] for row in published)
    assert set(published[0]) <= set(rows[0])
    with pytest.raises(ValueError, match=r"105 frames are needed .* the clip has 14"):
        time_solvers(
            template, body, pose, root, 2, base_parameters(), frames=100, implicit=ImplicitSettings(), warm_up=3
        )


def test_bad_input_is_refused_in_one_sentence(dressed):
    template, body, pose, root, lead_in = dressed
    parameters = base_parameters()
    with pytest.raises(ValueError, match=r"pose: expected shape \[L \+ T, 24, 3\]"):
        simulate_clip_implicit(template, body, pose[:, :20], root, lead_in, parameters)
    broken = pose.copy()
    broken[3, 4] = np.nan
    with pytest.raises(ValueError, match="pose: frame 3 is not finite"):
        simulate_clip_implicit(template, body, broken, root, lead_in, parameters)
    with pytest.raises(ValueError, match="lead_in = 14: allowed are 0 to 13"):
        simulate_clip_implicit(template, body, pose, root, 14, parameters)
    with pytest.raises(ValueError, match="was made for body 'small'"):
        simulate_clip_implicit(template, Body.load("full"), pose, root, lead_in, parameters)
    with pytest.raises(ValueError, match="'bend' is missing"):
        simulate_clip_implicit(
            template, body, pose, root, lead_in, {k: v for k, v in parameters.items() if k != "bend"}
        )
    with pytest.raises(ValueError, match="cg_tolerance = 0"):
        ImplicitSettings(cg_tolerance=0.0)
    with pytest.raises(ValueError, match="contact_queries = 9: at most one a step, that is 8"):
        ImplicitSettings(contact_queries=9)
    with pytest.raises(ValueError, match="must lie on both sides of 1"):
        ImplicitSettings(strain_limits=(1.01, 1.05))
    with pytest.raises(ValueError, match="sample 0 is not finite"):
        BodySurface(np.full((1, 3, 3), np.nan), np.array([[0, 1, 2]]), whole_body(1, 4))


def test_a_diverged_run_says_so(dressed):
    result = simulate_clip_implicit(
        *dressed, base_parameters(), ImplicitSettings(settle_seconds=0.0, absurd_strain=1e-6)
    )
    assert "an edge is strained by" in result.failure
    assert np.isfinite(result.vertices).all()
