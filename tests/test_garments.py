"""Garments: topology, exact counts, clearance, determinism, files and refusals."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from body.model import Body
from garments.build import GARMENT_KINDS, build_template, template_quality
from garments.distance_field import eased_field, empty_grid
from garments.landmarks import find_landmarks
from garments.quality import assert_quality, crossing_pairs
from garments.remesh import delaunay_flips, remesh
from garments.spec import GarmentSpec
from garments.surface import DenseSurface
from garments.template import GarmentTemplate
from geometry.topology import MeshTopology

SMALL_COUNTS = {"skirt": 300, "tshirt": 400, "pants": 450, "top": 400, "jumpsuit": 700, "dress": 550}


@pytest.fixture(scope="module")
def body() -> Body:
    return Body.load("small")


@pytest.fixture(scope="module")
def templates(body: Body) -> dict[str, GarmentTemplate]:
    return {kind: build_template(GarmentSpec(kind, kind, count), body) for kind, count in SMALL_COUNTS.items()}


@pytest.mark.parametrize("kind", sorted(GARMENT_KINDS))
def test_mesh_is_what_was_asked_for(kind: str, templates: dict[str, GarmentTemplate], body: Body) -> None:
    """Exact count, one piece of genus 0 with the right openings, good angles, outside the body, not crossing itself."""
    quality = template_quality(templates[kind], body)
    loops = {"skirt": 2, "tshirt": 4, "pants": 3, "top": 4, "jumpsuit": 5, "dress": 4}[kind]
    assert (quality.vertices, quality.components, quality.loops) == (SMALL_COUNTS[kind], 1, loops)
    assert quality.euler == 2 - loops
    assert quality.smallest_angle > 20.0
    assert quality.edge_variation < 0.2
    assert quality.clearance > 0.0015
    assert quality.crossings == 0


@pytest.mark.parametrize("kind", sorted(GARMENT_KINDS))
def test_faces_point_away_from_the_body(kind: str, templates: dict[str, GarmentTemplate]) -> None:
    """Closing the openings with flat lids gives a positive volume."""
    garment = templates[kind]
    centre = garment.vertices.mean(axis=0)
    corners = garment.vertices[garment.faces].astype(np.float64) - centre
    volume = np.linalg.det(corners).sum() / 6.0
    directed = np.concatenate([garment.faces[:, [0, 1]], garment.faces[:, [1, 2]], garment.faces[:, [2, 0]]])
    edges = {tuple(edge) for edge in directed.tolist()}
    for loop in garment.topology.boundary_loops():
        ring = loop if (loop[0], loop[1]) not in edges else loop[::-1]
        points = garment.vertices[ring].astype(np.float64) - centre
        lid = np.stack(
            [np.broadcast_to(points.mean(axis=0), points.shape), points, np.roll(points, -1, axis=0)], axis=1
        )
        volume += np.linalg.det(lid).sum() / 6.0
    assert volume > 0.01


@pytest.mark.parametrize("kind", ["skirt", "pants"])
def test_waist_ring_is_held(kind: str, templates: dict[str, GarmentTemplate], body: Body) -> None:
    """The pins are one whole opening, level at the waist and close to the skin."""
    garment = templates[kind]
    waist = find_landmarks(body).waist
    loops = [set(loop.tolist()) for loop in garment.topology.boundary_loops()]
    assert set(garment.pinned.tolist()) in loops
    np.testing.assert_allclose(garment.vertices[garment.pinned, 1], waist, atol=1e-3)
    for carried in ("tshirt", "top", "jumpsuit", "dress"):
        assert templates[carried].pinned.size == 0


def test_default_shapes(templates: dict[str, GarmentTemplate], body: Body) -> None:
    """Skirt to the knee, trousers to the ankles, T-shirt to the hip joints, its neckline close to the neck."""
    marks = find_landmarks(body)
    hips = body.joints[[1, 2], 1].mean()
    assert templates["skirt"].vertices[:, 1].min() == pytest.approx(marks.knee, abs=5e-3)
    assert templates["pants"].vertices[:, 1].min() == pytest.approx(marks.ankle + 0.04, abs=5e-3)
    shirt = templates["tshirt"]
    assert shirt.vertices[:, 1].min() == pytest.approx(hips, abs=5e-3)
    neckline = max(shirt.topology.boundary_loops(), key=lambda loop: shirt.vertices[loop, 1].mean())
    ring = shirt.vertices[neckline]
    assert np.ptp(ring[:, 0]) < 0.19  # narrower than the shoulders by far: it cannot slip off
    assert ring[:, 1].min() > body.joints[12, 1] - 0.10
    neck = body.joints[12, 1]
    for kind, hem in (("top", hips), ("dress", marks.knee), ("jumpsuit", marks.ankle + 0.04)):
        garment = templates[kind].vertices
        assert garment[:, 1].min() == pytest.approx(hem, abs=5e-3)
        assert neck - 0.02 < garment[:, 1].max() < neck + 0.05


def _openings(garment: GarmentTemplate) -> list[np.ndarray]:
    """Vertices of each opening [m], the lowest first."""
    loops = [garment.vertices[loop] for loop in garment.topology.boundary_loops()]
    return sorted(loops, key=lambda ring: ring[:, 1].mean())


@pytest.mark.parametrize("kind", ["top", "jumpsuit", "dress"])
def test_armholes_leave_straps_on_the_shoulders(kind: str, templates: dict[str, GarmentTemplate], body: Body) -> None:
    """One around each arm, from the strap to under the armpit, alike on both sides; between them cloth to rest on."""
    garment, shoulder = templates[kind], body.joints[16]
    holes = [ring for ring in _openings(garment) if abs(ring[:, 0].mean()) > 0.12 and ring[:, 1].mean() > 1.1]
    assert sorted(np.sign([ring[:, 0].mean() for ring in holes])) == [-1.0, 1.0]
    for ring in holes:
        assert shoulder[1] < ring[:, 1].max() < shoulder[1] + 0.11
        assert shoulder[1] - 0.20 < ring[:, 1].min() < shoulder[1] - 0.08
        assert np.ptp(np.abs(ring[:, 0])) < 0.07, "nearly upright"
    neckline = _openings(garment)[-1]
    top = max(ring[ring[:, 1].argmax(), 0] for ring in holes)
    assert top - neckline[:, 0].max() == pytest.approx(0.07, abs=0.02)
    assert np.abs(garment.vertices[garment.vertices[:, 1] > 1.25, 0]).max() < shoulder[0] + 0.06, "the arms are bare"


@pytest.mark.parametrize("kind", ["jumpsuit", "dress"])
def test_sleeves_instead_of_armholes(kind: str, templates: dict[str, GarmentTemplate], body: Body) -> None:
    """They end where asked, along the arm."""
    garment = build_template(GarmentSpec("s", kind, SMALL_COUNTS[kind] + 50, sleeve=0.18), body)
    shoulder, elbow = body.joints[16], body.joints[18]
    along = (garment.vertices - shoulder) @ (elbow - shoulder) / np.linalg.norm(elbow - shoulder)
    left = (garment.vertices[:, 0] > 0.2) & (garment.vertices[:, 1] > 1.0)
    assert along[left].max() == pytest.approx(0.18, abs=3e-3)
    assert len(_openings(garment)) == len(_openings(templates[kind]))


def test_dress_is_a_trunk_and_a_skirt(templates: dict[str, GarmentTemplate], body: Body) -> None:
    """Close to the chest, narrow at the waist, wider with every step down, and one sheet between the legs."""
    marks = find_landmarks(body)
    vertices = templates["dress"].vertices
    widths = [np.ptp(vertices[np.abs(vertices[:, 1] - y) < 0.03, 0]) for y in (marks.waist, 0.8, 0.6)]
    assert widths[0] < widths[1] < widths[2]
    wide = build_template(GarmentSpec("wide", "dress", 900, length=1.1, flare=0.7), body).vertices
    hem = marks.joints[12, 1] - 1.1
    assert wide[:, 1].min() == pytest.approx(hem, abs=2e-3)
    low = wide[wide[:, 1] < hem + 0.02]
    assert np.ptp(low[:, 0]) > widths[0] + 2 * 0.6 * 0.7 * (marks.waist - hem)
    angle = np.degrees(np.arctan2(low[:, 0], low[:, 2]))
    assert np.diff(np.sort(angle)).max() < 40.0


def test_jumpsuit_has_room_under_the_crotch(body: Body) -> None:
    marks = find_landmarks(body)
    lowest = []
    for kind, count in (("pants", 1200), ("jumpsuit", 1900)):  # edges of one length
        garment = build_template(GarmentSpec("g", kind, count), body)
        ends = garment.vertices[garment.topology.edges]
        across = ends[(ends[:, 0, 0] > 0.0) != (ends[:, 1, 0] > 0.0)]  # below the crotch no edge is on both sides
        lowest.append(marks.crotch - across[:, :, 1].mean(axis=1).min())
    assert 0.0 < lowest[0] < lowest[1] - 0.003 < 0.08


def test_a_hand_near_a_wide_hem_lends_it_no_weight(body: Body) -> None:
    wide = build_template(GarmentSpec("wide", "dress", 900, length=1.1, flare=0.8), body)
    arms = np.where(np.isin(wide.skin_index, range(16, 24)), wide.skin_weight, 0.0).sum(axis=1)
    assert arms[wide.vertices[:, 1] < 0.7].max() < 1e-3 < arms.max()


def test_skin_weights_are_smooth_and_sided(templates: dict[str, GarmentTemplate]) -> None:
    """Sum one; trouser legs follow their own leg; the middle of a skirt follows both legs alike."""
    for garment in templates.values():
        np.testing.assert_allclose(garment.skin_weight.sum(axis=1), 1.0, atol=1e-5)
    pants = templates["pants"]
    left_leg = np.where(np.isin(pants.skin_index, [1, 4, 7]), pants.skin_weight, 0.0).sum(axis=1)
    low = pants.vertices[:, 1] < 0.5
    assert left_leg[low & (pants.vertices[:, 0] > 0.1)].min() > 0.95
    assert left_leg[low & (pants.vertices[:, 0] < -0.1)].max() < 0.05
    skirt = templates["skirt"]
    sides = [np.where(np.isin(skirt.skin_index, j), skirt.skin_weight, 0.0).sum(axis=1) for j in ([1, 4], [2, 5])]
    i, j = skirt.topology.edges.T
    length = np.linalg.norm(skirt.vertices[i] - skirt.vertices[j], axis=1)
    assert (np.abs(sides[0][i] - sides[0][j]) / length).max() < 8.0  # a hard split would jump by 1 over one edge
    middle = (skirt.vertices[:, 1] < 0.6) & (np.abs(skirt.vertices[:, 0]) < 0.03)
    assert (np.abs(sides[0] - sides[1])[middle] < 0.5).all()


def test_same_spec_same_arrays(templates: dict[str, GarmentTemplate], body: Body) -> None:
    again = build_template(GarmentSpec("tshirt", "tshirt", SMALL_COUNTS["tshirt"]), body)
    for field in ("vertices", "faces", "pinned", "skin_index", "skin_weight"):
        np.testing.assert_array_equal(getattr(again, field), getattr(templates["tshirt"], field))


def test_measures_change_the_garment(body: Body) -> None:
    """Length moves the hem, flare widens it; the count stays exact also at the lower limit."""
    short = build_template(GarmentSpec("mini", "skirt", 200, length=0.30, flare=0.1), body)
    wide = build_template(GarmentSpec("maxi", "skirt", 321, length=0.70, flare=0.8), body)
    assert (len(short.vertices), len(wide.vertices)) == (200, 321)
    assert np.ptp(short.vertices[:, 1]) == pytest.approx(0.30, abs=1e-3)
    assert np.ptp(wide.vertices[:, 1]) == pytest.approx(0.70, abs=1e-3)
    assert np.ptp(wide.vertices[:, 0]) > np.ptp(short.vertices[:, 0]) + 0.4


def test_closed_field_bridges_a_hollow_and_keeps_distances() -> None:
    """Two balls of 8 cm, 3 cm apart: outside they keep their distances, between them the closing fills the neck."""
    half = _ball(0.08)
    left, right = half.vertices - [0.095, 0, 0], half.vertices + [0.095, 0, 0]

    class Marks:
        vertices = np.concatenate([left, right])
        faces = np.concatenate([half.faces, half.faces + len(left)])

    grid = empty_grid(np.array([-0.24, -0.15, -0.15]), np.array([0.24, 0.15, 0.15]), 0.01)
    ones = np.ones(grid.values.shape)
    for bridged, middle_inside in ((1.0, True), (0.0, False)):
        field = eased_field(grid, Marks, Marks.faces, 0.01 * ones, bridged * ones, 0.05)
        surface = field.level_surface()
        near = np.minimum(*(np.linalg.norm(surface.vertices - [x, 0, 0], axis=1) for x in (-0.095, 0.095)))
        outer = np.abs(surface.vertices[:, 0]) > 0.095
        np.testing.assert_allclose(near[outer], 0.09, atol=1.2e-3)
        at_middle = field.values[tuple(np.round((-grid.origin) / grid.spacing).astype(int))]
        assert (at_middle < 0.0) == middle_inside


def test_clip_keeps_area_and_a_clean_line() -> None:
    """Half a ball has half the area and one boundary circle exactly on the plane."""
    ball = _ball(0.1)
    half = ball.clipped(ball.vertices[:, 1] - 0.0123)
    curves = half.boundary_curves()
    assert len(curves) == 1
    np.testing.assert_allclose(curves[0][:, 1], 0.0123, atol=1e-7)
    assert half.area() == pytest.approx(2.0 * np.pi * 0.1 * 0.1123, rel=0.01)


def test_remesh_of_a_cap_is_isotropic_and_on_the_surface() -> None:
    ball = _ball(0.1)
    vertices, faces = remesh(ball.clipped(ball.vertices[:, 1]), 250, loops=1)
    assert len(vertices) == 250
    assert len(MeshTopology.from_faces(faces, 250).boundary_loops()) == 1
    np.testing.assert_allclose(np.linalg.norm(vertices, axis=1), 0.1, atol=1e-3)


def test_flip_repairs_a_thin_pair() -> None:
    """Two obtuse triangles over a long diagonal become two good ones over the short one."""
    vertices = np.array([[-1.0, 0, 0], [1.0, 0, 0], [0, 0.3, 0], [0, -0.3, 0]])
    flipped = delaunay_flips(vertices, np.array([[0, 1, 2], [1, 0, 3]]), smallest_degree=2)
    assert {2, 3} <= set(flipped[0].tolist()) & set(flipped[1].tolist())


def test_crossing_triangles_are_counted() -> None:
    vertices = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0.2, 0.2, -1], [0.3, 0.2, 1], [0.2, 0.4, 1.0]])
    assert crossing_pairs(vertices, np.array([[0, 1, 2], [3, 4, 5]])) == 1
    assert (
        crossing_pairs(vertices + np.repeat([[0, 0, 0], [2, 0, 0]], 3, axis=0), np.array([[0, 1, 2], [3, 4, 5]])) == 0
    )


def test_quality_bounds_refuse(templates: dict[str, GarmentTemplate], body: Body) -> None:
    good = template_quality(templates["skirt"], body)
    assert_quality("s", good, 300, 2)
    for change, text in (
        ({"smallest_angle": 5.0}, "smallest angle is 5.0"),
        ({"clearance": -0.002}, "-2.0 mm from the body"),
        ({"loops": 3}, "3 openings instead of 2"),
        ({"vertices": 299}, "299 vertices instead of 300"),
        ({"crossings": 4}, "4 pairs"),
    ):
        with pytest.raises(ValueError, match=text):
            assert_quality("s", replace(good, **change), 300, 2)


def test_file_round_trip(tmp_path, templates: dict[str, GarmentTemplate]) -> None:
    path = tmp_path / "deep" / "skirt.npz"
    templates["skirt"].save(path)
    loaded = GarmentTemplate.load(path)
    for field in GarmentTemplate.__dataclass_fields__:
        np.testing.assert_array_equal(getattr(loaded, field), getattr(templates["skirt"], field))
    assert [p.name for p in path.parent.iterdir()] == ["skirt.npz"]


@pytest.mark.parametrize(
    ("fields", "text"),
    [
        ({"kind": "cape"}, "unknown kind 'cape', known kinds are dress, jumpsuit, pants, skirt, top, tshirt"),
        ({"length": 5.0}, r"'length' must lie in 0.15..1.1, got 5.0"),
        ({"ease": -0.01}, r"'ease' must lie in .*got -0.01"),
        ({"ease": float("nan")}, "'ease' must lie in"),
        ({"vertices": 20}, r"'vertices' of skirt must be a whole number in 200..12600, got 20"),
        ({"vertices": 300.5}, "'vertices' of skirt must be a whole number"),
        ({"sleeve": 0.2}, "skirt has no measure 'sleeve'"),
        ({"kind": "top", "vertices": 400, "sleeve": 0.2}, "top has no measure 'sleeve'"),
        ({"kind": "dress", "vertices": 700, "sleeve": 0.05}, r"'sleeve' must be 0 \(no sleeves\) or at least 0.08"),
        ({"kind": "dress", "vertices": 700, "sleeve": 0.2, "strap": 0.07}, "'strap' is of a garment without sleeves"),
        (
            {"kind": "jumpsuit", "vertices": 500},
            r"'vertices' of jumpsuit must be a whole number in 600..12600, got 500",
        ),
        ({"name": " "}, "'name' must be a non-empty text"),
    ],
)
def test_spec_refuses(fields: dict, text: str) -> None:
    with pytest.raises(ValueError, match=text):
        GarmentSpec(**{"name": "s", "kind": "skirt", "vertices": 300, **fields})


@pytest.mark.parametrize(
    ("kind", "measures", "text"),
    [
        ("skirt", {"length": 1.09}, "'length' 1.090 m passes the ankles"),
        ("tshirt", {"length": 0.9}, "'length' 0.900 m passes the crotch"),
        ("tshirt", {"sleeve": 0.55}, "'sleeve' 0.550 m passes the wrist"),
        ("pants", {"length": 0.26}, "between crotch and ankles"),
        ("top", {"length": 0.9}, "'length' 0.900 m passes the crotch"),
        ("top", {"strap": 0.10, "neck": 0.03}, "'strap' 0.100 m passes the shoulder, this body and a neckline of this"),
        ("jumpsuit", {"length": 0.7}, "between crotch and ankles"),
        ("dress", {"length": 1.6}, "between crotch and ankles"),
        ("dress", {"sleeve": 0.32}, "its sleeves end .* above the waist"),
    ],
)
def test_measures_that_do_not_fit_the_body(kind: str, measures: dict, text: str, body: Body) -> None:
    with pytest.raises(ValueError, match=text):
        build_template(GarmentSpec("g", kind, 600, **measures), body)


def _changed(array: np.ndarray, at: object, value: float) -> np.ndarray:
    array = array.copy()
    array[at] = value
    return array


@pytest.mark.parametrize(
    ("field", "change", "text"),
    [
        ("vertices", lambda a: _changed(a, (7, 1), np.nan), "vertex 7 is not finite"),
        ("vertices", lambda a: a[:, :2], r"'vertices' must have shape \[V, 3\]"),
        ("faces", lambda a: _changed(a, (0, 0), 300), "triangle 0 has the corners .* outside the 300 vertices"),
        ("faces", lambda a: _changed(a, 3, a[3, [0, 0, 1]]), "triangle 3 .* is degenerate"),
        ("faces", lambda a: np.vstack([a, a[:1]]), "have the same corners"),
        ("faces", lambda a: _changed(a, 0, a[0, ::-1]), "are wound against each other"),
        ("faces", lambda a: a.astype(float), "'faces' must hold whole numbers"),
        ("pinned", lambda a: np.append(a, 300), "'pinned' must lie in 0..299"),
        ("pinned", lambda a: np.append(a, a[0]), "'pinned' names a vertex twice"),
        ("skin_weight", lambda a: a * 0.5, "sum to one"),
        ("skin_index", lambda a: a + 24, "'skin_index' must lie in 0..23"),
        ("skin_index", lambda a: a[:-1], r"'skin_index' must have shape \[300, 4\], got \[299, 4\]"),
    ],
)
def test_template_refuses(field: str, change, text: str, templates: dict[str, GarmentTemplate]) -> None:
    with pytest.raises(ValueError, match=text):
        replace(templates["skirt"], **{field: change(getattr(templates["skirt"], field))})


def test_a_failed_save_leaves_the_old_file_and_nothing_else(
    tmp_path, templates: dict[str, GarmentTemplate], monkeypatch
) -> None:
    path, skirt = tmp_path / "skirt.npz", templates["skirt"]
    skirt.save(path)
    before = path.read_bytes()

    def disk_full(stream, **_: object) -> None:
        stream.write(b"half")
        raise OSError("no space left on device")

    monkeypatch.setattr(np, "savez_compressed", disk_full)
    with pytest.raises(OSError, match="no space left"):
        skirt.save(path)
    assert path.read_bytes() == before and list(tmp_path.iterdir()) == [path]


def test_broken_files_are_refused(tmp_path, templates: dict[str, GarmentTemplate]) -> None:
    path = tmp_path / "g.npz"
    templates["skirt"].save(path)
    whole = path.read_bytes()
    path.write_bytes(whole[: len(whole) // 2])
    with pytest.raises(ValueError, match=r"g.npz: not a readable garment template"):
        GarmentTemplate.load(path)
    path.write_bytes(b"not a file of this kind")
    with pytest.raises(ValueError, match="not a readable garment template"):
        GarmentTemplate.load(path)
    np.savez(path, vertices=np.zeros((3, 3)))
    with pytest.raises(ValueError, match="it lacks format_version, name"):
        GarmentTemplate.load(path)
    np.savez(path, vertices=np.array([{"a": 1}], dtype=object), allow_pickle=True)
    with pytest.raises(ValueError, match="not a readable garment template"):
        GarmentTemplate.load(path)
    with pytest.raises(FileNotFoundError):
        GarmentTemplate.load(tmp_path / "absent.npz")


def _ball(radius: float) -> DenseSurface:
    """A closed, outward ball around the origin by marching cubes' own rules."""
    grid = empty_grid(np.full(3, -radius - 0.02), np.full(3, radius + 0.02), radius / 12.3)
    surface = grid.with_values(np.linalg.norm(grid.points(), axis=-1) - radius).level_surface()
    return DenseSurface(
        surface.vertices * (radius / np.linalg.norm(surface.vertices, axis=1, keepdims=True)), surface.faces
    )
