"""Edge strain of every world while it is simulated: how far the worst edge is, and percentiles over a clip."""

from __future__ import annotations

import numpy as np
import warp as wp

from sim.kernels import strain as kernels
from sim.kernels.lanes import launch, scalars
from sim.rest_state import RestState


class StrainMeter:
    """Strains of the edges of W worlds."""

    def __init__(self, rest: RestState, width: int, device: str):
        self.device = device
        self.threads = -(-len(rest.edge_length) // kernels.EDGES_A_THREAD)
        self.edges = wp.array(rest.topology.edges.astype(np.int32), dtype=wp.vec2i, device=device)
        self.over_length = wp.array((1.0 / rest.edge_length).astype(np.float32), dtype=float, device=device)
        self.worst = wp.zeros(self.threads, dtype=scalars(width), device=device)
        self.histogram = wp.zeros(width * kernels.BINS, dtype=int, device=device)
        self.width = width
        self.highest = np.zeros(width)

    def reset(self) -> None:
        """Begin a new clip."""
        self.histogram.zero_()
        self.highest = np.zeros(self.width)

    def measure(self, x: wp.array, counting: bool) -> np.ndarray:
        """Strain of the longest edge of each world, shape [W], infinite where a vertex is nowhere.

        Args:
            x: Positions in lanes [m], shape [V].
            counting: Whether this frame goes into the figures of the clip.
        """
        inputs = [self.edges, self.over_length, int(counting), x]
        outputs = [self.worst, self.histogram]
        launch(kernels.measure_strain, self.width, self.threads, inputs, outputs, self.device)
        ratio = self.worst.numpy().reshape(self.threads, self.width).max(axis=0).astype(np.float64)
        strain = np.where(ratio < 1.0e17, ratio - 1.0, np.inf)
        if counting:
            self.highest = np.maximum(self.highest, strain)
        return strain

    def percentile(self, share: float) -> np.ndarray:
        """|Strain| that this share of edges and counted frames stays below, shape [W], to the width of a bin."""
        counts = self.histogram.numpy().reshape(self.width, kernels.BINS).cumsum(axis=1)
        wanted = share * counts[:, -1:]
        return (np.argmax(counts >= wanted, axis=1) + 1) * kernels.BIN_WIDTH
