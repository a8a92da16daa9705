"""The body as closed rigid segments, one a joint: obstacles of ARCSim cannot deform.

A segment is the part of the surface that its joint moves noticeably, lidded where it was cut from the rest. Neighbours
overlap at a joint, so that bending opens no gap. Each segment moves with its joint's skinning transform: where skin
blends two joints, the segments stand in for it (:func:`segment_error` measures how well).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from geometry.proximity import closest_surface
from sim.arcsim.surface_pieces import closed, components, own_vertices

if TYPE_CHECKING:
    from body.model import Body

SMALLEST_PIECE = 8  # [triangles] of a segment; smaller islands lie inside the neighbours anyway


@dataclass(frozen=True)
class Segment:
    """A closed piece of the body.

    Attributes:
        joint: SMPL joint that moves it.
        vertices: Bind-pose positions [m], shape [N, 3]; those of the lids come last.
        faces: Outward triangles, shape [G, 3].
        skin: Body vertex of each of the first vertices, shape [<= N].
    """

    joint: int
    vertices: np.ndarray
    faces: np.ndarray
    skin: np.ndarray


def body_segments(body: Body, share: float = 0.4) -> list[Segment]:
    """Cut the body.

    Args:
        body: Closed body in its bind pose.
        share: A triangle belongs to every joint with more than this mean weight over its corners, and to the heaviest.
    """
    weight = np.zeros((len(body.vertices), len(body.joints)))
    np.add.at(weight, (np.arange(len(weight))[:, None], body.skin_index), body.skin_weight)
    of_face = weight[body.faces].mean(axis=1)
    belongs = (of_face > share) | (of_face == of_face.max(axis=1, keepdims=True))
    vertices = body.vertices.astype(np.float64)
    segments = []
    for joint in range(len(body.joints)):
        own = body.faces[belongs[:, joint]]
        if len(own) == 0:
            continue
        pieces = [own[piece] for piece in components(own) if len(piece) >= SMALLEST_PIECE]
        if not pieces:
            continue
        faces, origin = own_vertices(np.concatenate(pieces))
        segments.append(Segment(joint, *closed(vertices[origin], faces), origin))
    return segments


def segment_error(body: Body, segments: list[Segment], pose: np.ndarray, root: np.ndarray) -> dict[str, float]:
    """How far the segments' skin lies from the skinned body [m]: outside it and inside it, 99th percentile and largest.

    Args:
        body: The body that was cut.
        segments: Its segments.
        pose: Axis-angle poses [rad], shape [T, 24, 3].
        root: Root translations [m], shape [T, 3].
    """
    transforms, posed = body.joint_transforms(pose, root), body.posed(pose, root)
    outside, missing = [], []
    for frame in range(len(pose)):
        cloud, faces, count = [], [], 0
        for segment in segments:
            moved = segment.vertices @ transforms[frame, segment.joint, :3, :3].T
            moved += transforms[frame, segment.joint, :3, 3]
            outside.append(closest_surface(moved, posed[frame], body.faces).distance)
            cloud.append(moved)
            faces.append(segment.faces + count)
            count += len(moved)
        union = closest_surface(posed[frame], np.concatenate(cloud), np.concatenate(faces))
        missing.append(np.abs(union.distance))
    beyond, gone = np.maximum(np.concatenate(outside), 0.0), np.concatenate(missing)
    return {
        "beyond_skin_p99_m": float(np.quantile(beyond, 0.99)),
        "beyond_skin_max_m": float(beyond.max()),
        "off_skin_p99_m": float(np.quantile(gone, 0.99)),
        "off_skin_max_m": float(gone.max()),
    }
