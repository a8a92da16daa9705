"""Contact of a garment with itself, and of garments worn in layers with each other, in W worlds at once.

In: the rest state of a mesh (several garments make one mesh of several pieces), and the solver's state arrays. Between
two query intervals, ``find`` refits a tree of boxes and lists the features that are near each other, or will be;
within the interval, every substep calls ``launch_solve``. Cloth that has passed through itself is drawn apart; the
caller can release cloth from self-contact altogether, where the body pinches it.
"""

from __future__ import annotations

import numpy as np
import scipy.sparse as sp
import warp as wp

from sim.cloth_normals import find_normals
from sim.constraints import device_triangles
from sim.kernels import self_contact, self_detection, self_features, untangle
from sim.kernels.lanes import launch, scalars, vectors
from sim.rest_state import RestState
from sim.triangle_tree import TriangleTree

REST_EDGES = 0.6
"""Features nearer than this at rest, in mean edge lengths, are held apart by the cloth itself."""
FLAT_EDGES = 4.0
"""Extent of cloth, in mean edge lengths, that cannot meet itself before its normals turn by a right angle."""

_GPU_THREADS = 16384
_LARGEST = 10.0  # width of a triangle, in the longest edge at rest, that only a diverged world has
_GROWTH = 1.5


class SelfContact:
    """Feature pairs of a garment that are kept apart, and crossings that are drawn apart.

    Attributes:
        released: 1 where a vertex of a lane takes no part in self-contact, else 0; shape [V], a scalar in every lane.
            The caller writes it before ``find``, or puts an array of its own here before anything is recorded.
    """

    def __init__(self, rest: RestState, width: int, device: str, layer: np.ndarray | None = None):
        """Build the tree over the rest shape.

        Args:
            rest: Rest state of the garment, or of several in one mesh.
            width: Number of worlds W.
            device: Warp device.
            layer: For garments worn over each other, the place of each vertex from the body outwards, shape [V]; where
                two layers lie on each other, the outer one is kept outside of the inner one's outward normals.

        Raises:
            ValueError: ``layer`` has another shape, or differs within a connected piece.
        """
        self.device, self.width, self.count = device, width, len(rest.vertices)
        edge = float(rest.edge_length.mean())
        self.rest_distance, self.flat_distance = REST_EDGES * edge, FLAT_EDGES * edge
        self.largest = _LARGEST * float(rest.edge_length.max())
        _, piece = sp.csgraph.connected_components(rest.topology.adjacency(), directed=False)
        layer = _checked_layer(layer, piece)
        self.layered = bool(layer.max() > layer.min())

        faces = rest.topology.faces
        tree = TriangleTree.build(rest.vertices, faces, piece[faces[:, 0]])
        self.patches = wp.array(_patches(rest, tree, piece, layer), dtype=self_detection.Patch, device=device)
        nodes = np.zeros(len(tree.first), dtype=self_detection.Node.numpy_dtype())
        for name in nodes.dtype.names:
            nodes[name] = getattr(tree, name)
        self.tree = wp.array(nodes, dtype=self_detection.Node, device=device)
        self.leaves = wp.array(tree.leaves, dtype=int, device=device)
        self.inner = wp.array(np.concatenate([*tree.levels, np.zeros(0, np.int32)]), dtype=int, device=device)
        sizes = [len(level) for level in tree.levels]
        starts = np.cumsum([0, *sizes])
        # A CPU does one node after the other, deepest first; a GPU a depth at once.
        self.levels = [(0, len(self.inner))] if device == "cpu" else list(zip(starts[:-1].tolist(), sizes))

        vector, scalar = vectors(width), scalars(width)
        self.boxes = wp.zeros(6 * len(faces), dtype=vector, device=device)
        self.nodes = wp.zeros(6 * len(nodes), dtype=vector, device=device)
        self.rest = wp.array(rest.vertices.astype(np.float32), dtype=wp.vec3, device=device)
        self.inverse_mass = wp.array(rest.inverse_mass.astype(np.float32), dtype=float, device=device)
        self.released = wp.zeros(self.count, dtype=scalar, device=device)
        self.marked, self.tangled, self.before = (wp.zeros(self.count, dtype=scalar, device=device) for _ in range(3))
        self.total = wp.zeros(1, dtype=scalar, device=device)
        self.normals = wp.zeros(self.count, dtype=vector, device=device)
        self.triangles = device_triangles(rest, device) if self.layered else None
        self.threads = 1 if device == "cpu" else _GPU_THREADS
        self.one_by_one = device == "cpu"
        scratch = 1 if self.one_by_one else self.count
        self.active = wp.zeros(scratch, dtype=scalar, device=device)
        self.delta = wp.zeros(scratch, dtype=vector, device=device)

        self.found = wp.zeros(3, dtype=int, device=device)
        self._grown = False
        self._allocate([16 * len(faces), 16 * len(faces), 256])

    def find(self, substeps: int, parameters: wp.array, x: wp.array, v: wp.array) -> bool:
        """List what may touch within the next ``substeps``, in any lane. Never inside a graph.

        Args:
            substeps: Length of the interval until the next search.
            parameters: Rows of ``sim.kernels.parameters``.
            x: Positions [m], shape [V], a vector in every lane.
            v: Velocities [m/s], likewise.

        Returns:
            Whether the lists have grown: graphs that were recorded with them must be recorded again.
        """
        grown, self._grown = self._grown, False
        wp.copy(self.before, self.tangled)
        while True:
            self._search(float(substeps), parameters, x, v)
            found = self.found.numpy()
            if (found <= self._capacity).all():
                return grown
            wp.copy(self.tangled, self.before)  # a search that has to be repeated counts once
            self._allocate(np.maximum(self._capacity, (found * _GROWTH).astype(int)).tolist())
            grown = True

    def launch_solve(self, parameters: wp.array, x_prev: wp.array, x: wp.array, x_pred: wp.array) -> None:
        """Record: self-contact of one substep, after the cloth's own constraints.

        Args:
            parameters: Rows of ``sim.kernels.parameters``.
            x_prev: Positions at the start of the substep [m].
            x: Positions that are corrected [m].
            x_pred: Predicted positions [m], which follow where cloth is drawn out of cloth.
        """
        inputs = [1, self.found, self.crossings, self.inverse_mass, self.released, parameters]
        self._launch(untangle.draw_apart, 1, inputs, [x, x_pred])
        for mode in (self_contact.ONE_BY_ONE,) if self.one_by_one else (self_contact.COUNT, self_contact.ADD_UP):
            inputs = [int(mode), self.threads, self.found, self.pairs, self.inverse_mass, parameters, x_prev]
            outputs = [self.side, self.gap, x, self.active, self.delta]
            self._launch(self_contact.solve_self_contact, self.threads, inputs, outputs)
        if not self.one_by_one:
            self._launch(self_contact.apply_corrections, self.count, [], [x, self.active, self.delta])

    def forget(self) -> None:
        """Begin anew, before the garment is put somewhere else."""
        self.tangled.zero_()

    def pair_count(self) -> int:
        """Number of vertex-triangle and edge-edge pairs that are followed."""
        return int(self.found.numpy()[1])

    def crossing_count(self) -> np.ndarray:
        """Edges that pierced a triangle at the last search, in each lane, shape [W].

        Along a contour of intersection there is about one for each pair of triangles that cross.
        """
        return self.total.numpy().reshape(-1).astype(int)

    def count_crossings(self, parameters: wp.array, x: wp.array, v: wp.array) -> np.ndarray:
        """Search now and give the :meth:`crossing_count`: at the end of a clip, which no other search follows."""
        self._grown = self.find(0, parameters, x, v)
        return self.crossing_count()

    def _search(self, interval: float, parameters: wp.array, x: wp.array, v: wp.array) -> None:
        for counter in (self.found, self.total):
            counter.zero_()
        self._launch(
            self_detection.box_triangles,
            len(self.patches),
            [interval, self.largest, self.patches, parameters, x, v],
            [self.boxes],
        )
        self._launch(self_detection.box_leaves, len(self.leaves), [self.leaves, self.tree, self.boxes], [self.nodes])
        for first, count in self.levels:
            self._launch(self_detection.box_parents, count, [first, self.inner, self.tree], [self.nodes])
        inputs = [self.rest_distance, self.flat_distance, self.leaves, self.tree, self.patches, parameters]
        outputs = [self.found, self.triangle_pairs]
        self._launch(self_detection.find_triangle_pairs, len(self.leaves), [*inputs, self.nodes, self.boxes], outputs)
        inputs = [self.threads, self.patches, self.triangle_pairs, self.boxes, x]
        outputs = [self.found, self.crossings, self.marked, self.total]
        self._launch(untangle.find_crossings, self.threads, inputs, outputs)
        self._launch(untangle.count_searches, self.count, [], [self.marked, self.tangled])
        if self.layered:
            find_normals(self.triangles, parameters, x, self.normals, self.width, self.device)
        inputs = [self.threads, interval, self.rest_distance, self.patches, self.rest, self.triangle_pairs]
        inputs += [self.released, self.tangled, parameters, self.normals, x, v]
        outputs = [self.found, self.pairs, self.side, self.gap]
        for kernel in (self_features.find_vertex_triangles, self_features.find_edge_edges):
            self._launch(kernel, self.threads, inputs, outputs)

    def _allocate(self, capacity: list[int]) -> None:
        """Make room for that many triangle pairs, feature pairs and crossings."""
        self._capacity = np.array(capacity)
        triangles, features, crossings = capacity
        self.triangle_pairs = wp.zeros(triangles, dtype=wp.vec2i, device=self.device)
        self.pairs = wp.zeros(features, dtype=self_features.Pair, device=self.device)
        self.side, self.gap = (wp.zeros(features, dtype=scalars(self.width), device=self.device) for _ in range(2))
        self.crossings = wp.zeros(crossings, dtype=untangle.Crossing, device=self.device)

    def _launch(self, kernel: wp.Kernel, size: int, inputs: list, outputs: list) -> None:
        launch(kernel, self.width, size, inputs, outputs, self.device)


