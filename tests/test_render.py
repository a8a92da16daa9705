"""Pictures: what is drawn is what was given, every frame anew; sheets and animations keep their pixels."""

from __future__ import annotations

from pathlib import Path

import av
import numpy as np
import pytest
from PIL import Image

from report.camera import Framing, View
from report.render import ERROR_STOPS, SceneRenderer, error_colours, render_frame
from report.sheets import caption_height, contact_sheet, side_by_side, with_legend, write_animation, write_image
from report.sky import key_directions, seen_share, sky_directions
from report.tessellation import Tessellation
from report.video import write_video

SIZE = (96, 128)


def ball(radius: float, centre: tuple[float, float, float], rows: int = 8) -> tuple[np.ndarray, np.ndarray]:
    columns = 2 * rows
    theta, phi = np.linspace(0, np.pi, rows + 1)[1:-1], np.arange(columns) * np.pi / rows
    t, p = np.meshgrid(theta, phi, indexing="ij")
    ring = np.stack([np.sin(t) * np.cos(p), np.cos(t), -np.sin(t) * np.sin(p)], axis=-1).reshape(-1, 3)
    vertices = np.concatenate([ring, [[0, 1, 0], [0, -1, 0]]])
    north, last, faces = len(ring), (rows - 2) * columns, []
    for j in range(columns):
        k = (j + 1) % columns
        faces += [[north, j, k], [north + 1, last + k, last + j]]
        for i in range(rows - 2):
            a, b = i * columns + j, i * columns + k
            faces += [[a, a + columns, b], [b, a + columns, b + columns]]
    return radius * vertices + centre, np.array(faces)


@pytest.fixture(scope="module")
def scene() -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    garment, garment_faces = ball(0.3, (0.0, 1.3, 0.0))
    body, body_faces = ball(0.25, (0.0, 0.25, 0.0))
    return garment, garment_faces, body, body_faces


def coloured(image: np.ndarray) -> np.ndarray:
    """Pixels with a strong colour: the garment, nothing else in the scene."""
    wide = image.astype(int)
    return wide.max(axis=-1) - wide.min(axis=-1) > 60


def test_every_frame_is_drawn_anew_and_the_garment_is_where_it_should_be(scene) -> None:
    garment, garment_faces, body, body_faces = scene
    framing = Framing.of(np.stack([np.concatenate([garment, body])]), View(azimuth=0, elevation=0), SIZE)
    with SceneRenderer(garment_faces, body_faces, SIZE, (0.9, 0.1, 0.1)) as renderer:
        first = renderer.frame(garment, body, framing)
        second = renderer.frame(garment + [0.15, -0.4, 0.0], body, framing)
        again = renderer.frame(garment, body, framing)
    assert first.shape == (128, 96, 3) and first.dtype == np.uint8
    np.testing.assert_array_equal(first, again)
    centres = [np.argwhere(coloured(image)).mean(axis=0) for image in (first, second)]
    assert centres[1][0] > centres[0][0] + 10, "lower in the world must be lower in the picture"
    assert centres[1][1] > centres[0][1] + 4, "+x must be to the right, seen from the front"
    red = first[coloured(first)].mean(axis=0)
    assert red[0] > 2 * red[1]


def test_error_map_colours_the_erring_side(scene) -> None:
    garment, garment_faces, body, body_faces = scene
    error = np.where(garment[:, 0] > 0.05, 0.05, 0.0)
    image = render_frame(garment, garment_faces, body, body_faces, SIZE, view=View(0, 0), error=error).astype(int)
    dark = np.argwhere(image[..., 2] > image[..., 1] + 25)  # purple, which nothing else here is
    assert len(dark) > 30 and (dark[:, 1] > SIZE[0] / 2).all()
    np.testing.assert_allclose(error_colours(np.array([0.0, 0.02, 9.0]), 0.02), ERROR_STOPS[[0, -1, -1]])
    assert (np.diff(error_colours(np.linspace(0, 1, 50), 1.0).sum(axis=1)) < 0).all(), "lightness must fall steadily"


@pytest.mark.parametrize("follow", [False, True])
def test_framing_holds_the_whole_sequence(follow: bool) -> None:
    rng = np.random.default_rng(0)
    path = np.cumsum(rng.normal(size=(20, 1, 3)) * [0.1, 0.0, 0.1], axis=0)
    points = rng.uniform([-0.5, 0.0, -0.3], [0.5, 1.8, 0.3], (20, 350, 3)) + path
    framing = Framing.of(points, View(azimuth=40, elevation=15, follow=follow), (480, 640))
    back = framing.direction
    right = np.array([np.cos(np.deg2rad(40)), 0, -np.sin(np.deg2rad(40))])
    offset = points - framing.targets[:, None]
    tangent = np.tan(np.deg2rad(framing.field) / 2)
    depth = framing.distance - offset @ back
    assert (np.abs(offset @ np.cross(back, right)) < tangent * depth).all()
    assert (np.abs(offset @ right) < 0.75 * tangent * depth).all()
    moved = np.abs(np.diff(framing.targets, axis=0)).max()
    assert (moved > 0) == follow


