"""Pictures of dressed bodies, drawn off-screen in software.

In: garment and body vertices [m], optionally an error per garment vertex [m]. Out: images, uint8 [H, W, 3]. One
``SceneRenderer`` serves a whole sequence: the scene is built once and only vertices, colours and camera move.

Cloth is judged by its folds, so the light does the work: a warm key light, a cool fill, and a raking light along the
surface whose shadows draw wrinkles. Arms shade cloth and cloth shades legs (``report.sky``). The ground takes a soft
contact shadow, blurred in a small image instead of traced.
"""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence

import numpy as np
from scipy.ndimage import gaussian_filter
from scipy.sparse import csr_matrix

from geometry.topology import MeshTopology, normalized, vertex_normals
from report.camera import Framing, View
from report.colours import BODY, GARMENT_COLOURS
from report.sky import key_directions, seen_share, sky_directions
from report.tessellation import Tessellation

if sys.platform.startswith("linux") and not os.environ.get("DISPLAY"):
    # Without a display VTK would try X first and complain on every window.
    os.environ.setdefault("VTK_DEFAULT_OPENGL_WINDOW", "vtkEGLRenderWindow")

import pyvista as pv
from PIL import Image

BACKGROUND = np.array([0.955, 0.950, 0.942])
GROUND = np.array([0.918, 0.911, 0.900])
Colour = str | tuple[float, float, float] | np.ndarray
"""A key of ``GARMENT_COLOURS``, one RGB in 0..1, or one for each garment vertex, shape [V, 3]."""

ERROR_STOPS = np.array(
    [
        [0.935, 0.925, 0.905],
        [0.985, 0.850, 0.520],
        [0.955, 0.580, 0.290],
        [0.820, 0.290, 0.330],
        [0.520, 0.120, 0.400],
        [0.210, 0.055, 0.300],
    ]
)
"""Error colours from nought to the maximum: plain cloth, yellow, orange, red, purple; lightness falls steadily."""

KEY = (-0.80, 0.75, 0.48)
LIGHTS = (
    ((1.0, 0.97, 0.93), 0.86, KEY),
    ((0.88, 0.93, 1.0), 0.22, (0.70, 0.15, 0.95)),
    ((1.0, 0.98, 0.95), 0.46, (1.00, 0.40, 0.02)),
    ((0.9, 0.94, 1.0), 0.30, (-0.80, 0.50, -0.90)),
)
"""Colour, intensity and place as (right, up, towards the camera): key light, soft fill, rake, and a rim from behind."""

OVERSAMPLING = 2
GROUND_CELLS = 72
SHADOW_STRENGTH = 0.55