def _checked_layer(layer: np.ndarray | None, piece: np.ndarray) -> np.ndarray:
    if layer is None:
        return np.zeros(len(piece), dtype=np.int32)
    layer = np.asarray(layer)
    if layer.shape != piece.shape or layer.dtype.kind not in "iu":
        raise ValueError(f"layer: expected integers of shape [{len(piece)}], got {layer.dtype} {list(layer.shape)}")
    for number in range(piece.max() + 1):
        values = np.unique(layer[piece == number])
        if len(values) > 1:
            raise ValueError(f"layer: piece {number} of the mesh has layers {values.tolist()}; a piece has one")
    return layer.astype(np.int32)


def _patches(rest: RestState, tree: TriangleTree, piece: np.ndarray, layer: np.ndarray) -> np.ndarray:
    corners = rest.topology.faces[tree.order]
    centre = rest.vertices[corners].mean(axis=1)
    patches = np.zeros(len(corners), dtype=self_detection.Patch.numpy_dtype())
    patches["corner"] = corners
    patches["opposite"] = _opposite(corners)
    patches["owned"] = _owned(corners)
    patches["piece"], patches["layer"] = piece[corners[:, 0]], layer[corners[:, 0]]
    patches["centre"] = centre
    patches["radius"] = np.linalg.norm(rest.vertices[corners] - centre[:, None], axis=2).max(axis=1)
    return patches


