"""What is being made in the app, without a browser: a garment on a body in a motion, its keyframes, what they give.

``runtime.composing`` says what a frame looks like, ``app.keys`` what a keyframe is, ``app.making`` makes the frames.
Here they are one piece of work, which any thread may change, and of which every change can be undone.
"""

from __future__ import annotations

from collections.abc import Callable, Hashable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from app.body_shape import BodyShapes
from app.frames import Look
from app.history import History, Step
from app.keys import Keys
from app.making import WORKERS, Making
from app.materials import Material
from app.motions import FRAMES, checked_length
from app.turns import Turns
from app.wardrobe import Wardrobe
from body.model import Body
from formats.animation import Animation
from formats.keyframe import read_keyframe
from motions.clip import Clip
from motions.quality import measure
from runtime.asked_motion import asked_motion
from runtime.composing import Composer
from runtime.dressing import dressed_animation
from runtime.finished_run import FinishedRun
from runtime.keyframes import Keyframe
from runtime.motion_making import planted


@dataclass(frozen=True, eq=False)
class State:
    """All that an edit can change; nothing of it is ever changed itself.

    Attributes:
        garment: Name of the garment.
        clip: The motion, of the run's own body.
        shape: Shape coefficients of the body [standard deviations]; None for the run's own.
        keyframes: By frame number.
        materials: Of each keyframe, by frame.
        refine: Whether garments are taken out of the body.
    """

    garment: str
    clip: Clip
    shape: np.ndarray | None
    keyframes: tuple[Keyframe, ...]
    materials: Mapping[int, Material]
    refine: bool


