"""What is being made in the app, without a browser: a motion, a garment, its keyframes, and the sequence they give.

``runtime.composing`` says what a frame looks like. Here frames are kept until an edit makes them stale, and made again:
at once that which is looked at, and all others a few at a time, so that an edit in between never waits long.

Every keyframe has the intrinsic parameters that it is of or nearest to. Changing one of them moves z as far as the z of
the parameters moves, so that a shape keeps what it has beyond its parameters.
"""

from __future__ import annotations

import threading
from collections import deque
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
from scipy.ndimage import gaussian_filter

from app.frames import Frames, Look
from app.materials import Material, check_trained, nearest_parameters
from formats.animation import Animation
from formats.keyframe import read_keyframe
from formats.motion_file import read_motion
from motions.clip import Clip
from runtime.asked_motion import asked_motion
from runtime.composing import Composer
from runtime.dressing import Wearing, dressed_animation
from runtime.finished_run import FinishedRun
from runtime.intrinsic_space import IntrinsicSpace
from runtime.keyframes import Keyframe

FRAMES = 240
"""Length of a generated motion, at first."""

LONGEST = 3000
"""Frames of a motion, at most: a hundred seconds at 30 frames a second."""

BLOCK = 8
"""Frames that are decoded at once."""

WORKERS = 2
"""Threads that make frames again: most of the time is spent outside of Python's lock."""


STEADY = 0.2
"""Seconds over which the path of the body is smoothed."""


