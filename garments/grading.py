"""Grading: a garment made for one body, cut for another.

A tailor grades a pattern: no new design, but every piece let out or taken in where the other body is wider, narrower,
longer or shorter. Here the template's vertices move as the body surface under them moves from the one shape to the
other, while it stands in its bind pose. What grading keeps: triangles, order of the vertices, pins, skin weights,
layers, and the ease, the gap between garment and body. What it changes: positions, and with them all rest lengths, for
the built shape is the rest shape. A skirt's waistband is as long as the waist it sits on, its hem as far down the leg.

The nearest body point jumps from one leg to the other under a skirt and from arm to trunk in the armpit, so the field
of displacements is smoothed over the cloth like the skin weights (``garments.skinning``); pins follow the skin under
them.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from garments.fit import check_uncrossed
from garments.landmarks import find_landmarks
from garments.quality import CLEARANCE
from garments.skinning import body_under, smoothed, weight_reach
from garments.spec import WORN_AS
from garments.template import GarmentTemplate
from geometry.proximity import closest_surface

if TYPE_CHECKING:
    from body.model import Body


def displacement(template: GarmentTemplate, own: Body, other: Body) -> np.ndarray:
    """How far each vertex of a garment moves as its body turns into another, before anything is lifted [m], [V, 3]."""
    marks = find_landmarks(own)
    moved = np.asarray(other.vertices, np.float64) - marks.vertices
    vertices = template.vertices.astype(np.float64)
    raw, reach = np.empty_like(vertices), np.empty(len(vertices))
    for layer, kind in enumerate(template.worn_as):
        mine = template.layer == layer
        corners, barycentric = body_under(vertices[mine], marks, WORN_AS[kind].arms)
        raw[mine] = np.einsum("vk,vkc->vc", barycentric, moved[corners])
        reach[mine] = weight_reach(kind, vertices[mine], marks)
    return smoothed(raw, vertices, template.faces, reach, template.pinned)


def graded(template: GarmentTemplate, own: Body, other: Body) -> GarmentTemplate:
    """The garment cut for another body, on that body in its bind pose.

    Args:
        template: A garment on its own body.
        own: That body, in the shape that the garment was made for.
        other: The same body in another shape.

    Returns:
        The template with other vertices; everything else is the same. Of its own body: the template itself.

    Raises:
        ValueError: The bodies are not one body in two shapes, or the garment would pass through itself.
    """
    if not template.body_digest == own.digest == other.digest:
        raise ValueError(
            f"garment '{template.name}': made for body {template.body_name} ({template.body_digest}), it cannot be "
            f"graded from {own.name} ({own.digest}) to {other.name} ({other.digest}): they must be one body"
        )
    if np.allclose(own.vertices, other.vertices, rtol=0.0, atol=1e-6):
        return template
    gap = closest_surface(template.vertices, own.vertices, own.faces).distance
    vertices = template.vertices.astype(np.float64) + displacement(template, own, other)
    # Smoothing takes ease from hollows: what had room keeps at least that of a garment that is built.
    hits = closest_surface(vertices, other.vertices, other.faces)
    short = hits.distance < np.minimum(gap, 2.0 * CLEARANCE)
    wanted = np.minimum(gap, 2.0 * CLEARANCE)[short, None]
    vertices[short] = hits.point[short] + wanted * hits.normal[short]
    vertices = vertices.astype(np.float32)
    check_uncrossed(f"garment '{template.name}', graded to another body", vertices, template.faces)
    return replace(template, vertices=vertices)
