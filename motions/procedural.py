"""Embedded labelled motions: a label is a family with its options and a mood, a variant a draw of the manner.

Any number of variants exists, each a function of (label, variant, seed) alone, so that asking for more clips never
changes the others. All clips begin as a calm stance; feet do not slide; joint speeds stay below ``MAX_JOINT_SPEED``.
"""

from __future__ import annotations

import zlib
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from body.model import Body
from motions.clip import Clip
from motions.families import dance, exercise, gait, gesture, jump, strike
from motions.figure import Figure
from motions.performance import solve
from motions.quality import joint_velocity
from motions.stage import Stage
from motions.style import draw_style

MAX_JOINT_SPEED = 15.0  # [rad/s]; faster joints are rare outside of sports
SLOWER_TRIES = 4  # tempos tried before a variant that is too fast is slowed down as a whole


@dataclass(frozen=True)
class Recipe:
    """What a label means: a family with options, and the mood in which it is done."""

    family: Callable[..., None]
    options: dict[str, Any] = field(default_factory=dict)
    mood: str = "neutral"


def _recipe(family: Callable[..., None], mood: str = "neutral", **options: Any) -> Recipe:
    return Recipe(family, options, mood)


_DEFAULT: dict[str, Recipe] = {
    "walk": _recipe(gait.travel, gait="walk"),
    "wave-left": _recipe(gesture.wave, side="left"),
    "squat": _recipe(exercise.squat),
    "dance-sway": _recipe(dance.sway),
    "jump": _recipe(jump.hop),
    "turn-left": _recipe(gait.travel, gait="turn", direction="left"),
    "run": _recipe(gait.travel, gait="run"),
    "bow": _recipe(exercise.bow),
    "twist": _recipe(exercise.twist),
    "raise-arms": _recipe(gesture.raise_arms, way="side"),
    "sidestep-left": _recipe(gait.travel, gait="sidestep", direction="left"),
    "kick": _recipe(strike.kick, way="front"),
    "march": _recipe(gait.travel, gait="march"),
    "wave-right": _recipe(gesture.wave, side="right"),
    "dance-step": _recipe(dance.side_steps),
    "jumping-jack": _recipe(jump.hop, spread=0.2, arms="jack", height=0.09, crouch=0.1, pause=0.0),
    "walk-back": _recipe(gait.travel, gait="walk-back"),
    "throw": _recipe(strike.throw, way="over"),
    "turn-right": _recipe(gait.travel, gait="turn", direction="right"),
    "lunge": _recipe(exercise.lunge, way="front"),
    "stretch": _recipe(gesture.stretch, way="up"),
    "sidestep-right": _recipe(gait.travel, gait="sidestep", direction="right"),
    "punch": _recipe(strike.punch),
    "hip-circle": _recipe(exercise.trunk_circle, part="hips"),
    "clap": _recipe(gesture.clap),
    "wave-both": _recipe(gesture.wave, side="both"),
    "sneak": _recipe(gait.travel, gait="sneak"),
    "walk-fast": _recipe(gait.travel, gait="walk-fast"),
}

