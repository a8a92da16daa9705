"""Quality figures of the recorded frames of a clip, gathered frame by frame for every world."""

from __future__ import annotations

import numpy as np


class ClipFigures:
    """What was worst at the end of any recorded frame, and for how long, in W worlds.

    A run of frames is one frame after the other; the figures are those that ``sim.result`` describes.
    """

    def __init__(self, worlds: int):
        self.worlds = worlds
        self.inside, self.deepest = np.zeros(worlds), np.zeros(worlds)
        self.pinched, self.pinched_frames = np.zeros(worlds), np.zeros(worlds)
        self.longest_pinch, self._pinch = np.zeros(worlds), np.zeros(worlds)
        self.crossings, self.crossing_frames = np.zeros(worlds), np.zeros(worlds)
        self.triangles = np.zeros(worlds)
        self._folded = False

    def add_contact(self, distance: np.ndarray, pinched: np.ndarray) -> None:
        """A frame's signed distances to the body [m], shape [W, V], and where the body pinches cloth, likewise."""
        depth = -distance
        self.inside = np.maximum(self.inside, (depth > 0.0).sum(axis=1))
        self.deepest = np.maximum(self.deepest, depth.max(axis=1, initial=0.0))
        count = (pinched > 0.0).sum(axis=1)
        self.pinched = np.maximum(self.pinched, count)
        self.pinched_frames += count > 0
        self._pinch = np.where(count > 0, self._pinch + 1, 0)
        self.longest_pinch = np.maximum(self.longest_pinch, self._pinch)

    def add_crossings(self, count: np.ndarray) -> None:
        """A frame's crossings of the garment with itself, shape [W]."""
        self._folded = True
        self.crossings = np.maximum(self.crossings, count)
        self.crossing_frames += count > 0

    def add_triangles(self, count: np.ndarray) -> None:
        """Triangles inside the body in a frame that they were counted in, shape [W]."""
        self.triangles = np.maximum(self.triangles, count)

    def of(self, lane: int) -> dict[str, float]:
        """The figures of one world by name; without any of crossings where none were counted."""
        figures = {
            "deepest_penetration_m": self.deepest,
            "vertices_inside": self.inside,
            "triangles_inside_sampled": self.triangles,
            "pinched_vertices": self.pinched,
            "pinched_frames": self.pinched_frames,
            "longest_pinch_frames": self.longest_pinch,
        }
        if self._folded:
            figures |= {"crossing_pairs": self.crossings, "crossing_frames": self.crossing_frames}
        return {name: float(values[lane]) for name, values in figures.items()}