class Session:
    """One user's work on a finished run. Methods may be called from any thread.

    Attributes:
        path: Where the body is on the ground, without its sway, shape [T, 3] [m].

    Args:
        run: The finished run.
        garment: Garment to begin with; the run's first where None.
        motion: Motion to begin with: a label, a clip of the run or a file; the generator's first label where None.
        frames: Length of a motion that is made of a label.
        seed: Of that motion.

    Raises:
        ValueError: The run lacks what is needed, and what to run; an unknown garment or motion, and what is known.
    """

    def __init__(
        self,
        run: FinishedRun,
        garment: str | None = None,
        motion: str | None = None,
        frames: int = FRAMES,
        seed: int = 0,
    ) -> None:
        self.run = run
        self.garments = tuple(run.config["garments"])
        self.labels = tuple(run.generator.config.labels)
        self.refine = True
        self._composer: Composer | None = None
        self._work = threading.RLock()
        space = IntrinsicSpace(run.garment(garment or self.garments[0]))
        clip = asked_motion(run, motion or self.labels[0], None, frames, seed)
        self._start(Composer(space, self._checked(clip)), {})

    @property
    def garment(self) -> str:
        """Name of the garment."""
        return self._composer.space.garment.name

    @property
    def faces(self) -> np.ndarray:
        """Triangles of the garment, shape [F, 3]."""
        return self._composer.space.garment.template.faces

    @property
    def clip(self) -> Clip:
        """The motion."""
        return self._composer.clip

    @property
    def frames(self) -> int:
        """Length of the motion T."""
        return self._composer.frames

    @property
    def ranges(self) -> dict[str, tuple[float, float]]:
        """Intrinsic parameters that the model was told, and between what it was trained."""
        ranges = self._composer.space.garment.ranges
        return {name: ranges[name] for name in self._composer.space.tellable}

    @property
    def keyframes(self) -> tuple[Keyframe, ...]:
        """The keyframes by frame number."""
        return self._composer.keyframes

    @property
    def made(self) -> float:
        """Share of the frames that are as the keyframes say."""
        return self._frames.share

    def keyframe(self, frame: int) -> Keyframe | None:
        """The keyframe of a frame, or None."""
        return next((key for key in self.keyframes if key.frame == frame), None)

    def parameters_at(self, frame: int) -> dict[str, float]:
        """The intrinsic parameters that the garment has in a frame, or is nearest to."""
        return dict(self._material_at(frame).parameters)

    def latent(self, frame: int) -> np.ndarray:
        """z of a frame, shape [Z]."""
        self._check_frame(frame)
        return self._composer.latents(np.array([frame]))[0]

    def insert(self, frame: int) -> Keyframe:
        """A keyframe of the shape that the frame has at present: nothing changes until it is edited."""
        self._check_frame(frame)
        there = self.keyframe(frame)
        if there is not None:
            return there
        material = self._material_at(frame)
        origin = "material" if material.exact else "shape in between"
        return self._put(Keyframe(frame, self.latent(frame), None, origin), material)

    def insert_latent(self, frame: int, latent: np.ndarray, origin: str) -> Keyframe:
        """A keyframe of a point of the latent space, such as a candidate; takes the place of one that is there."""
        self._check_frame(frame)
        parameters = nearest_parameters(self._composer.space, latent)
        return self._put(Keyframe(frame, latent, None, origin), Material(parameters, False))

    def insert_parameters(self, frame: int, changed: Mapping[str, float]) -> Keyframe:
        """A keyframe with some intrinsic parameters changed; the rest of what it is stays.

        Raises:
            ValueError: A parameter or a value that the model was not trained on; says between what it was.
        """
        before, there = self._material_at(frame), self.keyframe(frame)
        check_trained(self.garment, self.ranges, changed)
        after = dict(before.parameters) | {name: float(value) for name, value in changed.items()}
        latent = self._latent_of(after)
        if not before.exact:
            latent = self.latent(frame) + latent - self._latent_of(before.parameters)
        origin = "material" if there is None or before.exact else there.origin.removesuffix(", changed") + ", changed"
        detail = None if there is None else there.detail
        return self._put(Keyframe(frame, latent, detail, origin), Material(after, before.exact))

    def insert_mesh(self, frame: int, path: Path) -> Keyframe:
        """A keyframe of a mesh file: the garment's own mesh in another shape, on the body as it is in that frame.

        Raises:
            ValueError: Not such a mesh; one sentence that names the file.
        """
        self._check_frame(frame)
        vertices = read_keyframe(path, self.faces, len(self._composer.space.garment.template.vertices))
        with self._work:
            key = self._composer.add_shape(frame, vertices, origin=path.name)
        return self._put(key, Material(nearest_parameters(self._composer.space, key.latent), False))

    def delete(self, frame: int) -> None:
        """Take a keyframe away; ``ValueError`` lists them where there is none."""
        with self._work:
            self._composer.delete(frame)
            self._materials.pop(frame, None)
            self._frames.edited()

    def move(self, frame: int, to: int) -> Keyframe:
        """Move a keyframe to another frame that has none."""
        if to != frame and self.keyframe(to) is not None:
            raise ValueError(f"frame {to} has a keyframe already; delete it first")
        with self._work:
            key = self._composer.move(frame, to)
            self._materials[key.frame] = self._materials.pop(frame)
            self._frames.edited()
        return key

    def candidates(self, seeds: range) -> np.ndarray:
        """Points of the latent space where garments of sampled materials are, shape [n, Z]."""
        return np.stack([self._composer.space.candidate(seed) for seed in seeds])

    def look_of(self, frame: int, latents: np.ndarray) -> list[Look]:
        """What garments of each of ``latents [n, Z]`` look like in a frame."""
        self._check_frame(frame)
        with self._work:
            made = [self._composer.alone(latent).frame(frame, self.refine) for latent in latents]
        return [Look.of(frame, one) for one in made]

    def look(self, frame: int) -> Look:
        """A frame as it is now; made at once where it is stale."""
        self._check_frame(frame)
        frames = self._frames
        version, kept = frames.kept(frame)
        if kept is not None:
            return kept
        with self._work:
            return frames.keep(Look.of(frame, self._composer.frame(frame, self.refine)), version)

    def remake(self, first: int = 0, progress: Callable[[float], None] | None = None) -> bool:
        """Make all stale frames, from ``first`` on and then those before it, on two threads.

        Args:
            first: Where to begin, such as the frame that is looked at.
            progress: Told the share of frames that are made; from any thread.

        Returns:
            Whether all are; False where an edit came in between.
        """
        with self._work:
            frames, refine = self._frames, self.refine
            version, stale = frames.version, frames.stale(first)
            twins = [self._composer.twin(refiner) for refiner in self._refiners]
        blocks = deque(stale[start : start + BLOCK] for start in range(0, len(stale), BLOCK))

        def outdated() -> bool:
            return frames is not self._frames or version != frames.version

        def work(composer: Composer) -> None:
            while True:
                try:
                    block = blocks.popleft()
                except IndexError:
                    return
                for frame, made in zip(block, composer.some_frames(block, refine), strict=True):
                    frames.keep(Look.of(int(frame), made), version)
                    if outdated():
                        return
                if progress:
                    progress(frames.share)

        with ThreadPoolExecutor(WORKERS) as pool:
            for done in [pool.submit(work, twin) for twin in twins]:
                done.result()
        return not outdated() and frames.all_made

    def set_refine(self, on: bool) -> None:
        """Whether garments are taken out of the body."""
        if on != self.refine:
            with self._work:
                self.refine = on
                self._frames.edited()

    def use_garment(self, name: str) -> list[int]:
        """Another garment. Keyframes that are materials go with it; what other keyframes are, it does not know.

        Returns:
            Frames of the keyframes that were given up.
        """
        composer = Composer(IntrinsicSpace(self.run.garment(name)), self.clip)
        with self._work:
            given_up = [key.frame for key in self.keyframes if not self._materials[key.frame].exact]
            kept = {frame: m.parameters for frame, m in self._materials.items() if m.exact}
            self._start(composer, {})
            for frame, parameters in sorted(kept.items()):
                asked = {name: parameters[name] for name in self.ranges if name in parameters}
                fitting = {name: float(np.clip(value, *self.ranges[name])) for name, value in asked.items()}
                values = self._base() | fitting
                self._put(Keyframe(frame, self._latent_of(values), None, "material"), Material(values, True))
        return given_up

    def use_label(self, label: str, frames: int, seed: int) -> None:
        """A generated motion in place of this one; see :meth:`use_clip`."""
        if label not in self.labels:
            raise ValueError(f"label {label!r} is unknown; known labels: {', '.join(self.labels)}")
        if not 2 <= frames <= LONGEST:
            raise ValueError(f"a motion of {frames} frames: allowed are 2 to {LONGEST}")
        self.use_clip(asked_motion(self.run, label, None, frames, seed))

    def use_motion_file(self, path: Path, name: str | None = None) -> None:
        """The motion of a file in place of this one: BVH, AMASS or our own; see :meth:`use_clip`.

        Args:
            path: The file.
            name: Which clip, of a file that holds several.
        """
        self.use_clip(read_motion(path, self.run.fps, self.run.body, name))

    def use_clip(self, clip: Clip) -> None:
        """Another motion. Keyframes stay what they are, at the same share of its length.

        Raises:
            ValueError: It is too long or too short.
        """
        with self._work:
            composer = self._composer.with_motion(self._checked(clip))
            scale = (composer.frames - 1) / (self.frames - 1)
            self._start(composer, {round(frame * scale): m for frame, m in sorted(self._materials.items())})

    def animation(self) -> Animation:
        """All of it, to be saved; frames that are stale are made first."""
        while True:
            self.remake()
            with self._work:
                if self._frames.all_made:
                    return self._animation()

    def _animation(self) -> Animation:
        garments, bodies = self._frames.stacked()
        notes: dict[str, str | float] = {"solver": "composed"}
        notes |= {f"keyframe_{key.frame}": key.origin for key in self.keyframes}
        wearing = Wearing(self._composer.space.garment)
        name = f"{self.garment}_{self.clip.name}"
        return dressed_animation(name, self.clip, wearing, garments, bodies, notes)

    @staticmethod
    def _checked(clip: Clip) -> Clip:
        if not 2 <= clip.frames <= LONGEST:
            raise ValueError(f"motion '{clip.name}' has {clip.frames} frames, allowed are 2 to {LONGEST}")
        return clip

    def _start(self, composer: Composer, materials: dict[int, Material]) -> None:
        """Begin with another garment or motion."""
        before, clip = self._composer, composer.clip
        if before is None or before.space is not composer.space:
            garment = composer.space.garment
            self._refiners = [garment.refiner(composer.body) for _ in range(WORKERS)]
        pelvis = (self.run.body.joints[0] + clip.root) * (1.0, 0.0, 1.0)
        self.path = gaussian_filter(pelvis, (STEADY * clip.fps, 0.0), mode="nearest")
        self._composer, self._materials, self._frames = composer, materials, Frames(composer.frames)

    def _put(self, key: Keyframe, material: Material) -> Keyframe:
        with self._work:
            key = self._composer.add(key)
            self._materials[key.frame] = material
            self._frames.edited()
        return key

    def _material_at(self, frame: int) -> Material:
        self._check_frame(frame)
        if frame in self._materials:
            return self._materials[frame]
        if not self._materials:
            return Material(self._base(), True)
        # Before the first keyframe and after the last there is what they are.
        ends = min(self._materials), max(self._materials)
        if not ends[0] < frame < ends[1]:
            return self._materials[ends[0] if frame < ends[0] else ends[1]]
        return Material(nearest_parameters(self._composer.space, self.latent(frame)), False)

    def _base(self) -> dict[str, float]:
        base = self._composer.space.garment.base_parameters
        return {name: float(base[name]) for name in self.ranges}

    def _latent_of(self, values: Mapping[str, float]) -> np.ndarray:
        space = self._composer.space
        return space.of_parameters(dict(space.garment.base_parameters) | dict(values))

    def _check_frame(self, frame: int) -> None:
        if not 0 <= frame < self.frames:
            raise ValueError(f"frame {frame} is outside of the motion, whose frames are 0 to {self.frames - 1}")