_FURTHER: dict[str, Recipe] = {
    "walk-slow": _recipe(gait.travel, gait="walk-slow"),
    "walk-happy": _recipe(gait.travel, "happy", gait="walk"),
    "walk-sad": _recipe(gait.travel, "sad", gait="walk"),
    "walk-angry": _recipe(gait.travel, "angry", gait="walk"),
    "walk-proud": _recipe(gait.travel, "proud", gait="stride"),
    "walk-tired": _recipe(gait.travel, "tired", gait="walk"),
    "walk-turn-left": _recipe(gait.travel, gait="walk-curve", direction="left"),
    "walk-turn-right": _recipe(gait.travel, gait="walk-curve", direction="right"),
    "walk-in-place": _recipe(gait.travel, gait="walk-in-place"),
    "sleepwalk": _recipe(gait.travel, "tired", gait="walk-slow", hands="ahead"),
    "tiptoe": _recipe(gait.travel, gait="tiptoe"),
    "stomp": _recipe(gait.travel, "angry", gait="stomp"),
    "jog": _recipe(gait.travel, gait="jog"),
    "run-in-place": _recipe(gait.travel, gait="run-in-place"),
    "march-in-place": _recipe(gait.travel, gait="march-in-place"),
    "spin-left": _recipe(gait.travel, gait="spin", direction="left"),
    "spin-right": _recipe(gait.travel, gait="spin", direction="right"),
    "shuffle-left": _recipe(gait.travel, gait="shuffle", direction="left", hands="guard"),
    "shuffle-right": _recipe(gait.travel, gait="shuffle", direction="right", hands="guard"),
    "wave-low": _recipe(gesture.wave, side="own", size="low"),
    "raise-front": _recipe(gesture.raise_arms, way="front"),
    "raise-left": _recipe(gesture.raise_arms, way="front", side="left"),
    "raise-right": _recipe(gesture.raise_arms, way="front", side="right"),
    "arms-forward": _recipe(gesture.raise_arms, way="forward"),
    "arms-sideways": _recipe(gesture.raise_arms, way="cross"),
    "clap-high": _recipe(gesture.clap, "happy", height="high"),
    "stretch-side": _recipe(gesture.stretch, way="side"),
    "point": _recipe(gesture.one_arm, gesture="point"),
    "salute": _recipe(gesture.one_arm, "proud", gesture="salute", side="right"),
    "beckon": _recipe(gesture.one_arm, gesture="beckon"),
    "guide": _recipe(gesture.one_arm, gesture="guide"),
    "call": _recipe(gesture.one_arm, gesture="call"),
    "slash": _recipe(gesture.one_arm, "angry", gesture="slash"),
    "reach-up": _recipe(gesture.one_arm, gesture="reach-up"),
    "push": _recipe(gesture.two_arms, gesture="push"),
    "pull": _recipe(gesture.two_arms, gesture="pull"),
    "shrug": _recipe(gesture.two_arms, gesture="shrug"),
    "cheer": _recipe(gesture.two_arms, "happy", gesture="cheer"),
    "open-arms": _recipe(gesture.two_arms, gesture="open-arms"),
    "breathe": _recipe(gesture.two_arms, gesture="breathe"),
    "arm-circles": _recipe(gesture.circle_arms),
    "arm-circles-back": _recipe(gesture.circle_arms, direction=-1),
    "crawl-stroke": _recipe(gesture.circle_arms, alternate=True),
    "look-around": _recipe(gesture.look_around),
    "squat-pulse": _recipe(exercise.squat, depth=0.2, period=0.95, hold=0.0, arms="rest"),
    "squat-hold": _recipe(exercise.squat, depth=0.42, period=3.0, hold=1.1),
    "bow-deep": _recipe(exercise.bow, angle=1.4, hold=0.7),
    "nod-bow": _recipe(exercise.bow, angle=0.35, hold=0.1),
    "curtsy": _recipe(exercise.bow, angle=0.3, hold=0.4, style="curtsy"),
    "jump-forward": _recipe(jump.hop, ahead=0.4, height=0.16),
    "jump-turn": _recipe(jump.hop, turn=1.2, height=0.17),
    "jump-high": _recipe(jump.hop, "happy", height=0.34, crouch=0.32),
    "skip-rope": _recipe(jump.hop, height=0.06, crouch=0.07, pause=0.0, arms="rope"),
    "hop-one-leg": _recipe(jump.hop, height=0.08, crouch=0.1, legs="one", arms="rest", pause=0.0),
    "punch-left": _recipe(strike.punch, arms="left"),
    "punch-right": _recipe(strike.punch, arms="right"),
    "hook": _recipe(strike.punch, way="hook"),
    "uppercut": _recipe(strike.punch, way="uppercut"),
    "kick-left": _recipe(strike.kick, way="front", side="left"),
    "kick-right": _recipe(strike.kick, way="front", side="right"),
    "kick-side": _recipe(strike.kick, way="side"),
    "kick-back": _recipe(strike.kick, way="back"),
    "knee-raise": _recipe(strike.kick, way="knee"),
    "throw-under": _recipe(strike.throw, way="under"),
    "lunge-side": _recipe(exercise.lunge, way="side"),
    "lunge-back": _recipe(exercise.lunge, way="back"),
    "trunk-circle": _recipe(exercise.trunk_circle, part="trunk"),
    "bend-side": _recipe(exercise.bend, way="side"),
    "touch-toes": _recipe(exercise.bend, way="toes"),
    "pick-up": _recipe(exercise.bend, way="pick"),
    "bend-back": _recipe(exercise.bend, way="back"),
    "twist-spread": _recipe(exercise.twist, arms="spread"),
    "twist-hips": _recipe(exercise.twist, arms="hips"),
    "balance": _recipe(exercise.balance_on_one_leg),
    "dance-high": _recipe(dance.sway, "happy", arms="high"),
    "dance-two-step": _recipe(dance.side_steps, "happy", steps=2, arms="clap"),
    "dance-kick": _recipe(dance.side_steps, "happy", kick=True),
    "dance-twist": _recipe(dance.twist_dance),
    "dance-disco": _recipe(dance.disco, "happy"),
    "dance-box": _recipe(dance.box_step),
    "dance-robot": _recipe(dance.robot),
    "dance-cha-cha": _recipe(dance.cha_cha),
    "dance-wave": _recipe(dance.arm_wave),
}

