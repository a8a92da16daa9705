"""Counts the garment triangles inside the body while they are simulated: exact, for whole ensembles at once.

Contact knows vertices and the edges between them; the body can still poke through the middle of a triangle. The count
takes a quarter of the time of a simulated frame, so it is made every few frames. Unlike ``sim.crossings`` it takes the
body as contact does, without hands, and does not tell pinched cloth apart.
"""

from __future__ import annotations

import numpy as np
import warp as wp

from sim.body_contact import BodyContact
from sim.kernels.body_crossings import count_inside
from sim.kernels.crossings import BodyTree


class BodyCrossings:
    """Triangles of W garments against the bodies that they are in contact with."""

    def __init__(self, faces: np.ndarray, contact: BodyContact):
        """Take the triangles of the garment, shape [F, 3], and the moving body."""
        self.device, self.contact = contact.device, contact
        self.faces = wp.array(np.ascontiguousarray(faces, dtype=np.int32), dtype=wp.vec3i, device=self.device)
        self.width = len(contact.skeleton.lane_motion)
        self.total = wp.zeros(self.width, dtype=int, device=self.device)
        self.tree = BodyTree()
        self.tree.points = wp.zeros(contact.skin.count, dtype=wp.vec3, device=self.device)
        corners = contact.faces.numpy().reshape(-1, 4)[:, :3]
        self.tree.indices = wp.array(np.ascontiguousarray(corners).ravel(), dtype=int, device=self.device)
        self.mesh: wp.Mesh | None = None

    def count(self, x: wp.array) -> np.ndarray:
        """Triangles that cross the surface of the body or lie below it at the last query, shape [W].

        Args:
            x: Positions in lanes [m], shape [V], relative to the same origins as the bodies.
        """
        skin, width = self.contact.skin, self.width
        motions = skin.motions
        lanes = width if motions == 1 else 1
        positions, distance = _flat(x, 3 * width), _flat(self.contact.distance, width)
        self.total.zero_()
        for motion in range(motions):
            wp.copy(self.tree.points, skin.end, src_offset=motion * skin.count, count=skin.count)
            if self.mesh is None:
                self.mesh = wp.Mesh(self.tree.points, self.tree.indices)
                self.tree.mesh = self.mesh.id
            else:
                self.mesh.refit()
            inputs = [motion, width, self.faces, positions, distance, self.tree]
            wp.launch(count_inside, (len(self.faces), lanes), inputs, [self.total], device=self.device)
        return self.total.numpy().copy()


def _flat(values: wp.array, wide: int) -> wp.array:
    """The same memory as single numbers."""
    return wp.array(ptr=values.ptr, dtype=float, shape=len(values) * wide, device=values.device)
