"""Garments worn over each other, as one garment: a mesh of several pieces with the layer of every vertex.

Each garment is built on the body as if it were alone; then the outer ones are lifted over the inner ones where they
would lie in them, for a simulation can only begin from cloth that is not crossed. What is lifted stays so: as for every
garment, the built shape is the rest shape, and a shirt over trousers is cut a little wider than one without.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from garments.build import build_template
from garments.import_mesh import import_garment
from garments.quality import crossing_triangles
from garments.spec import GarmentSpec, MeshGarmentSpec, OutfitSpec
from garments.template import GarmentTemplate
from geometry.proximity import SurfaceHits, closest_surface
from geometry.topology import MeshTopology, edge_lengths, vertex_normals

if TYPE_CHECKING:
    from body.model import Body

LAYER_GAP = 0.004
"""Distance of an outer garment to the one under it where they start [m]: about the thickness of the contact."""

DEEPEST = 0.08
"""Farthest that an outer vertex may lie under the inner garment, or be lifted over it [m]."""

SLOPE = 0.3
"""Steepest that the lift changes along the cloth [m/m], so that its triangles keep their shape."""

_ROUNDS = 30
_STRAIGHTEST = 0.5  # least cosine between the lift and the normal of the garment underneath that is counted on


def garment_spec(name: str, geometry: Mapping[str, Any]) -> GarmentSpec | MeshGarmentSpec | OutfitSpec:
    """What a configuration asks for.

    Args:
        name: Name of the garment.
        geometry: ``kind`` with the measures of that kind; for the kind ``mesh`` the fields of ``MeshGarmentSpec``; for
            the kind ``outfit`` the list ``worn`` of such mappings, innermost first, each with its ``name``.

    Raises:
        ValueError: in one sentence, if anything is not allowed.
    """
    if geometry["kind"] == "outfit":
        worn = [garment_spec(one["name"], {k: v for k, v in one.items() if k != "name"}) for one in geometry["worn"]]
        return OutfitSpec(name, tuple(worn))
    if geometry["kind"] == "mesh":
        return MeshGarmentSpec(name, **{key: value for key, value in geometry.items() if key != "kind"})
    return GarmentSpec(name, **geometry)


def make_template(spec: GarmentSpec | MeshGarmentSpec | OutfitSpec, body: Body) -> GarmentTemplate:
    """The template of any garment, on a body in its bind pose.

    Raises:
        FileNotFoundError: The file of a user's own mesh does not exist.
        ValueError: in one sentence, if the garment cannot be built on this body.
    """
    if isinstance(spec, OutfitSpec):
        return worn_together(spec.name, [make_template(one, body) for one in spec.worn])
    return (import_garment if isinstance(spec, MeshGarmentSpec) else build_template)(spec, body)


def worn_together(name: str, worn: list[GarmentTemplate]) -> GarmentTemplate:
    """Put garments that were built on the same body over each other.

    Args:
        name: Name of the outfit.
        worn: Its garments, innermost first.

    Returns:
        One template: vertices, triangles and pins of the garments, one after the other; ``layer`` tells them apart.

    Raises:
        ValueError: The garments were made for different bodies, or one cannot be laid over those under it without
            passing through them or itself.
    """
    stranger = next((one for one in worn if one.body_digest != worn[0].body_digest), None)
    if stranger is not None:
        raise ValueError(f"outfit '{name}': '{stranger.name}' was made for another body than '{worn[0].name}'")
    vertices, faces = worn[0].vertices.astype(np.float64), worn[0].faces
    pinned, counts = [worn[0].pinned], [len(vertices)]
    for one in worn[1:]:
        under = " and ".join(f"'{other.name}'" for other in worn[: len(counts)])
        try:
            outer = laid_over(one.vertices.astype(np.float64), one.faces, vertices, faces)
        except ValueError as error:
            raise ValueError(f"outfit '{name}': '{one.name}' cannot be laid over {under}: {error}") from None
        faces = np.concatenate([faces, one.faces + len(vertices)])
        pinned.append(one.pinned + len(vertices))
        vertices = np.concatenate([vertices, outer])
        counts.append(len(outer))
    return GarmentTemplate(
        name=name,
        kind="outfit",
        vertices=vertices.astype(np.float32),
        faces=faces,
        pinned=np.concatenate(pinned),
        skin_index=np.concatenate([one.skin_index for one in worn]),
        skin_weight=np.concatenate([one.skin_weight for one in worn]),
        body_name=worn[0].body_name,
        body_digest=worn[0].body_digest,
        pieces=sum(one.pieces for one in worn),
        layer=np.repeat(np.arange(len(worn)), counts),
        worn=tuple(one.name for one in worn),
        worn_as=tuple(one.kind for one in worn),
    )


def laid_over(
    vertices: np.ndarray, faces: np.ndarray, inner_vertices: np.ndarray, inner_faces: np.ndarray
) -> np.ndarray:
    """An outer garment lifted over an inner one where it lies in it or too near to it.

    Each vertex is moved along the garment's own normal, until both surfaces keep ``LAYER_GAP`` from each other's
    vertices and no triangles cross; around what has to move the lift fades out with ``SLOPE``.

    Args:
        vertices: The outer garment [m], shape [V, 3].
        faces: Its outward triangles, shape [F, 3].
        inner_vertices: The garments under it [m], shape [Vi, 3].
        inner_faces: Their outward triangles, shape [Fi, 3].

    Returns:
        Vertices of the outer garment [m], shape [V, 3]; exactly the given ones where nothing is to do.

    Raises:
        ValueError: It would have to be lifted too far, or triangles still cross after the last round.
    """
    topology = MeshTopology.from_faces(faces, len(vertices))
    inner_rim = _rim(MeshTopology.from_faces(inner_faces, len(inner_vertices)))
    outer_rim = _rim(topology)
    normals = vertex_normals(vertices, faces)
    length = edge_lengths(vertices, topology.edges)
    both = np.concatenate([inner_faces, faces + len(inner_vertices)])
    lift, lifted = np.zeros(len(vertices)), vertices
    crossed = np.zeros((0, 2), dtype=int)
    for _ in range(_ROUNDS):
        missing = np.maximum(
            _missing_above(lifted, normals, inner_vertices, inner_faces, inner_rim),
            _missing_below(lifted, faces, normals, inner_vertices, outer_rim),
        )
        # A hair's breadth more at each round, or rounding would keep the last one from being the last.
        missing[missing > 0.0] += 1.0e-5
        crossed = crossing_triangles(np.concatenate([inner_vertices, lifted]), both)
        crossed = crossed[(crossed >= len(inner_faces)).any(axis=1)] - len(inner_faces)
        between = crossed[crossed.min(axis=1) < 0].max(axis=1)
        missing[faces[between]] = np.maximum(missing[faces[between]], 0.5 * LAYER_GAP)
        if not missing.any():
            break
        lift = _faded(lift + missing, topology.edges, length)
        if lift.max() > DEEPEST:
            raise ValueError(f"it would have to be lifted by more than {1e3 * DEEPEST:g} mm; change its ease or length")
        lifted = vertices + lift[:, None] * normals
    if len(crossed):
        alone = int((crossed.min(axis=1) >= 0).sum())
        what = "of its own triangles" if alone == len(crossed) else "of triangles"
        raise ValueError(f"{len(crossed)} pairs {what} cross; change its ease or length")
    return lifted


def _missing_above(
    vertices: np.ndarray, normals: np.ndarray, inner_vertices: np.ndarray, inner_faces: np.ndarray, rim: np.ndarray
) -> np.ndarray:
    """How far each outer vertex has to go until it is outside the inner garment by the gap [m], shape [V]."""
    hits = closest_surface(vertices, inner_vertices, inner_faces)
    over = _over(hits, inner_faces, rim)
    missing = np.where(over & (hits.distance > -DEEPEST), np.maximum(LAYER_GAP - hits.distance, 0.0), 0.0)
    return missing / np.maximum((normals * hits.normal).sum(axis=1), _STRAIGHTEST)


def _missing_below(
    vertices: np.ndarray, faces: np.ndarray, normals: np.ndarray, inner_vertices: np.ndarray, rim: np.ndarray
) -> np.ndarray:
    """How far each outer vertex has to go until its triangles clear the inner garment's vertices [m], shape [V]."""
    hits = closest_surface(inner_vertices, vertices, faces)
    over = _over(hits, faces, rim)
    short = np.where(over & (hits.distance < DEEPEST), np.maximum(LAYER_GAP + hits.distance, 0.0), 0.0)
    missing = np.zeros(len(vertices))
    corners = faces[hits.face]
    np.maximum.at(missing, corners, np.broadcast_to(short[:, None], corners.shape))
    return missing


def _rim(topology: MeshTopology) -> np.ndarray:
    """Vertices on an opening, shape [V]."""
    rim = np.zeros(topology.vertex_count, dtype=bool)
    rim[topology.edges[topology.boundary]] = True
    return rim


def _over(hits: SurfaceHits, faces: np.ndarray, rim: np.ndarray) -> np.ndarray:
    """Whether closest points lie on the cloth itself, or at its opening: beyond that, a surface has no inside."""
    inner = np.where(rim[faces[hits.face]], 0.0, hits.barycentric).sum(axis=1) > 1e-9
    return inner | (np.abs(hits.distance) < LAYER_GAP)


def _faded(lift: np.ndarray, edges: np.ndarray, length: np.ndarray) -> np.ndarray:
    """The least field above ``lift`` [m], shape [V], that falls by no more than ``SLOPE`` along an edge."""
    i, j = edges.T
    while True:
        before = lift
        lift = before.copy()
        np.maximum.at(lift, i, before[j] - SLOPE * length)
        np.maximum.at(lift, j, before[i] - SLOPE * length)
        if np.array_equal(lift, before):
            return lift
