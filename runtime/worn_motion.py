"""A motion as a body of some shape makes it in a garment: what composing needs of it and no keyframe changes.

In: a garment's intrinsic space, a clip of the run's own body, perhaps another body shape. Out: bodies, signatures of
the motion as the autoencoder takes them, and the ways between the world and the own body's canonical garments.

On another body than the run's own, shapes are brought to the own body and back (``models.other_bodies``).

Dimensions: T frames, n of them that are asked for, V garment vertices, B body vertices, D signature.
"""

from __future__ import annotations

from functools import cached_property

import numpy as np

from models.motion_features import MotionTrack
from models.other_bodies import OtherBody
from motions.clip import Clip
from motions.looping import exact_loop, rounds_before
from runtime.dressing import Wearing
from runtime.intrinsic_space import IntrinsicSpace
from runtime.lazy_rows import LazyRows
from runtime.motion_making import clip_track, on_body


class WornMotion:
    """Each part is computed when it is first asked for, and then kept; bodies and garments a few frames at a time.

    Attributes:
        given: The clip as it was given, of the run's own body.
        clip: The clip as the body that wears the garment makes it.
        wearing: Garment and body.
        body: The body that wears the garment.

    Args:
        space: The garment's intrinsic space.
        clip: Motion of the run's own body, at the run's frame rate.
        shape: Shape coefficients of the body [standard deviations]; the run's own where None.
        loop: Whether the clip is a loop, whose last frame is its first; the garment is then one too.

    Raises:
        ValueError: The motion has another frame rate than the run.
    """

    def __init__(self, space: IntrinsicSpace, clip: Clip, shape: np.ndarray | None = None, loop: bool = False) -> None:
        run = space.garment.run
        if clip.fps != run.fps:
            raise ValueError(f"motion '{clip.name}' has {clip.fps:g} frames a second, {run.folder} has {run.fps:g}")
        self.space, self.given, self.shape, self.loop = space, clip, shape, loop
        self.wearing = Wearing(space.garment, None, shape)
        self.body = self.wearing.body
        worn = clip if shape is None else on_body(clip, run.body, self.body)
        self.clip = exact_loop(worn) if loop else worn

    @property
    def frames(self) -> int:
        """Number of frames T."""
        return self.clip.frames

    def prepare(self) -> None:
        """Compute now what all frames share, before several threads ask."""
        _ = self.signatures, self.change, self._pelvis, self.bodies

    @cached_property
    def bodies(self) -> LazyRows:
        """The body in the world [m], rows [T, B, 3]."""
        clip = self.clip
        return LazyRows(self.frames, lambda part: self.body.posed(clip.pose[part], clip.root[part]).astype(np.float32))

    @cached_property
    def signatures(self) -> np.ndarray:
        """What the autoencoder is told of the motion, shape [T, D]."""
        own = self._track if self._other is None else self._other.own_track(self._track)
        rows = self.space.signatures(own)
        if self.loop:
            rows[-1] = rows[0]
        return rows

    @cached_property
    def change(self) -> LazyRows:
        """From the own body's canonical garments to those of the body that wears them, rows [T, V or 1, 3] [m]."""
        track, other = self._track, self._other

        def rows(part: slice) -> np.ndarray:
            if other is None:
                return np.zeros((part.stop - part.start, 1, 3), dtype=np.float32)  # broadcasts over the vertices
            frames = slice(track.lead + part.start, track.lead + part.stop)
            return other.change(MotionTrack(track.pose[frames], track.joints[frames], 0, track.fps))

        return LazyRows(self.frames, rows)

    def checked(self, frame: int, wrap: bool = True) -> int:
        """A frame number as it counts: the last of a loop is its first.

        Raises:
            ValueError: It is outside of the motion.
        """
        if isinstance(frame, bool) or int(frame) != frame or not 0 <= frame < self.frames:
            raise ValueError(f"frame {frame}: the motion '{self.clip.name}' has the frames 0 to {self.frames - 1}")
        return int(frame) % (self.frames - 1) if self.loop and wrap else int(frame)

    def own(self, world: np.ndarray, numbers: np.ndarray) -> np.ndarray:
        """Canonical garments [n, V, 3] [m] on the run's own body, of those in the world in frames ``numbers [n]``."""
        rotation, position = (part[numbers] for part in self._pelvis)
        canonical = np.matmul(world - position[:, None], rotation)
        return (canonical - self.change[numbers]).astype(np.float32)

    def world(self, canonical: np.ndarray, numbers: np.ndarray) -> np.ndarray:
        """World garments [n, V, 3] [m] of canonical ones in the frames ``numbers [n]``."""
        rotation, position = (part[numbers] for part in self._pelvis)
        return (np.matmul(canonical, np.swapaxes(rotation, 1, 2)) + position[:, None]).astype(np.float32)

    def carried(self, first: np.ndarray) -> np.ndarray:
        """The garment [V, 3] [m] of the first frame where the loop has taken the body to."""
        (rotation, position), clip = self._pelvis, self.clip
        if np.array_equal(clip.pose[0], clip.pose[-1]) and np.array_equal(clip.root[0], clip.root[-1]):
            return first
        return ((first - position[0]) @ rotation[0] @ rotation[-1].T + position[-1]).astype(np.float32)

    def largest_step(self, world: np.ndarray) -> float:
        """Largest way of a vertex of ``world [T, V, 3]`` from a frame to the next, in the frame of the pelvis [m]."""
        rotation, position = self._pelvis
        canonical = np.matmul(world - position[:, None], rotation)
        return float(np.linalg.norm(np.diff(canonical, axis=0), axis=2).max())

    @cached_property
    def _track(self) -> MotionTrack:
        run = self.space.garment.run
        if not self.loop:
            return clip_track(self.clip, self.body, run.lead_in)
        # A loop has no beginning: what came before is what comes after.
        lead = rounds_before(self.clip, self.space.network.config.window + 2, self.body)
        return MotionTrack.from_motion(self.body, self.clip.pose, self.clip.root, *lead, self.clip.fps)

    @cached_property
    def _other(self) -> OtherBody | None:
        garment = self.space.garment
        if self.shape is None:
            return None
        return OtherBody(garment.template, garment.run.body, self.body, garment.grader)

    @cached_property
    def _pelvis(self) -> tuple[np.ndarray, np.ndarray]:
        lead = self._track.lead
        rotation, position = self._track.pelvis_frames()
        return rotation[lead:].astype(np.float32), position[lead:].astype(np.float32)
