"""Motion signatures whose rows are made when they are asked for.

In: the motions of sequences. Out: what a network is told about the motion up to a frame, a row a frame. A history of
100 frames of 24 joints is 7,272 numbers, nearly all of which the next frame has again: kept as rows, they would fill
the memory; made for a batch, they cost less than the network's first layer. Two kinds:

- ``joints``: joints of the current and all past frames of the window in the pelvis frame of the current frame, newest
  first (Wang 2019, section 3.1);
- ``features``: the ``motion`` features of ``models.motion_features``, which know where down is and how fast the pelvis
  travels, of the current and of some past frames, closer together near the present.

Both look into the lead-in; before its first frame the body stood still.
"""

from __future__ import annotations

from collections.abc import Sequence as Many

import numpy as np

from models.motion_features import MotionTrack, track_features

KINDS = ("joints", "features")
PAST = (0, 1, 2, 3, 5, 8, 12, 18, 27, 40, 60, 80, 100)
"""Frames looked back by ``features``, as far as the window reaches."""


class MotionHistory:
    """Signatures of the wanted frames of tracks, one after another; indexed like an array of shape [N, D].

    Args:
        tracks: Motions with their lead-in.
        kind: One of ``KINDS``.
        window: Frames looked back, W.
    """

    def __init__(self, tracks: Many[MotionTrack], kind: str, window: int) -> None:
        if kind not in KINDS:
            raise ValueError(f"motion signature {kind!r} is not one of {', '.join(KINDS)}")
        if window < 0 or not tracks:
            raise ValueError("motion history: needs at least one track and a window of 0 frames or more")
        self.kind = kind
        self._offsets = np.arange(window + 1) if kind == "joints" else np.array([o for o in PAST if o <= window])
        lengths = np.array([len(t.pose) for t in tracks])
        starts = np.concatenate([[0], np.cumsum(lengths)[:-1]])
        self._now = np.concatenate([s + t.lead + np.arange(t.frames) for s, t in zip(starts, tracks)])
        self._first = np.repeat(starts, [t.frames for t in tracks])
        if kind == "features":
            self._rows = np.concatenate([track_features(t, "motion") for t in tracks])
        else:
            self._rows = np.concatenate([t.joints for t in tracks]).astype(np.float32)
            frames = [t.pelvis_frames() for t in tracks]
            self._rotation = np.concatenate([r for r, _ in frames]).astype(np.float32)
            self._position = np.concatenate([p for _, p in frames]).astype(np.float32)

    @property
    def shape(self) -> tuple[int, int]:
        """(N, D)."""
        return len(self._now), len(self._offsets) * int(np.prod(self._rows.shape[1:]))

    def __len__(self) -> int:
        return len(self._now)

    def __getitem__(self, index: np.ndarray | slice) -> np.ndarray:
        """Signatures [B, D] float32 of the frames that ``index`` names."""
        now, first = self._now[index], self._first[index]
        rows = self._rows[np.maximum(now[:, None] - self._offsets, first[:, None])]
        if self.kind == "features":
            return rows.reshape(len(now), -1)
        centred = (rows - self._position[now][:, None, None]).reshape(len(now), -1, 3)
        return np.matmul(centred, self._rotation[now]).reshape(len(now), -1)

    def take(self, index: np.ndarray, axis: int = 0) -> MotionHistory:
        """The history of the given frames alone; it shares the motions with this one."""
        part = object.__new__(MotionHistory)
        part.__dict__.update(self.__dict__)
        part._now, part._first = self._now[index], self._first[index]
        return part
