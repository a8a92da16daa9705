"""Pictures of the worst frames of simulated cloth: faults red, pinched or in a hand orange, self crossings blue."""

from __future__ import annotations

import os
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from benchmarks.clean_table import ClipReport
    from benchmarks.subjects import Subject
    from sim.buried import Closure

CLOTH, FAULT, PINCHED, SELF = (196, 208, 214), (205, 30, 30), (245, 150, 30), (40, 80, 220)
SIZE = (1200, 900)  # [px]
NEAR, FAR = 0.75, 3.2  # [m] distance of the camera from the worst triangle, and from the whole body
ROOM = 0.12  # [m] what lies farther before the worst triangle is cut away in the near view


@dataclass(frozen=True)
class Sight:
    """One frame to draw: a score to rank it by, its name and what is to be seen."""

    score: float
    name: str
    cloth: np.ndarray
    faces: np.ndarray
    body: np.ndarray
    colours: np.ndarray
    focus: np.ndarray
    outward: np.ndarray


class Album:
    """Keeps the worst frames of a survey, by depth in the body and by self crossings, and draws them."""

    def __init__(self, body_faces: np.ndarray, count: int):
        self.body_faces, self.count = np.asarray(body_faces), count
        self.sights: dict[str, list[Sight]] = {"deep": [], "self": []}

    def keep(self, report: ClipReport, subject: Subject, posed: np.ndarray, closures: list[Closure]) -> None:
        """Take the worst frames of a clip if they are among the worst so far."""
        if report.failure is not None:
            return
        for kind, names in (("deep", ("deepest_mm", "triangles")), ("self", ("self_pairs", "max_strain"))):
            frame = report.worst_frame(*names)
            score = report.frames[names[0]][frame]
            kept = self.sights[kind]
            if score > 0 and (len(kept) < self.count or score > kept[-1].score):
                kept.append(self._sight(kind, score, frame, report, subject, posed[frame], closures[frame]))
                kept.sort(key=lambda sight: -sight.score)
                del kept[self.count :]

    def _sight(
        self,
        kind: str,
        score: float,
        frame: int,
        report: ClipReport,
        subject: Subject,
        body: np.ndarray,
        closure: Closure,
    ) -> Sight:
        cloth, faces = report.positions[frame], subject.simulator.template.faces
        found = subject.check(cloth, body, closure)
        colours = np.tile(np.array(CLOTH, dtype=np.uint8), (len(faces), 1))
        colours[found.self_count > 0] = SELF
        colours[found.triangle_inside] = PINCHED
        colours[found.triangle_fault] = FAULT
        centres = cloth[faces].mean(axis=1)
        if kind == "deep":
            worst = int(np.argmax(np.where(found.triangle_fault, found.triangle_depth, 0.0)))
            corners = body[self.body_faces[found.triangle_face[worst]]]
            outward = np.cross(corners[1] - corners[0], corners[2] - corners[0])
        else:
            # Where self crossings are densest: the one with the most others close by.
            crossing = centres[found.self_count > 0]
            near = np.linalg.norm(crossing[:, None] - crossing[None], axis=-1) < 0.05
            worst = int(np.flatnonzero(found.self_count > 0)[near.sum(axis=1).argmax()])
            outward = centres[worst] - body.mean(axis=0)
        outward = outward / max(np.linalg.norm(outward), 1e-9)
        name = f"{kind}_{report.garment}_{report.vertex_count}_{report.clip}_{frame:03d}"
        return Sight(score, name, cloth, faces, body, colours, centres[worst], outward)

    def draw(self, folder: str | Path) -> list[Path]:
        """Write one picture a frame: the whole body beside the worst place; returns their paths."""
        folder = Path(folder)
        folder.mkdir(parents=True, exist_ok=True)
        paths = []
        for sight in [sight for sights in self.sights.values() for sight in sights]:
            paths.append(folder / f"{sight.name}.png")
            self._draw_one(sight, paths[-1])
        return paths

    def _draw_one(self, sight: Sight, path: Path) -> None:
        if sys.platform.startswith("linux") and not os.environ.get("DISPLAY"):
            # Without a display VTK would try X first and complain on every window.
            os.environ.setdefault("VTK_DEFAULT_OPENGL_WINDOW", "vtkEGLRenderWindow")
        import pyvista as pv

        plotter = pv.Plotter(off_screen=True, shape=(1, 2), window_size=SIZE, border=False)
        for column, distance in enumerate((FAR, NEAR)):
            plotter.subplot(0, column)
            plotter.set_background("white")
            body = pv.PolyData.from_regular_faces(sight.body.astype(np.float32), self.body_faces)
            cloth = pv.PolyData.from_regular_faces(sight.cloth.astype(np.float32), sight.faces)
            cloth.cell_data["colour"] = sight.colours
            plotter.add_mesh(body, color=(0.86, 0.76, 0.68), smooth_shading=column == 0, ambient=0.2)
            plotter.add_mesh(
                cloth, scalars="colour", rgb=True, show_edges=column == 1, edge_color="#7a8288", ambient=0.3
            )
            target = sight.body.mean(axis=0) if column == 0 else sight.focus
            # From a little above, never from straight below or above.
            direction = sight.outward + np.array([0.0, 0.25, 0.0])
            direction[1] = np.clip(direction[1], -0.6, 0.8)
            direction /= np.linalg.norm(direction)
            plotter.camera.position = tuple(target + distance * direction)
            plotter.camera.focal_point = tuple(target)
            plotter.camera.up = (0.0, 1.0, 0.0)
            # The near view looks past arms that are in the way.
            plotter.camera.clipping_range = (0.02 if column == 0 else NEAR - ROOM, 20.0)
        plotter.screenshot(str(path))
        plotter.close()