class Session:
    """One user's work on a finished run. Methods may be called from any thread.

    Attributes:
        shapes: Body shapes that the run's models know.

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
        self.run, self.shapes = run, BodyShapes(run)
        self.garments = tuple(run.config["garments"])
        self.labels = tuple(run.generator.config.labels)
        self._wardrobe = Wardrobe(run, WORKERS)
        self._turns = Turns()
        self._history: History[State] = History()
        self._making: Making | None = None
        first = garment or self.garments[0]
        self._wardrobe.load(first)
        clip = checked_length(asked_motion(run, motion or self.labels[0], None, frames, seed))
        self._begin(Keys(self._wardrobe.composer(first, clip, None), {}), refine=True)

    @property
    def garment(self) -> str:
        """Name of the garment."""
        return self._keys.composer.space.garment.name

    @property
    def faces(self) -> np.ndarray:
        """Triangles of the garment, shape [F, 3]."""
        return self._keys.composer.space.garment.template.faces

    @property
    def clip(self) -> Clip:
        """The motion, as the body that wears the garment makes it."""
        return self._keys.composer.clip

    @property
    def frames(self) -> int:
        """Length of the motion T."""
        return self._keys.composer.frames

    @property
    def body(self) -> Body:
        """The body that wears the garment."""
        return self._keys.composer.body

    @property
    def shape(self) -> np.ndarray:
        """Shape coefficients of that body [standard deviations], shape [5 or more]."""
        shape = self._keys.composer.worn.shape
        return self.shapes.own if shape is None else shape

    @property
    def ranges(self) -> dict[str, tuple[float, float]]:
        """Intrinsic parameters that the model was told, and between what it was trained."""
        return self._keys.ranges

    @property
    def keyframes(self) -> tuple[Keyframe, ...]:
        """The keyframes by frame number."""
        return self._keys.all

    @property
    def path(self) -> np.ndarray:
        """Where the body is on the ground, without its sway, shape [T, 3] [m]."""
        return self._making.path

    @property
    def refine(self) -> bool:
        """Whether garments are taken out of the body."""
        return self._making.refine

    @property
    def made(self) -> float:
        """Share of the frames that are as the keyframes say."""
        return self._making.share

    @property
    def undoable(self) -> str | None:
        """What would be undone, in words; None where there is nothing."""
        return self._history.undoable

    @property
    def redoable(self) -> str | None:
        """What would be made again, in words; None where there is nothing."""
        return self._history.redoable

    def keyframe(self, frame: int) -> Keyframe | None:
        """The keyframe of a frame, or None."""
        return self._keys.at(frame)

    def parameters_at(self, frame: int) -> dict[str, float]:
        """The intrinsic parameters that the garment has in a frame, or is nearest to."""
        self._check_frame(frame)
        with self._turns.work:
            return dict(self._keys.material_at(frame).parameters)

    def latent(self, frame: int) -> np.ndarray:
        """z of a frame, shape [Z]."""
        self._check_frame(frame)
        return self._keys.latent(frame)

    def insert(self, frame: int) -> Keyframe:
        """A keyframe of the shape that the frame has at present: nothing changes until it is edited."""
        self._check_frame(frame)
        with self._turns.work:
            there = self._keys.at(frame)
            if there is not None:
                return there
            with self._edit(f"keyframe at frame {frame}", frame):
                return self._keys.insert(frame)

    def insert_latent(self, frame: int, latent: np.ndarray, origin: str) -> Keyframe:
        """A keyframe of a point of the latent space, such as a candidate; takes the place of one that is there."""
        self._check_frame(frame)
        with self._edit(f"{origin} at frame {frame}", frame):
            return self._keys.insert_latent(frame, latent, origin)

    def insert_parameters(self, frame: int, changed: Mapping[str, float]) -> Keyframe:
        """A keyframe with some intrinsic parameters changed; the rest of what it is stays. Moved without a pause, they
        are one edit.

        Raises:
            ValueError: A parameter or a value that the model was not trained on; says between what it was.
        """
        self._check_frame(frame)
        names = ", ".join(name.replace("_", " ") for name in changed)
        with self._edit(f"{names} at frame {frame}", frame, (frame, *changed)):
            return self._keys.insert_parameters(frame, changed)

    def insert_mesh(self, frame: int, path: Path) -> Keyframe:
        """A keyframe of a mesh file: the garment's own mesh in another shape, on the body as it is in that frame.

        Raises:
            ValueError: Not such a mesh; one sentence that names the file.
        """
        self._check_frame(frame)
        vertices = read_keyframe(path, self.faces, len(self._keys.composer.space.garment.template.vertices))
        with self._edit(f"{path.name} at frame {frame}", frame):
            return self._keys.insert_shape(frame, vertices, path.name)

    def delete(self, frame: int) -> None:
        """Take a keyframe away; ``ValueError`` lists them where there is none."""
        with self._edit(f"keyframe {frame} deleted", frame):
            self._keys.delete(frame)

    def move(self, frame: int, to: int) -> Keyframe:
        """Move a keyframe to another frame; ``ValueError`` where there is none, or the other has one."""
        with self._turns.work:
            there = self._keys.at(frame)
            if to == frame and there is not None:
                return there
            with self._edit(f"keyframe {frame} moved to {to}", frame):
                return self._keys.move(frame, to)

    def candidates(self, seeds: range) -> np.ndarray:
        """Points of the latent space where garments of sampled materials are, shape [n, Z]."""
        return np.stack([self._keys.composer.space.candidate(seed) for seed in seeds])

    def look_of(self, frame: int, latents: np.ndarray) -> list[Look]:
        """What garments of each of ``latents [n, Z]`` look like in a frame."""
        self._check_frame(frame)
        return self._making.looks_of(frame, latents)

    def look(self, frame: int) -> Look:
        """A frame as it is now; made at once where it is stale."""
        self._check_frame(frame)
        return self._making.look(frame)

    def remake(self, first: int = 0, progress: Callable[[float], None] | None = None) -> bool:
        """Make all stale frames; see ``Making.remake``. False where an edit came in between."""
        making = self._making
        return making.remake(first, progress) and making is self._making

    def set_refine(self, on: bool) -> None:
        """Whether garments are taken out of the body."""
        with self._turns.work:
            if on != self.refine:
                with self._edit(f"refinement {'on' if on else 'off'}"):
                    self._making.refine = on

    def use_garment(self, name: str) -> list[int]:
        """Another garment. Keyframes that are materials go with it; other ones it cannot know.

        Returns:
            Frames of the keyframes that were given up.
        """
        self._wardrobe.load(name)
        with self._edit(f"garment {name}"):
            keys, given_up = self._keys.in_garment(self._composer(replace(self._state(), garment=name)))
            self._begin(keys, self.refine)
        return given_up

    def use_shape(self, wanted: Sequence[float]) -> None:
        """Another body in the same motion, with the same keyframes. Moved without a pause, it is one edit.

        Args:
            wanted: A coefficient for each of ``shapes.ends`` [standard deviations].

        Raises:
            ValueError: The run's models know one body, or none that is so far out; says between what.
        """
        shape = self.shapes.checked(wanted)
        with self._edit("body shape", None, "body shape"):
            present = self._state()
            self._begin(
                self._keys.on_body(self._wardrobe.composer(present.garment, present.clip, shape)), present.refine
            )

    def use_clip(self, clip: Clip) -> None:
        """Another motion, of the run's own body. Keyframes stay what they are, at the same share of its length.

        Raises:
            ValueError: It is too long or too short.
        """
        checked_length(clip)
        with self._edit(f"motion {clip.name}"):
            present = self._state()
            self._begin(
                self._keys.in_motion(self._wardrobe.composer(present.garment, clip, present.shape)), present.refine
            )

    def plant_feet(self) -> tuple[float, float]:
        """The same motion with feet that neither slide nor sink into the ground (``motions.planting``), and the same
        keyframes.

        Returns:
            How fast feet that touch the ground slid before and slide now [m/s], in 99% of the frames.
        """
        with self._edit("feet planted"):
            present, own = self._state(), self.run.body
            clip = planted(present.clip, own)
            composer = self._wardrobe.composer(present.garment, clip, present.shape)
            self._begin(self._keys.on_body(composer), present.refine)
        before, after = (measure(one, own).skate_m_s for one in (present.clip, clip))
        return before, after

    def undo(self) -> Step[State]:
        """Take the last edit back; ``ValueError`` where there is none."""
        return self._stepped(self._history.undo)

    def redo(self) -> Step[State]:
        """Make the edit again that was undone last; ``ValueError`` where there is none."""
        return self._stepped(self._history.redo)

    def animation(self) -> Animation:
        """All of it, to be saved; frames that are stale are made first."""
        while True:
            self.remake()
            with self._turns.work:
                if not self._making.all_made:
                    continue
                notes: dict[str, str | float] = {"solver": "composed"}
                notes |= {f"keyframe_{key.frame}": key.origin for key in self.keyframes}
                wearing, name = self._keys.composer.worn.wearing, f"{self.garment}_{self.clip.name}"
                return dressed_animation(name, self.clip, wearing, *self._making.stacked(), notes)

    @contextmanager
    def _edit(self, name: str, frame: int | None = None, held: Hashable = None) -> Iterator[None]:
        """Make an edit that can be undone; one that fails has changed nothing."""
        with self._turns.edit():
            before = self._state()
            yield
            self._making.edited()
            self._history.record(name, before, frame, held)

    def _state(self) -> State:
        worn = self._keys.composer.worn
        return State(self.garment, worn.given, worn.shape, self._keys.all, self._keys.materials, self.refine)

    def _composer(self, state: State) -> Composer:
        """Garment, motion and body of a state, without its keyframes."""
        return self._wardrobe.composer(state.garment, state.clip, state.shape)

    def _stepped(self, take: Callable[[State], Step[State]]) -> Step[State]:
        with self._turns.edit():
            step = take(self._state())
            self._restore(step.state)
        return step

    def _restore(self, state: State) -> None:
        composer, present = self._keys.composer, self._state()
        if present.garment != state.garment or present.clip is not state.clip or present.shape is not state.shape:
            composer = self._composer(state)
        composer.use(state.keyframes)
        self._begin(Keys(composer, state.materials), state.refine)

    def _begin(self, keys: Keys, refine: bool) -> None:
        """Make what these keyframes give, in place of what was made."""
        if self._making is not None:
            self._making.edited()  # whoever makes it, stops
        refiners = self._wardrobe.refiners(keys.composer.space.garment.name)
        self._keys, self._making = keys, Making(keys.composer, refine, self._turns, refiners)

    def _check_frame(self, frame: int) -> None:
        if not 0 <= frame < self.frames:
            raise ValueError(f"frame {frame} is outside of the motion, whose frames are 0 to {self.frames - 1}")
