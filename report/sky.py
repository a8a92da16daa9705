"""How much of the sky, and of the key light, each vertex sees: soft shadows of arms on cloth and of cloth on legs.

In: points [m] with normals. Out: shares in 0..1. From each of a few directions, the points themselves make a coarse
map of heights; what lies below it is in shadow. That is some milliseconds a frame, where screen-space ambient occlusion
in software is a hundred, and hardly to be seen.
"""

from __future__ import annotations

import numpy as np

from geometry.topology import normalized

CELL = 0.024
"""Width of a cell of the height map [m]; a body has a vertex in nearly every one."""

LIFT, SOFT = 0.012, 0.03
"""Height above a point [m] from which on something shades it, and over which the shade becomes full."""

SKY_DIRECTIONS = 10
KEY_SPREAD = 0.16
"""Radius of the key light at unit distance: its shadows have soft edges."""


def sky_directions(count: int = SKY_DIRECTIONS) -> np.ndarray:
    """Unit vectors evenly spread over the upper half of a sphere and a little below its horizon, shape [count, 3]."""
    turn = np.pi * (3.0 - np.sqrt(5.0)) * np.arange(count)
    up = 1.0 - (np.arange(count) + 0.5) / count * 1.15
    flat = np.sqrt(1.0 - up**2)
    return np.stack([flat * np.cos(turn), up, flat * np.sin(turn)], axis=1)


def key_directions(key: np.ndarray) -> np.ndarray:
    """Four directions towards the edge of an extended light, shape [4, 3]; ``key [3]`` points at its middle."""
    key = normalized(np.asarray(key, dtype=np.float64))
    right = normalized(np.cross(key, [0.0, 1.0, 0.0]))
    up = np.cross(right, key)
    return normalized(key + KEY_SPREAD * np.array([right, -right, up, -up]))


def seen_share(points: np.ndarray, normals: np.ndarray, directions: np.ndarray) -> np.ndarray:
    """Share of the light from ``directions [D, 3]`` that reaches each of ``points [N, 3]`` past all others, shape [N].

    Weighted by the cosine with the normal, as a matt surface would; 1 where no direction is in front of a point.
    """
    reached, whole = np.zeros(len(points)), np.zeros(len(points))
    for direction in directions:
        cosine = normals @ direction
        front = cosine > 0.05
        free = 1.0 - _shaded(points, front, direction, cosine[front])
        reached[front] += cosine[front] * free
        whole[front] += cosine[front]
    return np.where(whole > 0, reached / np.maximum(whole, 1e-9), 1.0)


def _shaded(points: np.ndarray, front: np.ndarray, direction: np.ndarray, cosine: np.ndarray) -> np.ndarray:
    """Share of each point of ``front`` that others shade from a direction, 0..1."""
    side = normalized(np.cross(direction, [0.31, 0.17, 0.93]))
    flat = points @ np.stack([side, np.cross(direction, side)], axis=1) / CELL
    flat -= flat.min(axis=0) - 1.0
    height = points @ direction
    size = flat.max(axis=0).astype(int) + 3
    heights = np.full(size[0] * size[1], -np.inf)
    cell = flat.astype(int)
    np.maximum.at(heights, cell[:, 0] * size[1] + cell[:, 1], height)
    # The surface itself rises within a cell where light comes from the side: that is no shadow.
    rise = CELL * np.sqrt(1.0 - np.minimum(cosine, 1.0) ** 2) / np.maximum(cosine, 0.15)
    least = height[front] + LIFT + rise
    corner = flat[front] - 0.5
    low = np.floor(corner).astype(int)
    share = corner - low
    shade = np.zeros(len(least))
    for i in (0, 1):
        for j in (0, 1):
            weight = np.abs(1 - i - share[:, 0]) * np.abs(1 - j - share[:, 1])
            over = heights[(low[:, 0] + i) * size[1] + low[:, 1] + j] - least
            shade += weight * np.clip(over / SOFT, 0.0, 1.0)
    return shade
