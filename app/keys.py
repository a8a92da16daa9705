"""The keyframes of a session, each with the intrinsic parameters that it is of or nearest to.

Changing one of these moves z as far as the z of the parameters moves, so that a shape keeps what it has beyond its
parameters. Nothing here knows of threads or of frames that were made: ``app.session`` does.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from app.materials import Material, check_trained, nearest_parameters
from runtime.composing import Composer
from runtime.keyframes import Keyframe


class Keys:
    """Keyframes of a composer and their materials.

    Attributes:
        composer: Garment, motion and body, with the keyframes.

    Args:
        composer: It is changed with them.
        materials: Of each keyframe that it has, by frame.
    """

    def __init__(self, composer: Composer, materials: Mapping[int, Material]) -> None:
        self.composer, self._materials = composer, dict(materials)

    @property
    def all(self) -> tuple[Keyframe, ...]:
        """By frame number."""
        return self.composer.keyframes

    @property
    def materials(self) -> dict[int, Material]:
        """A copy of the materials, by frame."""
        return dict(self._materials)

    @property
    def ranges(self) -> dict[str, tuple[float, float]]:
        """Intrinsic parameters that the model was told, and between what it was trained."""
        space = self.composer.space
        return {name: space.garment.ranges[name] for name in space.tellable}

    def at(self, frame: int) -> Keyframe | None:
        """The keyframe of a frame, or None."""
        return next((key for key in self.all if key.frame == frame), None)

    def material_at(self, frame: int) -> Material:
        """Intrinsic parameters that the garment has in a frame, or is nearest to."""
        if frame in self._materials:
            return self._materials[frame]
        if not self._materials:
            return Material(self._base(), True)
        # Before the first keyframe and after the last there is what they are.
        ends = min(self._materials), max(self._materials)
        if not ends[0] < frame < ends[1]:
            return self._materials[ends[0] if frame < ends[0] else ends[1]]
        return Material(nearest_parameters(self.composer.space, self.latent(frame)), False)

    def latent(self, frame: int) -> np.ndarray:
        """z of a frame, shape [Z]."""
        return self.composer.latents(np.array([frame]))[0]

    def insert(self, frame: int) -> Keyframe:
        """A keyframe of the shape that the frame has at present."""
        material = self.material_at(frame)
        origin = "material" if material.exact else "shape in between"
        return self._put(Keyframe(frame, self.latent(frame), None, origin), material)

    def insert_latent(self, frame: int, latent: np.ndarray, origin: str) -> Keyframe:
        """A keyframe of a point of the latent space."""
        material = Material(nearest_parameters(self.composer.space, latent), False)
        return self._put(Keyframe(frame, latent, None, origin), material)

    def insert_parameters(self, frame: int, changed: Mapping[str, float]) -> Keyframe:
        """A keyframe with some intrinsic parameters changed; the rest of what it is stays.

        Raises:
            ValueError: A parameter or a value that the model was not trained on; says between what it was.
        """
        before, there = self.material_at(frame), self.at(frame)
        check_trained(self.composer.space.garment.name, self.ranges, changed)
        after = dict(before.parameters) | {name: float(value) for name, value in changed.items()}
        latent = self._latent_of(after)
        if not before.exact:
            latent = self.latent(frame) + latent - self._latent_of(before.parameters)
        origin = "material" if there is None or before.exact else there.origin.removesuffix(", changed") + ", changed"
        detail = None if there is None else there.detail
        return self._put(Keyframe(frame, latent, detail, origin), Material(after, before.exact))

    def insert_shape(self, frame: int, vertices: np.ndarray, origin: str) -> Keyframe:
        """A keyframe of a garment ``vertices [V, 3]`` [m] in the world, on the body as it is in that frame."""
        key = self.composer.add_shape(frame, vertices, origin=origin)
        self._materials[key.frame] = Material(nearest_parameters(self.composer.space, key.latent), False)
        return key

    def delete(self, frame: int) -> None:
        """Take a keyframe away; ``ValueError`` lists them where there is none."""
        self.composer.delete(frame)
        self._materials.pop(frame, None)

    def move(self, frame: int, to: int) -> Keyframe:
        """Move a keyframe to another frame that has none; ``ValueError`` where it has one."""
        if self.at(to) is not None:
            raise ValueError(f"frame {to} has a keyframe already; delete it first")
        key = self.composer.move(frame, to)
        self._materials[key.frame] = self._materials.pop(frame)
        return key

    def on_body(self, composer: Composer) -> Keys:
        """The same keyframes on another body in the same motion."""
        composer.use(self.all)
        return Keys(composer, self._materials)

    def in_motion(self, composer: Composer) -> Keys:
        """The same keyframes in another motion, at the same share of its length; details stay behind."""
        scale = (composer.frames - 1) / (self.composer.frames - 1)
        placed = {round(key.frame * scale): key for key in self.all}
        composer.use(replace(key, frame=frame, detail=None) for frame, key in placed.items())
        return Keys(composer, {frame: self._materials[key.frame] for frame, key in placed.items()})

    def in_garment(self, composer: Composer) -> tuple[Keys, list[int]]:
        """Keyframes that are materials, in another garment; what others are, it does not know.

        Returns:
            Those keyframes, and frames of those that were given up.
        """
        other, given_up = Keys(composer, {}), []
        for key in self.all:
            material = self._materials[key.frame]
            if not material.exact:
                given_up.append(key.frame)
                continue
            known = {name: material.parameters[name] for name in other.ranges if name in material.parameters}
            values = other._base() | {name: float(np.clip(v, *other.ranges[name])) for name, v in known.items()}
            other._put(Keyframe(key.frame, other._latent_of(values), None, "material"), Material(values, True))
        return other, given_up

    def _put(self, key: Keyframe, material: Material) -> Keyframe:
        key = self.composer.add(key)
        self._materials[key.frame] = material
        return key

    def _base(self) -> dict[str, float]:
        base = self.composer.space.garment.base_parameters
        return {name: float(base[name]) for name in self.ranges}

    def _latent_of(self, values: Mapping[str, float]) -> np.ndarray:
        space = self.composer.space
        return space.of_parameters(dict(space.garment.base_parameters) | dict(values))
