"""Composing a garment animation from keyframes (Wang 2019, section 4, "Application: garment animation authoring").

In: a garment's intrinsic space, a motion and keyframes. Out: single frames at once, and whole animations. Every
keyframe becomes a latent z; z is interpolated, decoded along the motion, and refined, so that no vertex is inside the
body (section 3.5). A keyframe that was given as a shape keeps its own detail there (``runtime.keyframes``).

What hangs on the motion and the body alone is in ``runtime.worn_motion``.

    space = IntrinsicSpace(FinishedRun.open("results/default").garment("skirt"))
    composer = Composer(space, clip)
    composer.add_parameters(0, material(space.garment, ["bend=8e-5"], True))
    composer.add_candidate(59, seed=7)
    composer.frame(30).vertices
    composer.compose().animation
"""

from __future__ import annotations

import copy
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from body.model import Body
from formats.animation import Animation, plain_name
from models.refinement import Refiner
from motions.clip import Clip
from runtime.dressing import dressed_animation
from runtime.intrinsic_space import IntrinsicSpace
from runtime.keyframes import HOLD, Interpolation, Keyframe
from runtime.worn_motion import WornMotion

BATCH = 32
"""Frames that are decoded at once, between two reports of progress."""

OnProgress = Callable[[int, int], None]
"""Takes the frames that are done and those of the whole."""


@dataclass(frozen=True)
class ComposedFrame:
    """One frame.

    Attributes:
        vertices: Garment in the world [m], shape [V, 3] float32.
        body: Body in the world [m], shape [B, 3].
        inside: Vertices that are inside the body before refinement, shape [V].
    """

    vertices: np.ndarray
    body: np.ndarray
    inside: np.ndarray


@dataclass(frozen=True)
class Composed:
    """A whole composed animation.

    Attributes:
        animation: Garment and body.
        inside: Share of the garment's vertices inside the body before refinement [1].
        inside_after: Vertices inside at the end; 0 after refinement.
        largest_step: Largest way of a vertex from a frame to the next, in the frame of the pelvis [m].
    """

    animation: Animation
    inside: float
    inside_after: int
    largest_step: float