class SceneRenderer:
    """Draws a garment on a body, frame after frame.

    Args:
        garment_faces: Triangles of the garment, shape [F, 3].
        body_faces: Triangles of the body, shape [Fb, 3].
        size: Width and height of the picture [px].
        colour: Garment colour.
        smooth: Round the garment's facets off by one level of Phong tessellation (positions at its vertices stay).
    """

    def __init__(
        self,
        garment_faces: np.ndarray,
        body_faces: np.ndarray,
        size: tuple[int, int] = (480, 640),
        colour: Colour = "skirt",
        smooth: bool = True,
    ) -> None:
        self.size = size
        self.colour = np.asarray(GARMENT_COLOURS[colour] if isinstance(colour, str) else colour, dtype=np.float64)
        self.garment_faces, self.body_faces = np.asarray(garment_faces), np.asarray(body_faces)
        self.tessellation = Tessellation(self.garment_faces) if smooth else None
        drawn = self.tessellation.faces if self.tessellation else self.garment_faces
        # Drawn at twice the size and averaged: cheaper in software than multi-sampling (46 against 75 ms of CPU).
        self._plotter = pv.Plotter(
            off_screen=True, window_size=[OVERSAMPLING * size[0], OVERSAMPLING * size[1]], lighting="none"
        )
        self._plotter.set_background(tuple(BACKGROUND))
        self._plotter.disable_anti_aliasing()
        self._garment = _mesh(drawn)
        self._garment["colour"] = np.full((int(drawn.max()) + 1, 3), 255, dtype=np.uint8)
        self._body = _mesh(self.body_faces)
        self._body["colour"] = np.full((int(self.body_faces.max()) + 1, 3), 255, dtype=np.uint8)
        self._ground = pv.Plane(
            center=(0, 0, 0), direction=(0, 1, 0), i_size=1, j_size=1,
            i_resolution=GROUND_CELLS - 1, j_resolution=GROUND_CELLS - 1,
        )  # fmt: skip
        self._ground_unit = np.asarray(self._ground.points)[:, [0, 2]].copy()
        self._ground["colour"] = np.full((self._ground.n_points, 3), 255, dtype=np.uint8)
        self._built = False
        self._laplacian: csr_matrix | None = None

    def __enter__(self) -> SceneRenderer:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Free the window."""
        self._plotter.close()

    def frame(
        self,
        garment: np.ndarray,
        body: np.ndarray,
        framing: Framing,
        index: int = 0,
        error: np.ndarray | None = None,
        largest_error: float = 0.05,
    ) -> np.ndarray:
        """One picture, uint8 [H, W, 3].

        Args:
            garment: Garment vertices [m], shape [V, 3].
            body: Body vertices [m], shape [B, 3].
            framing: Camera of the sequence.
            index: Frame whose target the camera looks at.
            error: Error of each garment vertex [m], shape [V]; colours the cloth instead of its own colour.
            largest_error: Error with the darkest colour [m].
        """
        garment, body = np.asarray(garment, dtype=np.float64), np.asarray(body, dtype=np.float64)
        normals, skin = vertex_normals(garment, self.garment_faces), vertex_normals(body, self.body_faces)
        light = self._light(np.concatenate([garment, body]), np.concatenate([normals, skin]), framing)
        if error is None:
            shade = self._smoothed(light[: len(garment)]) * self._folds(garment, normals)
            colours = np.clip(self.colour * shade[:, None], 0, 1)
        else:
            colours = error_colours(np.asarray(error), largest_error)
        points = garment
        if self.tessellation:
            points, normals, colours = self.tessellation(garment, normals, colours)
        _move(self._garment, points, normals)
        self._garment["colour"] = (255 * colours).astype(np.uint8)
        _move(self._body, body, skin)
        self._body["colour"] = (255 * np.clip(np.array(BODY) * light[len(garment) :, None], 0, 1)).astype(np.uint8)
        self._lay_ground(points, body, framing.targets[index])
        if not self._built:
            self._build(flat=error is not None)
        self._look(framing, index)
        self._plotter.render()
        drawn = Image.fromarray(np.ascontiguousarray(self._plotter.screenshot(return_img=True)[..., :3]))
        return np.asarray(drawn.reduce(OVERSAMPLING))

    def _build(self, flat: bool) -> None:
        """Add the actors; they need the first frame's points, or VTK guesses wrong bounds."""
        ambient, diffuse = (0.42, 0.62) if flat else (0.15, 1.0)
        actor = self._plotter.add_mesh(
            self._garment,
            scalars="colour",
            rgb=True,
            smooth_shading=False,
            show_scalar_bar=False,
            backface_params={"ambient": 0.6 * ambient, "diffuse": 0.45 * diffuse, "specular": 0.0},
        )
        _finish(actor, ambient, diffuse, specular=0.06)
        body = self._plotter.add_mesh(
            self._body, scalars="colour", rgb=True, smooth_shading=False, show_scalar_bar=False
        )
        _finish(body, ambient=0.28, diffuse=0.88, specular=0.08)
        self._plotter.add_mesh(self._ground, scalars="colour", rgb=True, lighting=False, show_scalar_bar=False)
        self._lights = [
            (pv.Light(color=colour, intensity=intensity, light_type="scene light"), place)
            for colour, intensity, place in LIGHTS
        ]
        for light, _ in self._lights:
            self._plotter.add_light(light)
        self._built = True

    def _look(self, framing: Framing, index: int) -> None:
        target, back = framing.targets[index], framing.direction
        camera = self._plotter.camera
        camera.position = tuple(target + framing.distance * back)
        camera.focal_point, camera.up, camera.view_angle = tuple(target), (0, 1, 0), framing.field
        camera.clipping_range = (0.2 * framing.distance, framing.distance + 12.0)
        # Lights turn with the camera, so that every view is lit alike; they stay level.
        right, forward = _level(framing)
        for light, (x, y, z) in self._lights:
            light.position = tuple(target + 10.0 * (x * right + y * np.array([0.0, 1.0, 0.0]) + z * forward))
            light.focal_point = tuple(target)

    def _light(self, points: np.ndarray, normals: np.ndarray, framing: Framing) -> np.ndarray:
        """Brightness of each point by what stands before the sky and before the key light, 0.4..1.07."""
        right, forward = _level(framing)
        x, y, z = KEY
        key = key_directions(x * right + y * np.array([0.0, 1.0, 0.0]) + z * forward)
        sky = seen_share(points, normals, sky_directions())
        return (0.58 + 0.46 * sky) * (0.76 + 0.27 * seen_share(points, normals, key))

    def _folds(self, garment: np.ndarray, normals: np.ndarray) -> np.ndarray:
        """Brightness of each vertex, 0.72..1.1: valleys darker, ridges lighter, finer than the sky's shadows are."""
        hollow = np.einsum("vc,vc->v", self._umbrella(len(garment)) @ garment, normals)
        return np.clip(1.0 + 32.0 * self._smoothed(hollow), 0.72, 1.10)

    def _smoothed(self, values: np.ndarray) -> np.ndarray:
        """Values [V] drawn half of the way to the mean of their neighbours on the cloth."""
        return values - 0.5 * (self._umbrella(len(values)) @ values)

    def _umbrella(self, vertices: int) -> csr_matrix:
        if self._laplacian is None:
            self._laplacian = MeshTopology.from_faces(self.garment_faces, vertices).uniform_laplacian()
        return self._laplacian

    def _lay_ground(self, garment: np.ndarray, body: np.ndarray, target: np.ndarray) -> None:
        """Put the ground under the target, with the soft shadow of what stands near it, fading into the background."""
        half = 1.6
        points = np.empty((len(self._ground_unit), 3))
        centre = target[[0, 2]]
        points[:, [0, 2]] = 2 * half * self._ground_unit + centre
        points[:, 1] = 0.0
        _move(self._ground, points)
        shadow = np.zeros((GROUND_CELLS, GROUND_CELLS))
        edges = np.linspace(-half, half, GROUND_CELLS + 1)
        for cloud, share in ((body, 1.0), (garment, 1.0)):
            # Light falls a little from the side; what is high up shades less and wider.
            height = np.maximum(cloud[:, 1], 0.0)
            x, z = cloud[:, 0] - centre[0] + 0.18 * height, cloud[:, 2] - centre[1] - 0.10 * height
            weight = share / len(cloud) / (1.0 + 2.5 * height)
            shadow += np.histogram2d(x, z, bins=(edges, edges), weights=weight)[0]
        wide, tight = gaussian_filter(shadow, 4.0), gaussian_filter(shadow, 1.6)
        cell = (2 * half / GROUND_CELLS) ** 2
        dark = 1.0 - np.exp(-0.09 * (0.7 * wide + 0.3 * tight) / cell)
        columns = np.round((self._ground_unit + 0.5) * (GROUND_CELLS - 1)).astype(int)
        darkness = SHADOW_STRENGTH * dark[columns[:, 0], columns[:, 1]]
        fade = np.clip(1.25 - np.linalg.norm(2 * self._ground_unit, axis=1) * 1.25, 0.0, 1.0)[:, None] ** 1.5
        colour = (BACKGROUND + fade * (GROUND - BACKGROUND)) * (1.0 - darkness * np.minimum(1, 2 * fade[:, 0]))[:, None]
        self._ground["colour"] = (255 * colour).astype(np.uint8)


