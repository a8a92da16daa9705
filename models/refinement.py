"""Refinement: drag a predicted garment out of the body while keeping its local shape.

Wang et al. 2019, section 3.5. In: predicted garment vertices and the body, frame by frame [m]. Out: a garment with no
vertex inside the body, from

    min  |L V* - L V|^2 + omega sum_{i in C} |v*_i - (o_i + eps n_i)|^2 + mu |V* - V|^2,

with the closest body point o_i and its normal n_i for each vertex that was found inside (set C). C grows over at most
five solves. The last term is ours: without it one colliding vertex of a free garment carries all of it along, because
the Laplacian does not see a translation; mu = 1e-2 keeps the change within about two edges of the collision. With 1e-3
it reached six edges far, where the prediction was right: the error against the truth grew by 2.3% on T-shirts of unseen
labels; now it falls by 0.3%, at the same change of the Laplacian.

Which side of the body a vertex belongs on says ``models.way_out``; what the constraints change is solved for by
``models.handle_solver``. A frame of 5,787 vertices, 1% of them inside, takes 5 to 8 ms of one core.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from geometry.proximity import PosedSurface, Sheet, SurfaceHits, SurfaceQuery
from geometry.topology import MeshTopology
from models.handle_solver import HandleSolver
from models.last_resort import TOUCH, project_out
from models.way_out import WayOut

HORIZON = 0.02
"""Least distance up to which the surface is looked up exactly [m]: with less, a vertex deep in a limb can be taken for
one outside, because the first face that is found near it lies beyond a fold."""

EDGE_MARGIN = 0.5
"""Share of the clearance that an edge's midpoint must keep, or its ends are pushed until it keeps all: where edges only
just come out, the body still shows through the triangles between them."""

STEEPEST = 0.25
"""Depth of an edge's midpoint, over the edge's length, up to which the edge is brought out."""


@dataclass(frozen=True)
class RefinementSettings:
    """Weights of the refinement.

    Attributes:
        clearance: eps, distance from the body that a colliding vertex is sent to [m].
        weight: omega, weight of the colliding vertices against the Laplacian.
        iterations: Most solves a frame; the paper needs fewer than 5.
        anchor: mu, weight that holds every vertex at its predicted place.
        edges: Also bring edges out whose midpoint is inside, or all but so, between two vertices outside. The paper
            looks at vertices alone; a coarse garment then shows the body through its triangles. Costs half as much
            again.
    """

    clearance: float = 3.0e-3
    weight: float = 100.0
    iterations: int = 5
    anchor: float = 1.0e-2
    edges: bool = False

    def __post_init__(self) -> None:
        if not (self.clearance > 0 and self.weight > 0 and self.iterations >= 1 and self.anchor > 0):
            raise ValueError(f"refinement: clearance, weight, anchor must be > 0 and iterations >= 1, got {self}")


@dataclass(frozen=True)
class FrameStats:
    """What happened in one frame.

    Attributes:
        inside: Vertices inside the body before.
        redirected: Of those, vertices whose nearest surface lay on the wrong side of the body; counted in each solve.
        iterations: Solves made.
        projected: Vertices that the solves left inside and the last resort moved.
        inside_after: Vertices inside at the end; 0 by construction.
        largest_move: Largest vertex displacement [m].
    """

    inside: int
    redirected: int
    iterations: int
    projected: int
    inside_after: int
    largest_move: float


@dataclass(frozen=True)
class SequenceStats:
    """Sums over the frames of a sequence; ``largest_move`` is the maximum [m]."""

    frames: int
    frames_touched: int
    inside: int
    redirected: int
    iterations: int
    projected: int
    inside_after: int
    largest_move: float


class Refiner:
    """Refinement for one garment connectivity and one body connectivity.

    Args:
        topology: Connectivity of the garment.
        body_faces: Outward oriented closed body surface, shape [F, 3].
        body_vertex_count: Number of body vertices B.
        settings: Weights.

    Attributes:
        horizon: Distance up to which the body's surface has to be known exactly [m].
    """

    def __init__(
        self,
        topology: MeshTopology,
        body_faces: np.ndarray,
        body_vertex_count: int,
        settings: RefinementSettings | None = None,
    ) -> None:
        self.settings = settings or RefinementSettings()
        self.body = SurfaceQuery(body_faces, body_vertex_count)
        self.horizon = max(4.0 * self.settings.clearance, HORIZON)
        self.edges = topology.edges
        self._ends = tuple(np.ascontiguousarray(end) for end in topology.edges.T)
        self.vertex_count = topology.vertex_count
        self.sheet = Sheet(topology.adjacency())
        self._way_out = WayOut(topology, self.settings.clearance)
        self._solver = HandleSolver(topology, self.settings.weight, self.settings.anchor)

    def refine_frame(self, vertices: np.ndarray, body_vertices: np.ndarray) -> tuple[np.ndarray, FrameStats]:
        """Refine one frame.

        Args:
            vertices: Predicted garment [m], shape [V, 3].
            body_vertices: Body of the same frame [m], shape [B, 3].

        Returns:
            Refined garment, shape [V, 3] float32, and what was done. A frame without collision comes back unchanged.
        """
        self._check(vertices)
        body = self.body.at(body_vertices)
        return self.refine_hits(vertices, body, self.near(vertices, body))

    def near(self, vertices: np.ndarray, body: PosedSurface) -> SurfaceHits:
        """Closest points of the body as far as contact matters: ``PosedSurface.query_sheet`` up to ``horizon``."""
        return body.query_sheet(vertices, self.sheet, self.horizon)

    def refine_hits(self, vertices: np.ndarray, body: PosedSurface, hits: SurfaceHits) -> tuple[np.ndarray, FrameStats]:
        """``refine_frame`` for a caller that knows the closest points, from ``near`` or from ``body.query``."""
        settings, horizon = self.settings, self.horizon
        start = np.asarray(vertices, dtype=np.float64)
        self._check(start)
        # A vertex is outside until it has moved as far as its distance, which is known up to the horizon.
        surface, normal, safe = hits.point.copy(), hits.normal.copy(), np.minimum(hits.distance, horizon) - TOUCH
        known, first_inside = np.isfinite(hits.distance), int((hits.distance < 0.0).sum())
        inside = safe < 0.0
        target = np.zeros_like(start)
        constrained = np.zeros(self.vertex_count, dtype=bool)
        current, checked, redirected, solves = start, start.copy(), 0, 0
        # Likewise a midpoint; of none is anything known at first.
        middles, free = start[:0], np.full(len(self.edges) if settings.edges else 0, -1.0)
        while solves < settings.iterations:
            wanted = inside.any()
            if wanted:
                redirected += self._way_out.correct(body, start, current, inside, known, surface, normal)
                target[inside] = surface[inside] + settings.clearance * normal[inside]
                constrained |= inside
            # Before the first solve, edges beside vertices inside say nothing about the garment that comes out.
            if settings.edges and not (wanted and solves == 0):
                ends, push, middles = self._buried_edges(body, current, safe, middles, free)
                target[ends] = current[ends] + push
                constrained[ends] = True
                wanted |= len(ends) > 0
            if not wanted:
                break
            held = np.flatnonzero(constrained)
            current = start + self._solver.solve(held, (target - start)[held])
            solves += 1
            ask = np.nonzero(constrained | (_length(current - checked) >= safe))[0]
            hits = body.query(current[ask])  # few, and what is said about them now is final
            surface[ask], normal[ask], checked[ask], known[ask] = hits.point, hits.normal, current[ask], True
            safe[ask] = np.minimum(hits.distance, horizon) - TOUCH
            inside[:] = False
            inside[ask] = safe[ask] < 0.0
        # Where the body runs through itself the nearest surface can change, and its side with it, although the vertex
        # crossed none, at any distance: whatever moved is asked once more, and what hardly did goes back.
        hardly = _length(current - start) < TOUCH
        current = np.where(hardly[:, None], start, current)
        ask = np.nonzero((_length(current - checked) > 0.0) & ~(hardly & ~constrained))[0]
        if len(ask):
            hits = body.query(current[ask])
            surface[ask], normal[ask], inside[ask] = hits.point, hits.normal, hits.distance < TOUCH
        refined, projected, left = project_out(body, self.edges, current, inside, surface, normal, settings.clearance)
        largest = float(_length(refined - start).max()) if solves else 0.0
        return refined, FrameStats(first_inside, redirected, solves, projected, left, largest)

    def refine_sequence(self, vertices: np.ndarray, body_vertices: np.ndarray) -> tuple[np.ndarray, SequenceStats]:
        """Refine ``vertices [T, V, 3]`` against ``body_vertices [T, B, 3]`` [m], frame by frame."""
        if len(vertices) != len(body_vertices):
            raise ValueError(f"vertices have {len(vertices)} frames, body_vertices {len(body_vertices)}")
        refined = np.empty(np.shape(vertices), dtype=np.float32)
        frames = []
        for t in range(len(vertices)):
            refined[t], stats = self.refine_frame(vertices[t], body_vertices[t])
            frames.append(stats)
        sums = {
            name: sum(getattr(f, name) for f in frames)
            for name in ("inside", "redirected", "iterations", "projected", "inside_after")
        }
        largest = max((f.largest_move for f in frames), default=0.0)
        touched = sum(f.iterations > 0 for f in frames)
        return refined, SequenceStats(frames=len(frames), frames_touched=touched, largest_move=largest, **sums)

    def _check(self, vertices: np.ndarray) -> None:
        if np.shape(vertices) != (self.vertex_count, 3):
            raise ValueError(f"vertices: expected shape [{self.vertex_count}, 3], got {list(np.shape(vertices))}")

    def _buried_edges(
        self, body: PosedSurface, vertices: np.ndarray, safe: np.ndarray, middles: np.ndarray, free: np.ndarray
    ) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Ends of edges whose midpoint is inside, or nearly so, and the push [m] that brings each end's deepest out.

        Midpoints that cannot have got there since they were last asked for are not asked for again.

        Args:
            body, vertices: Of the frame.
            safe: How far each end may move before it can be inside [m], shape [V].
            middles: What this returned last for the frame; empty at first.
            free: How far each midpoint may move from there before it is to be pushed [m], shape [E]; -1 where it was
                not asked for. Brought up to date in place.

        Returns:
            Ends, shape [C], pushes [C, 3], and the midpoints where they were last asked for, [E, 3].
        """
        # Only an edge longer than twice its ends' distances can dip into the body; an end inside comes out by itself.
        i, j = self._ends
        single, room = vertices.astype(np.float32), safe.astype(np.float32)
        length = _length(single.take(i, axis=0) - single.take(j, axis=0))
        one, other = room.take(i), room.take(j)
        near = np.nonzero((0.5 * length > np.maximum(one, other)) & (np.minimum(one, other) >= 0.0))[0]
        if len(middles) == 0:
            middles = np.zeros((len(self.edges), 3))
        now = 0.5 * (vertices.take(i[near], axis=0) + vertices.take(j[near], axis=0))
        ask = _length(now - middles.take(near, axis=0)) >= free.take(near)
        near, now = near[ask], now[ask]
        if len(near) == 0:
            return np.zeros(0, dtype=np.int64), np.zeros((0, 3)), middles
        hits = body.query(now)
        margin = EDGE_MARGIN * self.settings.clearance
        middles[near], free[near] = now, np.maximum(hits.distance - margin, 0.0)
        # An edge deeper than that runs through a limb or a fold, not over it: pushing its ends tears at the garment.
        buried = np.flatnonzero((hits.distance < margin) & (-hits.distance < STEEPEST * length[near]))
        # From the shallowest to the deepest: of several edges at one end, the deepest is written last and stays.
        buried = buried[np.argsort(-hits.distance[buried], kind="stable")]
        move = (self.settings.clearance - hits.distance[buried])[:, None] * hits.normal[buried]
        push = np.zeros_like(vertices)
        push[self.edges[near[buried]].reshape(-1)] = np.repeat(move, 2, axis=0)
        ends = np.unique(self.edges[near[buried]])
        return ends, push[ends], middles


def refine_sequence(
    vertices: np.ndarray,
    body_vertices: np.ndarray,
    topology: MeshTopology,
    body_faces: np.ndarray,
    settings: RefinementSettings | None = None,
) -> tuple[np.ndarray, SequenceStats]:
    """Refine one sequence; make one ``Refiner`` where several sequences share garment and body."""
    return Refiner(topology, body_faces, body_vertices.shape[1], settings).refine_sequence(vertices, body_vertices)


def _length(vectors: np.ndarray) -> np.ndarray:
    """Of each of ``vectors [N, 3]``; a third of the time of ``np.linalg.norm``."""
    return np.sqrt(np.einsum("nc,nc->n", vectors, vectors))
