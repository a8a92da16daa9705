"""A small clothed animation that every format can be tried on, and the motion of a body."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import trimesh
from scipy.spatial.transform import Rotation

from formats.animation import AnimatedMesh, Animation
from motions.clip import Clip

FPS = 24.0
FRAMES = 10


def tube(rows: int = 6, columns: int = 12) -> tuple[np.ndarray, np.ndarray]:
    """A skirt-like tube around the y axis, outward triangles."""
    angle = np.arange(columns) * 2 * np.pi / columns
    ring = np.stack([np.cos(angle), np.zeros(columns), np.sin(angle)], axis=1)
    vertices = np.concatenate([ring * (0.2 + 0.03 * row) + [0, 1.0 - 0.08 * row, 0] for row in range(rows)])
    faces = []
    for row in range(rows - 1):
        for j in range(columns):
            a, b = row * columns + j, row * columns + (j + 1) % columns
            faces += [[a, b, a + columns], [b, b + columns, a + columns]]
    return vertices, np.array(faces)


def moving(frames: int = FRAMES, seed: int = 0) -> np.ndarray:
    """The tube turning, walking and fluttering, [T, V, 3]."""
    vertices, _ = tube()
    rng = np.random.default_rng(seed)
    flutter = np.cumsum(rng.normal(size=(frames, *vertices.shape)), axis=0) * 0.002
    turns = Rotation.from_rotvec(np.outer(np.arange(frames) * 0.05, [0, 1, 0])).as_matrix()
    path = np.stack([0.02 * np.arange(frames), np.zeros(frames), 0.03 * np.arange(frames)], axis=1)
    return (np.einsum("tij,vj->tvi", turns, vertices) + flutter + path[:, None]).astype(np.float32)


def turning_walk() -> Animation:
    """A garment that flutters on a ball that slides."""
    vertices, faces = tube()
    uv = np.random.default_rng(1).random((len(vertices), 2))
    ball = trimesh.creation.icosphere(1, 0.15)
    body = np.asarray(ball.vertices) + [0, 0.8, 0] + 0.02 * np.arange(FRAMES)[:, None, None] * np.array([1, 0, 1.5])
    skirt = AnimatedMesh("skirt", faces, moving(), (0.9, 0.1, 0.1), "cloth", uv)
    return Animation((skirt, AnimatedMesh("body", ball.faces, body, (0.8, 0.8, 0.7), "skin")), FPS, "turning walk")


def walk(frames: int = FRAMES, fps: float = FPS) -> Clip:
    rng = np.random.default_rng(3)
    pose = 0.3 * rng.normal(size=(1, 24, 3)) + 0.01 * np.cumsum(rng.normal(size=(frames, 24, 3)), axis=0)
    pose[:, 22:] = 0.0
    root = np.stack([0.01 * np.arange(frames), np.zeros(frames), 0.02 * np.arange(frames)], axis=1)
    return Clip("walk_01", "take", "walk", pose, root, fps, "test")


def cut(animation: Animation, frames: int) -> Animation:
    return replace(animation, meshes=[replace(mesh, frames=mesh.frames[:frames]) for mesh in animation.meshes])


def contents(path: Path) -> dict[str, bytes]:
    files = sorted(path.iterdir()) if path.is_dir() else [path]
    return {file.name: file.read_bytes() for file in files}
