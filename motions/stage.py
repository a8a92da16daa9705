"""The stage a family of motions works on: a calm standing performance, a manner, a few shared moves."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from motions.arms import ArmPose, ArmTrack, arm_pose
from motions.feet import FootPlan, Step
from motions.figure import SIDES, Figure
from motions.performance import Performance, Trunk
from motions.style import Style
from motions.timing import slow_noise, transition

CALM_SECONDS = 0.1  # nothing moves before: frame 0 of every clip is a calm stance
STANDING_DROP = 0.012  # [m] the pelvis of a relaxed stance hangs lower than that of the stretched zero pose


class Stage:
    """A performance under construction.

    Attributes:
        times: Times of the frames [s], shape [T].
        style: Manner of the variant.
        figure: Measurements of the body.
        generator: Random numbers of the variant, for what the style does not cover.
        performance: The curves, a calm standing person at first.
    """

    def __init__(self, times: np.ndarray, style: Style, figure: Figure, generator: np.random.Generator) -> None:
        self.times, self.style, self.figure, self.generator = times, style, figure, generator
        frames = len(times)
        self.relaxed = relaxed_arm(style)
        feet = []
        for side in range(2):
            ankle = figure.feet[side].ankle
            feet.append(
                FootPlan(figure.feet[side], (ankle[0] * style.stance, ankle[2]), self.outward(side) * style.toe_out)
            )
        spine, head = Trunk.straight(frames), Trunk.straight(frames)
        spine.bend += style.slouch
        head.bend += style.nod - 0.5 * style.slouch
        self.performance = Performance(
            times=times,
            place=np.tile(figure.joints[0][[0, 2]] + [0.0, 0.01], (frames, 1)),
            drop=np.full(frames, STANDING_DROP + style.drop),
            pelvis=Trunk.straight(frames),
            spine=spine,
            head=head,
            feet=(feet[0], feet[1]),
            arms=(ArmTrack.held(self.relaxed, frames), ArmTrack.held(self.relaxed, frames)),
            knees_out=np.full(frames, 0.04),
            hang=np.full(frames, 0.85),
        )
        self._be_alive()

    @staticmethod
    def outward(side: int) -> float:
        """+1 for the left (0), -1 for the right (1): the sign of outward along x."""
        return 1.0 if side == 0 else -1.0

    def leading(self, side: str | None = None) -> int:
        """Index of the side that a family starts with: the named one, or the style's own when None."""
        return SIDES.index(side) if side else (0 if self.style.side > 0 else 1)

    @property
    def duration(self) -> float:
        """Time of the last frame [s]."""
        return float(self.times[-1])

    def seconds(self, neutral: float) -> float:
        """A duration at the variant's tempo [s]."""
        return neutral / self.style.tempo

    def repeats(self, period: float, start: float = CALM_SECONDS) -> list[float]:
        """Start times [s] of a movement that is repeated until the clip ends."""
        count = max(1, int(np.ceil((self.duration - start) / period)))
        return [start + index * period for index in range(count)]

    def beside(self, side: int, ahead: float = 0.0, outward: float = 0.0) -> tuple[float, float]:
        """Ground position (x, z) of a foot, moved from where its plan begins [m]."""
        x, z = self.performance.feet[side].place
        return x + self.outward(side) * outward, z + ahead

    def arm_course(self, side: int, keys: Sequence[tuple[float, ArmPose]]) -> None:
        """Move an arm from its relaxed pose through keyed poses; keys are (time [s], pose)."""
        self.performance.arms[side].follow(self.times, [(CALM_SECONDS, self.relaxed), *keys])

    def shift_weight(self, towards: int, amount: np.ndarray) -> None:
        """Move the pelvis towards a foot: 0 stays in the middle, 1 stands over that foot, shape [T]."""
        (x, z), _ = self.performance.feet[towards].standing_at()
        self.performance.place += amount[:, None] * (np.array([x, z + 0.02]) - self.performance.place[0])
        self.performance.pelvis.lean -= 0.05 * self.outward(towards) * amount
        self.performance.spine.lean += 0.05 * self.outward(towards) * amount

    def step(
        self, side: int, start: float, duration: float, place: tuple[float, float], yaw: float, **swing: float
    ) -> None:
        """Add a step of a foot; see :class:`motions.feet.Step` for the other values."""
        height = swing.pop("height", 0.06)
        self.performance.feet[side].steps.append(Step(start, start + duration, place, yaw, height, **swing))

    def raise_heel(self, side: int, angle: np.ndarray) -> None:
        """Let a standing foot roll on its ball by an angle [rad], shape [T], that is zero around its steps."""
        plan = self.performance.feet[side]
        plan.heel = angle if plan.heel is None else plan.heel + angle

    def balance(self, share: float = 0.45, seconds: float = 0.12) -> None:
        """Let the pelvis follow the supporting feet, after all steps are planned; `share` of the way to them."""
        tracks = tuple(plan.track(self.times) for plan in self.performance.feet)
        support = self.performance.support(tracks, seconds)
        both = np.mean([track.ankle[:, [0, 2]] for track in tracks], axis=0)
        begun = transition(self.times, 0.0, 0.25)[:, None]
        self.performance.place += begun * share * self.style.sway * (support - both)

    def _be_alive(self) -> None:
        """Breathing and small unsteadiness of trunk, head and arms."""
        noise = slow_noise(self.times, self.generator, 14) * self.style.noise
        trunk = self.performance
        for column, curve in enumerate((trunk.spine.bend, trunk.spine.turn, trunk.spine.lean)):
            curve += noise[:, column]
        for column, curve in enumerate((trunk.head.bend, trunk.head.turn, trunk.head.lean), 3):
            curve += 1.5 * noise[:, column]
        for side, arm in enumerate(trunk.arms):
            arm.swing += 1.5 * noise[:, 6 + 2 * side]
            arm.spread += 0.7 * np.abs(noise[:, 7 + 2 * side])
        trunk.place += 0.15 * noise[:, 10:12]


def relaxed_arm(style: Style) -> ArmPose:
    """The hanging arm of a standing person: a little away from the body, elbow soft, palm to the thigh."""
    spread, elbow = style.spread, style.elbow
    upper = (np.sin(spread), -np.cos(spread), -0.06)
    # The forearm swings ahead and stays as far out as the upper arm, so that the hand keeps clear of a skirt.
    fore = (np.sin(0.75 * spread) * np.cos(elbow), -np.cos(0.75 * spread) * np.cos(elbow), np.sin(elbow) - 0.06)
    return arm_pose(upper, fore, twist=0.1)


Family = Callable[..., None]
"""A family of motions: takes a :class:`Stage` and its own options, changes the performance in place."""