class Composer:
    """A motion, a garment and its keyframes. Without keyframes, the garment is of the base material.

    Attributes:
        worn: The motion on the body that wears the garment.

    Args:
        space: The garment's intrinsic space.
        clip: Motion of the run's own body, at the run's frame rate.
        shape: Shape coefficients of the body [standard deviations]; the run's own where None.
        hold: Seconds in which the detail of a given shape fades; 0 for the paper's interpolation, without any.
        loop: Whether the clip is a loop, whose last frame is its first; the garment is then one too.
        refiner: Of this garment, on whatever body; a new one where None.

    Raises:
        ValueError: The motion has another frame rate than the run.
    """

    def __init__(
        self,
        space: IntrinsicSpace,
        clip: Clip,
        shape: np.ndarray | None = None,
        hold: float = HOLD,
        loop: bool = False,
        refiner: Refiner | None = None,
    ) -> None:
        self.worn = WornMotion(space, clip, shape, loop)
        if not 0.0 <= hold < 1e6:
            raise ValueError(f"hold: {hold:g} s, allowed are 0 and more")
        self.space, self.hold = space, hold
        self._refiner = refiner or space.garment.refiner(self.body)
        self._keyframes: dict[int, Keyframe] = {}
        self._interpolation: Interpolation | None = None

    @property
    def clip(self) -> Clip:
        """The motion as the body that wears the garment makes it."""
        return self.worn.clip

    @property
    def body(self) -> Body:
        """The body that wears the garment."""
        return self.worn.body

    @property
    def frames(self) -> int:
        """Number of frames T."""
        return self.worn.frames

    @property
    def keyframes(self) -> tuple[Keyframe, ...]:
        """In the order of their frames."""
        return tuple(self._keyframes[frame] for frame in sorted(self._keyframes))

    def add(self, keyframe: Keyframe) -> Keyframe:
        """Set a keyframe; it takes the place of one at the same frame.

        Raises:
            ValueError: Its frame is outside of the motion, its latent or its detail is of another garment.
        """
        frame = self.worn.checked(keyframe.frame)
        latent = np.asarray(keyframe.latent, dtype=np.float32)
        if latent.shape != (self.space.network.config.latent,) or not np.isfinite(latent).all():
            raise ValueError(
                f"keyframe at {keyframe.frame}: a latent must be {self.space.network.config.latent} finite numbers, "
                f"got shape {list(latent.shape)}"
            )
        shape = (len(self.space.garment.template.vertices), 3)
        if keyframe.detail is not None and keyframe.detail.shape != shape:
            raise ValueError(f"keyframe at {keyframe.frame}: detail must be of shape {list(shape)}")
        self._keyframes[frame] = Keyframe(frame, latent, keyframe.detail, keyframe.origin)
        self._interpolation = None
        return self._keyframes[frame]

    def add_parameters(self, frame: int, parameters: Mapping[str, float] | None = None, origin: str = "") -> Keyframe:
        """A keyframe of intrinsic parameters (all of them; the base material's where None)."""
        self.worn.checked(frame)
        return self.add(Keyframe(frame, self.space.of_parameters(parameters), None, origin or "parameters"))

    def add_candidate(self, frame: int, seed: int) -> Keyframe:
        """A keyframe drawn from the latent space."""
        self.worn.checked(frame)
        return self.add(Keyframe(frame, self.space.candidate(seed), None, f"candidate {seed}"))

    def add_shape(self, frame: int, vertices: np.ndarray, canonical: bool = False, origin: str = "") -> Keyframe:
        """A keyframe of a given garment shape.

        Args:
            frame: Its number.
            vertices: Garment on the body's pose of that frame [m], shape [V, 3].
            canonical: Whether they are in the frame of the pelvis and not in the world.
            origin: Where they come from, in words.
        """
        number = self.worn.checked(frame)
        count = len(self.space.garment.template.vertices)
        if np.shape(vertices) != (count, 3):
            raise ValueError(
                f"keyframe at {frame}: has {len(vertices)} vertices, '{self.space.garment.name}' has {count}"
            )
        world = self.in_world(vertices, number) if canonical else np.asarray(vertices)
        own = self.worn.own(world[None], np.array([number]))
        signature = self.worn.signatures[number : number + 1]
        latent = self.space.encode(own, signature)
        detail = own[0] - self.space.decode(latent, signature)[0]
        return self.add(Keyframe(frame, latent, detail, origin or "shape"))

    def move(self, frame: int, to: int) -> Keyframe:
        """Take a keyframe to another frame; one that stands there is replaced.

        Raises:
            ValueError: There is none, or the new frame is outside of the motion.
        """
        keyframe = self._existing(frame)
        target = self.worn.checked(to)
        del self._keyframes[keyframe.frame]
        return self.add(keyframe.at(target))

    def delete(self, frame: int) -> None:
        """Take a keyframe away; ``ValueError`` where there is none."""
        del self._keyframes[self._existing(frame).frame]
        self._interpolation = None

    def use(self, keyframes: Iterable[Keyframe]) -> None:
        """Have these keyframes, at different frames, and no others.

        Raises:
            ValueError: As :meth:`add`; then those that there were are kept.
        """
        before, self._keyframes = self._keyframes, {}
        try:
            for keyframe in keyframes:
                self.add(keyframe)
        except ValueError:
            self._keyframes = before
            raise
        self._interpolation = None

    def alone(self, latent: np.ndarray) -> Composer:
        """The same motion with one z throughout and no other keyframe; it shares what was computed for this one."""
        other = self._sharing_copy()
        other._keyframes, other._interpolation = {}, None
        other.add(Keyframe(0, latent, None, "latent"))
        return other

    def in_world(self, canonical: np.ndarray, frame: int) -> np.ndarray:
        """World vertices [V, 3] [m] of canonical ones at a frame.

        Raises:
            ValueError: It is outside of the motion.
        """
        return self.worn.world(np.asarray(canonical)[None], np.array([self.worn.checked(frame, wrap=False)]))[0]

    def evidence(self, vertices: np.ndarray, numbers: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """What given garments ``vertices [n, V, 3]`` [m] in the world say of z in the frames ``numbers [n]``.

        Returns:
            Values and weights, [n, Z] each.

        Raises:
            ValueError: A frame is outside of the motion.
        """
        frames = np.array([self.worn.checked(int(number), wrap=False) for number in numbers])
        return self.space.evidence(self.worn.own(vertices, frames), self.worn.signatures[frames])

    def latents(self, frames: np.ndarray | None = None) -> np.ndarray:
        """z [n, Z] of the frames, all where None."""
        asked = np.arange(self.frames) if frames is None else np.asarray(frames)
        return self._between.latents(asked)

    def frame(self, number: int, refine: bool = True) -> ComposedFrame:
        """One frame, at once.

        Raises:
            ValueError: It is outside of the motion.
        """
        return next(self.some_frames([self.worn.checked(number, wrap=False)], refine))

    def some_frames(self, numbers: Sequence[int], refine: bool = True) -> Iterator[ComposedFrame]:
        """Some frames in turn, decoded together and refined one by one as they are asked for.

        Raises:
            ValueError: One is outside of the motion.
        """
        asked = np.array([self.worn.checked(int(number), wrap=False) for number in numbers], dtype=np.int64)
        for number, vertices in zip(asked, self.worn.world(self._canonical(asked), asked), strict=True):
            under = self.worn.bodies[number]
            posed = self._refiner.body.at(under)
            hits = self._refiner.near(vertices, posed)
            if refine:
                vertices = self._refiner.refine_hits(vertices, posed, hits)[0].astype(np.float32)
            yield ComposedFrame(vertices, under, hits.distance < 0.0)

    def twin(self, refiner: Refiner) -> Composer:
        """The same keyframes on the same motion, for another thread; later changes of the one do not reach the other.

        Args:
            refiner: Of this garment; a refiner is no thing for two threads.
        """
        other = self._sharing_copy()
        other._refiner, other._keyframes = refiner, dict(self._keyframes)
        return other

    def compose(self, refine: bool = True, progress: OnProgress | None = None) -> Composed:
        """The whole animation.

        Args:
            refine: Whether the garment is taken out of the body.
            progress: Called after every batch of frames.
        """
        frames = self.frames
        made = np.empty((frames, len(self.space.garment.template.vertices), 3), dtype=np.float32)
        inside = left = 0
        different = frames - 1 if self.worn.loop else frames
        for start in range(0, different, BATCH):
            numbers = np.arange(start, min(start + BATCH, different))
            world = self.worn.world(self._canonical(numbers), numbers)
            for number, vertices in zip(numbers, world, strict=True):
                posed = self._refiner.body.at(self.worn.bodies[number])
                hits = self._refiner.near(vertices, posed)
                count = int((hits.distance < 0.0).sum())
                inside += count
                if refine:
                    vertices, stats = self._refiner.refine_hits(vertices, posed, hits)
                    left += stats.inside_after
                else:
                    left += count
                made[number] = vertices
            if progress is not None:
                progress(min(start + BATCH, different), different)
        if self.worn.loop:
            made[-1] = self.worn.carried(made[0])
        notes: dict[str, str | float] = {"solver": "composed", "keyframes": self._listed(), "loop": str(self.worn.loop)}
        name = plain_name(f"{self.space.garment.name}_{self.clip.name}")
        animation = dressed_animation(name, self.clip, self.worn.wearing, made, self.worn.bodies.all(), notes)
        return Composed(animation, inside / (different * made.shape[1]), left, self.worn.largest_step(made))

    def _sharing_copy(self) -> Composer:
        # What hangs on the motion alone is computed once for both.
        self.worn.prepare()
        _ = self._between
        return copy.copy(self)

    def _canonical(self, numbers: np.ndarray) -> np.ndarray:
        """Canonical garments [n, V, 3] of some frames, before refinement."""
        shapes = self.space.decode(self.latents(numbers), self.worn.signatures[numbers])
        for row, number in enumerate(numbers):
            detail = self._between.detail(int(number))
            if detail is not None:
                shapes[row] += detail
        return shapes + self.worn.change[numbers]

    def _listed(self) -> str:
        return "; ".join(f"{k.frame}: {k.origin}" for k in self.keyframes) or "none: base material"

    def _existing(self, frame: int) -> Keyframe:
        number = self.worn.checked(frame)
        if number not in self._keyframes:
            known = ", ".join(str(k.frame) for k in self.keyframes) or "none"
            raise ValueError(f"frame {frame}: there is no keyframe; there are: {known}")
        return self._keyframes[number]

    @property
    def _between(self) -> Interpolation:
        if self._interpolation is None:
            keyframes = self.keyframes or (Keyframe(0, self.space.of_parameters(), None, "base material"),)
            period = self.frames - 1 if self.worn.loop else None
            self._interpolation = Interpolation(keyframes, self.hold * self.clip.fps, period)
        return self._interpolation