def render_sequence(
    garment: np.ndarray,
    garment_faces: np.ndarray,
    body: np.ndarray,
    body_faces: np.ndarray,
    size: tuple[int, int] = (480, 640),
    colour: Colour = "skirt",
    view: View | None = None,
    error: np.ndarray | None = None,
    largest_error: float = 0.05,
    framing: Framing | None = None,
) -> np.ndarray:
    """Pictures of a sequence, uint8 [T, H, W, 3].

    Args:
        garment: Garment vertices [m], shape [T, V, 3].
        garment_faces: Shape [F, 3].
        body: Body vertices [m], shape [T, B, 3].
        body_faces: Shape [Fb, 3].
        size: Width and height [px].
        colour: Garment colour.
        view: Camera angles; by default a little from the front left.
        error: Error of each vertex [m], shape [T, V].
        largest_error: Error with the darkest colour [m].
        framing: A camera to share between several methods, so that their pictures can be laid side by side; by default
            one that sees all of this sequence.
    """
    if len(garment) != len(body) or (error is not None and len(error) != len(garment)):
        raise ValueError(f"render: garment has {len(garment)} frames, body {len(body)}")
    framing = framing or Framing.of(body, view or View(), size, garment)
    with SceneRenderer(garment_faces, body_faces, size, colour) as scene:
        return np.stack(
            [
                scene.frame(garment[t], body[t], framing, t, None if error is None else error[t], largest_error)
                for t in range(len(garment))
            ]
        )


