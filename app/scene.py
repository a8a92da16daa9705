"""The picture: body and garment on a neutral ground, candidates beside them, and what is inside the body.

In: what frames look like. Out: a scene of ``viser``, the same for every page that shows it. The scene moves under the
camera, so that the body stays in view however far it walks.
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence

import numpy as np
import viser

from app.frames import Look
from geometry.topology import vertex_normals
from report.colours import BODY, GARMENT_COLOURS

BACKGROUND = (246, 244, 241)
CANDIDATE_PLACES = (-1.4, -0.72, 0.72, 1.4)
"""Where candidates stand beside the body, as the camera sees it at first: to its right [m]."""

_EYE, _LOOK_AT = np.array([1.5, 1.5, 4.3]), np.array([0.0, 0.92, 0.0])
_BEHIND = 1.0
"""How far behind the body they stand [m]."""
_INSIDE, _TAKEN_OUT = (214, 24, 62), (240, 150, 40)
_LIFT = 0.006
"""How far over the cloth marks of its vertices are [m]: what lies in it is half hidden by it."""
_FIELD = np.deg2rad(28.0)


class Scene:
    """Body, garment, ground, light and candidates.

    Args:
        server: Where they are shown.
    """

    def __init__(self, server: viser.ViserServer) -> None:
        self.server, scene = server, server.scene
        scene.set_up_direction("+y")
        # A key light from the upper left that draws folds, a cool fill, and little from everywhere.
        scene.configure_default_lights(False)
        scene.configure_environment_map(None)
        scene.set_background_image(np.full((2, 2, 3), BACKGROUND, dtype=np.uint8), format="png")
        scene.add_light_hemisphere("/light/sky", sky_color=(255, 252, 247), ground_color=(190, 184, 176), intensity=1.5)
        scene.add_light_directional(
            "/light/key", color=(255, 244, 230), intensity=2.6, position=(2.4, 3.6, 2.6), cast_shadow=True
        )
        scene.add_light_directional("/light/fill", color=(214, 228, 255), intensity=0.7, position=(-3.0, 1.6, 1.2))
        scene.add_light_directional("/light/rim", color=(255, 255, 255), intensity=0.9, position=(-0.8, 2.2, -3.0))
        self._stage = scene.add_frame("/stage", show_axes=False)
        scene.add_grid(
            "/stage/ground",
            infinite_grid=True,
            fade_distance=14.0,
            plane="xz",
            cell_size=0.25,
            section_size=1.0,
            cell_color=(228, 225, 220),
            section_color=(212, 208, 202),
            shadow_opacity=0.22,
        )
        camera = server.initial_camera
        camera.position, camera.look_at, camera.fov = _EYE, _LOOK_AT, float(_FIELD)
        self._garment = self._body = None
        self._candidates: list[viser.SceneNodeHandle] = []
        self._inside = scene.add_point_cloud(
            "/stage/inside",
            np.zeros((0, 3), np.float32),
            _INSIDE,
            point_size=0.011,
            point_shape="circle",
            visible=False,
        )
        self.follow = self.highlight = self._body_seen = True

    def dress(self, garment: str, faces: np.ndarray, body_faces: np.ndarray, look: Look) -> None:
        """Put a garment on, in place of another."""
        scene = self.server.scene
        known = GARMENT_COLOURS.get(garment, next(iter(GARMENT_COLOURS.values())))
        self.colour = tuple(round(255 * part) for part in known)
        self._faces, self._body_faces = faces, body_faces
        with self.server.atomic():
            # A shadow map is too coarse for folds and faces: it draws stripes on them.
            self._body = scene.add_mesh_simple(
                "/stage/body",
                look.body,
                body_faces,
                color=tuple(round(255 * part) for part in BODY),
                receive_shadow=False,
            )
            self._body.visible = self._body_seen
            self._garment = scene.add_mesh_simple(
                "/stage/garment", look.garment, faces, color=self.colour, side="double", receive_shadow=False
            )
        self.clear_candidates()

    def show(self, look: Look, place: np.ndarray, refined: bool) -> None:
        """Show a frame.

        Args:
            look: The frame.
            place: Where the body is on the ground, shape [3] [m].
            refined: Whether the garment was taken out of the body.
        """
        with self.server.atomic():
            self._body.vertices, self._garment.vertices = look.body, look.garment
            shown = self.highlight and len(look.inside) > 0
            if shown:
                normals = vertex_normals(look.garment, self._faces)[look.inside]
                self._inside.points = look.garment[look.inside] + (_LIFT * normals).astype(np.float32)
                self._inside.colors = np.array(_TAKEN_OUT if refined else _INSIDE, dtype=np.uint8)
            self._inside.visible = shown
            # What is inside the body is seen through it.
            self._body.opacity = 0.7 if self.highlight and not refined else None
            self._stage.position = -place if self.follow else np.zeros(3)

    def show_body(self, on: bool) -> None:
        """Whether the body is seen."""
        self._body.visible = self._body_seen = on

    def show_candidates(
        self, looks: Sequence[Look], names: Sequence[str], chosen: Callable[[str, object], None]
    ) -> None:
        """Stand candidates side by side, left and right of the body; a click on one is told with its name."""
        self.clear_candidates()
        scene, back = self.server.scene, (_EYE - _LOOK_AT) * (1.0, 0.0, 1.0)
        back /= np.linalg.norm(back)
        right = np.array([back[2], 0.0, -back[0]])
        with self.server.atomic():
            for number, (look, called) in enumerate(zip(looks, names, strict=True)):
                place = CANDIDATE_PLACES[number] * right - _BEHIND * back
                name = f"/stage/candidates/{number + 1}"
                self._candidates += [scene.add_frame(name, show_axes=False, position=place)]
                body = scene.add_mesh_simple(
                    f"{name}/body",
                    look.body,
                    self._body_faces,
                    color=(208, 203, 198),
                    opacity=0.35,
                    cast_shadow=False,
                    receive_shadow=False,
                )
                garment = scene.add_mesh_simple(
                    f"{name}/garment",
                    look.garment,
                    self._faces,
                    color=self._lighter(),
                    side="double",
                    receive_shadow=False,
                )
                head = look.body[look.body[:, 1].argmax()] + np.array([0.0, 0.12, 0.0])
                scene.add_label(f"{name}/label", called, position=head)
                for mesh in (body, garment):
                    mesh.on_click(functools.partial(chosen, called))

    def clear_candidates(self) -> None:
        """Send the candidates away."""
        for handle in self._candidates:
            handle.remove()
        self._candidates = []

    @property
    def candidates(self) -> int:
        """Candidates that are shown."""
        return len(self._candidates)

    def _lighter(self) -> tuple[int, int, int]:
        return tuple(round(0.72 * part + 0.28 * 255) for part in self.colour)
