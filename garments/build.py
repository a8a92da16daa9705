"""Building a garment: dense surface of its kind -> exactly N vertices -> pins and skin weights -> quality check."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from garments.dress import dress_surface
from garments.jumpsuit import jumpsuit_surface
from garments.landmarks import Landmarks, find_landmarks
from garments.pants import pants_surface
from garments.quality import CLEARANCE, MeshQuality, assert_quality, measure_quality
from garments.remesh import remesh
from garments.shirt import shirt_surface
from garments.skinning import garment_weights, weight_reach
from garments.skirt import skirt_surface
from garments.spec import GarmentSpec
from garments.surface import DenseSurface
from garments.template import GarmentTemplate
from geometry.proximity import closest_surface
from geometry.topology import MeshTopology

if TYPE_CHECKING:
    from body.model import Body


@dataclass(frozen=True)
class GarmentKind:
    """One kind of garment.

    Attributes:
        surface: Makes the dense surface from (spec, landmarks, edge length of the mesh to come [m]).
        loops: Openings: boundary loops of the mesh.
        typical_area: Area on an adult body [m^2], from which the edge length is foreseen.
        held_waist: Whether the topmost opening is pinned to the body.
        arms: Whether it is worn on the arms.
    """

    surface: Callable[[GarmentSpec, Landmarks, float], DenseSurface]
    loops: int
    typical_area: float
    held_waist: bool
    arms: bool


GARMENT_KINDS: dict[str, GarmentKind] = {
    "skirt": GarmentKind(lambda spec, marks, _: skirt_surface(spec, marks), 2, 0.8, held_waist=True, arms=False),
    "tshirt": GarmentKind(shirt_surface, 4, 0.9, held_waist=False, arms=True),
    "top": GarmentKind(shirt_surface, 4, 0.6, held_waist=False, arms=True),
    "pants": GarmentKind(pants_surface, 3, 1.1, held_waist=True, arms=False),
    "jumpsuit": GarmentKind(jumpsuit_surface, 5, 1.6, held_waist=False, arms=True),
    "dress": GarmentKind(dress_surface, 4, 1.4, held_waist=False, arms=True),
}
"""Every kind that can be built, by the name used in ``GarmentSpec.kind``."""


def build_template(spec: GarmentSpec, body: Body) -> GarmentTemplate:
    """Build a garment on a body in its bind pose.

    Args:
        spec: What to build.
        body: The body to build it on.

    Returns:
        A template of exactly ``spec.vertices`` vertices. The same spec and body give the same arrays.

    Raises:
        ValueError: in one sentence, if the measures do not fit this body or the mesh misses a bound of ``quality``.
    """
    kind = GARMENT_KINDS[spec.kind]
    marks = find_landmarks(body)
    edge = float(
        np.sqrt(kind.typical_area / (0.866 * spec.vertices))
    )  # N equilateral triangles have area N 0.866 edge^2
    try:
        vertices, faces = remesh(kind.surface(spec, marks, edge), spec.vertices, kind.loops)
    except ValueError as error:
        text = str(error)
        raise ValueError(text if spec.name in text else f"garment '{spec.name}': {text}") from None
    vertices = _lifted(vertices, marks)
    held = _topmost_loop(vertices, faces) if kind.held_waist else np.zeros(0, dtype=np.int32)
    reach = weight_reach(spec.kind, vertices, marks)
    index, weight = garment_weights(vertices, faces, held, body, marks, reach, kind.arms)
    vertices = vertices.astype(np.float32)
    assert_quality(spec.name, measure_quality(vertices, faces, marks.vertices, marks.faces), spec.vertices, kind.loops)
    return GarmentTemplate(
        name=spec.name,
        kind=spec.kind,
        vertices=vertices,
        faces=faces,
        pinned=held,
        skin_index=index,
        skin_weight=weight,
        body_name=body.name,
        body_digest=body.digest,
    )


def template_quality(template: GarmentTemplate, body: Body) -> MeshQuality:
    """Figures of a template on the body it was built on."""
    return measure_quality(template.vertices, template.faces, np.asarray(body.vertices, np.float64), body.faces)


def _lifted(vertices: np.ndarray, marks: Landmarks) -> np.ndarray:
    """Vertices that rounding left too near the body moved out to twice the smallest clearance."""
    hits = closest_surface(vertices, marks.vertices, marks.faces)
    short = hits.distance < 2.0 * CLEARANCE
    lifted = vertices.copy()
    lifted[short] = hits.point[short] + 2.0 * CLEARANCE * hits.normal[short]
    return lifted


def _topmost_loop(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """Sorted vertices of the highest boundary loop, shape [P]."""
    loops = MeshTopology.from_faces(faces, len(vertices)).boundary_loops()
    return np.sort(max(loops, key=lambda loop: vertices[loop, 1].mean())).astype(np.int32)
