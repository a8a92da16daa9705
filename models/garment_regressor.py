"""Garment regressor: from a body motion to a sequence of garment shapes (Shi 2023, section 3.3).

In: a ``MotionTrack``. Out: garment vertices in the canonical (pelvis) frame. The variants stand in ``VARIANTS``:

- ``paper``: encoder over all poses, causal decoder over all vertices of the past frames, a start token (BOS) that an
  MLP gives from the mean pose and that was trained against the sequence's last frame; teacher forcing.
- ``paper-fixed-bos``: the same with a start token of zeros (Table 9).
- ``steady``: the same encoder and decoder, causal and by distance, over principal coefficients and ``motion`` features,
  correcting a network that goes straight from the motion to the shape.
  In training the decoder sees its own free-running roll-out, noised, in place of the true past with a share that rises
  to ``rollout_share``: under teacher forcing alone errors grow along the sequence, because the network never sees them.
- ``window``: no garment state at all: an MLP from the motion of the last 0.7 s (at 30 Hz), corrected by kernel ridge
  regression of what it left over of its training set.
- ``gru``: no garment state either, but a learned memory of the motion.

``models.sequence_regressor`` holds the network of the first three, ``models.window_regressor`` and
``models.recurrent_regressor`` those of the others, and ``models.garment_fitting`` trains and stores any of them.
``paper`` looks at a whole segment, future poses included, and is given longer motions in segments, each with a start
token of its own, as its authors do; the others are causal and take sequences of any length as a whole.

Dimensions: B sequences, L lead-in and T wanted frames, D features, K code size (3 V or the principal coefficients).
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
import torch
from torch import Tensor, nn

from models.motion_features import FEATURE_KINDS, MotionTrack, track_features
from models.shape_code import ShapeCode


@dataclass(frozen=True)
class RegressorConfig:
    """Sizes and training choices; the defaults are the paper's.

    Attributes:
        vertices: Garment vertices V.
        variant: Key of ``VARIANTS`` that this config was made from; "custom" for none.
        features: Kind of motion features, see ``models.motion_features``.
        components: Principal coefficients of the shape code; 0 = all coordinates.
        decoder: "transformer", "window" or "gru".
        width, layers, heads, feed_forward, dropout: Of the Transformer encoder and decoder (paper: M = 2); of the GRU
            the first two.
        bos_hidden: Hidden layers of the BOS network.
        bos_target: Frame that the BOS network is trained against: "last" of the current sequence (paper) or "first";
            "none": the start token is zero, which is the mean shape.
        attention_window: Frames that attention reaches back; 0 = absolute positions, whole segment, future poses seen.
        input_noise: Noise on the past shapes in training, as a fraction of their spread.
        rollout_share: Share of past frames taken from the model's own roll-out at the end of training; 0 = teacher
            forcing.
        laplacian_weight: Weight of the Laplacian term (lambda_Lap).
        window_offsets: Frames into the past whose features enter a frame's input; (0,) = the frame alone (paper).
        window_hidden: Hidden layers of the network that goes straight from the motion to the shape: all of the window
            variant; in the Transformer a path beside the decoder, which then only corrects it. () = none (paper).
        centres: Training frames, at most, that the window variant's kernel correction stands on; 0 = no correction.
        segment: Frames that a longer motion is cut into; 0 = never cut. Training sets it where positions are absolute.
    """

    vertices: int
    variant: str = "custom"
    features: str = "pose"
    components: int = 0
    decoder: str = "transformer"
    width: int = 256
    layers: int = 2
    heads: int = 4
    feed_forward: int = 512
    dropout: float = 0.1
    bos_hidden: tuple[int, ...] = (1024, 4096)
    bos_target: str = "last"
    attention_window: int = 0
    input_noise: float = 0.0
    rollout_share: float = 0.0
    laplacian_weight: float = 0.1
    window_offsets: tuple[int, ...] = (0,)
    window_hidden: tuple[int, ...] = ()
    centres: int = 0
    segment: int = 0

    def __post_init__(self) -> None:
        # A config read back from a file holds lists where it held tuples.
        for name in ("bos_hidden", "window_offsets", "window_hidden"):
            object.__setattr__(self, name, tuple(getattr(self, name)))
        for name, allowed in (
            ("features", tuple(FEATURE_KINDS)),
            ("decoder", ("transformer", "window", "gru")),
            ("bos_target", ("last", "first", "none")),
        ):
            if getattr(self, name) not in allowed:
                raise ValueError(f"regressor {name}: {getattr(self, name)!r} is not one of {', '.join(allowed)}")
        if self.window_offsets[0] != 0 or any(b <= a for a, b in pairwise(self.window_offsets)):
            raise ValueError(f"regressor window_offsets: must rise from 0, got {list(self.window_offsets)}")
        if self.centres < 0 or (self.centres and self.decoder != "window"):
            raise ValueError(f'regressor centres: {self.centres} with decoder {self.decoder!r}; only "window" has any')
        if not 0.0 <= self.rollout_share <= 1.0:
            raise ValueError(f"regressor rollout_share: must be in [0, 1], got {self.rollout_share}")


# Denser near the present: what a garment remembers fades. Reaching back 24 or 44 frames was no better on a skirt.
RECENT_PAST = (0, 1, 2, 3, 5, 8, 12)

# By kind of features: 6-D rotations; joints in metres, where a smaller one makes millimetres of the feet as weighty as
# decimetres of the arms, and a window's correction takes for unlike what a garment cannot tell apart.
_LEAST_SPREAD = {"pose": 0.05, "motion": 0.1}

VARIANTS: dict[str, dict] = {
    "paper": {},
    "paper-fixed-bos": {"bos_target": "none"},
    "steady": {
        "features": "motion",
        "components": 128,
        "attention_window": 32,
        "window_offsets": RECENT_PAST,
        "bos_hidden": (256, 256),
        "bos_target": "first",
        "window_hidden": (512, 512),
        "input_noise": 0.1,
        "rollout_share": 0.8,
    },
    "window": {
        "features": "motion",
        "components": 128,
        "decoder": "window",
        "window_offsets": (*RECENT_PAST, 20),
        "window_hidden": (640, 640, 640),
    },
    "gru": {"features": "motion", "components": 128, "decoder": "gru", "layers": 1, "width": 384},
}


def variant_config(name: str, vertices: int, **overrides) -> RegressorConfig:
    """Config of a named variant for a garment of ``vertices`` vertices, with single values changed by ``overrides``."""
    if name not in VARIANTS:
        raise ValueError(f"unknown regressor variant {name!r}; known: {', '.join(VARIANTS)}")
    # No more components than coordinates, so that a tiny garment needs no setting of its own.
    values = {"components": min(VARIANTS[name].get("components", 0), 3 * vertices)}
    return replace(RegressorConfig(vertices), **{**VARIANTS[name], **values, "variant": name, **overrides})


class Regressor(nn.Module, ABC):
    """What every variant shares: feature scaling, shape code, and dressing a motion."""

    def __init__(self, config: RegressorConfig, faces: np.ndarray) -> None:
        super().__init__()
        self.config = config
        self.feature_size = FEATURE_KINDS[config.features]
        self.register_buffer("feature_mean", torch.zeros(self.feature_size))
        self.register_buffer("feature_scale", torch.ones(self.feature_size))
        self.input_size = self.feature_size * len(config.window_offsets)
        self.shape = ShapeCode(config.vertices, config.components, faces)

    def set_feature_scaling(self, features: np.ndarray) -> None:
        """Take mean and spread of training features [N, D]; those that hardly vary keep a floor."""
        self.feature_mean.copy_(torch.as_tensor(features.mean(0)))
        self.feature_scale.copy_(torch.as_tensor(features.std(0)).clamp_min(_LEAST_SPREAD[self.config.features]))

    def features(self, track: MotionTrack) -> Tensor:
        """Scaled features [L + T, D] of a track, on the module's device."""
        raw = torch.as_tensor(track_features(track, self.config.features), device=self.feature_mean.device)
        # Beyond 6 spreads there was no training data: held there, rather than extrapolated.
        return ((raw - self.feature_mean) / self.feature_scale).clamp(-6.0, 6.0)

    def windows(self, features: Tensor) -> Tensor:
        """Features of each frame and its past ones side by side, [B, F, offsets * D], of features [B, F, D].

        Before the first frame of the track the body stood still: its features are repeated.
        """
        if len(self.config.window_offsets) == 1:
            return features
        offsets = torch.tensor(self.config.window_offsets, device=features.device)
        index = (torch.arange(features.shape[1], device=features.device)[:, None] - offsets).clamp_min(0)
        return features[:, index].flatten(2)

    def direct_network(self) -> nn.Sequential:
        """Fully connected network from windows [..., offsets * D] to codes [..., K], as ``window_hidden`` says."""
        c = self.config
        sizes = (self.input_size, *c.window_hidden)
        layers: list[nn.Module] = []
        for before, after in pairwise(sizes):
            layers += [nn.Linear(before, after), nn.GELU(), nn.Dropout(c.dropout)]
        return nn.Sequential(*layers, nn.Linear(sizes[-1], self.shape.size))

    @abstractmethod
    def unroll(self, features: Tensor, lead: int) -> Tensor:
        """Free-running codes [B, T, K] of scaled features [B, L + T, D]."""

    @torch.no_grad()
    def dress(self, track: MotionTrack) -> np.ndarray:
        """Canonical garment vertices [m], shape [T, V, 3] float32, of one motion, without looking at any truth."""
        return self.dress_all([track])[0]

    @torch.no_grad()
    def dress_all(self, tracks: list[MotionTrack], batch: int = 16) -> list[np.ndarray]:
        """``dress`` for many motions; those of equal length and lead-in are decoded side by side."""
        segment = self.config.segment
        if segment and any(track.frames > segment for track in tracks):
            pieces = [_segments(track, segment) for track in tracks]
            dressed = iter(self.dress_all([piece for some in pieces for piece in some], batch))
            return [np.concatenate([next(dressed) for _ in some]) for some in pieces]
        was_training = self.training
        self.eval()
        groups: dict[tuple[int, int], list[int]] = {}
        for number, track in enumerate(tracks):
            groups.setdefault((len(track.pose), track.lead), []).append(number)
        dressed: list[np.ndarray] = [np.empty(0)] * len(tracks)
        for (_, lead), numbers in groups.items():
            for start in range(0, len(numbers), batch):
                chosen = numbers[start : start + batch]
                codes = self.unroll(torch.stack([self.features(tracks[n]) for n in chosen]), lead)
                for number, vertices in zip(chosen, self.shape.decode(codes).cpu().numpy(), strict=True):
                    dressed[number] = vertices
        self.train(was_training)
        return dressed


def _segments(track: MotionTrack, length: int) -> list[MotionTrack]:
    """The wanted frames of a track in pieces of at most ``length`` frames, without lead-in."""
    first = range(track.lead, len(track.pose), length)
    return [MotionTrack(track.pose[a : a + length], track.joints[a : a + length], 0, track.fps) for a in first]
