"""One scene that every solver of the benchmark is given: garment, moving body, pins and material.

A scene is plain arrays, so that a peer in another Python environment can read it with NumPy alone. Positions are in
metres, y is up. Recorded are the frames after the lead-in; before the first frame every solver may let the garment
settle on the body of frame 0, which is the bind pose that the garment was made on.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

if TYPE_CHECKING:
    from body.model import Body
    from motions.clip import Clip

FPS = 30.0
LEAD_IN = 24
"""Frames from the bind pose into the clip, as in the default run."""

SETTLE_SECONDS = 1.0
"""Time that a peer is given on the standing body before the lead-in [s]."""

MATERIALS: dict[str, dict[str, float]] = {
    "skirt": {"density": 0.20, "stretch": 1000.0, "shear": 300.0, "bend": 8.0e-5, "air_drag": 0.8},
    "tshirt": {"density": 0.15, "stretch": 800.0, "shear": 250.0, "bend": 5.0e-5, "air_drag": 0.6, "friction": 0.3},
    "pants": {"density": 0.20, "stretch": 1000.0, "shear": 300.0, "bend": 8.0e-5, "air_drag": 0.8},
}
"""Material of each kind of garment, a middling weave: fixed here, so that times stay comparable over the years."""

BODY = "full"
SEED = 20191


@dataclass(frozen=True)
class Scene:
    """A garment on a moving body.

    Attributes:
        garment: Name of the garment in the table.
        vertices: Rest shape and start [m], shape [V, 3].
        faces: Its triangles, shape [F, 3].
        pinned: Vertices that are held to the body, shape [P].
        pins: Where they are at the end of each frame [m], shape [L + T, P, 3].
        body: Body at the end of each frame [m], shape [L + T, B, 3].
        body_faces: Its outward triangles, shape [G, 3].
        lead_in: Number L of frames that are not recorded.
        fps: Frames a second [Hz].
        parameters: Every intrinsic parameter by name.
        template: File of the garment's template, for solvers of this project.
        self_contact: Whether the cloth shall collide with itself.
    """

    garment: str
    vertices: np.ndarray
    faces: np.ndarray
    pinned: np.ndarray
    pins: np.ndarray
    body: np.ndarray
    body_faces: np.ndarray
    lead_in: int
    fps: float
    parameters: dict[str, float]
    template: str = ""
    self_contact: bool = False

    @property
    def frames(self) -> int:
        """Number T of recorded frames."""
        return len(self.body) - self.lead_in

    @property
    def edges(self) -> np.ndarray:
        """Every edge of the garment once, shape [E, 2]."""
        sides = np.concatenate([self.faces[:, [0, 1]], self.faces[:, [1, 2]], self.faces[:, [2, 0]]])
        return np.unique(np.sort(sides, axis=1), axis=0)

    @property
    def edge_length(self) -> np.ndarray:
        """Rest length of each edge [m], shape [E]."""
        i, j = self.edges.T
        return np.linalg.norm(self.vertices[i] - self.vertices[j], axis=1)

    @property
    def vertex_area(self) -> np.ndarray:
        """A third of the areas around each vertex [m^2], shape [V]."""
        a, b, c = (self.vertices[self.faces[:, k]] for k in range(3))
        area = 0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1)
        return np.bincount(self.faces.ravel(), np.repeat(area / 3.0, 3), minlength=len(self.vertices))

    def save(self, path: str | Path) -> None:
        """Write the scene as one NumPy archive."""
        facts = {name: getattr(self, name) for name in _FACTS}
        arrays = {name: getattr(self, name) for name in _ARRAYS}
        np.savez(path, facts=np.frombuffer(json.dumps(facts).encode(), dtype=np.uint8), **arrays)

    @classmethod
    def load(cls, path: str | Path) -> Scene:
        """Read a scene that ``save`` wrote."""
        with np.load(path) as archive:
            facts = json.loads(archive["facts"].tobytes())
            return cls(**facts, **{name: archive[name] for name in _ARRAYS})


_FACTS = ("garment", "lead_in", "fps", "parameters", "template", "self_contact")
_ARRAYS = ("vertices", "faces", "pinned", "pins", "body", "body_faces")


def hinge_stiffness(bend: float) -> float:
    """Stiffness of one hinge against its dihedral angle [N m] that bends like a sheet of stiffness ``bend`` [N m].

    The isometric energy ``bend/2 e^2 theta^2 / (A0 + A1)`` (Bergou et al. 2006) with ``A0 + A1 = sqrt(3)/2 e^2`` of two
    equilateral triangles.
    """
    return 2.0 / np.sqrt(3.0) * bend


def spring_stiffness(stretch: float) -> float:
    """Stiffness of the edges [N/m] of an equilateral lattice whose sheet has the stiffness ``stretch`` [N/m]."""
    return np.sqrt(3.0) / 2.0 * stretch


def walking_clip(body: Body, frames: int) -> Clip:
    """The clip of the benchmark, the same for every garment."""
    from motions.procedural import generate_clip

    return generate_clip("walk", 0, frames, FPS, SEED, body)


def motion(body: Body, frames: int) -> tuple[np.ndarray, np.ndarray]:
    """Poses [rad], shape [L + T, 24, 3], and roots [m], shape [L + T, 3], lead-in first."""
    from motions.lead_in import lead_in

    clip = walking_clip(body, frames)
    pose, root = lead_in(clip, body, LEAD_IN)
    return np.concatenate([pose, clip.pose]), np.concatenate([root, clip.root])


def make_scene(template_path: str | Path, frames: int, substeps: int, self_contact: bool = False) -> Scene:
    """The scene of a garment: the walking clip and the garment's own material.

    Args:
        template_path: File of a template made for the benchmark's body.
        frames: Number T of recorded frames.
        substeps: The parameter of that name.
        self_contact: Whether the cloth shall collide with itself.
    """
    from body.model import Body, skin
    from garments.template import GarmentTemplate
    from sim.parameters import base_parameters

    template, body = GarmentTemplate.load(template_path), Body.load(BODY)
    pose, root = motion(body, frames)
    transforms = body.joint_transforms(pose, root)
    held = template.pinned
    pins = skin(template.vertices[held], template.skin_index[held], template.skin_weight[held], transforms)
    return Scene(
        garment=template.kind,
        vertices=template.vertices.astype(np.float64),
        faces=template.faces,
        pinned=held,
        pins=pins.astype(np.float32),
        body=body.posed(pose, root).astype(np.float32),
        body_faces=body.faces,
        lead_in=LEAD_IN,
        fps=FPS,
        parameters=base_parameters(MATERIALS[template.kind] | {"substeps": substeps}),
        template=str(template_path),
        self_contact=self_contact,
    )
