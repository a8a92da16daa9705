"""How clean simulated cloth is: crossings of a garment with itself and with the body, and how deep they go.

In: world positions of a garment and of a closed body at one instant. Out: exact counts of crossing triangle pairs,
vertices and triangles inside the body with their depth, those that the body pinches told apart from faults (the rule
stands in ``sim.buried``). Made to judge contact code: it shares nothing with the solver.

Two triangles without a common vertex cross where an edge of one passes through the inside of the other; touching is no
crossing. Inside is where the body's winding number is positive, so it holds where the body overlaps itself.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import warp as wp

from sim.buried import PINCH_REACH, Closure, SurfaceTree, checked_closed, checked_faces, checked_points
from sim.compile import resolve_device
from sim.kernels import crossings as kernels


@dataclass(frozen=True)
class Crossings:
    """Crossings of one garment at one instant. V garment vertices, F garment triangles.

    Attributes:
        self_pairs: Pairs of garment triangles that cross.
        pinched_self_pairs: Those of them of which a triangle is pinched.
        self_count: Garment triangles that each triangle crosses, shape [F].
        body_count: Body triangles that each triangle crosses, shape [F].
        vertex_depth: Distance of each vertex to the surface of the body where it is inside, 0 outside [m], shape [V].
        vertex_pinched: Vertices inside where the body is closed to cloth, shape [V].
        triangle_depth: The same of the deepest sounded point of each triangle [m], shape [F]: corners, edge midpoints,
            centroid and the points nearest to body vertices that poke through.
        triangle_pinched: Triangles that cross anything, or are inside, where the body is closed to cloth, shape [F].
        triangle_face: Body face nearest to the deepest point of each triangle, -1 for those outside, shape [F].
        vertex_aside: Vertices inside whose nearest body face is set aside, shape [V].
        triangle_aside: Triangles that cross faces set aside and no others, or lie inside next to one, shape [F].
    """

    self_pairs: int
    pinched_self_pairs: int
    self_count: np.ndarray
    body_count: np.ndarray
    vertex_depth: np.ndarray
    vertex_pinched: np.ndarray
    triangle_depth: np.ndarray
    triangle_pinched: np.ndarray
    triangle_face: np.ndarray
    vertex_aside: np.ndarray
    triangle_aside: np.ndarray

    @property
    def vertex_fault(self) -> np.ndarray:
        """Vertices inside the body that are neither pinched nor at a face set aside, shape [V]."""
        return (self.vertex_depth > 0.0) & ~self.vertex_pinched & ~self.vertex_aside

    @property
    def triangle_fault(self) -> np.ndarray:
        """Triangles inside the body that are neither pinched nor at a face set aside, shape [F]."""
        return self.triangle_inside & ~self.triangle_pinched & ~self.triangle_aside

    @property
    def triangle_inside(self) -> np.ndarray:
        """Triangles that cross the body or lie inside it, pinched or not, shape [F]."""
        return (self.body_count > 0) | (self.triangle_depth > 0.0)

    @property
    def body_pairs(self) -> int:
        """Pairs of a garment and a body triangle that cross, of faults alone."""
        return int(self.body_count[self.triangle_fault].sum())

    @property
    def pinched_body_pairs(self) -> int:
        """Pairs of a pinched garment triangle and a body triangle that cross."""
        return int(self.body_count[self.triangle_pinched & ~self.triangle_aside].sum())

    @property
    def vertices_inside(self) -> int:
        """Vertices inside the body that are faults."""
        return int(self.vertex_fault.sum())

    @property
    def pinched_vertices(self) -> int:
        """Vertices inside the body where it is closed to cloth."""
        return int(((self.vertex_depth > 0.0) & self.vertex_pinched & ~self.vertex_aside).sum())

    @property
    def aside_vertices(self) -> int:
        """Vertices inside the body at faces set aside, pinched or not."""
        return int(self.vertex_aside.sum())

    @property
    def triangles_inside(self) -> int:
        """Triangles that cross the body or lie inside it and are faults."""
        return int(self.triangle_fault.sum())

    @property
    def pinched_triangles(self) -> int:
        """Triangles that cross the body or lie inside it where it is closed to cloth."""
        return int((self.triangle_inside & self.triangle_pinched & ~self.triangle_aside).sum())

    @property
    def aside_triangles(self) -> int:
        """Triangles that cross the body or lie inside it at faces set aside, pinched or not."""
        return int(self.triangle_aside.sum())

    @property
    def deepest_m(self) -> float:
        """Depth of the deepest point of the faults [m]."""
        return float(np.max(self.triangle_depth, where=self.triangle_fault, initial=0.0))

    @property
    def deepest_pinched_m(self) -> float:
        """Depth of the deepest pinched point [m]."""
        return float(np.max(self.triangle_depth, where=self.triangle_pinched & ~self.triangle_aside, initial=0.0))


class CrossingChecker:
    """Checks a garment against itself and a body, frame by frame.

    Several garments are checked together as one mesh: their crossings with each other are self crossings then.
    """

    def __init__(
        self,
        garment_faces: np.ndarray,
        body_faces: np.ndarray,
        device: str = "auto",
        aside: np.ndarray | None = None,
    ):
        """Take the triangles of both.

        Args:
            garment_faces: Triangles of the garment, shape [F, 3].
            body_faces: Outward oriented triangles of a closed surface, shape [G, 3].
            device: ``auto``, ``cpu`` or ``cuda``.
            aside: Body faces that cloth is not meant to keep off, such as those of the hands, shape [G]: what is inside
                there is counted apart, and is no fault. None for no such faces.

        Raises:
            ValueError: Wrong shapes, or the body is not closed.
        """
        self.device = resolve_device(device)
        self._garment = SurfaceTree(checked_faces(garment_faces, "garment faces"), self.device)
        self._body = SurfaceTree(checked_closed(body_faces), self.device)
        count = self._body.face_count
        self._aside = np.zeros(count, dtype=bool) if aside is None else np.asarray(aside)
        if self._aside.shape != (count,) or self._aside.dtype != bool:
            raise ValueError(
                f"aside: expected bool of shape [{count}], got {self._aside.dtype} {list(self._aside.shape)}"
            )
        self._device_aside = wp.array(self._aside, dtype=wp.bool, device=self.device)

    def check(
        self, garment_positions: np.ndarray, body_positions: np.ndarray, closure: Closure | None = None
    ) -> Crossings:
        """Crossings at one instant.

        Args:
            garment_positions: World positions [m], shape [V, 3].
            body_positions: World positions [m], shape [B, 3].
            closure: Where this pose of the body is closed to cloth; None: nowhere, so that nothing counts as pinched.

        Raises:
            ValueError: Wrong shapes or NaN.
        """
        garment, body, device = self._garment, self._body, self.device
        cloth = checked_points(garment_positions, garment.vertex_count, "garment positions")
        posed = checked_points(body_positions, body.vertex_count, "body positions")
        origin = posed.mean(axis=0)  # inside the trunk: float32 is finest there, and rays lead away from it
        garment.move(cloth - origin)
        body.move(posed - origin)
        closed = np.zeros(body.face_count, dtype=bool) if closure is None else closure.closed
        if closed.shape != (body.face_count,):
            raise ValueError(f"closure: made for {len(closed)} body faces, the body has {body.face_count}")
        closed = wp.array(closed, dtype=wp.bool, device=device)
        tree = kernels.BodyTree()
        tree.mesh, tree.points, tree.indices = body.mesh.id, body.points, body.indices

        vertices, faces = garment.vertex_count, garment.face_count
        self_count, body_count, aside_count, face = (wp.zeros(faces, dtype=int, device=device) for _ in range(4))
        vertex_face, total = (wp.zeros(n, dtype=int, device=device) for n in (vertices, 1))
        vertex_depth, depth = (wp.zeros(n, dtype=float, device=device) for n in (vertices, faces))
        vertex_pinched, pinched = (wp.zeros(n, dtype=wp.bool, device=device) for n in (vertices, faces))

        surface = [garment.mesh.id, garment.points, garment.indices]
        wp.launch(kernels.cross_self, faces, surface, [self_count], device=device)
        inputs = [*surface[1:], tree, self._device_aside]
        wp.launch(kernels.cross_body, faces, inputs, [body_count, aside_count], device=device)
        inputs = [garment.points, tree, closed, PINCH_REACH]
        outputs = [vertex_depth, vertex_face, vertex_pinched]
        wp.launch(kernels.measure_vertices, vertices, inputs, outputs, device=device)
        inputs = [*surface[1:], tree, closed, PINCH_REACH, body_count, self_count, vertex_depth, vertex_pinched]
        wp.launch(kernels.measure_triangles, faces, inputs, [depth, face, pinched], device=device)
        inputs = [*surface, self_count, pinched]
        wp.launch(kernels.count_pinched_pairs, faces, inputs, [total], device=device)

        counted, crossed, nearest = self_count.numpy().copy(), body_count.numpy().copy(), face.numpy().copy()
        near_aside = np.where(crossed > 0, aside_count.numpy() == crossed, self._at(nearest))
        return Crossings(
            self_pairs=int(counted.sum()) // 2,
            pinched_self_pairs=int(total.numpy()[0]),
            self_count=counted,
            body_count=crossed,
            vertex_depth=vertex_depth.numpy().copy(),
            vertex_pinched=vertex_pinched.numpy().astype(bool),
            triangle_depth=depth.numpy().copy(),
            triangle_pinched=pinched.numpy().astype(bool),
            triangle_face=nearest,
            vertex_aside=self._at(vertex_face.numpy()),
            triangle_aside=near_aside,
        )

    def _at(self, face: np.ndarray) -> np.ndarray:
        """Whether these body faces, -1 for none, are set aside."""
        return (face >= 0) & self._aside[face]