def render_frame(
    garment: np.ndarray,
    garment_faces: np.ndarray,
    body: np.ndarray,
    body_faces: np.ndarray,
    size: tuple[int, int] = (480, 640),
    colour: Colour = "skirt",
    view: View | None = None,
    error: np.ndarray | None = None,
    largest_error: float = 0.05,
) -> np.ndarray:
    """One picture, uint8 [H, W, 3]; arguments as ``render_sequence`` without the frame axis."""
    errors = None if error is None else error[None]
    frames = render_sequence(
        garment[None], garment_faces, body[None], body_faces, size, colour, view, errors, largest_error
    )
    return frames[0]


def worn_colours(kinds: Sequence[str], layer: np.ndarray) -> np.ndarray:
    """RGB in 0..1 of each vertex, shape [V, 3], of garments worn over each other.

    Args:
        kinds: Kind of each garment: it has that kind's colour, or the next one that no garment under it has.
        layer: Garment of each vertex, shape [V].
    """
    free = dict(GARMENT_COLOURS)
    colours = []
    for kind in kinds:
        free = free or dict(GARMENT_COLOURS)
        colours.append(free.pop(kind if kind in free else next(iter(free))))
    return np.array(colours)[layer]


def error_colours(error: np.ndarray, largest_error: float) -> np.ndarray:
    """RGB in 0..1, shape [..., 3], of errors [m]; everything above ``largest_error`` has the last colour."""
    if largest_error <= 0:
        raise ValueError(f"largest_error: must be positive, got {largest_error}")
    place = np.clip(error / largest_error, 0, 1)
    stops = np.linspace(0, 1, len(ERROR_STOPS))
    return np.stack([np.interp(place, stops, ERROR_STOPS[:, k]) for k in range(3)], axis=-1)


def _level(framing: Framing) -> tuple[np.ndarray, np.ndarray]:
    """Unit vectors to the right of the camera and towards it, along the ground."""
    back = framing.direction
    forward = normalized(np.array([back[0], 0.0, back[2]]))
    return np.array([forward[2], 0.0, -forward[0]]), forward


def _finish(actor: pv.Actor, ambient: float, diffuse: float, specular: float) -> None:
    """Shade by interpolated normals, without highlights that would look like plastic."""
    actor.prop.interpolation = "Phong"
    actor.prop.ambient, actor.prop.diffuse = ambient, diffuse
    actor.prop.specular, actor.prop.specular_power = specular, 14


def _mesh(faces: np.ndarray) -> pv.PolyData:
    count = int(faces.max()) + 1
    mesh = pv.PolyData(np.zeros((count, 3)), np.column_stack([np.full(len(faces), 3), faces]).ravel())
    mesh.point_data.active_normals = np.tile([0.0, 0.0, 1.0], (count, 1))
    return mesh


def _move(mesh: pv.PolyData, points: np.ndarray, normals: np.ndarray | None = None) -> None:
    mesh.points = points.astype(np.float32)
    if normals is not None:
        mesh.point_data.active_normals = normals.astype(np.float32)
