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
from functools import cached_property
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


class Grader:
    """A garment on its own body, measured once and cut for any other shape of that body.

    Args:
        template: A garment on its own body.
        own: That body, in the shape that the garment was made for.

    Raises:
        ValueError: The garment was made for another body.
    """

    def __init__(self, template: GarmentTemplate, own: Body) -> None:
        if template.body_digest != own.digest:
            raise _another_body(template, own, own)
        self.template, self.own = template, own

    def on(self, other: Body) -> GarmentTemplate:
        """The garment cut for a body, on that body in its bind pose; as ``graded``."""
        template, own = self.template, self.own
        if own.digest != other.digest:
            raise _another_body(template, own, other)
        if np.allclose(own.vertices, other.vertices, rtol=0.0, atol=1e-6):
            return template
        vertices = template.vertices.astype(np.float64) + self.displacement(other)
        # Smoothing takes ease from hollows: what had room keeps at least that of a garment that is built.
        hits = closest_surface(vertices, other.vertices, other.faces)
        wanted = np.minimum(self._gap, 2.0 * CLEARANCE)
        short = hits.distance < wanted
        vertices[short] = hits.point[short] + wanted[short, None] * hits.normal[short]
        vertices = vertices.astype(np.float32)
        check_uncrossed(f"garment '{template.name}', graded to another body", vertices, template.faces)
        return replace(template, vertices=vertices)

    def displacement(self, other: Body) -> np.ndarray:
        """How far each vertex moves as its body turns into another, before anything is lifted [m], shape [V, 3]."""
        template, (corners, barycentric, reach) = self.template, self._under
        moved = np.asarray(other.vertices, np.float64) - np.asarray(self.own.vertices, np.float64)
        raw = np.einsum("vk,vkc->vc", barycentric, moved[corners])
        return smoothed(raw, template.vertices.astype(np.float64), template.faces, reach, template.pinned)

    @cached_property
    def _under(self) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Corners [V, 3] and weights [V, 3] of the body's triangle under each vertex; how far smoothing reaches [V]."""
        marks = find_landmarks(self.own)
        vertices = self.template.vertices.astype(np.float64)
        corners = np.empty((len(vertices), 3), dtype=np.int64)
        barycentric, reach = np.empty((len(vertices), 3)), np.empty(len(vertices))
        for layer, kind in enumerate(self.template.worn_as):
            mine = self.template.layer == layer
            corners[mine], barycentric[mine] = body_under(vertices[mine], marks, WORN_AS[kind].arms)
            reach[mine] = weight_reach(kind, vertices[mine], marks)
        return corners, barycentric, reach

    @cached_property
    def _gap(self) -> np.ndarray:
        """Between the own body and each vertex [m], shape [V]."""
        return closest_surface(self.template.vertices, self.own.vertices, self.own.faces).distance


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
    if template.body_digest != own.digest:
        raise _another_body(template, own, other)
    return Grader(template, own).on(other)


def _another_body(template: GarmentTemplate, own: Body, other: Body) -> ValueError:
    return ValueError(
        f"garment '{template.name}': made for body {template.body_name} ({template.body_digest}), it cannot be "
        f"graded from {own.name} ({own.digest}) to {other.name} ({other.digest}): they must be one body"
    )