def _edge_keys(corners: np.ndarray) -> np.ndarray:
    """One number for each edge from corner c to c + 1, whatever its direction, shape [3 F]."""
    ends = np.stack([corners, np.roll(corners, -1, axis=1)], axis=2).reshape(-1, 2).astype(np.int64)
    return ends.min(axis=1) * (corners.max() + 1) + ends.max(axis=1)


def _owned(corners: np.ndarray) -> np.ndarray:
    """Bits of the vertices and edges that each triangle has to test: the first triangle that has one."""
    owned = np.zeros(len(corners), dtype=np.int32)
    for features, bit in ((corners.ravel(), 1), (_edge_keys(corners), 8)):
        _, first = np.unique(features, return_index=True)
        np.bitwise_or.at(owned, first // 3, (bit << (first % 3)).astype(np.int32))
    return owned


def _opposite(corners: np.ndarray) -> np.ndarray:
    """The far vertex of the neighbour at each edge, -1 at a rim, shape [F, 3]."""
    keys = _edge_keys(corners)
    far = np.roll(corners, -2, axis=1).ravel()
    order = np.argsort(keys, kind="stable")
    pairs = np.flatnonzero(np.diff(keys[order]) == 0)
    opposite = np.full(len(keys), -1, dtype=np.int32)
    opposite[order[pairs]], opposite[order[pairs + 1]] = far[order[pairs + 1]], far[order[pairs]]
    return opposite.reshape(-1, 3)
