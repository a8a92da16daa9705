"""A tree of boxes over the triangles of a garment, built once from its rest shape.

Cloth neighbours stay neighbours, so the tree of the rest shape serves every later shape: only the boxes are refitted.
It is kept as flat arrays in preorder, so that it can be walked without a stack: from a node, either to the next one
(its first child) or to ``escape`` (past its whole subtree).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

LEAF = 4
"""Most triangles in a leaf."""


@dataclass(frozen=True)
class TriangleTree:
    """Nodes in preorder (children after parents, leaves from left to right). N nodes, L leaves, F triangles.

    Attributes:
        order: Triangles in the order of the leaves, shape [F].
        first: First position in ``order`` that belongs to the node, shape [N].
        count: Number of triangles of a leaf, 0 for an inner node, shape [N].
        escape: Next node in preorder that lies outside of the node's subtree, N past the last one, shape [N].
        leaves: The nodes that are leaves, shape [L].
        right: Second child of an inner node (the first one is the next node), -1 for a leaf, shape [N].
        piece: Connected piece of the node's triangles, -1 for several, shape [N].
        centre: Centre of the box of their corners at rest [m], shape [N, 3].
        radius: Distance from there to the farthest corner [m], shape [N].
        levels: Inner nodes of each depth, deepest first: the order in which boxes are merged.
    """

    order: np.ndarray
    first: np.ndarray
    count: np.ndarray
    escape: np.ndarray
    leaves: np.ndarray
    right: np.ndarray
    piece: np.ndarray
    centre: np.ndarray
    radius: np.ndarray
    levels: tuple[np.ndarray, ...]

    @classmethod
    def build(cls, vertices: np.ndarray, faces: np.ndarray, component: np.ndarray) -> TriangleTree:
        """Split components first, then halve along the longest side of the box of the triangles' centres.

        Args:
            vertices: Rest positions [m], shape [V, 3].
            faces: Triangles, shape [F, 3].
            component: Connected piece of each triangle, shape [F]: layers that lie on each other share no leaf.
        """
        centres = vertices[faces].mean(axis=1)
        first, count, escape, right, depth, order = [], [], [], [], [], []
        piece, centre, radius = [], [], []

        def grow(members: np.ndarray, level: int) -> None:
            node = len(first)
            first.append(len(order))
            count.append(0)
            escape.append(0)
            right.append(-1)
            depth.append(level)
            pieces = np.unique(component[members])
            corners = vertices[faces[members]].reshape(-1, 3)
            middle = (corners.min(axis=0) + corners.max(axis=0)) / 2.0
            piece.append(int(pieces[0]) if len(pieces) == 1 else -1)
            centre.append(middle)
            radius.append(np.linalg.norm(corners - middle, axis=1).max())
            if len(pieces) == 1 and len(members) <= LEAF:
                order.extend(members.tolist())
                count[node] = len(members)
            else:
                if len(pieces) > 1:
                    lower = np.isin(component[members], pieces[: len(pieces) // 2])
                    halves = members[lower], members[~lower]
                else:
                    points = centres[members]
                    axis = int(np.argmax(np.ptp(points, axis=0)))
                    ranked = members[np.argsort(points[:, axis], kind="stable")]
                    # Whole leaves on the left, so that leaves are full.
                    left = -(-len(ranked) // (2 * LEAF)) * LEAF
                    halves = ranked[:left], ranked[left:]
                grow(halves[0], level + 1)
                right[node] = len(first)
                grow(halves[1], level + 1)
            escape[node] = len(first)

        grow(np.arange(len(faces)), 0)
        counts, depths = np.array(count, dtype=np.int32), np.array(depth)
        inner = [np.flatnonzero((depths == level) & (counts == 0)) for level in range(depths.max(), -1, -1)]
        return cls(
            order=np.array(order, dtype=np.int32),
            first=np.array(first, dtype=np.int32),
            count=counts,
            escape=np.array(escape, dtype=np.int32),
            leaves=np.flatnonzero(counts > 0).astype(np.int32),
            right=np.array(right, dtype=np.int32),
            piece=np.array(piece, dtype=np.int32),
            centre=np.array(centre),
            radius=np.array(radius),
            levels=tuple(nodes.astype(np.int32) for nodes in inner if len(nodes)),
        )
