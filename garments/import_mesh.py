"""A user's own garment: a mesh file, modelled on the bind-pose body, made into a template.

The file brings the shape alone. Skin weights come from the body underneath, as for the garments that are built here;
what the garment is worn as says whether the arms lend any, whether it hangs around both legs at once, and what of it is
held to the body.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from garments.fit import check_outside, check_size_and_place, check_uncrossed
from garments.landmarks import Landmarks, find_landmarks
from garments.mesh_file import read_mesh
from garments.skinning import garment_weights, weight_reach
from garments.spec import WORN_AS, MeshGarmentSpec
from garments.template import GarmentTemplate
from geometry.mesh_check import check_arrays, check_mesh
from geometry.proximity import closest_surface
from geometry.topology import MeshTopology, vertex_normals

if TYPE_CHECKING:
    from body.model import Body

WAIST_BAND = 0.015
"""Half the height of the band around the natural waist that ``held: waist`` pins [m]."""

WAIST_NEAR = 0.04
"""Farthest from the body that a vertex of that band is held [m]."""


def import_garment(spec: MeshGarmentSpec, body: Body) -> GarmentTemplate:
    """Read a mesh and put it on a body in its bind pose.

    Args:
        spec: The file, its scale and how it is worn.
        body: The body that it was modelled on.

    Returns:
        A template with the vertices and triangles of the file, in its order; turned outwards where the file's
        triangles face the body.

    Raises:
        FileNotFoundError: No such file.
        ValueError: The file cannot be read, or its mesh is no clean sheet of cloth, of another scale than the body,
            beside it, inside it or crossed; one sentence that names the file and the element.
    """
    vertices, faces = read_mesh(spec.file)
    vertices = vertices * spec.scale
    what = str(spec.file)
    check_arrays(what, vertices, faces)
    check_size_and_place(what, vertices, body)
    check_mesh(what, vertices, faces)
    check_uncrossed(what, vertices, faces)
    marks = find_landmarks(body)
    hits = closest_surface(vertices, marks.vertices, marks.faces)
    check_outside(what, hits)
    if (vertex_normals(vertices, faces) * hits.normal).sum() < 0.0:
        faces = faces[:, ::-1]
    held = _held(what, spec.held, vertices, faces, hits.distance, marks)
    reach = weight_reach(spec.worn_as, vertices, marks)
    index, weight = garment_weights(vertices, faces, held, body, marks, reach, WORN_AS[spec.worn_as].arms)
    return GarmentTemplate(
        name=spec.name,
        kind=spec.worn_as,
        vertices=vertices.astype(np.float32),
        faces=faces.astype(np.int32),
        pinned=held,
        skin_index=index,
        skin_weight=weight,
        body_name=body.name,
        body_digest=body.digest,
    )


def _held(
    what: str, held: str, vertices: np.ndarray, faces: np.ndarray, distance: np.ndarray, marks: Landmarks
) -> np.ndarray:
    """Sorted vertices that are pinned, shape [P]."""
    if held == "top":
        loops = MeshTopology.from_faces(faces, len(vertices)).boundary_loops()
        if not loops:
            raise ValueError(f"{what}: the mesh is closed, so it has no topmost opening to hold ('held: top')")
        return np.sort(max(loops, key=lambda loop: vertices[loop, 1].mean())).astype(np.int32)
    if held == "waist":
        band = (np.abs(vertices[:, 1] - marks.waist) < WAIST_BAND) & (distance < WAIST_NEAR)
        if not band.any():
            raise ValueError(
                f"{what}: no vertex is near the waist ('held: waist'), which is at a height of {marks.waist:.2f} m"
            )
        return np.flatnonzero(band).astype(np.int32)
    return np.zeros(0, dtype=np.int32)
