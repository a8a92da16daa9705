"""A garment in motion as somebody shows it: an animation of this program, or one mesh on a pose.

In: animations, meshes. Out: what their frames say of the intrinsic space, whoever wears them. Each ``ValueError`` is
one sentence that says what does not fit.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from formats.animation import Animation, plain_name
from formats.body_notes import noted_shape
from motions.clip import Clip
from runtime.composing import Composer
from runtime.intrinsic_space import IntrinsicSpace
from runtime.motion_making import on_body


@dataclass(frozen=True)
class ShownGarment:
    """Frames of a garment and the motion under them.

    Attributes:
        composer: The motion, without keyframes.
        vertices: Garment in the world [m], shape [n, V, 3].
        numbers: The frames of the motion that they are in, shape [n].
        origin: What it was shown in, in words.
    """

    composer: Composer
    vertices: np.ndarray
    numbers: np.ndarray
    origin: str

    @classmethod
    def of_animation(cls, space: IntrinsicSpace, animation: Animation) -> ShownGarment:
        """From an animation with its motion, such as ``generate``, ``dress`` and ``export`` write.

        Raises:
            ValueError: Another garment, no motion, another frame rate than the run's, or a body that cannot be.
        """
        garment, run = space.garment, space.garment.run
        shown = str(animation.notes.get("garment", garment.name))
        if shown != garment.name:
            raise ValueError(f"animation '{animation.name}' shows the garment '{shown}', asked for is '{garment.name}'")
        mesh = animation.mesh(plain_name(garment.name))
        faces, count = garment.template.faces, len(garment.template.vertices)
        if mesh.frames.shape[1] != count or not np.array_equal(mesh.faces, faces):
            raise ValueError(
                f"animation '{animation.name}': its {garment.name} has {mesh.frames.shape[1]} vertices and "
                f"{len(mesh.faces)} triangles, that of {run.folder} has {count} and {len(faces)}"
                f"{', connected otherwise' if mesh.frames.shape[1] == count else ''}"
            )
        if animation.clip is None:
            raise ValueError(
                f"animation '{animation.name}' does not hold the motion of its body, without which nothing can be told "
                "of the garment"
            )
        clip, shape = animation.clip, noted_shape(animation)
        if shape is not None:
            clip = on_body(clip, run.plain_body.shaped(shape), run.body)
        return cls(Composer(space, clip, shape), mesh.frames, np.arange(animation.frames), animation.name)

    @classmethod
    def of_mesh(
        cls, space: IntrinsicSpace, clip: Clip, frame: int, vertices: np.ndarray, canonical: bool = False
    ) -> ShownGarment:
        """From one mesh [V, 3] [m] on the pose of one frame of a clip; other frames of the clip are its past alone.

        Raises:
            ValueError: The frame is outside of the clip.
        """
        composer = Composer(space, clip)
        world = composer.in_world(vertices, frame) if canonical else np.asarray(vertices, dtype=np.float32)
        return cls(composer, world[None], np.array([frame]), f"frame {frame} of {clip.name}")

    @property
    def frames(self) -> int:
        """Number of frames that are shown."""
        return len(self.vertices)

    def evidence(self) -> tuple[np.ndarray, np.ndarray]:
        """What each frame says of z and how sure it is: values and weights, [n, Z] each."""
        return self.composer.evidence(self.vertices, self.numbers)

    def latents(self, parts: int = 1) -> np.ndarray:
        """z [parts, Z] of so many equal parts of the frames; of one part, what all frames agree upon.

        Raises:
            ValueError: No part, or more parts than frames.
        """
        if not 1 <= parts <= self.frames:
            raise ValueError(f"{parts} parts are asked for; allowed are 1 to the {self.frames} frames that there are")
        values, weights = self.evidence()
        pieces = zip(np.array_split(values, parts), np.array_split(weights, parts), strict=True)
        prior = self.composer.space.network.prior
        return np.stack([(v * w).sum(0) / (w.sum(0) + prior) for v, w in pieces]).astype(np.float32)