def test_tessellation_keeps_vertices_and_rounds_off() -> None:
    vertices, faces = ball(1.0, (0, 0, 0))
    tessellation = Tessellation(faces)
    points, normals, colours = tessellation(vertices, vertices, np.abs(vertices))
    assert len(tessellation.faces) == 4 * len(faces) and len(points) == len(colours) == tessellation.faces.max() + 1
    np.testing.assert_array_equal(points[: len(vertices)], vertices)
    i, j = tessellation.edges.T
    flat = 1 - np.linalg.norm(0.5 * (vertices[i] + vertices[j]), axis=1)
    round_ = np.abs(1 - np.linalg.norm(points[len(vertices) :], axis=1))
    assert round_.max() < 0.5 * flat.max()
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1.0)


def test_what_hangs_above_shades_what_lies_below() -> None:
    side = np.linspace(-0.5, 0.5, 41)
    x, z = (a.ravel() for a in np.meshgrid(side, side))
    floor = np.stack([x, np.zeros_like(x), z], axis=1)
    roof = np.stack([0.3 * x, np.full_like(x, 0.3), 0.3 * z], axis=1)
    up = np.tile([0.0, 1.0, 0.0], (len(floor), 1))
    alone = seen_share(floor, up, sky_directions())
    assert alone.min() > 0.97, "a plane does not shade itself"
    both = seen_share(np.concatenate([floor, roof]), np.concatenate([up, up]), sky_directions())[: len(floor)]
    middle, corner = np.hypot(x, z).argmin(), np.hypot(x, z).argmax()
    assert both[middle] < 0.7 < 0.9 < both[corner]
    lit = seen_share(np.concatenate([floor, roof]), np.concatenate([up, up]), key_directions(np.array([1.0, 1.0, 0.0])))
    darkest = floor[lit[: len(floor)].argmin()]
    assert darkest[0] < -0.15 and abs(darkest[2]) < 0.2, "the shadow falls away from the light"


def test_video_lasts_as_long_as_its_frames_and_refuses_what_is_no_picture(tmp_path: Path) -> None:
    frames = np.stack([np.full((33, 47, 3), 40 * t, dtype=np.uint8) for t in range(6)])
    write_video(tmp_path / "clip.mp4", frames, fps=25.0)
    with av.open(str(tmp_path / "clip.mp4")) as video:
        assert float(video.streams.video[0].duration * video.streams.video[0].time_base) == pytest.approx(6 / 25)
        shown = [frame.to_ndarray(format="rgb24") for frame in video.decode(video=0)]
    assert shown[0].shape == (32, 46, 3)
    assert [abs(int(image[16, 24, 0]) - 40 * t) < 12 for t, image in enumerate(shown)] == [True] * 6
    with pytest.raises(ValueError, match="expected images uint8"):
        write_video(tmp_path / "bad.mp4", frames.astype(float), fps=30.0)
    assert [path.name for path in tmp_path.iterdir()] == ["clip.mp4"]


def test_sheets_place_their_pictures() -> None:
    tiles = [[np.full((40, 60, 3), 10 * (3 * i + j), dtype=np.uint8) for j in range(3)] for i in range(2)]
    sheet = contact_sheet(tiles, ["upper", "lower"], ["a", "b", "c"])
    head = caption_height(60)
    assert (sheet[head + 46 : head + 86, head + 132 : head + 192] == 50).all()
    joined = side_by_side([np.stack([tiles[0][1]] * 4), np.stack([tiles[1][2]] * 4)])
    assert joined.shape == (4, 40, 126, 3) and (joined[:, :, 66:] == 50).all()
    with pytest.raises(ValueError, match="one shape"):
        side_by_side([np.zeros((2, 4, 4, 3)), np.zeros((3, 4, 4, 3))])


def test_legend_shows_its_colours_in_the_corner_alone() -> None:
    plain = np.full((2, 200, 240, 3), 240, dtype=np.uint8)
    drawn = with_legend(plain, ERROR_STOPS, 40.0, "mm", "vertex error")
    changed = np.argwhere((drawn != plain).any(axis=-1))
    assert changed[:, 1].min() > 130 and changed[:, 2].max() < 160
    np.testing.assert_array_equal(drawn[0], drawn[1])
    darkest = (255 * ERROR_STOPS[-1]).astype(np.uint8)
    assert (drawn == darkest).all(axis=-1).any()


def test_animation_round_trip(tmp_path: Path) -> None:
    frames = np.stack([np.full((32, 48, 3), 40 * t, dtype=np.uint8) for t in range(6)])
    write_animation(tmp_path / "clip.webp", frames, fps=30.0)
    with Image.open(tmp_path / "clip.webp") as image:
        assert image.n_frames == 6 and image.size == (48, 32)
        durations = []
        for t in range(6):
            image.seek(t)
            image.load()
            durations.append(image.info["duration"])
            assert abs(int(np.asarray(image.convert("RGB"))[16, 24, 0]) - 40 * t) < 12
    assert sum(durations) == 200
    write_image(tmp_path / "one.png", frames[3])
    np.testing.assert_array_equal(np.asarray(Image.open(tmp_path / "one.png")), frames[3])
    with pytest.raises(ValueError, match="expected images uint8"):
        write_animation(tmp_path / "bad.webp", frames.astype(float), fps=30.0)
