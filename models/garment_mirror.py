"""Examples of a garment seen in the mirror: twice the motions without a simulation.

In: a motion with its simulated garment, and the template. Out: the same with left and right exchanged, at the plane
x = 0 of the bind pose. The body is its own mirror image; a garment's mesh is not, for its vertices lie where the mesher
put them. So the mirrored garment is read off at the places of the template's vertices: each lies, mirrored, on a
triangle of the template, and takes that triangle's corners with the same weights. What that rounds off, folds narrower
than a triangle, is small beside what twice the motions teach.
"""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp

from body.skeleton import mirrored_joint_order
from geometry.proximity import SurfaceQuery
from models.garment_fitting import GarmentExample
from models.motion_features import MotionTrack
from motions.mirror import mirror_motion

REFLECTION = np.float32([-1.0, 1.0, 1.0])

MOST_ASIDE = 0.02
"""Farthest that a mirrored vertex may lie off the template [m]: beyond, the garment itself has a left and a right."""


def mirror_map(vertices: np.ndarray, faces: np.ndarray) -> sp.csr_matrix:
    """Weights [V, V] that give each vertex of the mirrored garment from the vertices of the garment, rows of sum 1.

    Args:
        vertices, faces: Of the template on the bind-pose body, [V, 3] [m] and [F, 3].

    Raises:
        ValueError: The garment is not its own mirror image.
    """
    hits = SurfaceQuery(faces, len(vertices)).query(np.asarray(vertices, dtype=np.float64) * REFLECTION, vertices)
    aside = float(np.abs(hits.distance).max())
    if aside > MOST_ASIDE:
        raise ValueError(f"mirroring: the garment's left and right differ by {aside:.3f} m, allowed is {MOST_ASIDE} m")
    rows = np.repeat(np.arange(len(vertices)), 3)
    columns = np.asarray(faces)[hits.face].ravel()
    return sp.csr_matrix((hits.barycentric.ravel(), (rows, columns)), shape=(len(vertices), len(vertices)))


def mirrored_example(example: GarmentExample, weights: sp.csr_matrix) -> GarmentExample:
    """The example with left and right exchanged; ``weights`` as of ``mirror_map``."""
    track, frames = example.track, len(example.vertices)
    pose, _ = mirror_motion(track.pose, np.zeros((len(track.pose), 3)))
    joints = track.joints[:, mirrored_joint_order()] * REFLECTION
    flat = example.vertices.transpose(1, 0, 2).reshape(example.vertices.shape[1], -1)
    taken = (weights @ flat).reshape(-1, frames, 3).transpose(1, 0, 2)
    mirrored = MotionTrack(pose.astype(track.pose.dtype), joints.astype(track.joints.dtype), track.lead, track.fps)
    return GarmentExample(mirrored, (taken * REFLECTION).astype(np.float32), mirrored=True)
