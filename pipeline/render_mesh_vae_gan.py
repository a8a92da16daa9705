"""Stage ``render_mesh_vae_gan``: generated clothing in pictures (Ma 2019, Fig. 4 to 6).

In: the network in use, the templates and the layer files of all types. Out: a folder of pictures with their list
``figures.json``: every type with several z on a body that was not trained on, several poses of unseen clips with
several z, and the way from one type to another.
"""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import torch

from body.model import Body
from datasets.atomic import atomic_folder, write_text
from datasets.layers import LayerExamples
from datasets.splits import UNSEEN_BODIES_AND_MOTIONS
from garments.body_layer import cast_layer, dressed_body
from garments.template import GarmentTemplate
from models.mesh_vae_gan import MeshVaeGan
from models.mesh_vae_gan_fitting import load_mesh_vae_gan
from pipeline.layer_data import job_layers
from pipeline.sequence_data import job_body
from pipeline.stage import Job, run_stage
from report.camera import View
from report.render import GARMENT_COLOURS, render_frame
from report.sheets import contact_sheet, write_image

CODES = 4
"""Random z of a picture, side by side."""
POSES = 3
"""Each of a label of its own."""
STEPS = 5
"""Between two types, both ends among them."""
COLOURS = np.array([GARMENT_COLOURS["pants"], GARMENT_COLOURS["tshirt"]])
"""Of the garments, from the body outwards."""


class LayerPainter:
    """Draws dressed bodies: the faces of the body mesh that a type covers in the garments' colours, the rest as skin.

    Args:
        body: The run's own body, whose mesh it is.
        worn: Garment over each body vertex for each type, -1 where there is none, shape [B] by name of the type.
        size: Width and height [px].
    """

    def __init__(self, body: Body, worn: dict[str, np.ndarray], size: tuple[int, int]) -> None:
        self.body, self.worn, self.size = body, worn, size

    def draw(self, vertices: np.ndarray, worn: np.ndarray) -> np.ndarray:
        """One picture, uint8 [H, W, 3], of a dressed body [B, 3] [m]."""
        faces = self.body.faces
        outermost = worn[faces].max(axis=1)
        cloth = outermost >= 0  # the faces between cloth and bare skin are the garment's edge
        own_worn = worn.copy()
        np.maximum.at(own_worn, faces[cloth], outermost[cloth, None])
        colours = COLOURS[np.where(worn >= 0, worn, np.maximum(own_worn, 0))]
        garment, own = _compact(faces[cloth])
        skin, bare = _compact(faces[~cloth])
        return render_frame(vertices[own], garment, vertices[bare], skin, self.size, colours[own], View(20.0))


def main(job: Job) -> None:
    """Draw everything into a folder beside the final one, then move it there."""
    torch.set_num_threads(max(1, job.threads))
    with atomic_folder(job.outputs[0]) as folder:
        draw(job, folder)


