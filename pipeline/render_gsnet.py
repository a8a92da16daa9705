"""Stage ``render_gsnet``: garments that no network was trained on, in pictures.

In: the network in use, the baselines that dress any garment, and the wardrobe. Out: a folder with a sheet and its list
``figures.json``: of each category the first unseen template in one frame of a motion that nobody trained on, as it was
simulated, as GSNet dresses it and as the best of the baselines does, the error of both in colour.
"""

from __future__ import annotations

import json
from collections.abc import Sequence as Many
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch

from body.model import Body
from datasets.atomic import atomic_folder, write_text
from datasets.sequences import Sequence
from models.garment_animator import Animator
from models.garment_graph import GarmentGraph
from models.gsnet_fitting import build_animator, load_animator
from pipeline.gsnet_data import dressed
from pipeline.sequence_data import job_body
from pipeline.stage import Job, run_stage
from pipeline.wardrobe_data import UNSEEN_BOTH, UNSEEN_TEMPLATES, WardrobeGarment, job_wardrobe
from report.camera import Framing, View
from report.render import ERROR_STOPS, GARMENT_COLOURS, SceneRenderer
from report.sheets import contact_sheet, with_legend, write_image

LARGEST = 0.05
"""Error with the darkest colour [m]."""


@dataclass(frozen=True)
class Shown:
    """One frame of an unseen template.

    Attributes:
        garment, sequence, frame: Which one.
        worn: World vertices [m] of the whole sequence by each network, shape [T, N, 3] each.
    """

    garment: WardrobeGarment
    sequence: Sequence
    frame: int
    worn: dict[str, np.ndarray]

    def errors_mm(self, name: str) -> np.ndarray:
        """Of each vertex in the frame, shape [N]."""
        return 1e3 * np.linalg.norm(self.worn[name][self.frame] - self.sequence.vertices[self.frame], axis=1)

    def figures(self, names: Many[str]) -> list[str]:
        """Mean errors, as the caption says them."""
        return [f"{name} {self.errors_mm(name).mean():.1f}" for name in names]


def main(job: Job) -> None:
    """Draw everything into a folder beside the final one, then move it there."""
    torch.set_num_threads(max(1, job.threads))
    with atomic_folder(job.outputs[0]) as folder:
        draw(job, folder)


def draw(job: Job, folder: Path) -> None:
    """The sheet and its list."""
    names, body = job.spec["networks"], job_body(job)
    networks = {name: load_animator(path) for name, path in zip(names, job.inputs, strict=False)}
    garments = [one for one in job_wardrobe(job, (UNSEEN_BOTH, UNSEEN_TEMPLATES)) if one.number == 0]
    shown = [_dressed(one, networks, body) for one in garments]
    ours, *others = names
    mean = {name: np.mean([np.mean(one.errors_mm(name)) for one in shown]) for name in names}
    best = min(others, key=mean.__getitem__, default=None)
    columns = [ours] if best is None else [ours, best]
    size = (round(0.72 * job.spec["report"]["width"]), round(0.72 * job.spec["report"]["height"]))
    rows = [_row(one, columns, body, size, legend=k == 0) for k, one in enumerate(shown)]
    labels = ["simulated"] + [text for name in columns for text in (name, f"error of {name}")]
    write_image(folder / "unseen.webp", sheet := contact_sheet(rows, [s.garment.category for s in shown], labels))
    said = "; ".join(
        f"{s.garment.category} " + ", ".join(f"{name} {s.errors_mm(name).mean():.1f}" for name in columns)
        for s in shown
    )
    entry = {
        "file": "unseen.webp",
        "kind": "gsnet",
        "title": "Templates that no network was trained on",
        "caption": f"A motion that none was trained on either. Mean error of the frame [mm]: {said}.",
        "alt": "Garments of all categories, simulated and as networks dress them",
        "width": int(sheet.shape[1]),
        "height": int(sheet.shape[0]),
        "animated": False,
    }
    write_text(folder / "figures.json", json.dumps({"garment": "wardrobe", "figures": [entry]}, indent=1))


def _dressed(garment: WardrobeGarment, networks: dict[str, Animator], body: Body) -> Shown:
    """The first sequence in the category's own fabric, of a held-out take where there is one."""
    sequences = sorted(garment.sequences, key=lambda s: (s.split != UNSEEN_BOTH, s.phi != 0))
    sequence, graph = sequences[0], GarmentGraph.of(garment.template, body)
    worn = {}
    for name, network in networks.items():
        worn[name] = sequence.in_world(dressed(network, graph, [sequence], body, network.config.materials)[0])
    return Shown(garment, sequence, liveliest(sequence, graph, body), worn)


def liveliest(sequence: Sequence, graph: GarmentGraph, body: Body) -> int:
    """Frame in which the simulated cloth is farthest from being skinned: chosen without a look at any network."""
    skinning = build_animator("skinning", {"materials": (), "body": body.digest})
    skinned = sequence.in_world(dressed(skinning, graph, [sequence], body, ())[0])
    return int(np.linalg.norm(skinned - sequence.vertices, axis=2).mean(axis=1).argmax())


def _row(one: Shown, columns: Many[str], body: Body, size: tuple[int, int], legend: bool) -> list[np.ndarray]:
    """Pictures of a garment, all through one camera."""
    at, sequence = one.frame, one.sequence
    under = body.posed(sequence.pose[at : at + 1], sequence.root[at : at + 1])
    framing = Framing.of(under, View(20.0), size, sequence.vertices[at : at + 1])
    colour, faces = GARMENT_COLOURS.get(one.garment.category, GARMENT_COLOURS["skirt"]), one.garment.template.faces

    def picture(vertices: np.ndarray, error: np.ndarray | None = None) -> np.ndarray:
        with SceneRenderer(faces, body.faces, size, colour) as scene:
            return scene.frame(vertices, under[0], framing, 0, error, LARGEST)

    pictures = [picture(sequence.vertices[at])]
    for name in columns:
        vertices = one.worn[name][at]
        coloured = picture(vertices, one.errors_mm(name) / 1e3)
        pictures += [
            picture(vertices),
            with_legend(coloured, ERROR_STOPS, 1e3 * LARGEST, "mm", "error") if legend else coloured,
        ]
    return pictures


if __name__ == "__main__":
    run_stage(main)