_RECIPES = _DEFAULT | _FURTHER

DEFAULT_LABELS: tuple[str, ...] = tuple(_DEFAULT)
"""Labels of an ordinary run; any first part of the list is a varied selection."""

LABELS: tuple[str, ...] = tuple(_RECIPES)
"""All labels, at least the 66 of Shi et al. 2023; the default ones first."""


def generate_clip(label: str, variant: int, frames: int, fps: float, seed: int, body: Body) -> Clip:
    """One labelled clip.

    Args:
        label: One of ``LABELS``.
        variant: Number of the variant, from 0; every variant is done in another manner.
        frames: Number of frames T.
        fps: Frames per second [Hz].
        seed: Seed of the whole set of clips.
        body: Body whose proportions the motion is made for; it stands on the ground y = 0.

    Returns:
        A clip whose take is its own name; the same arguments give the same clip.

    Raises:
        ValueError: Unknown label, negative variant or seed, fewer than 2 frames.
    """
    if label not in _RECIPES:
        raise ValueError(f"unknown motion label {label!r}; known are {', '.join(LABELS)}")
    if variant < 0 or seed < 0:
        raise ValueError(f"variant and seed count from 0, got variant {variant} and seed {seed}")
    if frames < 2 or not 1.0 <= fps <= 480.0:
        raise ValueError(f"a clip needs at least 2 frames and 1 to 480 frames a second, got {frames} and {fps}")
    times = np.arange(frames) / fps
    figure = Figure.of(body)
    tempo = 1.0
    for _ in range(SLOWER_TRIES):
        pose, root = _perform(label, variant, times, seed, figure, tempo)
        fastest = float(np.linalg.norm(joint_velocity(pose, fps), axis=-1).max())
        if fastest <= MAX_JOINT_SPEED:
            break
        tempo *= max(0.75, 0.96 * MAX_JOINT_SPEED / fastest)
    else:
        # What gravity times (a landing) does not follow the tempo: the whole clip is played slower.
        pose, root = _perform(label, variant, times * 0.95 * MAX_JOINT_SPEED / fastest, seed, figure, tempo)
    name = f"{label}_{variant:03d}"
    return Clip(name=name, take=name, label=label, pose=pose, root=root, fps=fps, source="procedural")


def _perform(
    label: str, variant: int, times: np.ndarray, seed: int, figure: Figure, tempo: float
) -> tuple[np.ndarray, np.ndarray]:
    """Pose and root of a variant, done slower by the factor `tempo`."""
    recipe = _RECIPES[label]
    generator = np.random.default_rng([seed, variant, zlib.crc32(label.encode())])
    style = draw_style(generator, recipe.mood)
    stage = Stage(times, replace(style, tempo=style.tempo * tempo), figure, generator)
    recipe.family(stage, **recipe.options)
    return solve(stage.performance, figure)