def draw(job: Job, folder: Path) -> None:
    """All pictures, in the order of the paper."""
    spec, body = job.spec, job_body(job)
    types = spec["types"]
    network = load_mesh_vae_gan(job.inputs[0], body)
    templates = [GarmentTemplate.load(path) for path in job.inputs[1 : 1 + len(types)]]
    examples = job_layers(job, job.inputs[1 + len(types) :])
    worn = {kind: _worn_over(cast_layer(one, body), body) for kind, one in zip(types, templates, strict=True)}
    size = (spec["report"]["width"] // 2, spec["report"]["height"] // 2)
    painter = LayerPainter(body, worn, size)
    frames = examples.chosen(examples.split == UNSEEN_BODIES_AND_MOTIONS)
    frames = frames if len(frames) else examples
    other = Body.load(body.name).shaped(frames.shape[0])
    z = np.random.default_rng(spec["seed"]).standard_normal((CODES, network.config.latent))
    entries = [
        _types_by_codes(painter, network, other, types, z, folder),
        _poses_by_codes(painter, network, other, frames, z, folder),
    ]
    if len(types) > 1:
        entries.append(_between_types(painter, network, other, types, z[0], folder))
    write_text(folder / "figures.json", json.dumps({"garment": "layer", "figures": entries}, indent=1))


def _types_by_codes(painter, network: MeshVaeGan, body: Body, types: list[str], z: np.ndarray, folder: Path) -> dict:
    """Fig. 4: a type a row, a z a column, in the bind pose."""
    pose = np.repeat(body.bind_pose()[None], len(z), axis=0)
    rows = []
    for kind in types:
        dressed = dressed_body(body, network.generate(z, pose, [kind] * len(z)), pose, np.zeros((len(z), 3)))
        rows.append([painter.draw(one, painter.worn[kind]) for one in dressed])
    return _written(folder, "types", "Types and z", rows, types, z, "A type of clothing a row, the same random z in a "
                    "column, on a body that was not trained on.")  # fmt: skip


def _poses_by_codes(
    painter, network: MeshVaeGan, body: Body, frames: LayerExamples, z: np.ndarray, folder: Path
) -> dict:
    """Fig. 5: a pose of an unseen clip a row, a z a column, all of one type."""
    kind = "shortlong" if "shortlong" in frames.types else frames.types[-1]
    rows, labels = [], []
    of_label = {clip.rsplit("_", 1)[0]: clip for clip in sorted(set(frames.clip.tolist()))}
    for label, clip in list(of_label.items())[:POSES]:
        own = np.flatnonzero(frames.clip == clip)
        # The frame whose joints are turned farthest: most clips begin and end upright.
        number = int(own[np.abs(frames.pose[own, 1:]).sum(axis=(1, 2)).argmax()])
        pose, root = (np.repeat(getattr(frames, name)[number][None], len(z), axis=0) for name in ("pose", "root"))
        dressed = dressed_body(body, network.generate(z, pose, [kind] * len(z)), pose, root)
        rows.append([painter.draw(one, painter.worn[kind]) for one in dressed])
        labels.append(label)
    return _written(folder, "poses", "Poses and z", rows, labels, z, "A pose of a clip that was not trained on a row, "
                    f"the same random z in a column; {kind}.")  # fmt: skip


def _between_types(painter, network: MeshVaeGan, body: Body, types: list[str], z: np.ndarray, folder: Path) -> dict:
    """Fig. 6: from one type to another at one z."""
    first, last = ("longshort", "shortlong") if {"longshort", "shortlong"} <= set(types) else (types[0], types[-1])
    shares = np.linspace(0.0, 1.0, STEPS)
    weights = np.zeros((STEPS, len(types)))
    weights[:, types.index(first)], weights[:, types.index(last)] = 1.0 - shares, shares
    pose = np.repeat(body.bind_pose()[None], STEPS, axis=0)
    layers = network.generate(np.repeat(z[None], STEPS, axis=0), pose, weights)
    dressed = dressed_body(body, layers, pose, np.zeros((STEPS, 3)))
    row = []
    for share, one in zip(shares, dressed, strict=True):
        # Which vertices are cloth is no number: the nearer type says.
        row.append(painter.draw(one, painter.worn[first if share < 0.5 else last]))
    image = contact_sheet([row], [f"{first} to {last}"], [f"{100 * share:.0f}%" for share in shares])
    write_image(folder / "between.webp", image)
    return _entry("between", "Between two types", image, f"From {first} to {last} at one z and one pose.")


def _written(folder: Path, name: str, title: str, rows: list, labels: list[str], z: np.ndarray, caption: str) -> dict:
    image = contact_sheet(rows, labels, [f"z {k + 1}" for k in range(len(z))])
    write_image(folder / f"{name}.webp", image)
    return _entry(name, title, image, caption)


def _entry(name: str, title: str, image: np.ndarray, caption: str) -> dict:
    return {
        "file": f"{name}.webp",
        "kind": f"layer_{name}",
        "title": title,
        "caption": caption,
        "alt": f"Bodies in generated clothing. {caption}",
        "width": int(image.shape[1]),
        "height": int(image.shape[0]),
        "animated": False,
    }


def _worn_over(layer, body: Body) -> np.ndarray:
    worn = np.full(len(body.vertices), -1)
    worn[layer.covered] = layer.worn
    return worn


def _compact(faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Faces renumbered over the vertices that they use, and those vertices."""
    used, numbered = np.unique(faces, return_inverse=True)
    return numbered.reshape(faces.shape), used


if __name__ == "__main__":
    run_stage(main)
