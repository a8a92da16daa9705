"""Check of the pins: a motion must not tear apart the vertices that are held to the body.

Pins follow the skin under them, whatever the cloth between them can bear. Weights that hang one pin on the waist and
its neighbour on a hand would end as a diverged simulation; here they end as a sentence.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
import scipy.sparse as sp

from body.model import skin
from geometry.topology import edge_lengths

if TYPE_CHECKING:
    from garments.template import GarmentTemplate

MOST_STRETCH = 1.0
"""Strain between two pins that a motion may ask for; a waist ring that twists with its wearer is at 0.06."""


class PinSpans:
    """The pairs of pins that are watched, with the length of cloth between them.

    Watched are pins that share an edge, and all pins against the first one by the shortest way over the mesh.
    """

    def __init__(self, template: GarmentTemplate):
        self.template = template
        pinned, edges = template.pinned, template.topology.edges
        vertices = template.vertices.astype(np.float64)
        number = np.full(len(vertices), -1)
        number[pinned] = np.arange(len(pinned))
        held = edges[(number[edges] >= 0).all(axis=1)]
        self.pairs, self.length = number[held], edge_lengths(vertices, held)
        if len(pinned) > 1:
            ways = sp.coo_matrix((edge_lengths(vertices, edges), edges.T), shape=(len(vertices),) * 2)
            way = sp.csgraph.dijkstra(ways.tocsr(), directed=False, indices=int(pinned[0]))[pinned]
            reached = np.flatnonzero(np.isfinite(way) & (way > 0.0))
            self.pairs = np.concatenate([self.pairs, np.stack([np.zeros_like(reached), reached], axis=1)])
            self.length = np.concatenate([self.length, way[reached]])

    def check(self, transforms: np.ndarray, lead_in: int = 0) -> None:
        """Refuse a motion that carries pins farther apart than the cloth between them can follow.

        Args:
            transforms: Skinning transforms of the body, shape [L + T, joints, 4, 4].
            lead_in: Number L of leading frames: frame 0 of an error is the first one after them.

        Raises:
            ValueError: Names the two vertices, the frame and how far they are torn apart.
        """
        if len(self.pairs) == 0:
            return
        template, pinned = self.template, self.template.pinned
        where = skin(template.vertices[pinned], template.skin_index[pinned], template.skin_weight[pinned], transforms)
        stretch = edge_lengths(where.astype(np.float64), self.pairs) / self.length - 1.0
        frame, worst = np.unravel_index(stretch.argmax(), stretch.shape)
        if stretch[frame, worst] > MOST_STRETCH:
            a, b = pinned[self.pairs[worst]]
            raise ValueError(
                f"the pinned vertices {a} and {b} are torn apart to {1.0 + stretch[frame, worst]:.1f} times the cloth "
                f"between them in frame {frame - lead_in}, at most {1.0 + MOST_STRETCH:g} times is allowed: their skin "
                "weights hang them on different parts of the body"
            )
